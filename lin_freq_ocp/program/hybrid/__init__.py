"""Relaxations and mixed-integer programs of problems with modes."""
