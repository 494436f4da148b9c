# ruff: noqa: D102
"""Equations on the spectrum of a signal: stop bands, and linear equations over all times.

Bands are stated in rad/sample, Hz or DFT bins; the length of the signal turns them into bins. A stop band sets DFT bins
of this horizon to zero; between the bins, the spectrum is small but not zero. ``FrequencyConstraint`` documents the
methods without a docstring.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import (
    Array,
    ComplexArray,
    Mask,
    assign,
    brief,
    positive_number,
    real_array,
    real_signal,
    require_rows_hold,
    seal,
    to_shape,
    with_columns,
)
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import datum, first_few, number, price, runs_in_words, runs_of, short_name
from lin_freq_ocp.problem.numbers import NOTCHES, Axis, Number
from lin_freq_ocp.problem.spectrum.base import (
    Constraints,
    FrequencyConstraint,
    Signal,
    component_indices,
    component_words,
    named_entries,
)
from lin_freq_ocp.problem.terms.maps import StageMap, SumMap
from lin_freq_ocp.problem.terms.penalties import NormBall
from lin_freq_ocp.problem.terms.penalty import HARD, weight_of
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrumMap
from lin_freq_ocp.problem.terms.term import Term, TermKind

BIN_TOLERANCE = 1e-9  # distance of a cut-off from a bin (relative to the bin number above 1) at which it is on the bin
WIDEST = 3.0  # the widest notch of a slider, relative to the stated width


@dataclass(frozen=True)
class Band(FrequencyConstraint):
    """A stop band on one or all components of a signal, from low_pass, high_pass, band_pass, notch or stop_band.

    Parameters
    ----------
    kind : str
        The name of that function, or "harmonics".
    edges : tuple of float
        Lower and upper edge in ``unit``; centre and width of a notch; the bins of a stop band, the orders of harmonics.
    unit : {"rad/sample", "Hz", "bins", "harmonics"}
        Unit of the edges.
    component : int, str or None
        Index or name of the component; None means all.
    """

    kind: str
    edges: tuple[float, ...]
    unit: str
    component: int | str | None = None
    removes_bins: ClassVar[bool] = True

    @property
    def listed(self) -> bool:
        """Whether its bins are listed, by their numbers or as harmonics."""
        return self.unit in ("bins", "harmonics")

    @property
    def title(self) -> str:
        """Return the kind of band in words."""
        return self.kind.replace("_", " ")

    def numbers(self, axis: Axis, finest: float = np.inf) -> Iterator[Number]:
        """Yield the edges below Nyquist; those of a notch move in steps of at most ``finest`` of its width."""
        factor, nyquist = axis.per_unit(self.unit), axis.nyquist
        if self.listed or max(filter(np.isfinite, self.limits)) * factor > nyquist:
            return
        first, second = (edge * factor for edge in self.edges)
        step = min(axis.step, finest * second) if self.kind == "notch" else axis.step
        around, middle = NOTCHES * step, (first + second) / 2
        ranges = {  # which edge, its name, the direction in which the problem gets easier, and the range of its slider
            "low_pass": [(1, "cut-off", 1, step, nyquist - step)],
            "high_pass": [(0, "cut-off", -1, step, nyquist - step)],
            "band_pass": [(0, "lower edge", -1, 0.0, middle), (1, "upper edge", 1, middle, nyquist)],
            "notch": [
                (0, "centre", 0, max(step, first - around), min(nyquist - step, first + around)),
                (1, "width", -1, step, min(WIDEST * max(second, step), nyquist)),
            ],
        }
        for i, label, direction, low, high in ranges[self.kind]:
            value, put = (first, second)[i], partial(Band.with_edge, i=i, factor=factor)
            ends = min(low, value), max(high, value)
            yield Number(f"edge.{{}}.{i}", label, axis.unit, value, *ends, direction, put, step)

    def with_edge(self, value: float, i: int, factor: float) -> Band:
        """Return the band with another edge, in a unit that ``factor`` turns the band's unit into."""
        return replace(self, edges=(*self.edges[:i], value / factor, *self.edges[i + 1 :]))

    @property
    def limits(self) -> tuple[float, float]:
        """Return the lower and upper edge in ``unit`` of a band of frequencies."""
        first, second = self.edges
        return (first - second / 2, first + second / 2) if self.kind == "notch" else (first, second)

    @property
    def removed(self) -> str:
        """Return the removed bins in words."""
        if self.unit == "bins":
            bins = np.unique([int(edge) for edge in self.edges])
            return f"bins {runs_in_words(runs_of(bins))}" if len(bins) > 1 else f"bin {bins[0]}"
        low, high = (number(edge) for edge in self.limits)
        return {
            "low_pass": f"the bins above {high} {self.unit}",
            "high_pass": f"the bins below {low} {self.unit}",
            "band_pass": f"the bins below {low} and above {high} {self.unit}",
            "notch": f"the bins between {low} and {high} {self.unit}",
        }[self.kind]

    def describe(self, names: Sequence[str]) -> str:
        of = component_words(self.component, names)
        return f"{self.title} of {of}: {self.removed} are zero, and their mirror images"

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        """Yield equations for the stopped bins of outputs; those of states and controls are masks of the problem."""
        if signal.kind is not TermKind.OUTPUT_SPECTRUM:
            return
        for name, C, D in signal.rows(field, self.component):
            bins = np.flatnonzero(self.stopped(signal.length, signal.sampling_time, field))
            if len(bins):
                stopped = SpectrumMap(C, D, np.ones(signal.length), signal.length, bins, joint=True)
                yield Term(f"stop band on {name}", signal.kind, stopped, NormBall(2, np.zeros(()), HARD), source)

    def augmented(self, n: int, k: int) -> Sequence[Band]:
        return self.on_components(n)

    def stopped(self, length: int, sampling_time: float | None, field: str) -> Mask:
        return self.at(length, sampling_time, field)

    def remark(self, length: int, sampling_time: float | None, field: str) -> str:
        stopped = self.at(length, sampling_time, field)
        if stopped.any() and not stopped.all():
            return ""
        step = f"2 pi / {length} rad/sample" if sampling_time is None else f"{1 / (length * sampling_time):.3g} Hz"
        apart = f"; its bins are {step} apart, and closer with a longer horizon"
        count, then = ("every", ", which must then be zero") if stopped.any() else ("no", apart)
        return f"{field}: {self} removes {count} bin of a signal of {length} samples{then}."

    def at(self, length: int, sampling_time: float | None, field: str) -> Mask:
        """Return which bins k = 0 .. length//2 of ``length`` samples the band names, (length//2 + 1,)."""
        k = np.arange(length // 2 + 1)
        if self.unit == "bins":
            outside = [bin for bin in self.edges if abs(bin) > length]
            if outside:
                expected = f"bins 0 .. {length - 1} of a signal of {length} samples"
                advice = "Bins are 0-based; a negative bin -k is the conjugate of k, and N counts as 0."
                raise ProblemError(f"{field}.bins", f"bin {outside[0]}", expected, advice)
            bins = np.array(self.edges, dtype=int)
            return np.isin(k, np.minimum(bins % length, -bins % length))
        bins_per_unit = self.bins_per_unit(length, sampling_time, field)
        low, high = (edge * bins_per_unit for edge in self.limits)
        slack_low, slack_high = (BIN_TOLERANCE * max(1.0, edge) for edge in (low, high))
        if self.kind == "notch":
            return (k > low + slack_low) & (k < high - slack_high)
        return ~((k >= low - slack_low) & (k <= high + slack_high))

    def bins_per_unit(self, length: int, sampling_time: float | None, field: str) -> float:
        """Return the number of bins of ``length`` samples per unit of the edges."""
        if self.unit == "rad/sample":
            return length / (2 * np.pi)
        if sampling_time is None:
            advice = "Give dynamics.sampling_time, or the edges in rad/sample."
            raise ProblemError(field, str(self), "a sampling time", advice)
        nyquist = 0.5 / sampling_time
        for edge in self.edges:
            if np.isfinite(edge) and edge > nyquist * (1 + BIN_TOLERANCE):
                expected, advice = f"the Nyquist frequency {nyquist:g} Hz", f"The sampling time is {sampling_time:g} s."
                raise ProblemError(f"{field}.{self.kind}", f"{edge:g} Hz", f"at most {expected}", advice)
        return sampling_time * length

    def __str__(self) -> str:
        if self.unit == "bins":
            shown = brief([int(edge) for edge in self.edges], 40)
        else:
            shown = " .. ".join(f"{edge:.6g}" for edge in self.limits if np.isfinite(edge)) + f" {self.unit}"
        return f"{self.kind}({shown})" + ("" if self.component is None else f" on {self.component!r}")


def low_pass(
    cutoff: float | None = None, *, cutoff_hz: float | None = None, component: int | str | None = None
) -> Band:
    """Keep the bins up to the cut-off and remove the bins above.

    Parameters
    ----------
    cutoff, cutoff_hz : float
        Cut-off in rad/sample (0 .. pi) or in Hz (0 .. Nyquist); exactly one of them. A bin at the cut-off is kept.
    component : int or str, optional
        Index or name of the component; default all.

    Returns
    -------
    Band

    Raises
    ------
    ProblemError
        If not exactly one of the cut-offs is given, or it is out of range.

    Examples
    --------
    >>> lfo.low_pass(cutoff_hz=5)
    Band(...)
    """
    edges, unit = _edges("low_pass", cutoff=(cutoff, cutoff_hz))
    return Band("low_pass", (0.0, *edges), unit, component)


def high_pass(
    cutoff: float | None = None, *, cutoff_hz: float | None = None, component: int | str | None = None
) -> Band:
    """Keep the bins from the cut-off on and remove the bins below.

    Parameters
    ----------
    cutoff, cutoff_hz, component
        As for ``low_pass``.

    Returns
    -------
    Band

    Raises
    ------
    ProblemError
        If not exactly one unit is given, or an edge is out of range.

    Examples
    --------
    >>> str(lfo.spectrum.high_pass(0.1))
    'high_pass(0.1 rad/sample)'
    """
    edges, unit = _edges("high_pass", cutoff=(cutoff, cutoff_hz))
    return Band("high_pass", (*edges, np.inf), unit, component)


def band_pass(
    lower: float | None = None,
    upper: float | None = None,
    *,
    lower_hz: float | None = None,
    upper_hz: float | None = None,
    component: int | str | None = None,
) -> Band:
    """Keep the bins from ``lower`` to ``upper`` (both kept) and remove the others.

    Parameters
    ----------
    lower, upper : float
        In rad/sample (0 .. pi).
    lower_hz, upper_hz : float
        The same in Hz.
    component : int or str, optional
        Index or name of the component; default all.

    Returns
    -------
    Band

    Raises
    ------
    ProblemError
        If not exactly one unit is given, or an edge is out of range.

    Examples
    --------
    >>> str(lfo.spectrum.band_pass(0.1, 0.5))
    'band_pass(0.1 .. 0.5 rad/sample)'
    """
    edges, unit = _edges("band_pass", lower=(lower, lower_hz), upper=(upper, upper_hz))
    if edges[0] > edges[1]:
        got = f"lower {edges[0]:g} above upper {edges[1]:g} {unit}"
        raise ProblemError("band_pass", got, "lower <= upper", "Exchange them?")
    return Band("band_pass", edges, unit, component)


def notch(
    centre: float | None = None,
    width: float | None = None,
    *,
    centre_hz: float | None = None,
    width_hz: float | None = None,
    component: int | str | None = None,
) -> Band:
    """Remove the bins closer to ``centre`` than half of ``width`` and keep the others.

    Parameters
    ----------
    centre, width : float
        In rad/sample (0 .. pi).
    centre_hz, width_hz : float
        The same in Hz.
    component : int or str, optional
        Index or name of the component; default all.

    Returns
    -------
    Band

    Raises
    ------
    ProblemError
        If not exactly one unit is given, or an edge is out of range.

    Examples
    --------
    >>> str(lfo.spectrum.notch(1.0, 0.2))
    'notch(0.9 .. 1.1 rad/sample)'
    """
    edges, unit = _edges("notch", centre=(centre, centre_hz), width=(width, width_hz))
    if edges[1] == 0:
        raise ProblemError("notch.width", "0", "a width above zero")
    return Band("notch", edges, unit, component)


def stop_band(*unnamed: object, bins: Iterable[int] | None = None, component: int | str | None = None) -> Band:
    """Remove the listed DFT bins, 0-based mod N, each with its conjugate bin N-k.

    Parameters
    ----------
    bins : iterable of int
        By name only: ``stop_band([5, 7])`` does not say whether it means bins or frequencies.
    component : int or str, optional
        Index or name of the component; default all.

    Returns
    -------
    Band

    Raises
    ------
    ProblemError
        If ``bins`` is missing or not named, is empty, or has an entry that is no whole number.

    Examples
    --------
    >>> lfo.stop_band(bins=[3, 4, 5], component=0)
    Band(...)
    """
    if unnamed or bins is None:
        advice = "For frequencies: notch(centre_hz=6, width_hz=2) removes 5 to 7 Hz, low_pass(cutoff_hz=5) all above."
        got = f"{brief(unnamed[0])} without a name" if unnamed else "no bins"
        raise ProblemError("stop_band.bins", got, "DFT bins by name: stop_band(bins=[5, 7])", advice)
    listed = list(bins) if isinstance(bins, Iterable) else [bins]
    if not listed or not all(isinstance(k, (int, np.integer)) and not isinstance(k, bool) for k in listed):
        advice = "Leave the band out to remove nothing."
        raise ProblemError("stop_band.bins", brief(listed), "a list of at least one whole number", advice)
    return Band("stop_band", tuple(int(k) for k in listed), "bins", component)


def _edges(kind: str, **pairs: tuple[float | None, float | None]) -> tuple[tuple[float, ...], str]:
    """Return the edges and their unit from pairs (in rad/sample, in Hz), exactly one of them not None."""
    edges, units = list[float](), list[str]()
    for name, (radians, hertz) in pairs.items():
        if (radians is None) == (hertz is None):
            got = f"{'neither' if radians is None else 'both'} of {name} and {name}_hz"
            raise ProblemError(f"{kind}.{name}", got, "exactly one of them")
        given, field = (radians, f"{kind}.{name}") if hertz is None else (hertz, f"{kind}.{name}_hz")
        value = real_array(field, given)
        if value.ndim or value < 0:
            got = brief(given.item() if isinstance(given, np.generic) else given)
            raise ProblemError(field, got, "one number, zero or above")
        if hertz is None and value > np.pi * (1 + BIN_TOLERANCE):
            got, expected = f"{float(value):g} rad/sample", "at most pi, the Nyquist frequency"
            raise ProblemError(f"{kind}.{name}", got, expected, f"In Hz it is {name}_hz=.")
        edges.append(float(value))
        units.append("rad/sample" if hertz is None else "Hz")
    if len(set(units)) > 1:
        got = ", ".join(f"{name} in {unit}" for name, unit in zip(pairs, units, strict=True))
        raise ProblemError(kind, got, "both in the same unit")
    return tuple(edges), units[0]


def stopped_bins(
    field: str, constraints: Constraints, length: int, component_names: Sequence[str], sampling_time: float | None
) -> Mask:
    """Return which bins the bands remove from which component, (length//2 + 1, components)."""
    stopped = np.zeros((length // 2 + 1, len(component_names)), dtype=bool)
    for where, band in named_entries(field, constraints):
        if not isinstance(band, FrequencyConstraint):
            expected = "a band, MagnitudeBound, EnergyBound or LinearConstraint"
            advice = "Make a band with low_pass, high_pass, band_pass, notch or stop_band."
            raise ProblemError(where, brief(band), expected, advice)
        columns = component_indices(where, band.component, component_names)
        stopped[:, columns] |= band.stopped(length, sampling_time, where)[:, None]
    return seal(stopped)


def band_remarks(
    entries: Iterable[tuple[str, FrequencyConstraint]],
    length: int,
    component_names: Sequence[str],
    sampling_time: float | None,
) -> Iterator[str]:
    """Yield which bands of a signal, each with its name, remove or bound no bin, or remove every bin.

    They remove every bin alone or with the bands before them.
    """
    stopped = np.zeros((length // 2 + 1, len(component_names)), dtype=bool)
    for where, band in entries:
        before = stopped.all(axis=0)
        stopped = stopped | stopped_bins(where, band, length, component_names, sampling_time)
        if remark := band.remark(length, sampling_time, where):
            yield remark
        elif (stopped.all(axis=0) & ~before).any():
            text = f"removes every bin of a signal of {length} samples that the bands before it keep"
            yield f"{where}: {band} {text}; the signal must then be zero."


def bands_of(stop: Mask) -> list[Band]:
    """Return bands that remove exactly these bins, (k, components)."""
    components = np.flatnonzero(stop.any(0))
    return [stop_band(bins=np.flatnonzero(stop[:, i]).tolist(), component=int(i)) for i in components]


def bins_far_from_passed(stopped: Mask, bins: float) -> Mask:
    """Return which stopped bins lie farther than ``bins`` from every passed bin; if no bin is passed, from bin 0."""
    if not np.isfinite(bins):
        return np.zeros_like(stopped)
    k, passed = np.arange(len(stopped)), np.flatnonzero(~stopped)
    if not len(passed):
        return stopped & (k >= bins)
    return stopped & (np.abs(k[:, None] - passed).min(1) > bins)


def time_signal(rho: ComplexArray, length: int) -> Array:
    """Return (R' rho)_t = sum_k Re(rho_k exp(2 pi i k t / N)), N = length, for rho (..., N//2 + 1, components)."""
    if not rho.any():
        return np.zeros((*rho.shape[:-2], length, rho.shape[-1]), dtype=rho.real.dtype)
    return np.swapaxes(real_signal(np.swapaxes(rho, -1, -2), length), -1, -2)


@dataclass(frozen=True, eq=False, init=False)
class LinearConstraint(FrequencyConstraint):
    """constant + sum_t coefficients_t v_t = 0 for a signal v of states or controls (paper, (SFC) and (CFC)).

    Parameters
    ----------
    coefficients : (times, rows, components)
        One matrix per time: T for controls, T+1 for states (T with Periodic()).
    constant : (rows,), optional
        Default zero.
    penalty : float, optional
        Makes the equations soft: penalty times the Euclidean norm of the left-hand side is added to the cost.

    Raises
    ------
    ProblemError
        If shapes do not match or entries are not finite.

    Examples
    --------
    >>> mean = lfo.spectrum.LinearConstraint([[[0.25]]] * 4)  # of four controls
    >>> mean.coefficients.shape
    (4, 1, 1)
    """

    coefficients: Array
    constant: Array
    penalty: float | None
    on_outputs: ClassVar[bool] = False

    def __init__(self, coefficients: ArrayLike, constant: ArrayLike | None = None, penalty: float | None = None):
        matrices = real_array("LinearConstraint.coefficients", coefficients)
        if matrices.ndim != 3 or 0 in matrices.shape:
            expected = "one matrix (rows, components) per time"
            raise ProblemError("LinearConstraint.coefficients", f"shape {matrices.shape}", expected)
        rows = matrices.shape[1]
        right = to_shape("LinearConstraint.constant", np.zeros(rows) if constant is None else constant, (rows,))
        soft = None if penalty is None else positive_number("LinearConstraint.penalty", penalty)
        if soft is None:
            require_rows_hold("LinearConstraint.constant", ~matrices.any(axis=(0, 2)) & (right != 0), right)
        assign(self, coefficients=matrices, constant=right, penalty=soft)

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        expected = (signal.length, self.coefficients.shape[1], len(signal.names))
        if self.coefficients.shape != expected:
            raise ProblemError(f"{field}.coefficients", f"shape {self.coefficients.shape}", f"shape {expected}")
        parts = (self.coefficients, None) if signal.D is None else (None, self.coefficients)
        stages = StageMap(np.arange(signal.length), *parts, np.zeros(len(self.constant)))
        ball = NormBall(2, np.zeros(()), weight_of(self.penalty))
        yield Term(f"linear constraint of {signal.kind}", signal.kind, SumMap((stages,), self.constant), ball, source)

    def augmented(self, n: int, k: int) -> Sequence[FrequencyConstraint]:
        return [LinearConstraint(with_columns(self.coefficients, k), self.constant, self.penalty)]

    def softened(self, penalty: float) -> LinearConstraint:
        return self.changed(penalty=penalty) if self.penalty is None else self

    def describe(self, names: Sequence[str]) -> str:
        rows = self.coefficients.shape[1]
        signals = [short_name(name) for i, name in enumerate(names) if self.coefficients[:, :, i].any()]
        of = first_few(signals) if signals else "no signal"
        equations = "linear equation" if rows == 1 else f"{rows} linear equations"
        right = "" if not self.constant.any() else f", {datum('constant', self.constant, 1)}"
        cost = price(self.penalty, "norm")
        return f"{equations} in {of} over all times: constant + sum of coefficients_t v_t = 0{right}{cost}"
