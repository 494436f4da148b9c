"""The loops of the structured method, compiled by numba."""
