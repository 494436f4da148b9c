# ruff: noqa: D102  (a method without a docstring is described by ``FrequencyConstraint``)
"""Frequency constraints on short windows of a signal, and on samples of the past together with those to come."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, assign, brief, positive_integer, real_array, with_columns
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, Signal, component_indices
from lin_freq_ocp.problem.spectrum.bounds import SpectrumBound
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrogramMap
from lin_freq_ocp.problem.terms.term import Term


@dataclass(frozen=True, eq=False, init=False)
class Spectrogram(FrequencyConstraint):
    """A mask or an energy bound on every window of a signal: a bound on its spectrogram.

    Windows of ``length`` samples begin at the first sample of the past, and every ``hop`` samples from there. Those
    that end within the horizon, and not in the past, are constrained. Without ``length`` it is a single window of the
    past and the whole horizon.

    Parameters
    ----------
    bound : MagnitudeBound or EnergyBound
        On each window, of the same number of samples. A window function is a part of it.
    length : int, optional
        Samples of a window.
    hop : int, optional
        Samples from the begin of a window to that of the next; default half a window.
    past : (P, components), or (P,) for a single one, optional
        The samples before time 0, the last of them at time -1, in the unit of the signal. Default none.
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
        if length is None and hop is not None:
            raise ProblemError("Spectrogram.hop", brief(hop), "a length of the windows with it")
        samples = None if length is None else positive_integer("Spectrogram.length", length)
        step = None if samples is None else max(samples // 2, 1)
        before = None if past is None else real_array("Spectrogram.past", past)
        if before is not None and (before.ndim not in (1, 2) or not before.size):
            advice = "Time is axis 0; leave it out for none."
            raise ProblemError("Spectrogram.past", f"shape {before.shape}", "an array (P, components)", advice)
        if before is not None and before.ndim == 1:
            before = before[:, None]
        if hop is not None:
            step = positive_integer("Spectrogram.hop", hop)
        later = offset if isinstance(offset, int) and offset == 0 else positive_integer("Spectrogram.offset", offset)
        if samples is not None and step is not None and step > samples:
            raise ProblemError("Spectrogram.hop", f"{step}", f"at most the length of a window, {samples}")
        assign(
            self,
            bound=bound,
            length=samples,
            hop=step,
            past=before,
            offset=later,
            component=bound.component,
            penalty=bound.penalty,
        )

    def behind(self, past: Array, measured: int) -> Self:
        first = np.zeros((0, past.shape[1])) if self.past is None else self.past
        whole = np.concatenate([first, past])
        if self.length is None:
            return self.changed(past=whole[len(past) :] if len(first) else None, offset=0)
        ended, hop = max(len(whole) + measured - self.length + 1, 0), self.hop or 1
        begin = self.offset + max(-(-(ended - self.offset) // hop), 0) * hop  # of the first window that is not over
        ahead = max(begin - len(whole), 0)
        return self.changed(past=whole[begin:] if begin < len(whole) else None, offset=ahead)

    def describe(self, names: Sequence[str]) -> str:
        behind = "" if self.past is None else f" behind {plural(len(self.past), 'sample')} of the past"
        of = f"every window of {self.length} samples, a new one every {self.hop}" if self.length else "all samples"
        return f"{self.bound.describe(names)}; on {of}{behind}"

    def augmented(self, n: int, k: int) -> Sequence[FrequencyConstraint]:
        past = None if self.past is None else with_columns(self.past, k)
        return [self.changed(bound=one, component=one.component, past=past) for one in self.bound.on_components(n)]

    @property
    def levels(self) -> Array | None:
        return self.bound.levels

    @property
    def power(self) -> int:
        return self.bound.power

    def at_levels(self, levels: Array) -> Self:
        return self.changed(bound=self.bound.at_levels(levels))

    def softened(self, penalty: float) -> Self:
        bound = self.bound.softened(penalty)
        return self.changed(bound=bound, penalty=bound.penalty)

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        count, samples = len(signal.names), signal.length
        before = np.zeros((0, count)) if self.past is None else self.past
        if before.shape[1] != count:
            raise ProblemError(f"{field}.past", f"shape {before.shape}", f"shape ({len(before)}, {count})")
        length = len(before) + samples - self.offset if self.length is None else self.length
        first = np.arange(self.offset - len(before), samples - length + 1, self.hop or 1)
        first = first[first + length > 0]
        if not len(first):
            got = f"windows of {length} samples, of {len(before)} in the past and {samples} to come"
            raise ProblemError(f"{field}.length", got, "at least one window that ends within the horizon")
        window = Signal(signal.kind, signal.C, signal.D, signal.names, length, signal.sampling_time)
        components = component_indices(field, self.component, signal.names)
        bounded = self.bound.spectra(window, f"{field}.bound")
        for (name, spectrum, limits), i in zip(bounded, components, strict=False):  # none without bins
            windows = SpectrogramMap(spectrum, first, before[:, i])
            of = f"{'windows' if self.length else 'past and future'} of {name}"
            yield self.bound.term(of, signal.kind, windows, np.tile(limits, len(first)), source)
