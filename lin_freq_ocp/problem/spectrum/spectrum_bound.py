# ruff: noqa: D102
"""The base of bounds on spectra: their bins, window and grid, and the units of their limits.

A grid finer than the DFT's (``oversampling``) or a window also bounds the spectrum between the bins.
``FrequencyConstraint`` documents the methods without a docstring.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Indices, assign, brief, positive_integer, positive_number, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import ordinal, short_name, split_unit
from lin_freq_ocp.problem.numbers import Axis, Number
from lin_freq_ocp.problem.spectrum.bands import Band, stop_band
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, Signal, component_indices
from lin_freq_ocp.problem.spectrum.harmonics import Harmonics
from lin_freq_ocp.problem.spectrum.stated_limits import StatedLimit
from lin_freq_ocp.problem.terms.maps import AffineMap, StageMap, SumMap
from lin_freq_ocp.problem.terms.penalties import NormBall, StandardCone
from lin_freq_ocp.problem.terms.penalty import HARD
from lin_freq_ocp.problem.terms.quantity import Quantity, Statement
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrumMap
from lin_freq_ocp.problem.terms.term import Term, TermKind

PART_OF_WIDTH = 0.1  # step of the edges of a notch at every frequency, relative to its width; bins mean nothing there
OR_HARMONICS = "Or harmonics= of fundamental_hz=, in place of both."


@dataclass(frozen=True, eq=False, init=False)
class SpectrumBound(FrequencyConstraint, ABC):
    """What MagnitudeBound and EnergyBound share: bins, window and price."""

    label: ClassVar[str]
    joint: ClassVar[bool]  # whether one limit bounds all bins together
    between: bool = False  # whether the limit also holds between the points of the grid
    edges: bool = False  # whether the points of the grid next to the band are also bounded
    limit: float | Array  # as stated
    quantity: Quantity  # the unit of the limit
    fundamental_hz: float | None
    band: Band
    component: int | str | None
    penalty: float | None
    window: str | Array | None
    oversampling: int

    def _set_domain(
        self,
        stated: StatedLimit,
        fundamental_hz: float | None,
        bins: Iterable[int] | None,
        band: Band | None,
        component: int | str | None,
        penalty: float | None,
        window: str | ArrayLike | None,
        oversampling: int,
    ) -> None:
        kind, domains = type(self).__name__, (stated.harmonics, band, bins)
        if sum(domain is not None for domain in domains) != 1:
            got = "both" if any(domain is not None for domain in domains) else "neither"
            raise ProblemError(kind, f"{got} of bins and band", "exactly one of them", OR_HARMONICS)
        domain = stop_band(bins=bins) if bins is not None else stated.harmonics or band
        if not isinstance(domain, Band):
            raise ProblemError(f"{kind}.band", brief(band), "a band", "Make one with low_pass, notch, stop_band, ...")
        if component is not None and domain.component is not None:
            got = f"{component!r}, and {domain.component!r} from the band"
            raise ProblemError(f"{kind}.component", got, "one component")
        if isinstance(window, str):
            _named_window(kind, window, 8)
        elif window is not None:
            window = real_array(f"{kind}.window", window)
        if stated.quantity.of_fundamental and (penalty is not None or oversampling != 1 or self.every_frequency):
            got = "a penalty, oversampling or every_frequency"
            expected = "none with of='fundamental', a cone at bins"
            raise ProblemError(stated.field, got, expected, "State of= as a number.")
        assign(
            self,
            quantity=stated.quantity,
            fundamental_hz=fundamental_hz,
            band=domain,
            component=domain.component if component is None else component,
            penalty=None if penalty is None else positive_number(f"{kind}.penalty", penalty),
            window=window,
            oversampling=positive_integer(f"{kind}.oversampling", oversampling),
        )

    @abstractmethod
    def bin_levels(self, bins: Indices, points: int, sampling_time: float | None, field: str) -> Array:
        """Return the limits of bins of a grid of so many points in levels, (bins,); one limit, (), of a joint bound."""

    def numbers(self, axis: Axis) -> Iterator[Number]:
        edges = self.band.numbers(axis, PART_OF_WIDTH if self.every_frequency else np.inf)
        for edge in edges if np.ndim(self.limit) == 0 else ():  # else every bin or frequency has its own limit
            yield replace(edge, put=partial(SpectrumBound.with_band, put=edge.put))
        yield from super().numbers(axis)

    def with_band(self, value: float, put: Callable[..., object]) -> Self:
        """Return the bound with the band that ``put`` makes of its own."""
        return self.changed(band=put(self.band, value))

    @property
    @abstractmethod
    def factor(self) -> float:
        """Return the limit on the grid per unit of the stated limit, or of its root."""

    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        for name, spectrum, levels, sums in self.spectra(signal, field):
            if self.quantity.of_fundamental:
                yield from self._parts_of_fundamental(name, spectrum, levels, signal, field, source)
            else:
                term = self.term(name, signal.kind, spectrum, levels, sums, source)
                yield replace(term, statement=self.statement(name, spectrum, levels, signal.sampling_time))

    def spectra(self, signal: Signal, field: str) -> Iterator[tuple[str, SpectrumMap, Array, Array | float]]:
        """Yield the name and the spectrum of each bounded component, the levels of its groups and sums per level.

        Levels are (groups,) or (), sums of samples per level (groups,) or one number.
        """
        step = signal.sampling_time
        bins = self.bins(signal.length, step, field)
        window, points = self.samples(signal.length, field), self.oversampling * signal.length
        levels = self.bin_levels(bins, points, step, field)
        at_ends, inner = self.quantity.sums(window, step, field)
        for name, C, D in signal.rows(field, self.component):
            if len(bins):
                spectrum = SpectrumMap(C, D, window, points, bins, self.joint)
                sums, differ = inner, at_ends != inner and spectrum.real.any()
                if self.joint and differ:
                    expected, advice = (
                        "bins between 0 and N/2, where sums count alike",
                        "Leave these out, or state limit=.",
                    )
                    raise ProblemError(f"{field}.band", f"{self.band.removed}, with 0 or N/2", expected, advice)
                if differ and not self.between:
                    sums = np.where(spectrum.real, at_ends, inner)
                yield name, spectrum, levels, self.factor * sums

    def term(
        self, name: str, kind: TermKind, part: AffineMap, levels: Array, sums: Array | float, source: tuple[str, int]
    ) -> Term:
        """Return the term of a component: levels times the sums per level bound the norms of its groups."""
        # the price is on the level, of an energy on its root; that of a mask on sums is on the sums themselves
        per_level = sums if self.joint or not self.quantity.is_sum else 1.0
        weight = HARD if self.penalty is None else np.asarray(self.penalty / per_level)
        ball = NormBall(2, np.asarray(levels * sums), weight)
        return Term(f"{self.label} on {name}", kind, part, ball, source, sums, band=self._band_in_names)

    def statement(self, name: str, spectrum: SpectrumMap, levels: Array, sampling_time: float | None) -> Statement:
        """Return how the limits of a component are shown: each listed bin alone, or the band."""
        short, each = short_name(name), self.band.listed and self.oversampling == 1 and not self.joint
        if each and self.band.unit == "harmonics":
            labels = [f"{ordinal(int(order))} harmonic of {short}" for order in self.band.edges]
        elif each:
            labels = [f"bin {k} of {short}" for k in spectrum.bins]
        else:
            labels = [f"{short}, {self.band.removed.removeprefix('the bins ')}"]
        return Statement(self.quantity, name, labels, levels, sampling_time, in_band=not each)

    def _parts_of_fundamental(
        self, name: str, spectrum: SpectrumMap, levels: Array, signal: Signal, field: str, source: tuple[str, int]
    ) -> Iterator[Term]:
        """Yield a cone for each group: its norm is at most a part of Re(exp(-i phase) u_1)."""
        phase, samples = self.quantity.phase, np.arange(spectrum.samples)
        fundamental = Harmonics("harmonics", (1.0,), "harmonics", fundamental_hz=self.fundamental_hz or 0.0)
        first = np.flatnonzero(fundamental.at(signal.length, signal.sampling_time, field))
        along = np.array([np.cos(phase), np.sin(phase)]) @ replace(spectrum, bins=first, joint=False).waves()
        at_ends, inner = self.quantity.sums(spectrum.window, signal.sampling_time, field)
        statement = self.statement(name, spectrum, levels, signal.sampling_time)
        for i in range(spectrum.shape[0]):
            part = replace(spectrum, bins=spectrum.bins if self.joint else spectrum.bins[i : i + 1], joint=True)
            level, label = np.ravel(levels)[i], statement.labels[min(i, len(statement.labels) - 1)]
            share = level / 100 * (at_ends / inner if part.real.any() else 1.0)
            rows = np.vstack([share * along, part.waves()]).T[:, :, None]
            of_x, of_u = (None if row is None else rows * row for row in (spectrum.C, spectrum.D))
            none = np.zeros(rows.shape[1])
            shown = replace(statement, labels=[label], levels=np.asarray(level), relative=True)
            sums = SumMap((StageMap(samples, of_x, of_u, none),), none)
            title, band = f"{self.label} on {name}", label.removesuffix(f" of {short_name(name)}")
            yield Term(title, signal.kind, sums, StandardCone(), source, band=band, statement=shown)

    def augmented(self, n: int, k: int) -> Sequence[SpectrumBound]:
        return self.on_components(n)

    def softened(self, penalty: float) -> Self:
        always_hard = self.quantity.of_fundamental
        return self.changed(penalty=penalty) if self.penalty is None and not always_hard else self

    def shown(self, level: float, names: Sequence[str]) -> str:
        unit = "" if self.quantity.keyword in ("limit", "energy") else self.limit_unit(names)
        return f"{float(self.quantity.stated(np.asarray(level))):.6g} {unit}".rstrip()

    def limit_unit(self, names: Sequence[str]) -> str:
        """Return the unit of the limit of a signal with components of these names."""
        indices = component_indices(type(self).__name__, self.component, names)
        units = {split_unit(names[i])[1] for i in indices}
        return self.quantity.unit(units.pop() if len(units) == 1 else "")

    @property
    def _band_in_names(self) -> str:
        """Return the band, if the names of terms show it; those of limits on sums are numbered."""
        return "" if self.quantity.is_sum else self.band.removed.replace("the bins", "frequencies")

    @property
    def where(self) -> str:
        """Return the bins, the window and the grid in words."""
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

    def remark(self, length: int, sampling_time: float | None, field: str) -> str:
        everywhere = self.band.listed or self.every_frequency  # a held mask may be above the Nyquist frequency
        if everywhere or self.band.at(self.oversampling * length, sampling_time, f"{field}.band").any():
            return ""
        return f"{field}.band: {self.band} bounds no bin of a signal of {length} samples."

    def bins(self, length: int, sampling_time: float | None, field: str) -> Indices:
        """Return the bounded points of the grid: indices within 0 .. oversampling * length / 2."""
        q, points = self.oversampling, self.oversampling * length
        if not self.band.listed:
            inside = self.band.at(points, sampling_time, f"{field}.band")
            if self.edges:
                inside = np.convolve(inside, np.ones(3), "same") > 0
            return np.flatnonzero(inside)
        listed = np.flatnonzero(self.band.at(length, sampling_time, field))
        grid = np.zeros(points // 2 + 1, dtype=bool)
        for k in listed:  # and the points between neighbours; for odd N, the last bin is next to its own conjugate
            last = q * k + (q if k + 1 in listed or 2 * k + 1 == length else 0)
            grid[q * k : last + 1] = True
        return np.flatnonzero(grid)


def _named_window(field: str, name: str, length: int) -> Array:
    from scipy.signal import get_window  # slow to import

    try:
        return np.asarray(get_window(name, length, fftbins=False), dtype=np.float64)
    except ValueError:
        expected = "a window of scipy.signal, such as 'hann', or numbers"
        raise ProblemError(f"{field}.window", repr(name), expected) from None
