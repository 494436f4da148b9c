"""Benchmarks with piecewise-affine and piecewise-smooth dynamics, each with its source."""
