"""Pointwise constraint sets."""
