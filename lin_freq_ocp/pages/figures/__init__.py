"""Figures of results, comparisons and sweeps; they need no display and change no global setting."""
