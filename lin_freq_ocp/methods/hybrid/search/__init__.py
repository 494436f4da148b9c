"""Mode sequences of piecewise-affine problems: enumeration, branch and bound, and multipliers where modes meet."""
