"""JUDGE: sees the problem, a trajectory and multipliers, from any source; never how they were found."""
