"""Trajectories and solutions as files and as objects of other packages."""
