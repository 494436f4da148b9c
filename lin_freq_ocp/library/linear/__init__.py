"""Benchmarks with linear dynamics, each with its source."""
