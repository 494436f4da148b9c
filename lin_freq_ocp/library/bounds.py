"""Bounds that lie symmetrically about zero."""

from __future__ import annotations

from lin_freq_ocp.problem.arrays import Bound
from lin_freq_ocp.problem.sets import Box


def symmetric(bounds: Bound) -> Box:
    """Return the box of all v with |v_i| <= bounds_i; None where there is no bound."""
    limit = Box(None, bounds).upper
    return Box(-limit, limit)
