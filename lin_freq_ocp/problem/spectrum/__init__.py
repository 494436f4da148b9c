"""Frequency constraints: bands of frequencies, and bounds on magnitude and energy."""
