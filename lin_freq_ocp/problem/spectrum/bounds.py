# ruff: noqa: D102  (a method without a docstring is described by ``FrequencyConstraint``)
"""Bounds on magnitudes and energies of spectra.

They bound the bins that a band would remove: MagnitudeBound(0, band=low_pass(...)) is that low pass itself. On a finer
grid than the DFT's (``oversampling``), or with a window, they also bound the spectrum between the bins; with
``every_frequency`` a mask holds at all frequencies of its band. The functions at the end read limits as they are given.
"""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import (
    Array,
    Indices,
    assign,
    brief,
    positive_integer,
    positive_number,
    real_array,
    require_bool,
)
from lin_freq_ocp.base.errors import BandWarning, ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import AT_MOST, number, price
from lin_freq_ocp.problem.numbers import Axis, Number
from lin_freq_ocp.problem.spectrum.bands import Band, stop_band
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, Signal, component_words
from lin_freq_ocp.problem.terms.maps import AffineMap
from lin_freq_ocp.problem.terms.penalties import NormBall
from lin_freq_ocp.problem.terms.penalty import weight_of
from lin_freq_ocp.problem.terms.semi_infinite import Frequencies, HeldFrequencies, HeldMap, Limits, limits_on
from lin_freq_ocp.problem.terms.spectrum_maps import FrequencyMap, SpectrumMap
from lin_freq_ocp.problem.terms.term import Term, TermKind

Limit = ArrayLike | Callable[[Array], ArrayLike]
PART_OF_WIDTH = 0.1  # of a notch at every frequency, where bins mean nothing: the step of its edges
SAMPLED = 64  # frequencies of an interval at which a function is evaluated, or of two points with a limit in dB
NO_ZERO = (
    "A signal of finitely many samples whose spectrum vanishes on an interval is zero everywhere. Give a level above "
    "zero, or remove the bins of the horizon: the band itself instead of a MagnitudeBound."
)
NO_LOWER_MASK = (
    "A lower bound on a magnitude is not convex (of two signals above it, the mean can be zero), so no global optimum "
    "could be proven. Ask for a reference instead: u_ref, x_ref."
)


@dataclass(frozen=True, eq=False, init=False)
class SpectrumBound(FrequencyConstraint, ABC):
    """The bins, window and price that MagnitudeBound and EnergyBound share."""

    label: ClassVar[str]
    together: ClassVar[bool]  # whether one limit holds for all bins
    limit: float | Array
    band: Band
    component: int | str | None
    penalty: float | None
    window: str | Array | None
    oversampling: int

    def _set_domain(
        self,
        bins: Iterable[int] | None,
        band: Band | None,
        component: int | str | None,
        penalty: float | None,
        window: str | ArrayLike | None,
        oversampling: int,
    ) -> None:
        kind = type(self).__name__
        if (bins is None) == (band is None):
            got = "neither" if bins is None else "both"
            raise ProblemError(kind, f"{got} of bins and band", "exactly one of them")
        domain = band if bins is None else stop_band(bins=bins)
        if not isinstance(domain, Band):
            raise ProblemError(f"{kind}.band", brief(band), "a band", "Make one with low_pass, notch, stop_band, ...")
        if component is not None and domain.component is not None:
            got = f"{component!r}, and {domain.component!r} from the band"
            raise ProblemError(f"{kind}.component", got, "one component")
        if isinstance(window, str):
            _named_window(kind, window, 8)
        elif window is not None:
            window = real_array(f"{kind}.window", window)
        assign(
            self,
            band=domain,
            component=domain.component if component is None else component,
            penalty=None if penalty is None else positive_number(f"{kind}.penalty", penalty),
            window=window,
            oversampling=positive_integer(f"{kind}.oversampling", oversampling),
        )

    @abstractmethod
    def limits(self, count: int, field: str) -> Array:
        """Return the limit of the norm of each of ``count`` points of the grid, or of all together."""

    def numbers(self, axis: Axis) -> Iterator[Number]:
        edges = self.band.numbers(axis, PART_OF_WIDTH if self.every_frequency else np.inf)
        for edge in edges if np.ndim(self.limit) == 0 else ():  # else each bin or frequency has a limit of its own
            yield replace(edge, put=partial(_move_band, edge.put))
        yield from super().numbers(axis)

    @property
    @abstractmethod
    def factor(self) -> float:
        """Return the limit on the grid per unit of the given limit, or of its root."""

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        for name, spectrum, limits in self.spectra(signal, field):
            yield self.term(name, signal.kind, spectrum, limits, source)

    def spectra(self, signal: Signal, field: str) -> Iterator[tuple[str, SpectrumMap, Array]]:
        """Yield the name and the spectrum of each bounded component, and the limits of its groups, (groups,) or ()."""
        bins = self.bins(signal.length, signal.sampling_time, field)
        window, points = self.samples(signal.length, field), self.oversampling * signal.length
        for name, C, D in signal.rows(field, self.component):
            limits = self.limits(len(bins), field)
            if len(bins):  # else a warning has been issued
                yield name, SpectrumMap(C, D, window, points, bins, self.together), limits

    def term(self, name: str, kind: TermKind, values: AffineMap, limits: Array, source: tuple[str, int]) -> Term:
        """Return the term of a component: its values, group by group, are bounded by these limits."""
        weight = weight_of(self.penalty) / (self.factor if self.together else 1.0)  # of the root of an energy as given
        return Term(f"{self.label} on {name}", kind, values, NormBall(2, limits, weight), source, self.factor)

    def augmented(self, n: int, k: int) -> Sequence[SpectrumBound]:
        return self.on_components(n)

    def softened(self, penalty: float) -> Self:
        return self if self.penalty is not None else self.changed(penalty=penalty)

    @property
    def where(self) -> str:
        """Return a text of the bins, the window and the grid."""
        window = "" if self.window is None else f"; window {self.window if isinstance(self.window, str) else 'given'}"
        finer = "" if self.oversampling == 1 else f"; on a grid {self.oversampling} times as fine"
        return f"{self.band.removed}{window}{finer}"

    def samples(self, length: int, field: str) -> Array:
        """Return the window of a signal, (length,)."""
        if self.window is None:
            return np.ones(length)
        if isinstance(self.window, str):
            return _named_window(field, self.window, length)
        if self.window.shape != (length,):
            raise ProblemError(f"{field}.window", f"shape {self.window.shape}", f"shape ({length},), one per sample")
        return self.window

    def bins(self, length: int, sampling_time: float | None, field: str) -> Indices:
        """Return the bounded points of the grid: indices within 0 .. oversampling * length / 2."""
        q, points = self.oversampling, self.oversampling * length
        if self.band.unit != "bins":
            found = np.flatnonzero(self.band.at(points, sampling_time, f"{field}.band"))
            if not len(found):
                what = f"{field}.band: {self.band} bounds no bin of a signal of {length} samples."
                warnings.warn(what, BandWarning, stacklevel=2)
            return found
        named = np.flatnonzero(self.band.at(length, sampling_time, field))
        grid = np.zeros(points // 2 + 1, dtype=bool)
        for k in named:  # between neighbours, too; for odd N, the last bin's is its own conjugate
            last = q * k + (q if k + 1 in named or 2 * k + 1 == length else 0)
            grid[q * k : last + 1] = True
        return np.flatnonzero(grid)


def _move_band(put: Callable[..., object], bound: SpectrumBound, value: float) -> SpectrumBound:
    return bound.changed(band=put(bound.band, value))


class MagnitudeBound(SpectrumBound):
    """|uhat_k| <= limit at the bins that a band would remove (a mask).

    Parameters
    ----------
    limit : float or (bins,)
        In the units of the DFT, sum_t u_t exp(-2 pi i k t/N): the unit of the signal, as no 1/N stands before the sum.
        One number, or one for each of the bounded bins 0 .. N/2 (with oversampling, for each point of the finer grid).
    limit_db : float or (bins,), with ``reference`` : float
        Instead of ``limit``: limit = reference * 10^(limit_db / 20).
    bins : list of int, or band : Band
        Where; of a Band, the bins it would remove.
    component : int or str, optional
        Index or name of the component; default all, each with this bound.
    penalty : float, optional
        Makes it soft: penalty * excess of each bin is added to the cost; with every_frequency, of max |V|/l - 1.
    window : str or (N,), optional
        Multiplies the signal first; a name is one of scipy.signal.get_window.
    oversampling : int
        Holds on a grid this many times as fine as the DFT's, with the frequencies of the band between its bins.
    between : bool
        Hold the limit between the points of the finer grid, too: on them it is made smaller by
        cos(pi/(2 oversampling)), as no spectrum of N samples exceeds its largest value on the whole grid by more
        (Ehlich and Zeller, Mathematische Zeitschrift 86, 1964). That is a theorem for a mask of one level on the whole
        circle. At the ends of a band, beyond which the spectrum is much larger, what it is between the last two points
        can exceed the limit, the more the deeper the mask: look at the zero-padded spectrum.
        A price is for the excess over this smaller limit.
    every_frequency : bool
        |V(w)| <= limit for every w of the band (in its closure), V(w) = sum_t u_t exp(-iwt), and not at bins only:
        what holds whatever the signal is padded with. The limit is then one number above zero, points (frequency,
        limit) of shape (points, 2) in the unit of the band, linear between them, or a function of the frequency, which
        is sampled to 64 points of the band; in ``limit_db``, points are linear over the logarithm of the frequency,
        sampled to 64 points from each to the next. Excludes bins, oversampling and between.
    hold : bool
        With every_frequency: for the signal as the plant sees it, held for a sampling time h after each sample,
        |sinc(f h) V(2 pi f h)| <= limit, sinc(a) = sin(pi a) / (pi a), at every f of the band in Hz, images above
        Nyquist included: low_pass(cutoff_hz=f_c) is then [f_c, infinity), and edges and points may be above Nyquist.
        After the last point, the last limit holds.

    Raises
    ------
    ProblemError
        If a value is not of this kind.
    UnsupportedError
        For ``at_least``: signals above a mask are no convex set.

    Examples
    --------
    >>> lfo.MagnitudeBound(0.5, band=lfo.low_pass(1.0))  # at the bins that the low pass would remove
    MagnitudeBound(...)
    """

    label = "mask"
    together = False
    limit: Array
    between: bool
    every_frequency: bool
    hold: bool

    def __init__(
        self,
        limit: Limit | None = None,
        *,
        limit_db: ArrayLike | None = None,
        reference: float | None = None,
        at_least: ArrayLike | None = None,
        bins: Iterable[int] | None = None,
        band: Band | None = None,
        component: int | str | None = None,
        penalty: float | None = None,
        window: str | ArrayLike | None = None,
        oversampling: int = 1,
        between: bool = False,
        every_frequency: bool = False,
        hold: bool = False,
    ):
        if at_least is not None:
            raise UnsupportedError(f"MagnitudeBound.at_least: {NO_LOWER_MASK}")
        if (limit is None) == (limit_db is None):
            got = "neither" if limit is None else "both"
            raise ProblemError("MagnitudeBound.limit", got, "exactly one of limit and limit_db")
        if (limit_db is None) != (reference is None):
            expected = "a reference with limit_db, and only with it"
            raise ProblemError("MagnitudeBound.reference", brief(reference), expected)
        for name, given in (("every_frequency", every_frequency), ("hold", hold), ("between", between)):
            require_bool(f"MagnitudeBound.{name}", given)
        read = partial(limit_of_frequencies, band) if every_frequency else limit_of_bins
        found = read(limit, limit_db, reference)
        assign(self, limit=found, between=between, every_frequency=every_frequency, hold=hold)
        self._set_domain(bins, band, component, penalty, window, oversampling)
        if every_frequency and (self.band.unit == "bins" or oversampling != 1 or between):
            got = "bins, oversampling or between, with every_frequency=True"
            raise ProblemError("MagnitudeBound", got, "a band of frequencies and a limit")
        if hold and not (every_frequency and self.band.unit == "Hz"):
            got = "hold=True without every_frequency=True, or with a band that is not in Hz"
            raise ProblemError("MagnitudeBound.hold", got, "every_frequency=True and a band in Hz")
        if between and self.oversampling < 2:
            raise ProblemError("MagnitudeBound.oversampling", "1", "at least 2 (better 4) for between=True")

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        if not self.every_frequency:
            yield from super().terms(signal, field, source)
            return
        limits = limits_of(field, self.limit, self.band, signal.sampling_time, self.hold)
        samples, price_of_excess = (self.samples(signal.length, field), np.zeros(0)), float(weight_of(self.penalty))
        kind, of_signal = (HeldFrequencies, HeldMap) if self.hold else (Frequencies, FrequencyMap)
        maps = (of_signal(C, D, *samples) for _, C, D in signal.rows(field, self.component))
        masks = (kind(values, limits, price=price_of_excess) for values in maps)
        yield from self.semi_infinite_terms(f"{'held ' if self.hold else ''}mask on", signal, masks, source)

    def describe(self, names: Sequence[str]) -> str:
        low, high = (number(float(limit)) for limit in (self.levels.min(), self.levels.max()))
        limit = low if low == high else f"{low} to {high} (a limit for each bin)"
        of = component_words(self.component, names)
        if self.every_frequency:
            spectrum = "|sinc(f h) V|, as it is held," if self.hold else "|V(w)|"
            where = f"at every frequency of {self.where}{price(self.penalty, 'largest excess relative to the limit')}"
            return f"mask of {of}: {spectrum} {AT_MOST} {limit} {where}"
        between = " and between its points" if self.between else ""
        return f"mask of {of}: |DFT| {AT_MOST} {limit} at {self.where}{between}{price(self.penalty, 'excess of a bin')}"

    def bins(self, length: int, sampling_time: float | None, field: str) -> Indices:
        found = super().bins(length, sampling_time, field)
        listed = [int(k) for k in self.band.edges] if self.band.unit == "bins" and self.limit.ndim else []
        if listed and (listed != sorted(set(listed)) or not 0 <= listed[0] <= listed[-1] <= length // 2):
            got = f"{brief(listed)}, with a limit for each"
            raise ProblemError(f"{field}.bins", got, f"increasing bins within 0 .. {length // 2}")
        return found

    def limits(self, count: int, field: str) -> Array:
        if self.limit.shape not in ((), (count,)):
            raise ProblemError(f"{field}.limit", f"shape {self.limit.shape}", f"one number, or {count}: one per bin")
        return np.broadcast_to(self.factor * self.limit, (count,))

    @property
    def levels(self) -> Array:
        return self.limit[:, 1] if self.limit.ndim == 2 else self.limit

    def at_levels(self, levels: Array) -> Self:
        return self.changed(limit=np.column_stack([self.limit[:, 0], levels]) if self.limit.ndim == 2 else levels)

    @property
    def factor(self) -> float:
        return float(np.cos(np.pi / (2 * self.oversampling))) if self.between else 1.0


class EnergyBound(SpectrumBound):
    """sum |uhat_k|^2 <= limit over the bins 0 .. N/2 that a band would remove; each pair of conjugate bins once.

    Parameters
    ----------
    limit : float
        In squared units of the DFT. With oversampling q, the sum over the finer grid is divided by q.
    penalty : float, optional
        Makes it soft: penalty * excess of the root of the energy (with oversampling, of the sum divided by q) over the
        root of the limit is added to the cost.
    bins, band, component, window, oversampling
        As for ``MagnitudeBound``.

    Raises
    ------
    ProblemError
        If a value is not of this kind.

    Examples
    --------
    >>> lfo.spectrum.EnergyBound(0.5, band=lfo.low_pass(1.0)).describe(["thrust"])
    'energy of thrust: sum of |DFT|² ≤ 0.5 over the bins above 1 rad/sample'
    """

    label = "energy bound"
    together = True
    limit: float

    def __init__(
        self,
        limit: float,
        *,
        bins: Iterable[int] | None = None,
        band: Band | None = None,
        component: int | str | None = None,
        penalty: float | None = None,
        window: str | ArrayLike | None = None,
        oversampling: int = 1,
    ):
        energy = real_array("EnergyBound.limit", limit)
        if energy.ndim or energy < 0:
            raise ProblemError("EnergyBound.limit", brief(limit), "one number, zero or above")
        assign(self, limit=float(energy))
        self._set_domain(bins, band, component, penalty, window, oversampling)

    def describe(self, names: Sequence[str]) -> str:
        of, limit = component_words(self.component, names), f"{AT_MOST} {number(self.limit)}"
        square, cost = "\N{SUPERSCRIPT TWO}", price(self.penalty, "excess of its root")
        return f"energy of {of}: sum of |DFT|{square} {limit} over {self.where}{cost}"

    @property
    def levels(self) -> Array:
        return np.sqrt(self.limit)

    @property
    def power(self) -> int:
        return 2

    def at_levels(self, levels: Array) -> Self:
        return self.changed(limit=float(levels) ** 2)

    def limits(self, count: int, field: str) -> Array:
        return np.asarray(self.factor * np.sqrt(self.limit))

    @property
    def factor(self) -> float:
        return float(np.sqrt(self.oversampling))


def softened_constraint(penalty: float, given: FrequencyConstraint) -> FrequencyConstraint:
    """Return a frequency constraint with a price per unit of excess: of a stop band, of each of its bins."""
    if isinstance(given, Band):
        return MagnitudeBound(0.0, band=given, penalty=penalty)
    return given.softened(penalty)


def _named_window(field: str, name: str, length: int) -> Array:
    from scipy.signal import get_window  # slow to import

    try:
        return np.asarray(get_window(name, length, fftbins=False), dtype=np.float64)
    except ValueError:
        expected = "a window of scipy.signal, such as 'hann', or numbers"
        raise ProblemError(f"{field}.window", repr(name), expected) from None


def limit_of_bins(limit: object, limit_db: ArrayLike | None, reference: float | None) -> Array:
    """Return the limit of bins as one number, (), or one for each, (bins,)."""
    field, given = ("MagnitudeBound.limit", limit) if limit_db is None else ("MagnitudeBound.limit_db", limit_db)
    bound = real_array(field, given, allow_infinite=limit_db is None)
    if limit_db is not None:
        with np.errstate(over="ignore"):  # so high that there is no limit
            bound = np.asarray(from_decibels(bound, reference))
    if bound.ndim > 1 or (bound < 0).any():
        raise ProblemError(field, brief(given), "one number, zero or above, or one for each bin")
    return bound


def limit_of_frequencies(
    band: Band | None, limit: Limit | None, limit_db: ArrayLike | None, reference: float | None
) -> Array:
    """Return the limit as one number, (), or as points (frequency in the band's unit, limit), (points, 2).

    Points in dB are linear over the logarithm of the frequency, and are sampled to points that are linear over it.
    """
    field = "MagnitudeBound.limit"
    if limit_db is not None:
        found = real_array(f"{field}_db", limit_db)
        if found.ndim:
            w, decibels = _sample_decibels(f"{field}_db", _require_points(f"{field}_db", found))
            found = np.column_stack([w, from_decibels(decibels, reference)])
        else:
            found = from_decibels(found, reference)
    elif callable(limit):
        found = _sample_function(field, limit, band)
    else:
        found = real_array(field, limit)
    if found.ndim:
        found = _require_points(field, found)
    lowest = (found[:, 1] if found.ndim else found).min()
    if lowest <= 0:
        raise ProblemError(field, f"{lowest:g}", "a limit above zero at every frequency", NO_ZERO)
    return found


def from_decibels(decibels: Array, reference: object) -> Array:
    """Return reference * 10^(decibels / 20)."""
    return positive_number("MagnitudeBound.reference", reference) * 10 ** (decibels / 20)


def _require_points(field: str, given: Array) -> Array:
    if given.ndim != 2 or given.shape[1] != 2 or len(given) < 2:
        expected = "one number, or points (frequency, limit) of shape (points, 2), at least two"
        raise ProblemError(field, f"shape {given.shape}", expected)
    if (np.diff(given[:, 0]) <= 0).any() or given[0, 0] < 0:
        raise ProblemError(field, brief(given[:, 0].tolist()), "frequencies that increase, from 0 or above")
    return given


def _sample_decibels(field: str, points: Array) -> tuple[Array, Array]:
    """Return frequencies and levels that are linear in dB over the logarithm of the frequency between given ones."""
    if points[0, 0] <= 0:
        raise ProblemError(field, "a point at frequency 0", "the first point above 0, for dB over log frequency")
    w = np.unique(
        np.concatenate([np.geomspace(*pair, SAMPLED) for pair in zip(points[:-1, 0], points[1:, 0], strict=True)])
    )
    return w, np.interp(np.log(w), np.log(points[:, 0]), points[:, 1])


def _sample_function(field: str, limit: Callable[[Array], ArrayLike], band: Band | None) -> Array:
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


def limits_of(field: str, limit: Array, band: Band, sampling_time: float | None, hold: bool) -> Limits:
    """Return the limit on the closed intervals that a band removes, in rad/sample.

    Of a held signal, at w = 2 pi f h of any size: beyond the last point the limit is constant, and of an interval
    without end, there is one period of V after it.
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
    slack = 1e-9 * np.pi  # rounding of a change of unit
    if limit.ndim and (points[0] > first + slack or points[-1] < last - slack):
        got = f"points from {limit[0, 0]:g} to {limit[-1, 0]:g} {band.unit}"
        expected = f"points from {first / factor:g}{'' if hold else f' to {last / factor:g}'} {band.unit}"
        raise ProblemError(f"{field}.limit", got, f"{expected}, which the band removes")
    return limits_on(intervals, points, values)
