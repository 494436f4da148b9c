# ruff: noqa: D102  (a method without a docstring is described by ``FrequencyConstraint``)
"""Equations on the spectrum of a signal: stop bands, and linear equations over all times.

Bands are in rad/sample, Hz or DFT bins, and become bins when they meet a signal's length. A stop band sets DFT bins of
this horizon to zero. What lies between the bins is small, but not zero.
"""

from __future__ import annotations

import warnings
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
from lin_freq_ocp.base.errors import BandWarning, ProblemError
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

BIN_TOLERANCE = 1e-9  # distance of a cut-off from a bin (relative to the bin number above 1) at which it falls on it


@dataclass(frozen=True)
class Band(FrequencyConstraint):
    """A stop band on one or all components of a signal; made by low_pass, high_pass, band_pass, notch, stop_band.

    Parameters
    ----------
    kind : str
        The name of the function that made it.
    edges : tuple of float
        Lower and upper edge in ``unit``; of a notch, centre and width; of a stop band given by bins, the bins.
    unit : {"rad/sample", "Hz", "bins"}
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
    def title(self) -> str:
        """Return its kind in words."""
        return self.kind.replace("_", " ")

    def numbers(self, axis: Axis, finest: float = np.inf) -> Iterator[Number]:
        """Yield its edges within Nyquist; those of a notch in steps of at most a part of its width."""
        factor, edges = axis.per_unit(self.unit), EDGES.get(self.kind, ())
        if not edges or max(filter(np.isfinite, self.limits)) * factor > axis.nyquist:
            return
        own, step = [edge * factor for edge in self.edges], axis.step
        if self.kind == "notch":
            step = min(step, finest * own[1])
        for i, label, direction, range_of in edges:
            value, (low, high) = own[i], range_of(own, step, axis.nyquist)
            put = partial(_move_edge, i, factor)
            ends = min(low, value), max(high, value)
            yield Number(f"edge.{{}}.{i}", label, axis.unit, value, *ends, direction, put, step)

    @property
    def limits(self) -> tuple[float, float]:
        """Return the lower and upper edge in ``unit``, of a band given by frequencies."""
        first, second = self.edges
        return (first - second / 2, first + second / 2) if self.kind == "notch" else (first, second)

    @property
    def removed(self) -> str:
        """Return a text of the bins that it removes."""
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
        """Yield the stopped bins of outputs as equations."""
        if signal.kind is not TermKind.OUTPUT_SPECTRUM:
            return
        for name, C, D in signal.rows(field, self.component):
            bins = np.flatnonzero(self.stopped(signal.length, signal.sampling_time, field))
            if len(bins):  # else a warning has been issued
                stopped = SpectrumMap(C, D, np.ones(signal.length), signal.length, bins, together=True)
                yield Term(f"stop band on {name}", signal.kind, stopped, NormBall(2, np.zeros(()), HARD), source)

    def augmented(self, n: int, k: int) -> Sequence[Band]:
        return self.on_components(n)

    def stopped(self, length: int, sampling_time: float | None, field: str) -> Mask:
        """Return which bins k = 0 .. length//2 of a signal of ``length`` samples are removed; warn if none or all."""
        stopped = self.at(length, sampling_time, field)
        if stopped.all() or not stopped.any():
            count, then = ("every", ", which must then be zero") if stopped.any() else ("no", "")
            what = f"removes {count} bin of a signal of {length} samples{then}."
            warnings.warn(f"{field}: {self} {what}", BandWarning, stacklevel=2)
        return stopped

    def at(self, length: int, sampling_time: float | None, field: str) -> Mask:
        """Return which bins k = 0 .. length//2 of a signal of ``length`` samples it names, (length//2 + 1,)."""
        k = np.arange(length // 2 + 1)
        if self.unit == "bins":
            outside = [bin for bin in self.edges if abs(bin) > length]
            if outside:
                raise ProblemError(
                    f"{field}.bins",
                    f"bin {outside[0]}",
                    f"bins 0 .. {length - 1} of a signal of {length} samples",
                    "Bins are 0-based; a negative bin -k is the conjugate of k, and N counts as 0.",
                )
            bins = np.array(self.edges, dtype=int)
            return np.isin(k, np.minimum(bins % length, -bins % length))
        bins_per_unit = self.bins_per_unit(length, sampling_time, field)
        low, high = (edge * bins_per_unit for edge in self.limits)
        slack_low, slack_high = (BIN_TOLERANCE * max(1.0, edge) for edge in (low, high))
        if self.kind == "notch":
            return (k > low + slack_low) & (k < high - slack_high)
        return ~((k >= low - slack_low) & (k <= high + slack_high))

    def bins_per_unit(self, length: int, sampling_time: float | None, field: str) -> float:
        """Return how many bins of a signal of ``length`` samples there are in a unit of the edges."""
        if self.unit == "rad/sample":
            return length / (2 * np.pi)
        if sampling_time is None:
            advice = "Give dynamics.sampling_time, or the edges in rad/sample."
            raise ProblemError(field, str(self), "a sampling time", advice)
        nyquist = 0.5 / sampling_time
        for edge in self.edges:
            if np.isfinite(edge) and edge > nyquist * (1 + BIN_TOLERANCE):
                raise ProblemError(
                    f"{field}.{self.kind}",
                    f"{edge:g} Hz",
                    f"at most the Nyquist frequency {nyquist:g} Hz",
                    f"The sampling time is {sampling_time:g} s.",
                )
        return sampling_time * length

    def __str__(self) -> str:
        if self.unit == "bins":
            shown = brief([int(edge) for edge in self.edges], 40)
        else:
            shown = " .. ".join(f"{edge:.6g}" for edge in self.limits if np.isfinite(edge)) + f" {self.unit}"
        return f"{self.kind}({shown})" + ("" if self.component is None else f" on {self.component!r}")


def _move_edge(i: int, factor: float, band: Band, value: float) -> Band:
    return replace(band, edges=(*band.edges[:i], value / factor, *band.edges[i + 1 :]))


def _cutoffs(own: Sequence[float], step: float, nyquist: float) -> tuple[float, float]:
    return step, nyquist - step


def _centres(own: Sequence[float], step: float, nyquist: float) -> tuple[float, float]:
    return max(step, own[0] - NOTCHES * step), min(nyquist - step, own[0] + NOTCHES * step)


WIDEST = 3.0  # notches, of their own width
# Of every kind of band the edges that can be moved: index, name, direction in which the problem gets easier, and range
EDGES = {
    "low_pass": [(1, "cut-off", 1, _cutoffs)],
    "high_pass": [(0, "cut-off", -1, _cutoffs)],
    "band_pass": [
        (0, "lower edge", -1, lambda own, step, nyquist: (0.0, sum(own) / 2)),
        (1, "upper edge", 1, lambda own, step, nyquist: (sum(own) / 2, nyquist)),
    ],
    "notch": [
        (0, "centre", 0, _centres),
        (1, "width", -1, lambda own, step, nyquist: (step, min(WIDEST * max(own[1], step), nyquist))),
    ],
}


def low_pass(
    cutoff: float | None = None, *, cutoff_hz: float | None = None, component: int | str | None = None
) -> Band:
    """Keep the bins up to the cut-off and remove those above.

    Parameters
    ----------
    cutoff, cutoff_hz : float
        Cut-off in rad/sample (0 .. pi) or in Hz (0 .. Nyquist); exactly one of them. A bin on it is kept.
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
    """Keep the bins from the cut-off on and remove those below.

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
    """Remove the bins nearer to ``centre`` than half of ``width``, and keep the others.

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


def stop_band(*, bins: Iterable[int], component: int | str | None = None) -> Band:
    """Remove the listed DFT bins, 0-based mod N; the conjugate bin N-k of each goes with it.

    Parameters
    ----------
    bins : iterable of int
    component : int or str, optional
        Index or name of the component; default all.

    Returns
    -------
    Band

    Raises
    ------
    ProblemError
        If there is no bin, or the bins are not whole numbers.

    Examples
    --------
    >>> lfo.stop_band(bins=[3, 4, 5], component=0)
    Band(...)
    """
    listed = list(bins) if isinstance(bins, Iterable) else [bins]
    if not listed or not all(isinstance(k, (int, np.integer)) and not isinstance(k, bool) for k in listed):
        advice = "Leave the band out to remove nothing."
        raise ProblemError("stop_band.bins", brief(listed), "a list of at least one whole number", advice)
    return Band("stop_band", tuple(int(k) for k in listed), "bins", component)


def _edges(kind: str, **given: tuple[float | None, float | None]) -> tuple[tuple[float, ...], str]:
    """Return the edges and their unit, of pairs (in rad/sample, in Hz) of which one is None."""
    edges, units = list[float](), list[str]()
    for name, (radians, hertz) in given.items():
        if (radians is None) == (hertz is None):
            got = f"{'neither' if radians is None else 'both'} of {name} and {name}_hz"
            raise ProblemError(f"{kind}.{name}", got, "exactly one of them")
        value = real_array(f"{kind}.{name}", radians if hertz is None else hertz)
        if value.ndim or value < 0:
            got = brief(radians if hertz is None else hertz)
            raise ProblemError(f"{kind}.{name}", got, "one number, zero or above")
        if hertz is None and value > np.pi * (1 + BIN_TOLERANCE):
            got, expected = f"{float(value):g} rad/sample", "at most pi, the Nyquist frequency"
            raise ProblemError(f"{kind}.{name}", got, expected, f"In Hz it is {name}_hz=.")
        edges.append(float(value))
        units.append("rad/sample" if hertz is None else "Hz")
    if len(set(units)) > 1:
        got = ", ".join(f"{name} in {unit}" for name, unit in zip(given, units, strict=True))
        raise ProblemError(kind, got, "both in the same unit")
    return tuple(edges), units[0]


def stopped_bins(
    field: str, given: Constraints, length: int, component_names: Sequence[str], sampling_time: float | None
) -> Mask:
    """Return which bins are removed from which component, shape (length//2 + 1, components); bands are united."""
    stopped = np.zeros((length // 2 + 1, len(component_names)), dtype=bool)
    for where, band in named_entries(field, given):
        if not isinstance(band, FrequencyConstraint):
            expected = "a band, MagnitudeBound, EnergyBound or LinearConstraint"
            advice = "Make a band with low_pass, high_pass, band_pass, notch or stop_band."
            raise ProblemError(where, brief(band), expected, advice)
        if not isinstance(band, Band):
            continue
        columns = component_indices(where, band.component, component_names)
        alone, full = band.stopped(length, sampling_time, where), stopped[:, columns].all(axis=0)
        stopped[:, columns] |= alone[:, None]
        if not alone.all() and (stopped[:, columns].all(axis=0) & ~full).any():
            what = f"removes every bin of a signal of {length} samples that the bands before it leave"
            warnings.warn(f"{where}: {band} {what}; it must then be zero.", BandWarning, stacklevel=2)
    return seal(stopped)


def bands_of(stop: Mask) -> list[Band]:
    """Return bands that remove just these bins (k, components)."""
    components = np.flatnonzero(stop.any(0))
    return [stop_band(bins=np.flatnonzero(stop[:, i]).tolist(), component=int(i)) for i in components]


def kept_stopped(stopped: Mask, bins: float) -> Mask:
    """Return which stopped bins lie farther than ``bins`` from every passed one; bin 0 counts as one if none is."""
    if not np.isfinite(bins):
        return np.zeros_like(stopped)
    k, passed = np.arange(len(stopped)), np.flatnonzero(~stopped)
    if not len(passed):
        return stopped & (k >= bins)
    return stopped & (np.abs(k[:, None] - passed).min(1) > bins)


def time_signal(rho: ComplexArray, length: int) -> Array:
    """Return (R' rho)_t = sum_k Re(rho_k exp(2 pi i k t / N)), N = length, for rho (N//2 + 1, components)."""
    if not rho.any():
        return np.zeros((length, rho.shape[1]), dtype=rho.real.dtype)
    return real_signal(rho.T, length).T


@dataclass(frozen=True, eq=False, init=False)
class LinearConstraint(FrequencyConstraint):
    """constant + sum_t coefficients_t v_t = 0 for the signal v it is given for (paper, (SFC) and (CFC)).

    Parameters
    ----------
    coefficients : (times, rows, components)
        One matrix per time: T of them for controls, T+1 for states (T with Periodic()).
    constant : (rows,), optional
        Zero without.
    penalty : float, optional
        Makes it soft: penalty times the Euclidean norm of the left-hand side is added to the cost.

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
        return self if self.penalty is not None else LinearConstraint(self.coefficients, self.constant, penalty)

    def describe(self, names: Sequence[str]) -> str:
        rows = self.coefficients.shape[1]
        used = [short_name(name) for i, name in enumerate(names) if self.coefficients[:, :, i].any()]
        of = first_few(used) if used else "nothing"
        equations = "linear equation" if rows == 1 else f"{rows} linear equations"
        right = "" if not self.constant.any() else f", {datum('constant', self.constant, 1)}"
        cost = price(self.penalty, "norm")
        return f"{equations} in {of} over all times: constant + sum of coefficients_t v_t = 0{right}{cost}"
