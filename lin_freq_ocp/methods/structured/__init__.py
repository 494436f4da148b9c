"""An interior-point method over stages and frequencies: Riccati recursions, and coupling rows by their smaller side."""
