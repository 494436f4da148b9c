"""What is made of a problem: reduced and sampled problems with the way back, limits, sizes, simulations, starts."""
