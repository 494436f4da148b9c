"""Runs and sweeps as files: the problem, its options, results and environment."""
