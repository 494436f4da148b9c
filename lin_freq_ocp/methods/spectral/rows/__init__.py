"""Pointwise rows: those of the working set, those that a point violates, and responses of all or nearby ones."""
