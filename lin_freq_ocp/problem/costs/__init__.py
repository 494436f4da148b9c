"""Quadratic costs and norms."""
