"""Smooth nonlinear dynamics: a primal-dual barrier method with exact second derivatives on the structured systems."""
