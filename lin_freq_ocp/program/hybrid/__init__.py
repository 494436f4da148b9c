"""Piecewise-affine problems as mixed-integer programs and as convex relaxations."""
