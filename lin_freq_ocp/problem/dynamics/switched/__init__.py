"""Dynamics whose control switches: between levels at every sample, and at free angles."""
