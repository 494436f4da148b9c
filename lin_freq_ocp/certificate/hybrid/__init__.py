"""Conditions and bounds of problems with modes: the joint inclusion where modes meet."""
