"""Benchmarks, one file each: ``main(arguments)`` prints its tables. They are started by scripts/benchmark.py."""
