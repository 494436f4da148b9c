"""Limits of masks, as users give them: at bins, and at every frequency of a band."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, brief, positive_number, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.spectrum.bands import Band
from lin_freq_ocp.problem.terms.limits import Limits, limits_on

SAMPLED = 64  # frequencies of an interval at which a function is evaluated, or of two points with a limit in dB
Limit = ArrayLike | Callable[[Array], ArrayLike]
NO_ZERO = (
    "A signal of finitely many samples whose spectrum vanishes on an interval is zero everywhere. Give a level above "
    "zero, or remove the bins of the horizon: the band itself instead of a MagnitudeBound."
)


def require_one_limit(limit: object, limit_db: object, reference: float | None) -> None:
    """Raise ProblemError unless there is a limit, in one of its forms."""
    if (limit is None) == (limit_db is None):
        got = "neither" if limit is None else "both"
        raise ProblemError("MagnitudeBound.limit", got, "exactly one of limit and limit_db")
    if (limit_db is None) != (reference is None):
        raise ProblemError("MagnitudeBound.reference", brief(reference), "a reference with limit_db, and only with it")


def limit_of_bins(limit: object, limit_db: ArrayLike | None, reference: float | None) -> Array:
    """Return the limit of bins as one number, (), or one for each, (bins,)."""
    field = "MagnitudeBound.limit"
    if limit_db is None:
        bound = real_array(field, limit, allow_infinite=True)
    else:
        field, level = "MagnitudeBound.limit_db", positive_number("MagnitudeBound.reference", reference)
        with np.errstate(over="ignore"):  # so high that there is no limit
            bound = np.asarray(level * 10 ** (real_array(field, limit_db) / 20))
    if bound.ndim > 1 or (bound < 0).any():
        given = limit if limit_db is None else limit_db
        raise ProblemError(field, brief(given), "one number, zero or above, or one for each bin")
    return bound


def level(
    field: str, limit: Limit | None, limit_db: ArrayLike | None, reference: float | None, band: Band | None
) -> Array:
    """Return the limit as one number, (), or as points (frequency in the band's unit, limit), (points, 2).

    Points in dB are linear over the logarithm of the frequency, and are sampled to points that are linear over it.
    """
    if limit_db is not None:
        decibels = real_array(f"{field}_db", limit_db)
        factor = positive_number("MagnitudeBound.reference", reference)
        if decibels.ndim:
            decibels = _over_logarithm(f"{field}_db", _points(f"{field}_db", decibels))
        scaled = factor * 10 ** (decibels[..., -1:] / 20) if decibels.ndim else factor * 10 ** (decibels / 20)
        found = np.hstack([decibels[:, :1], scaled]) if decibels.ndim else scaled
    elif callable(limit):
        found = _sampled(field, limit, band)
    else:
        found = real_array(field, limit)
    if found.ndim:
        found = _points(field, found)
    lowest = found[:, 1] if found.ndim else found
    if (lowest <= 0).any():
        raise ProblemError(field, f"{float(lowest.min()):g}", "a limit above zero at every frequency", NO_ZERO)
    return found


def limits_of(field: str, limit: Array, band: Band, sampling_time: float | None) -> Limits:
    """Return the limit on the closed intervals that a band removes, in rad/sample."""
    factor = 2 * np.pi * band.bins_per_unit(1, sampling_time, field)
    intervals = _intervals(field, band, factor)
    if not limit.ndim:
        return limits_on(intervals, np.zeros(1), limit.reshape(1))
    points, values = limit[:, 0] * factor, limit[:, 1]
    first, last = intervals[0][0], intervals[-1][1]
    slack = 1e-9 * np.pi  # rounding of a change of unit
    if points[0] > first + slack or points[-1] < last - slack:
        got = f"points from {limit[0, 0]:g} to {limit[-1, 0]:g} {band.unit}"
        expected = f"points from {first / factor:g} to {last / factor:g} {band.unit}, which the band removes"
        raise ProblemError(f"{field}.limit", got, expected)
    return limits_on(intervals, points, values)


def held_limits_of(field: str, limit: Array, band: Band, sampling_time: float | None) -> Limits:
    """Return the limit of a held signal on the intervals in Hz that a band removes, at w = 2 pi f h of any size.

    Beyond the last point the limit is constant; of an interval without end, there is one period of V after it.
    """
    if sampling_time is None:
        raise ProblemError(field, f"{band}, and no sampling time", "dynamics with a sampling_time in seconds, for hold")
    intervals = _without_end(band)
    if not intervals or intervals[0][0] >= intervals[-1][1]:
        raise ProblemError(f"{field}.band", str(band), "a band that removes frequencies")
    points, values = (limit[:, 0], limit[:, 1]) if limit.ndim else (np.zeros(1), limit.reshape(1))
    first = intervals[0][0]
    if limit.ndim and points[0] > first * (1 + 1e-9):
        got = f"points from {points[0]:g} Hz"
        raise ProblemError(f"{field}.limit", got, f"points from {first:g} Hz, which the band removes")
    w = 2 * np.pi * sampling_time
    ends = [
        (low, high if np.isfinite(high) else max(low, float(points[-1])) + 1 / sampling_time) for low, high in intervals
    ]
    return limits_on([(w * low, w * high) for low, high in ends], w * points, values)


def _without_end(band: Band) -> list[tuple[float, float]]:
    """Return the closed intervals from 0 to infinity that a band removes, in its unit."""
    low, high = band.limits
    if band.kind == "notch":
        return [(max(low, 0.0), high)]
    return ([(0.0, low)] if low > 0 else []) + ([(high, np.inf)] if np.isfinite(high) else [])


def _intervals(field: str, band: Band, factor: float) -> Sequence[tuple[float, float]]:
    """Return the closed intervals within [0, pi] that a band removes, in rad/sample."""
    low, high = (min(edge * factor, np.pi) for edge in band.limits)
    if band.kind == "notch":
        found = [(max(low, 0.0), high)]
    else:
        found = ([(0.0, low)] if low > 0 else []) + ([(high, np.pi)] if high < np.pi else [])
    if not found or found[0][0] >= found[-1][1]:
        raise ProblemError(f"{field}.band", str(band), "a band that removes frequencies between 0 and Nyquist")
    return found


def _points(field: str, given: Array) -> Array:
    if given.ndim != 2 or given.shape[1] != 2 or len(given) < 2:
        expected = "one number, or points (frequency, limit) of shape (points, 2), at least two"
        raise ProblemError(field, f"shape {given.shape}", expected)
    if (np.diff(given[:, 0]) <= 0).any() or given[0, 0] < 0:
        raise ProblemError(field, brief(given[:, 0].tolist()), "frequencies that increase, from 0 or above")
    return given


def _over_logarithm(field: str, points: Array) -> Array:
    """Return points that are linear in dB over the logarithm of the frequency between given ones."""
    if points[0, 0] <= 0:
        raise ProblemError(field, "a point at frequency 0", "the first point above 0, for dB over log frequency")
    w = np.unique(
        np.concatenate([np.geomspace(*pair, SAMPLED) for pair in zip(points[:-1, 0], points[1:, 0], strict=True)])
    )
    return np.column_stack([w, np.interp(np.log(w), np.log(points[:, 0]), points[:, 1])])


def _sampled(field: str, limit: Callable[[Array], ArrayLike], band: Band | None) -> Array:
    """Return a function of the frequency in the band's unit as points."""
    if band is None or band.unit == "bins" or (band.unit == "Hz" and band.kind in ("low_pass", "band_pass")):
        advice = "Give points instead: np.column_stack([frequencies, limits])."
        raise ProblemError(field, "a function", "a band in rad/sample, whose ends are known", advice)
    low, high = band.limits
    first = max(low, 0.0) if band.kind == "notch" else 0.0
    last = high if band.kind == "notch" else low if band.kind == "high_pass" else np.pi
    w = np.unique(
        np.concatenate([np.linspace(first, last, SAMPLED), [edge for edge in (low, high) if first < edge < last]])
    )
    return np.column_stack([w, np.broadcast_to(real_array(field, limit(w)), w.shape)])
