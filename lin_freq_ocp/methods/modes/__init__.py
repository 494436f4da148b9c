"""Search over the mode sequences of piecewise-affine problems."""
