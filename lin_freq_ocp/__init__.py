"""Discrete-time optimal control with constraints in time and in frequency, with a certificate for every answer."""
