"""SOLVE, with our own methods: a problem becomes a Candidate, a trajectory with multipliers but never a verdict."""
