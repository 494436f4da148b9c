# ruff: noqa: D102
"""Bounds on magnitudes and energies of spectra.

They bound the bins that a band would remove: MagnitudeBound(0, band=low_pass(...)) is that low pass itself. With
``every_frequency`` a mask holds at all frequencies of its band. ``stated_limits.py`` reads the limits that users state.
``FrequencyConstraint`` documents the methods without a docstring.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Indices, assign, brief, real_array, require_bool
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import AT_MOST, number, price, short_name
from lin_freq_ocp.problem.spectrum.bands import Band
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, Signal, component_words
from lin_freq_ocp.problem.spectrum.spectrum_bound import SpectrumBound
from lin_freq_ocp.problem.spectrum.stated_limits import (
    ByOrder,
    Reference,
    Stated,
    limit_levels,
    limits_at_bins,
    limits_of_band,
    read_limits,
    stated_limit,
)
from lin_freq_ocp.problem.terms.penalty import weight_of
from lin_freq_ocp.problem.terms.quantity import SQUARED, Quantity, Statement
from lin_freq_ocp.problem.terms.semi_infinite import MagnitudeMask, ZeroOrderHoldMap, ZeroOrderHoldMask
from lin_freq_ocp.problem.terms.spectrum_maps import FrequencyMap, SpectrumMap
from lin_freq_ocp.problem.terms.term import Term

NO_LOWER_MASK = (
    "A lower bound on a magnitude is not convex (the mean of two signals above it can be zero), so no global optimum "
    "could be proven. Use a reference instead: u_ref, x_ref."
)


class MagnitudeBound(SpectrumBound):
    """A mask: ``amplitude=``, ``rms=``, ``percent=``, ``density=`` or ``db=``; a plain number is a sum of samples.

    It bounds each bin that a band would remove. Exactly one keyword states the limit: one number, one for each bounded
    bin 0 .. N/2 (with oversampling, for each point of the finer grid), points (frequency in the band's unit, limit) of
    shape (points, 2), linear between them, or a mapping from orders of harmonics to limits.

    Parameters
    ----------
    limit : float, array or mapping
        Of |uhat_k|, uhat_k = sum_t u_t exp(-2 pi i k t/N): a sum of samples, N/2 times the amplitude of a sinusoid.
    limit_db : float, array or mapping, with ``reference`` : float
        Of the same sum: limit = reference * 10^(limit_db / 20).
    amplitude : float, array or mapping
        Peak of a sinusoid a cos(2 pi k t/N + phase), in the unit of the signal: |uhat_k| <= N/2 * a, and N * a at bins
        0 and N/2. With a window, N is the sum of the window.
    rms : float, array or mapping
        RMS value of the sinusoid, a / sqrt(2); at bins 0 and N/2, of the constant or alternating part, a.
    percent : float, array or mapping, with ``of``
        The amplitude in percent of ``of``: a number, the amplitude of the reference; or "fundamental", the signal's own
        component at ``fundamental_hz`` with the ``phase`` in radians of a cosine: |uhat_k| <= percent/100 *
        Re(exp(-i phase) uhat_1), a second-order cone. It must hold (no penalty), at bins of the record itself.
    density : float, array or mapping
        One-sided power spectral density in squared units per Hz, as scipy.signal.periodogram returns it with the
        window and without detrending. The problem must have a sampling time. Points are linear in the density.
    db : float, array or mapping, with ``reference`` : float
        The amplitude is reference * 10^(db / 20). Points are linear over the logarithm of the frequency.
    harmonics : list of int or mapping, with ``fundamental_hz`` : float
        The orders of the bounded harmonics; a mapping {5: 4.0, 7: 4.0} also states their amplitudes. The signal must
        last a whole number of periods of the fundamental.
    bins : list of int, or band : Band
        The bounded bins: listed, or the bins that the band would remove.
    component : int or str, optional
        Index or name of the component; default all, each with this bound.
    penalty : float, optional
        Makes the mask soft: penalty times the violation of each bin is added to the cost, in the unit of the limit (of
        a density, of its root; of db, relative to the reference); with every_frequency, penalty times max |V|/l - 1.
    window : str or (N,), optional
        A window that multiplies the signal; names are those of scipy.signal.get_window.
    oversampling : int
        Bound a grid that is this many times as fine as the DFT's.
    between : bool
        Also bound the spectrum between the points of the finer grid: the limit at the points is smaller by the factor
        cos(pi/(2 oversampling)), because a spectrum of N samples exceeds its largest value on the whole grid by no more
        (Ehlich and Zeller, Mathematische Zeitschrift 86, 1964). The theorem is for a mask of one level on the whole
        circle. At the end of a band next to large values, the spectrum between the last two points can exceed the
        limit, the more the deeper the mask: look at the zero-padded spectrum, or use ``every_frequency``. A price is
        on the violation of the smaller limit.
    edges : bool
        Also bound the points of the grid next to the band: from the last one at or below the band to the first one at
        or above it.
    every_frequency : bool
        |V(w)| <= limit for every w in the closed band, V(w) = sum_t u_t exp(-iwt), not at bins only: zero-padding shows
        no violation. The limit is one number above zero, points (frequency, limit) of shape (points, 2) in the unit
        of the band, linear between them, or a function of the frequency, sampled at 64 points of the band. Points of
        ``limit_db`` and ``db`` are linear over the logarithm of the frequency; they and those of a density are sampled
        at 64 points between two of them. An amplitude a is N/2 * a at every frequency, 0 and Nyquist included. Not
        with bins, harmonics, oversampling or between.
    hold : bool
        With every_frequency: bound the zero-order hold of the signal, which is what the plant sees:
        |sinc(f h) V(2 pi f h)| <= limit, sinc(a) = sin(pi a) / (pi a), at every f of the band in Hz, with sampling time
        h. This includes the images above Nyquist: low_pass(cutoff_hz=f_c) bounds [f_c, infinity), and edges and points
        may be above Nyquist. The limit of the last point holds above it.

    Raises
    ------
    ProblemError
        If a value is not of this kind.
    UnsupportedError
        For ``at_least``: the signals above a mask are no convex set.

    Examples
    --------
    >>> lfo.MagnitudeBound(amplitude=0.02, band=lfo.low_pass(1.0))  # at the bins that the low pass would remove
    MagnitudeBound(...)
    >>> lfo.MagnitudeBound(harmonics={5: 4.0, 7: 4.0}, fundamental_hz=50).describe(["i [A]"])
    'mask of i: amplitude ≤ 4 A at harmonics 5 and 7 of 50 Hz'
    """

    label = "mask"
    joint = False
    limit: Array
    between: bool
    every_frequency: bool
    hold: bool

    def __init__(
        self,
        limit: Stated = None,
        *,
        amplitude: Stated = None,
        rms: Stated = None,
        percent: Stated = None,
        of: Reference = None,
        phase: float | None = None,
        density: Stated = None,
        db: Stated = None,
        limit_db: Stated = None,
        reference: float | None = None,
        harmonics: ByOrder | Iterable[int] | None = None,
        fundamental_hz: float | None = None,
        at_least: ArrayLike | None = None,
        bins: Iterable[int] | None = None,
        band: Band | None = None,
        component: int | str | None = None,
        penalty: float | None = None,
        window: str | ArrayLike | None = None,
        oversampling: int = 1,
        between: bool = False,
        edges: bool = False,
        every_frequency: bool = False,
        hold: bool = False,
    ):
        if at_least is not None:
            raise UnsupportedError(f"MagnitudeBound.at_least: {NO_LOWER_MASK}")
        limits = {"amplitude": amplitude, "rms": rms, "percent": percent, "density": density, "db": db}
        limits |= {"limit": limit, "limit_db": limit_db}
        stated = stated_limit("MagnitudeBound", limits, harmonics, fundamental_hz, of, phase, reference)
        for name, flag in (
            ("every_frequency", every_frequency),
            ("hold", hold),
            ("between", between),
            ("edges", edges),
        ):
            require_bool(f"MagnitudeBound.{name}", flag)
        assign(self, between=between, edges=edges, every_frequency=every_frequency, hold=hold)
        self._set_domain(stated, fundamental_hz, bins, band, component, penalty, window, oversampling)
        if every_frequency and (self.band.listed or oversampling != 1 or between):
            got = "bins, harmonics, oversampling or between, with every_frequency=True"
            raise ProblemError("MagnitudeBound", got, "a band of frequencies and a limit")
        if edges and (self.band.listed or every_frequency):
            got = "True, with bins or every_frequency"
            raise ProblemError("MagnitudeBound.edges", got, "a band, and points of a grid")
        if hold and not (every_frequency and self.band.unit == "Hz"):
            got = "hold=True without every_frequency=True, or with a band that is not in Hz"
            raise ProblemError("MagnitudeBound.hold", got, "every_frequency=True and a band in Hz")
        if between and self.oversampling < 2:
            raise ProblemError("MagnitudeBound.oversampling", "1", "at least 2 (better 4) for between=True")
        values = read_limits(stated, every_frequency, band)
        if values.ndim == 2 and self.band.listed:
            expected = "one for each bin, or points of a band of frequencies"
            raise ProblemError(stated.field, brief(stated.value), expected)
        assign(self, limit=values)

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        if not self.every_frequency:
            yield from super().terms(signal, field, source)
            return
        window, penalty = self.samples(signal.length, field), float(weight_of(self.penalty))
        sums = self.quantity.sums(window, signal.sampling_time, field)[1]
        levels = limit_levels(self.limit, self.quantity)
        limits = limits_of_band(field, levels, self.band, signal.sampling_time, self.hold).scaled(sums)
        mask, values = (ZeroOrderHoldMask, ZeroOrderHoldMap) if self.hold else (MagnitudeMask, FrequencyMap)
        rows = list(signal.rows(field, self.component))
        maps = (values(C, D, window, np.zeros(0)) for _, C, D in rows)
        step = signal.sampling_time if self.band.unit == "Hz" else None
        hertz = None if step is None else 1 / (2 * np.pi * step)
        masks = (mask(spectrum, limits, price=penalty, hertz=hertz) for spectrum in maps)
        terms = self.semi_infinite_terms(f"{'held ' if self.hold else ''}mask on", signal, masks, source)
        for term, (name, _, _) in zip(terms, rows, strict=True):
            label = f"{short_name(name)}{' (held)' if self.hold else ''}, {self.where.removeprefix('the bins ')}"
            shown = Statement(self.quantity, name, [label], np.zeros(()), signal.sampling_time, in_band=True)
            yield replace(term, per_limit=sums, statement=shown, band=self._band_in_names)

    def describe(self, names: Sequence[str]) -> str:
        known = self.limit[:, 1] if self.limit.ndim == 2 else self.limit
        low, high = (number(float(limit)) for limit in (known.min(), known.max()))
        each = "a limit for each frequency" if self.limit.ndim == 2 else "a limit for each bin"
        unit, words = "" if self.quantity.keyword == "limit" else f" {self.limit_unit(names)}", self.quantity.kind.words
        limit = f"{low}{unit.rstrip()}" if low == high else f"{low} to {high}{unit.rstrip()} ({each})"
        of = component_words(self.component, names)
        if self.every_frequency:
            spectrum = ("|sinc(f h) V|, as it is held," if self.hold else "|V(w)|") if self.quantity.is_sum else words
            where = f"at every frequency of {self.where}{price(self.penalty, 'largest excess relative to the limit')}"
            return f"mask of {of}: {spectrum} {AT_MOST} {limit} {where}"
        between = " and between its points" if self.between else ""
        return (
            f"mask of {of}: {words} {AT_MOST} {limit} at {self.where}{between}{price(self.penalty, 'excess of a bin')}"
        )

    def bins(self, length: int, sampling_time: float | None, field: str) -> Indices:
        bounded = super().bins(length, sampling_time, field)
        listed = [int(k) for k in self.band.edges] if self.band.unit == "bins" and self.limit.ndim else []
        if listed and (listed != sorted(set(listed)) or not 0 <= listed[0] <= listed[-1] <= length // 2):
            got = f"{brief(listed)}, with a limit for each"
            raise ProblemError(f"{field}.bins", got, f"increasing bins within 0 .. {length // 2}")
        return bounded

    def bin_levels(self, bins: Indices, points: int, sampling_time: float | None, field: str) -> Array:
        return limits_at_bins(field, self.limit, self.quantity, self.band, bins, points, sampling_time)

    @property
    def levels(self) -> Array:
        return self.quantity.level(self.limit[:, 1] if self.limit.ndim == 2 else self.limit)

    def at_levels(self, levels: Array) -> Self:
        limit = np.asarray(self.quantity.stated(levels))
        return self.changed(limit=np.column_stack([self.limit[:, 0], limit]) if self.limit.ndim == 2 else limit)

    def tightened(self, signal: Signal, field: str, leak: Callable[[SpectrumMap], Array]) -> list[FrequencyConstraint]:
        if self.every_frequency or self.quantity.of_fundamental:
            return [self]
        tight = list[FrequencyConstraint]()
        for one in self.on_components(len(signal.names)):
            for name, spectrum, levels, sums in one.spectra(signal, field):
                added = leak(spectrum) / sums
                less = levels - added
                if self.penalty is None and (less < 0).any():
                    k = int(np.argmin(less))
                    got = f"{number(float(levels[k]))} at bin {spectrum.bins[k]} of {short_name(name)}"
                    advice = "gain=None adds nothing to controls."
                    raise ProblemError(field, got, f"at least {number(float(added[k]))}, which loads can add", advice)
                limit = np.asarray(self.quantity.stated(np.maximum(less, 0.0)))
                tight.append(one.changed(limit=limit) if added.any() else one)
        return tight

    @property
    def factor(self) -> float:
        return float(np.cos(np.pi / (2 * self.oversampling))) if self.between else 1.0


class EnergyBound(SpectrumBound):
    """A bound on a band as a whole: ``rms=``, ``amplitude=`` or ``percent=``; a plain number is a sum of squares.

    Parameters
    ----------
    limit : float
        Of sum |uhat_k|^2 over the bins 0 .. N/2 that a band would remove, each conjugate pair counted once, in squared
        units of the DFT. With oversampling q, the sum over the finer grid is divided by q.
    rms : float
        RMS value of the part of the signal in the band, by Parseval's theorem: the root of the sum of the squared RMS
        values of its bins. Like the next two, not with bins 0 and N/2, a window or oversampling.
    amplitude : float
        The root of the sum of the squared amplitudes.
    percent : float, with ``of``
        The root of the sum of the squared amplitudes in percent of ``of``, as for ``MagnitudeBound``: the total
        harmonic distortion for of="fundamental" with its ``phase``, the total demand distortion for a number.
    harmonics : list of int, with ``fundamental_hz`` : float
        The orders in the sum.
    penalty : float, optional
        Makes the bound soft: penalty * max(sqrt(energy) - sqrt(limit), 0) is added to the cost; of the others, penalty
        times the violation in the unit of the limit.
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
    >>> distortion = lfo.spectrum.EnergyBound(percent=5, of=100.0, harmonics=range(2, 51), fundamental_hz=50)
    >>> distortion.describe(["i [A]"])
    'energy of i: amplitude ≤ 5 % of 100 A over harmonics 2 to 50 of 50 Hz'
    """

    label = "energy bound"
    joint = True
    limit: float

    def __init__(
        self,
        limit: float | None = None,
        *,
        rms: float | None = None,
        amplitude: float | None = None,
        percent: float | None = None,
        of: Reference = None,
        phase: float | None = None,
        harmonics: Iterable[int] | None = None,
        fundamental_hz: float | None = None,
        bins: Iterable[int] | None = None,
        band: Band | None = None,
        component: int | str | None = None,
        penalty: float | None = None,
        window: str | ArrayLike | None = None,
        oversampling: int = 1,
    ):
        limits = {"rms": rms, "amplitude": amplitude, "percent": percent, "limit": limit}
        stated = stated_limit("EnergyBound", limits, harmonics, fundamental_hz, of, phase)
        energy = real_array(stated.field, stated.value)
        if energy.ndim or energy < 0:
            raise ProblemError(stated.field, brief(stated.value), "one number, zero or above")
        if stated.quantity.is_sum:
            stated = stated._replace(quantity=Quantity("energy"))
        elif window is not None or oversampling != 1:
            raise ProblemError(stated.field, "a window or oversampling", "the bins of the record itself, or limit=")
        assign(self, limit=float(energy))
        self._set_domain(stated, fundamental_hz, bins, band, component, penalty, window, oversampling)

    def describe(self, names: Sequence[str]) -> str:
        of, words = component_words(self.component, names), self.quantity.kind.words
        limit, cost = f"{AT_MOST} {number(self.limit)} {self.limit_unit(names)}", price(self.penalty)
        if self.quantity.is_sum:
            words, limit = f"sum of |DFT|{SQUARED}", f"{AT_MOST} {number(self.limit)}"
            cost = price(self.penalty, "excess of its root")
        return f"energy of {of}: {words} {limit} over {self.where}{cost}"

    @property
    def levels(self) -> Array:
        return self.quantity.level(np.asarray(self.limit))

    def at_levels(self, levels: Array) -> Self:
        return self.changed(limit=float(self.quantity.stated(levels)))

    def bin_levels(self, bins: Indices, points: int, sampling_time: float | None, field: str) -> Array:
        return self.levels

    @property
    def factor(self) -> float:
        return float(np.sqrt(self.oversampling))


def softened_constraint(penalty: float, constraint: FrequencyConstraint) -> FrequencyConstraint:
    """Return a soft frequency constraint; a stop band becomes a mask of level 0, with a price on each bin."""
    if isinstance(constraint, Band):
        return MagnitudeBound(0.0, band=constraint, penalty=penalty)
    return constraint.softened(penalty)
