"""Largest values over parameter sets, with proof."""
