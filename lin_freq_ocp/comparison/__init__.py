"""Filters and input shapers, compared with the solution under the frequency constraint."""
