"""The least horizon at which a problem is feasible."""
