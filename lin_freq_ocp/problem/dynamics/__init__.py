"""Linear, piecewise-affine and piecewise-smooth dynamics."""
