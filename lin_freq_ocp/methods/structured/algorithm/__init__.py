"""The homogeneous self-dual embedding, its cones, and the exchange of mask points."""
