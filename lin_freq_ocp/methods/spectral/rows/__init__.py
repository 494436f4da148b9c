"""Pointwise rows: the working set, violated rows, and responses of all or of nearby rows."""
