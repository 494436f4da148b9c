"""The side of the coefficients that frequency constraints keep."""
