"""SOLVE, problems with modes: multipliers of their mode sequences, and what they say of the map as a whole."""
