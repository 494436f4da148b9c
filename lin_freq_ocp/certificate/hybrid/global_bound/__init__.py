"""Global lower bounds of piecewise-smooth problems, by dynamic programming with interval arithmetic."""
