"""The judge of dynamics with modes and kinks, and their global bounds."""
