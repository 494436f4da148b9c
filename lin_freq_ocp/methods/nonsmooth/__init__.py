"""Piecewise-smooth dynamics: sequential quadratic programs, a semismooth Newton method, and cells for a global bound."""
