"""Search over mode sequences of piecewise-affine problems: enumeration, branch and bound, mixed-integer solvers."""
