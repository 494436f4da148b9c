# ruff: noqa: D102
"""Frequency constraints on short windows of a signal, which may begin with measured samples of the past.

``FrequencyConstraint`` documents the methods without a docstring.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, assign, brief, positive_integer, positive_number, real_array, with_columns
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.problem.spectrum.bands import Band
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, Signal, WindowSpectra, component_indices
from lin_freq_ocp.problem.spectrum.bounds import MagnitudeBound
from lin_freq_ocp.problem.spectrum.spectrum_bound import SpectrumBound
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrumMap
from lin_freq_ocp.problem.terms.term import Term


@dataclass(frozen=True, eq=False, init=False)
class Spectrogram(FrequencyConstraint):
    """A mask or an energy bound on every window of a signal: a bound on its spectrogram.

    Windows of ``length`` samples begin at the first sample of the past and every ``hop`` samples after it. A window is
    constrained if it ends within the horizon. In a loop, windows of controls that begin before a plan ends are, too:
    the plan holds its last control, and a window of this constant is one of them. Without ``length`` there is one
    window: the past and the whole horizon.

    Parameters
    ----------
    bound : MagnitudeBound or EnergyBound
        The bound on the spectrum of each window; it may have a window function.
    length : int, optional
        Samples of a window.
    hop : int, optional
        Samples from the start of one window to the start of the next; default half a window.
    past : float, (P, components), or (P,) for a single one, optional
        The samples before time 0, the last of them at time -1, in the unit of the signal. A number is that of
        length - 1 samples; 0 is a signal at rest, of all components. Default none.
    offset : int
        Samples of the past, or of the horizon without one, before the first window begins.

    Raises
    ------
    ProblemError
        If a value is not of this kind.

    References
    ----------
    Hours, Zeilinger, Gondhalekar and Jones, "Constrained spectrum control", IEEE Transactions on Automatic Control 60,
    2015: bounds on short-time spectra in model predictive control.

    Examples
    --------
    >>> quiet = lfo.MagnitudeBound(0.5, band=lfo.low_pass(1.0))
    >>> lfo.spectrum.Spectrogram(quiet, length=16).hop
    8
    """

    label = "spectrogram"
    remembers: ClassVar[bool] = True
    bound: SpectrumBound
    length: int | None
    hop: int | None
    past: Array | None
    offset: int
    component: int | str | None
    penalty: float | None
    held: bool = False  # whether windows that end after the horizon hold its last sample
    rest: Array | None = None  # controls (T, components) of a known plan: where it exceeds a level, this is raised
    facets: int | None = None  # to its value, or to the polygon around it that has so many facets

    def __init__(
        self,
        bound: SpectrumBound,
        length: int | None = None,
        hop: int | None = None,
        past: ArrayLike | None = None,
        offset: int = 0,
    ):
        if not isinstance(bound, SpectrumBound):
            advice = "A band that is left out is MagnitudeBound(0, band=...)."
            raise ProblemError("Spectrogram.bound", brief(bound), "a MagnitudeBound or an EnergyBound", advice)
        if bound.quantity.of_fundamental:
            expected = "a bound of another quantity: a window has no fundamental of its own"
            raise ProblemError("Spectrogram.bound", "percent of='fundamental'", expected, "State of= as a number.")
        if length is None and hop is not None:
            raise ProblemError("Spectrogram.hop", brief(hop), "a length of the windows with it")
        samples = None if length is None else positive_integer("Spectrogram.length", length)
        step = None if samples is None else max(samples // 2, 1)
        measured = None if past is None else real_array("Spectrogram.past", past)
        if measured is not None and measured.ndim == 0 and samples is not None:
            measured = np.full(samples - 1, measured)
        if measured is not None and (measured.ndim not in (1, 2) or not measured.size):
            advice = "Time is axis 0. Leave past out if no sample is known."
            raise ProblemError("Spectrogram.past", f"shape {measured.shape}", "an array (P, components)", advice)
        if measured is not None and measured.ndim == 1:
            measured = measured[:, None]
        if hop is not None:
            step = positive_integer("Spectrogram.hop", hop)
        skipped = offset if isinstance(offset, int) and offset == 0 else positive_integer("Spectrogram.offset", offset)
        if samples is not None and step is not None and step > samples:
            raise ProblemError("Spectrogram.hop", f"{step}", f"at most the length of a window, {samples}")
        assign(
            self,
            bound=bound,
            length=samples,
            hop=step,
            past=measured,
            offset=skipped,
            component=bound.component,
            penalty=bound.penalty,
        )

    def _past_columns(self, count: int) -> Array:
        """Return the past of so many components, (P, count); one component at rest stands for all."""
        past = np.zeros((0, 1)) if self.past is None else self.past
        return past if past.any() or past.shape[1] != 1 else np.zeros((len(past), count))

    @property
    def slides(self) -> bool:
        return self.length is not None and self.penalty is None and not (self.bound.joint or self.bound.every_frequency)

    def hold_last(self, rest: Array, facets: int | None = None) -> Self:
        return self if self.length is None else self.changed(held=True, rest=rest, facets=facets)

    def with_correction(self, change: Array, ago: int) -> Self:
        if self.past is None or len(self.past) < ago:
            return self
        past = self.past.copy()
        past[-ago] += change
        return self.changed(past=past)

    def with_past(self, past: Array, measured: int) -> Self:
        first = self._past_columns(past.shape[1])
        whole = np.concatenate([first, past])
        if self.length is None:
            return self.changed(past=whole[len(past) :] if len(first) else None, offset=0)
        over, hop = max(len(whole) + measured - self.length + 1, 0), self.hop or 1
        begin = self.offset + max(-(-(over - self.offset) // hop), 0) * hop  # of the first window that is not over
        ahead = max(begin - len(whole), 0)
        return self.changed(past=whole[begin:] if begin < len(whole) else None, offset=ahead)

    def describe(self, names: Sequence[str]) -> str:
        past = "" if self.past is None else f" after {plural(len(self.past), 'sample')} of the past"
        of = f"every window of {self.length} samples, a new one every {self.hop}" if self.length else "all samples"
        return f"{self.bound.describe(names)}; on {of}{past}"

    def augmented(self, n: int, k: int) -> Sequence[FrequencyConstraint]:
        past = None if self.past is None else with_columns(self._past_columns(n), k)
        bounds = self.bound.on_components(n)
        return [self.changed(bound=bound, component=bound.component, past=past) for bound in bounds]

    @property
    def levels(self) -> Array | None:
        return self.bound.levels

    def shown(self, level: float, names: Sequence[str]) -> str:
        return self.bound.shown(level, names)

    def at_levels(self, levels: Array) -> Self:
        return self.changed(bound=self.bound.at_levels(levels))

    def softened(self, penalty: float) -> Self:
        bound = self.bound.softened(penalty)
        return self.changed(bound=bound, penalty=bound.penalty)

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        for name, windows, levels, sums in self.windows(signal, field):
            of, count = f"{'windows' if self.length else 'past and future'} of {name}", len(windows.starts)
            per_level, every = np.tile(sums, count) if np.ndim(sums) else sums, np.tile(levels, count)
            if self.rest is not None and self.penalty is None:
                every = np.maximum(every, windows.gauges(self.rest, self.facets) / per_level)
            term = self.bound.term(of, signal.kind, windows, every, per_level, source)
            shown = self.bound.statement(name, windows, levels, signal.sampling_time)
            labels = [f"{label}, in a window" if self.length else label for label in shown.labels]
            labels = labels * (count if len(labels) > 1 else 1)
            yield replace(term, statement=replace(shown, labels=labels, levels=np.tile(levels, count)))

    def remark(self, length: int, sampling_time: float | None, field: str) -> str:
        return self.bound.remark(self.length or length, sampling_time, f"{field}.bound")

    def measure(self, signal: Signal, field: str, x: Array, u: Array, plan: int) -> Iterator[WindowSpectra]:
        known = 0 if self.past is None else len(self.past)
        length, hop = (known + plan - self.offset, 1) if self.length is None else (self.length, self.hop)
        if known + signal.length - self.offset < length:
            return  # no window has ended
        for name, windows, levels, sums in self.changed(length=length, hop=hop, held=False).windows(signal, field):
            every = replace(windows, bins=np.arange(windows.points // 2 + 1), joint=False)
            yield WindowSpectra(
                name=name,
                begins=windows.starts,
                length=length,
                frequencies=2 * np.pi * every.bins / every.points,
                magnitudes=np.linalg.norm(every.values(x, u), axis=1).reshape(len(windows.starts), -1),
                bins=windows.bins,
                limits=np.asarray(levels * sums),
                amplitude=2.0 / float(windows.window.sum()),
                soft=self.penalty is not None,
            )

    def windows(self, signal: Signal, field: str) -> Iterator[tuple[str, SpectrumMap, Array, Array | float]]:
        count, samples = len(signal.names), signal.length
        past = self._past_columns(count)
        if past.shape[1] != count:
            raise ProblemError(f"{field}.past", f"shape {past.shape}", f"shape ({len(past)}, {count})")
        length = len(past) + samples - self.offset if self.length is None else self.length
        last = samples - 1 if self.held else samples - length
        first = np.arange(self.offset - len(past), last + 1, self.hop or 1)
        first = first[first + length > 0]
        if self.held and (not len(first) or first[-1] < last):
            first = np.append(first, last)
        if not len(first):
            got = f"windows of {length} samples, with {len(past)} samples in the past and {samples} to come"
            advice = "In a loop, past=0 of closed_loop begins windows before it."
            raise ProblemError(f"{field}.length", got, "at least one window that ends within the horizon", advice)
        window = Signal(signal.kind, signal.C, signal.D, signal.names, length, signal.sampling_time)
        components = component_indices(field, self.component, signal.names)
        bounded = self.bound.spectra(window, f"{field}.bound")
        for (name, spectrum, levels, sums), i in zip(bounded, components, strict=False):  # none without bins
            yield name, replace(spectrum, starts=first, past=past[:, i], held=self.held), levels, sums


LOBE = 4.0  # width of the main lobe of a Hann window, in bins of its length
LENGTH_ROUNDING = 1e-9  # of a length that is a whole number
LEAST_WINDOW = 8  # samples; shorter windows have no lobe


def closed_loop(
    band: Band,
    amplitude: float,
    sampling_time: float | None = None,
    length: int | None = None,
    hop: int | None = None,
    past: ArrayLike | None = None,
    oversampling: int = 4,
) -> Spectrogram:
    """Limit the applied signal of a control loop in a band: windows with a Hann taper over applied and planned samples.

    On every window of ``length`` samples that begins at a multiple of ``hop``, the amplitude 2 |V(w)| / sum(taper) of
    the tapered samples v is at most ``amplitude`` at the points of a grid with steps of 2 pi / (oversampling length),
    from the last point at or below the band to the first one at or above it. At every frequency between two of these
    points it is at most amplitude + 0.33 U / oversampling^2, where U is the largest |v_t|: a function exceeds its
    values at the ends of an interval of width d by at most d^2/8 times its largest second derivative, here
    U sum taper_t (t - centre)^2. In windows between two of these it is at most
    amplitude + 2 pi (hop / (length - 1))^2 U.

    Parameters
    ----------
    band : Band
        The frequencies to limit, as of ``notch`` or ``low_pass``: those which the band would remove; not given by bins.
    amplitude : float
        Of a sinusoid, in the unit of the signal, above zero.
    sampling_time : float, optional
        Seconds; required for a band in Hz.
    length : int, optional
        Samples of a window. Default: so many that the main lobe of the taper, 4 / length cycles per sample wide, fits
        into the band, and half of it between zero and the band.
    hop : int, optional
        Default an eighth of the length.
    past : float, (P, components), or (P,), optional
        The samples before the loop begins, length - 1 or more, or their common value: 0 for a plant at rest. Without
        it, the first window begins with the loop.
    oversampling : int
        Points of the grid per bin of the window.

    Returns
    -------
    Spectrogram
        A hard constraint. A loop whose other hard constraints are of controls alone always has a plan that keeps it.

    Raises
    ------
    ProblemError
        If a value is not of this kind.

    References
    ----------
    Harris, "On the use of windows for harmonic analysis with the discrete Fourier transform", Proceedings of the IEEE
    66, 1978. Hours, Zeilinger, Gondhalekar and Jones, IEEE Transactions on Automatic Control 60, 2015.

    Examples
    --------
    >>> limit = lfo.spectrum.closed_loop(lfo.spectrum.notch(centre_hz=8, width_hz=4), 0.1, sampling_time=0.02)
    >>> limit.length, limit.hop
    (50, 6)
    """
    level = positive_number("closed_loop.amplitude", amplitude)
    MagnitudeBound(level, band=band)  # raises for what is no band
    if band.listed:
        expected = "a band of frequencies"
        raise ProblemError("closed_loop.band", brief(band), expected, "Such as notch(centre_hz=8, width_hz=2).")
    if length is None:
        if band.unit == "Hz" and sampling_time is None:
            raise ProblemError("closed_loop.sampling_time", "None", "seconds, for a band in Hz")
        per_sample = 1 / (2 * np.pi) if band.unit == "rad/sample" else float(sampling_time or 0.0)
        low, high = (min(edge * per_sample, 0.5) for edge in band.limits)
        parts = [(low, high)] if band.kind == "notch" else [(0.0, low), (high, 0.5)]
        sizes = [min(end - begin, 2 * begin or np.inf) for begin, end in parts if end > begin]
        if not sizes:
            raise ProblemError("closed_loop.band", brief(band), "frequencies below half of the sampling rate")
        length = max(int(np.ceil(LOBE / min(sizes) - LENGTH_ROUNDING)), LEAST_WINDOW)
    samples = positive_integer("closed_loop.length", length)
    if past is not None and np.ndim(past) and len(real_array("closed_loop.past", past)) < samples - 1:
        advice = "Of the windows that are under way when the loop begins; 0 for a plant at rest."
        expected = f"at least {samples - 1} samples, 0 or None"
        raise ProblemError("closed_loop.past", f"shape {np.shape(past)}", expected, advice)
    taper = np.hanning(samples).sum()
    bound = MagnitudeBound(level * taper / 2, band=band, window="hann", oversampling=oversampling, edges=True)
    return Spectrogram(bound, samples, max(samples // 8, 1) if hop is None else hop, past)
