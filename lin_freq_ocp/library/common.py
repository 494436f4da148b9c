"""Helpers of the library: sampled plants, symmetric bounds, stop bands, costs without 1/2, and flags."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, pi

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import brief, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import Band, low_pass, notch, stop_band
from lin_freq_ocp.problem.spectrum.base import Constraints, FrequencyConstraint


def symmetric(parameter: str, bounds: float | Sequence[float | None] | None) -> Box:
    """Return the box of all v with |v_i| <= bounds_i; None where there is no bound."""
    if isinstance(bounds, Sequence) and not isinstance(bounds, str):
        given = [np.inf if bound is None else bound for bound in bounds]
    else:
        given = np.inf if bounds is None else bounds
    limit = real_array(parameter, given, allow_infinite=True)
    if (limit < 0).any():
        raise ProblemError(parameter, brief(bounds), "bounds of zero or above, or None for no bound")
    return Box(-limit, limit)


def sampled_plant(A: ArrayLike, B: ArrayLike, sampling_time: float, states: str, controls: str) -> LinearDynamics:
    """Return dx/dt = A x + B u, sampled by a zero-order hold; names are in one text, "angle [rad], rate [rad/s]"."""
    names = {"state_names": states.split(", "), "control_names": controls.split(", ")}
    return LinearDynamics.from_continuous(A, B, sampling_time, **names)


def notch_at(frequency: float, width_hz: float | None, component: str | None = None) -> Band | None:
    """Return the stop band around a frequency in rad/s, ``width_hz`` wide; None without a width."""
    return None if width_hz is None else notch(centre_hz=frequency / (2 * pi), width_hz=width_hz, component=component)


def low_pass_at(cutoff_hz: float | None) -> Band | None:
    """Return the low pass of all controls with this cut-off in Hz; None without one."""
    return None if cutoff_hz is None else low_pass(cutoff_hz=cutoff_hz)


# A stop band, several, bins to remove, "freq" or "none"; see ``control_band``.
Spectrum = FrequencyConstraint | str | Sequence[FrequencyConstraint | int] | None


def control_band(given: Spectrum, horizon: int) -> Constraints:
    """Return the frequency constraints that a value of the parameter ``control_spectrum`` means.

    Whole numbers are the bins to remove, "freq" the bins max(2, ceil(T/3)) <= k <= T//2 of every control; None and
    "none" are no frequency constraint.
    """
    if isinstance(given, str):
        if given == "none":
            return None
        if given != "freq":
            raise ProblemError("control_spectrum", repr(given), "'freq', a band, a list of bins, or None")
        if horizon < 4:
            raise ProblemError("control_spectrum", f"'freq' at a horizon of {horizon}", "a horizon of at least 4")
        return stop_band(bins=range(max(2, ceil(horizon / 3)), horizon // 2 + 1))
    if not isinstance(given, Sequence):
        return given
    bands = [entry for entry in given if not isinstance(entry, (int, np.integer))]
    bins = [entry for entry in given if isinstance(entry, (int, np.integer))]
    if bands and bins:
        raise ProblemError("control_spectrum", "bands and bins in one list", "either bands or bins")
    return stop_band(bins=bins) if bins else bands


def flag(parameter: str, given: object) -> bool:
    """Return True or False, or raise ProblemError naming the parameter."""
    if not isinstance(given, bool):
        raise ProblemError(parameter, brief(given), "True or False")
    return given


def sum_of_squares(Q: ArrayLike, R: ArrayLike, terminal_cost: bool, x_ref: ArrayLike = 0.0) -> QuadraticCost:
    """Return sum_{t<T} a'Q a + u'R u, a = x_t - x_ref, plus a'Q a at T with ``terminal_cost``; no 1/2 anywhere."""
    double = 2 * real_array("Q", Q)
    terminal = double if flag("terminal_cost", terminal_cost) else 0.0
    return QuadraticCost(Q=double, R=2 * real_array("R", R), P=terminal, x_ref=x_ref)
