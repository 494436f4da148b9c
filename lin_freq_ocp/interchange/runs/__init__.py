"""Runs and sweeps as files: the problem, its options, what it ended with, and where."""
