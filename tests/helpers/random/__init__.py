"""Random problems: each module has one family, and returns the same problem for the same seed."""
