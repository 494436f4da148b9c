"""Terms h(L(x, u)): affine maps of the trajectory, and the convex functions of their values."""
