"""An interior-point method over stages and frequencies: Riccati recursions, coupling rows in range or null space."""
