"""Limits of spectra as users state them: which keyword states a limit, its harmonics, and its values."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Indices, brief, positive_number, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import join_words
from lin_freq_ocp.problem.spectrum.bands import BIN_TOLERANCE, Band
from lin_freq_ocp.problem.spectrum.harmonics import Harmonics
from lin_freq_ocp.problem.terms.quantity import IN_DECIBELS, OWN_FUNDAMENTAL, Quantity
from lin_freq_ocp.problem.terms.semi_infinite import Limits, limits_on

ByOrder = Mapping[int, float]  # limits by the orders of harmonics
Limit = ArrayLike | Callable[[Array], ArrayLike]
Stated = Limit | ByOrder | None
Reference = float | Literal["fundamental"] | None
SAMPLES = 64  # of a function on an interval, or between two points of a limit that is not linear
NO_ZERO = (
    "Only the signal 0 has a spectrum that vanishes on an interval. State a level above zero, or remove "
    "the bins of the horizon by the band itself."
)
NO_PHASE = (
    "|u_5| <= p |u_1| is not convex: a fundamental may grow in any direction. With its phase, "
    "|u_5| <= p Re(exp(-i phase) u_1) is: phase=0 for a cosine, -pi/2 for a sine. Or state its amplitude as a number."
)
KEYWORDS = "A plain number is a sum of samples; amplitude= is that of a sinusoid."


class StatedLimit(NamedTuple):
    """The limit that one keyword of a bound states, and the harmonics that it applies to."""

    field: str  # in errors, such as "MagnitudeBound.amplitude"
    quantity: Quantity
    value: Limit | None
    harmonics: Harmonics | None


def stated_limit(
    kind: str,
    stated: Mapping[str, Stated],
    orders: ByOrder | Iterable[int] | None,
    fundamental_hz: float | None,
    of: Reference = None,
    phase: float | None = None,
    reference: float | None = None,
) -> StatedLimit:
    """Return the limit of a bound: exactly one of the keywords ``stated``, or a mapping of orders, states it."""
    if isinstance(orders, Mapping):
        stated, orders = {**stated, "harmonics": orders}, None
    found = [key for key, value in stated.items() if value is not None]
    if len(found) != 1:
        expected = f"exactly one of {', '.join(key for key in stated if key != 'harmonics')}"
        raise ProblemError(f"{kind}.limit", join_words(found) if found else "no limit", expected, KEYWORDS)
    field, value, band = f"{kind}.{found[0]}", stated[found[0]], None
    quantity = _quantity(kind, "amplitude" if found[0] == "harmonics" else found[0], of, phase, reference)
    if isinstance(value, Mapping):
        if orders is not None:
            raise ProblemError(f"{kind}.harmonics", f"orders, and {found[0]} by order", "orders only once")
        orders = [int(str(key)) if str(key).isdigit() else key for key in value]  # keys in files are texts
        value = list(value.values())
    needed = orders is not None or quantity.of_fundamental
    if needed != (fundamental_hz is not None):
        expected = "Hz, such as 50" if needed else "None without harmonics and without of='fundamental'"
        raise ProblemError(f"{kind}.fundamental_hz", brief(fundamental_hz), expected)
    fundamental = 0.0 if fundamental_hz is None else positive_number(f"{kind}.fundamental_hz", fundamental_hz)
    if orders is not None:
        listed = list(orders) if isinstance(orders, Iterable) else [orders]
        whole = all(isinstance(k, (int, np.integer)) and not isinstance(k, bool) and k >= 1 for k in listed)
        if not listed or not whole or len(set(listed)) < len(listed):
            expected = "different orders, whole numbers from 1, the fundamental, on"
            raise ProblemError(f"{kind}.harmonics", brief(listed), expected)
        limit = real_array(field, value, allow_infinite=True)
        if limit.shape not in ((), (len(listed),)):
            raise ProblemError(field, f"shape {limit.shape}", f"one number, or {len(listed)}: one per harmonic")
        value = limit[np.argsort(listed)] if limit.ndim else limit
        band = Harmonics("harmonics", tuple(sorted(map(float, listed))), "harmonics", fundamental_hz=fundamental)
    return StatedLimit(field, quantity, value, band)


def _quantity(kind: str, keyword: str, of: Reference, phase: float | None, reference: float | None) -> Quantity:
    """Return the unit of a limit; the arguments that it refers to are there, and only these."""
    own = isinstance(of, str)
    if own and of != OWN_FUNDAMENTAL:
        raise ProblemError(f"{kind}.of", brief(of), "an amplitude as a number, or 'fundamental'")
    uses = {"of": keyword == "percent", "reference": keyword in IN_DECIBELS, "phase": own}
    given, keys = {"of": of, "reference": reference, "phase": phase}, {"of": "percent", "phase": "of='fundamental'"}
    for name, used in uses.items():
        if used != (given[name] is not None):
            expected = f"a value with {keys.get(name, ' or '.join(IN_DECIBELS))}, and only with it"
            raise ProblemError(f"{kind}.{name}", brief(given[name]), expected, NO_PHASE * (name == "phase" and used))
    if own:
        angle = real_array(f"{kind}.phase", phase)
        if angle.ndim:
            raise ProblemError(f"{kind}.phase", brief(phase), "one number, in radians")
        return Quantity(keyword, OWN_FUNDAMENTAL, float(angle))
    number = next((positive_number(f"{kind}.{name}", given[name]) for name in ("of", "reference") if uses[name]), 1.0)
    return Quantity(keyword, number)


def read_limits(limit: StatedLimit, every_frequency: bool, band: Band | None) -> Array:
    """Return the limit as stated: one number, (), one for each bin, (bins,), or points, (points, 2).

    Points are (frequency in the band's unit, limit). At every frequency a function is sampled as points.
    """
    field, value, decibels = limit.field, limit.value, limit.quantity.keyword in IN_DECIBELS
    if callable(value) and every_frequency:
        value = _sample_function(field, value, band)
    array = real_array(field, value, allow_infinite=not (decibels or every_frequency))
    levels = array[:, 1] if array.ndim == 2 and array.shape[1] == 2 else array
    if array.ndim > 1 or (array.ndim and every_frequency):
        each = "" if every_frequency else "one for each bin, "
        if array.ndim != 2 or array.shape[1] != 2 or len(array) < 2:
            expected = f"one number, {each}or points (frequency, limit) of shape (points, 2), at least two"
            raise ProblemError(field, f"shape {array.shape}" if every_frequency else brief(limit.value), expected)
        if (np.diff(array[:, 0]) <= 0).any() or array[0, 0] < 0:
            raise ProblemError(field, brief(array[:, 0].tolist()), "frequencies that increase, from 0 or above")
        if decibels and array[0, 0] <= 0:
            expected = "the first point above 0, for dB over log frequency"
            raise ProblemError(field, "a point at frequency 0", expected)
    lowest = np.inf if decibels else float(levels.min(initial=np.inf))
    if lowest < 0:
        raise ProblemError(field, brief(limit.value), "one number, zero or above, or one for each bin")
    if every_frequency and lowest == 0:
        raise ProblemError(field, "0", "a limit above zero at every frequency", NO_ZERO)
    return array


def interpolate(frequencies: Array, points: Array, logarithmic: bool) -> Array:
    """Return the limits of points (frequency, limit) at frequencies, linear over the frequency or its logarithm."""
    over = np.log if logarithmic else np.asarray
    return np.interp(over(frequencies), over(points[:, 0]), points[:, 1])


def limits_at_bins(
    field: str, limit: Array, quantity: Quantity, band: Band, bins: Indices, points: int, sampling_time: float | None
) -> Array:
    """Return the levels of bins of a grid of so many points, (bins,)."""
    if limit.ndim == 2:
        at = bins / band.bins_per_unit(points, sampling_time, f"{field}.band")
        slack = BIN_TOLERANCE * max(1.0, float(at.max(initial=0.0)))
        if len(at) and (at[0] < limit[0, 0] - slack or at[-1] > limit[-1, 0] + slack):
            got = f"points from {limit[0, 0]:g} to {limit[-1, 0]:g} {band.unit}"
            expected = f"points from {at[0]:g} to {at[-1]:g} {band.unit}, the bounded bins"
            raise ProblemError(f"{field}.{quantity.keyword}", got, expected)
        limit = interpolate(at, limit, quantity.keyword in IN_DECIBELS)
    elif limit.shape not in ((), (len(bins),)):
        expected = f"one number, or {len(bins)}: one per bin"
        raise ProblemError(f"{field}.{quantity.keyword}", f"shape {limit.shape}", expected)
    return np.broadcast_to(quantity.level(limit), (len(bins),))


def limit_levels(limit: Array, quantity: Quantity) -> Array:
    """Return a limit at every frequency in levels: one number, or points, between which it is linear."""
    if limit.ndim == 0:
        return quantity.level(limit)
    w, logarithmic = limit[:, 0], quantity.keyword in IN_DECIBELS
    if logarithmic or quantity.keyword == "density":
        space = np.geomspace if logarithmic else np.linspace
        w = np.unique(np.concatenate([space(low, high, SAMPLES) for low, high in pairwise(w)]))
    return np.column_stack([w, quantity.level(interpolate(w, limit, logarithmic))])


def _sample_function(field: str, limit: Callable[[Array], ArrayLike], band: Band | None) -> Array:
    """Return samples of a function of the frequency in the band's unit as points (frequency, limit)."""
    if band is None or band.unit == "bins" or (band.unit == "Hz" and band.kind in ("low_pass", "band_pass")):
        advice = "Give points instead: np.column_stack([frequencies, limits])."
        raise ProblemError(field, "a function", "a band in rad/sample, which ends at pi", advice)
    low, high = band.limits
    first = max(low, 0.0) if band.kind == "notch" else 0.0
    last = high if band.kind == "notch" else low if band.kind == "high_pass" else np.pi
    edges = [edge for edge in (low, high) if first < edge < last]
    w = np.unique(np.concatenate([np.linspace(first, last, SAMPLES), edges]))
    return np.column_stack([w, np.broadcast_to(real_array(field, limit(w)), w.shape)])


def limits_of_band(field: str, limit: Array, band: Band, sampling_time: float | None, hold: bool) -> Limits:
    """Return the limit on the closed intervals that a band removes, in rad/sample.

    For a zero-order hold, w = 2 pi f h may be above pi. After the last point the limit is constant; of an unbounded
    interval, one period of V after that point suffices (``ZeroOrderHoldMask``).
    """
    if hold and sampling_time is None:
        raise ProblemError(field, f"{band}, and no sampling time", "dynamics with a sampling_time in seconds, for hold")
    factor = 2 * np.pi * (sampling_time if hold and sampling_time else band.bins_per_unit(1, sampling_time, field))
    points, values = (limit[:, 0] * factor, limit[:, 1]) if limit.ndim else (np.zeros(1), limit.reshape(1))
    low, high = (edge * factor for edge in band.limits)
    highest = max(high, float(points[-1])) + 2 * np.pi if hold else np.pi
    low, high = min(low, highest), min(high, highest)
    if band.kind == "notch":
        intervals = [(max(low, 0.0), high)]
    else:
        intervals = ([(0.0, low)] if low > 0 else []) + ([(high, highest)] if high < highest else [])
    if not intervals or intervals[0][0] >= intervals[-1][1]:
        expected = "a band that removes frequencies" + ("" if hold else " between 0 and Nyquist")
        raise ProblemError(f"{field}.band", str(band), expected)
    first, last = intervals[0][0], float(points[-1]) if hold else intervals[-1][1]
    slack = BIN_TOLERANCE * np.pi  # rounding of the change of unit
    if limit.ndim and (points[0] > first + slack or points[-1] < last - slack):
        got = f"points from {limit[0, 0]:g} to {limit[-1, 0]:g} {band.unit}"
        expected = f"points from {first / factor:g}{'' if hold else f' to {last / factor:g}'} {band.unit}"
        raise ProblemError(f"{field}.limit", got, f"{expected}, which the band removes")
    return limits_on(intervals, points, values)
