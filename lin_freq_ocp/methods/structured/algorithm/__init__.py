"""The homogeneous self-dual embedding."""
