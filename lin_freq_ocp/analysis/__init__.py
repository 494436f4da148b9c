"""Quantities computed from a problem and a trajectory without a solver."""
