"""One problem at every point of a grid of parameters."""
