"""Piecewise-smooth dynamics: sequential quadratic programs, a semismooth Newton method, cells for a global bound."""
