"""Dynamics and controls with modes, kinks or levels, and search trees as data."""
