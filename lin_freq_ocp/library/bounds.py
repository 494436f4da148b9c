"""Bounds that lie symmetrically about zero, and stop bands around a resonance."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np

from lin_freq_ocp.arrays import brief, real_array
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import Band, notch


def symmetric(parameter: str, bounds: float | Sequence[float | None] | None) -> Box:
    """Return the box of all v with |v_i| <= bounds_i; None where there is no bound."""
    given = list(bounds) if isinstance(bounds, Sequence) and not isinstance(bounds, str) else bounds
    endless = [np.inf if bound is None else bound for bound in given] if isinstance(given, list) else given
    limit = real_array(parameter, np.inf if endless is None else endless, allow_infinite=True)
    if (limit < 0).any():
        raise ProblemError(parameter, brief(bounds), "bounds of zero or above, or None for no bound")
    return Box(-limit, limit)


def notch_at(frequency: float, width_hz: float | None, component: str | None = None) -> Band | None:
    """Return the stop band around a frequency in rad/s, ``width_hz`` wide; None without a width."""
    return None if width_hz is None else notch(centre_hz=frequency / (2 * pi), width_hz=width_hz, component=component)
