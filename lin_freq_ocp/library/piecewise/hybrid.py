"""What the piecewise-affine problems of the library share: the band of their references, and costs without 1/2."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import brief, real_array
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.spectrum.bands import stop_band

# The text that stands for the stop band of the reference values: bins max(2, ceil(T/3)) .. T//2 of all controls.
REFERENCE_BAND = "freq"
SHORTEST_BAND_HORIZON = 4  # the smallest T for which the band of the references has a bin


def control_band(given: Any, horizon: int) -> Any:
    """Return what the parameter ``control_spectrum`` of a problem stands for.

    Parameters
    ----------
    given : band, list of bands, list of whole numbers, "freq" or None
        Whole numbers are the bins to remove; "freq" the bins max(2, ceil(T/3)) <= k <= T//2 of every control. None, or
        "none", is no frequency constraint.
    horizon : int
        T.
    """
    if isinstance(given, str):
        if given == "none":
            return None
        if given != REFERENCE_BAND:
            expected = f"{REFERENCE_BAND!r}, a band, a list of bins, or None"
            raise ProblemError("control_spectrum", repr(given), expected)
        if horizon < SHORTEST_BAND_HORIZON:
            expected = f"a horizon of at least {SHORTEST_BAND_HORIZON}"
            raise ProblemError("control_spectrum", f"{REFERENCE_BAND!r} at a horizon of {horizon}", expected)
        return stop_band(bins=range(max(2, ceil(horizon / 3)), horizon // 2 + 1))
    if isinstance(given, Sequence) and given and all(isinstance(k, (int, np.integer)) for k in given):
        return stop_band(bins=given)
    return given


def flag(parameter: str, given: Any) -> bool:
    """Return True or False, or raise ProblemError naming the parameter."""
    if not isinstance(given, bool):
        raise ProblemError(parameter, brief(given), "True or False")
    return given


def sum_of_squares(Q: Any, R: Any, terminal_cost: Any, x_ref: Any = 0.0) -> QuadraticCost:
    """Return sum_{t<T} a'Q a + u'R u, a = x_t - x_ref, plus a'Q a at T with ``terminal_cost``; no 1/2 anywhere."""
    double = 2 * real_array("Q", Q)
    terminal = double if flag("terminal_cost", terminal_cost) else 0.0
    return QuadraticCost(Q=double, R=2 * real_array("R", R), P=terminal, x_ref=x_ref)
