"""Modes over time, in figures and in sentences."""
