"""The protocol of frequency constraints on signals: states, controls, or linear outputs of both.

A new frequency constraint is a subclass of ``FrequencyConstraint`` in a file of its own, with ``describe``, ``terms``
and ``augmented``. Its record in problem files is an entry of a table in ``files/problem_tables.py``.
``lin_freq_ocp.testing.check_terms`` checks it. ``OutputSpectrum`` puts such constraints on linear outputs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import (
    Array,
    Indices,
    Mask,
    assign,
    brief,
    first_largest,
    real_array,
    with_columns,
    with_fields,
)
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.names import component_names, index_of_name
from lin_freq_ocp.base.phrases import MOST_TEXT, combination, number, plural, runs_of, short_name
from lin_freq_ocp.problem.numbers import Axis, Number
from lin_freq_ocp.problem.terms.semi_infinite import SemiInfiniteConstraint
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrumMap
from lin_freq_ocp.problem.terms.term import Term, TermKind

Entry = TypeVar("Entry")
LEVELS = -40.0, 20.0, 0.5  # dB: lowest, highest, and a step


class FrequencyConstraint(ABC):
    """A constraint on the spectrum of a signal; a soft one has a price instead."""

    label: ClassVar[str] = "frequency constraint"  # the kind of constraint, as users read it
    component: int | str | None = None  # index or name; None: all
    penalty: float | None = None  # the price per unit of violation; None: it must hold
    output_names: Sequence[str] = ()  # the names of linear outputs, if the constraint defines them
    on_outputs: ClassVar[bool] = True  # whether it may constrain linear outputs
    remembers: ClassVar[bool] = False  # whether it depends on samples of the past
    removes_bins: ClassVar[bool] = False  # whether it is a stop band

    @abstractmethod
    def describe(self, names: Sequence[str]) -> str:
        """Return the constraint in words, for a signal with components of these names."""

    @abstractmethod
    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        """Yield the terms h(L(x, u)) of the constraint.

        ``field`` is the name in error messages, ``source`` the field of the problem and the index there.
        """

    @abstractmethod
    def augmented(self, n: int, k: int) -> Sequence[FrequencyConstraint]:
        """Return the same constraints on x in R^n if the signal becomes (x, w), w in R^k."""

    def translated(self, mean: Array) -> FrequencyConstraint:
        """Return the constraint on the signal less a constant (components,); itself if it does not limit the mean."""
        return self

    def on_components(self, n: int) -> list[Self]:
        """Return a copy for each component that it constrains, of a signal in R^n."""
        return [self.changed(component=i) for i in (range(n) if self.component is None else [self.component])]

    def changed(self, **fields: object) -> Self:
        """Return a copy with other fields."""
        return with_fields(self, **fields)

    def stopped(self, length: int, sampling_time: float | None, field: str) -> Mask:
        """Return which bins k = 0 .. length//2 of ``length`` samples it removes."""
        return np.zeros(length // 2 + 1, dtype=bool)

    def remark(self, length: int, sampling_time: float | None, field: str) -> str:
        """Return why it limits nothing of a signal of ``length`` samples, or everything; else an empty text."""
        return ""

    @property
    def title(self) -> str:
        """Return the kind of constraint in words."""
        return self.label

    @property
    def levels(self) -> Array | None:
        """Return the limits on magnitudes, of any shape; None if no limit can be moved."""
        return None

    @property
    def highest(self) -> float:
        """Return the highest finite level, 0 without any."""
        levels = np.zeros(1) if self.levels is None else self.levels
        return float(np.max(levels, initial=0.0, where=np.isfinite(levels)))

    def shown(self, level: float, names: Sequence[str]) -> str:
        """Return a level in the unit in which the limit is stated, for components of these names."""
        return f"{level:.6g}"

    def at_levels(self, levels: Array) -> Self:
        """Return a copy with other limits on magnitudes, of the same shape."""
        return self

    def numbers(self, axis: Axis) -> Iterator[Number]:
        """Yield the numbers that can be moved: a change of all levels in dB, if they are above zero."""
        if self.levels is not None and self.levels.any():
            low, high, step = LEVELS
            yield Number("level.{}", "level", "dB", 0.0, low, high, 1, FrequencyConstraint.amplified, step)

    def amplified(self, decibels: float) -> Self:
        """Return a copy with all levels higher by a gain."""
        return self if self.levels is None else self.at_levels(self.levels * 10 ** (decibels / 20))

    def relaxed(self, amount: float) -> Self:
        """Return a copy with all levels higher by an amount."""
        return self if self.levels is None else self.at_levels(self.levels + amount)

    def tightened(self, signal: Signal, field: str, leak: Callable[[SpectrumMap], Array]) -> list[FrequencyConstraint]:
        """Return the constraints with the limits of bins less ``leak`` of their spectrum, (bins,); others stay."""
        return [self]

    @property
    def constraints(self) -> Sequence[FrequencyConstraint]:
        """Return the constraints of this entry of a problem: several if it constrains outputs, else itself."""
        return (self,)

    def with_constraints(self, constraints: Sequence[FrequencyConstraint]) -> FrequencyConstraint:
        """Return the entry with other constraints; this one is replaced by the first."""
        return constraints[0]

    @property
    def hard_part(self) -> FrequencyConstraint | None:
        """Return the part that must hold; None for a soft constraint."""
        return self if self.penalty is None else None

    @property
    def slides(self) -> bool:
        """Whether it limits each point of sliding windows, and is hard."""
        return False

    def windows(self, signal: Signal, field: str) -> Iterator[tuple[str, SpectrumMap, Array, Array | float]]:
        """Yield the name, the windows, the levels of a window's groups and sums per level, of each component."""
        yield from ()

    def hold_last(self, rest: Array, facets: int | None = None) -> FrequencyConstraint:
        """Return the constraint on controls of a plan that holds its last one.

        Levels are at least the values of the controls ``rest`` (T, components) of a known plan; with ``facets``, the
        radius of the polygon of so many facets whose boundary they are on.
        """
        return self

    def with_correction(self, change: Array, ago: int) -> FrequencyConstraint:
        """Return the constraint after a change of the sample of the past so many samples ago, (components,)."""
        return self

    def with_past(self, past: Array, measured: int) -> FrequencyConstraint:
        """Return the constraint on the samples that follow ``past``, (k, components); itself if it has no memory.

        ``measured`` is the number of samples from time 0 on that are also measured.
        """
        return self

    def measure(self, signal: Signal, field: str, x: Array, u: Array, plan: int) -> Iterator[WindowSpectra]:
        """Yield the ``WindowSpectra`` of each component of an applied signal, of x and u; none if it has no memory.

        ``plan`` is the number of samples of the signal in a plan.
        """
        yield from ()

    every_frequency: bool = False  # whether it is semi-infinite: its terms sample it at finitely many points
    points: Sequence[Array] | None = None  # the sampled points of each component; None: the first points
    points_only: bool = False  # whether nothing is required elsewhere: a relaxation

    def at_frequencies(self, points: Sequence[Array], points_only: bool) -> Self:
        """Return a copy with other sampled points, one array for each component."""
        return self.changed(points=tuple(points), points_only=points_only)

    def semi_infinite_terms(
        self, label: str, signal: Signal, constraints: Iterable[SemiInfiniteConstraint], source: tuple[str, int]
    ) -> Iterator[Term]:
        """Yield the term of each component: its semi-infinite constraint, sampled at the points so far."""
        indices = component_indices(label, self.component, signal.names)
        for k, (i, constraint) in enumerate(zip(indices, constraints, strict=True)):
            values, balls = constraint.at(constraint.first_points() if self.points is None else self.points[k])
            name, semi_infinite = f"{label} {signal.names[i]}", None if self.points_only else constraint
            yield Term(name, signal.kind, values, balls, source, semi_infinite=semi_infinite)

    def softened(self, penalty: float) -> Self:
        """Return a copy with a price per unit of violation; itself, if it has one or cannot have one."""
        return self


Constraints = FrequencyConstraint | Sequence[FrequencyConstraint] | None  # a field of a problem, as users state it


@dataclass(frozen=True, eq=False)
class Signal:
    """The signal y_t = C x_t + D u_t that the frequency constraints of one field apply to."""

    kind: TermKind
    C: Array | None  # (components, n)
    D: Array | None  # (components, m)
    names: Sequence[str]  # of the components
    length: int  # the number of samples, from time 0
    sampling_time: float | None

    def rows(self, field: str, component: int | str | None) -> Iterator[tuple[str, Array | None, Array | None]]:
        """Yield name and rows of C and D of a component, or of all for None; errors name the field."""
        for j in component_indices(field, component, self.names):
            yield self.names[j], None if self.C is None else self.C[j], None if self.D is None else self.D[j]


EXCEEDED = 1e-6  # of a limit, relative: the accuracy to which the judge checks plans


@dataclass(frozen=True, eq=False)
class WindowSpectra:
    """The spectra of the windows of a signal, and the limits that a Spectrogram states for them.

    Attributes
    ----------
    name : str
        Of the component.
    begins : (windows,)
        The sample with which each window begins; those before time 0 belong to the past.
    length : int
        Samples of a window.
    frequencies : (points,)
        In rad/sample, 0 to pi.
    magnitudes : (windows, points)
        |V| of the windows, times their taper.
    bins : (bins,)
        The points of the grid that are bounded.
    limits : (bins,), or ()
        Of |V|; one number, of the root of the sum of squares, for a bound on the energy.
    amplitude : float
        Of a sinusoid per unit of |V|: 2 / sum(taper).
    soft : bool
        Whether the limits may be exceeded at a price.
    """

    name: str
    begins: Indices
    length: int
    frequencies: Array
    magnitudes: Array
    bins: Indices
    limits: Array
    amplitude: float
    soft: bool

    @property
    def joint(self) -> bool:
        """Whether one limit bounds all bins of a window together."""
        return self.limits.ndim == 0

    @property
    def ratios(self) -> Array:
        """Return what is bounded relative to its limit, (windows, bins); (windows, 1) for an energy."""
        bounded = self.magnitudes[:, self.bins]
        if self.joint:
            bounded = np.linalg.norm(bounded, axis=1, keepdims=True)
        above = np.where(bounded > 0, np.inf, 0.0)
        return np.divide(bounded, self.limits, out=above, where=np.broadcast_to(self.limits > 0, bounded.shape))

    @property
    def bands(self) -> list[tuple[int, int]]:
        """Return the first and the last point of each run of neighbouring bounded points."""
        return runs_of(self.bins)

    @property
    def exceeded(self) -> Mask:
        """Return which limits of which windows are exceeded, in the shape of ``ratios``."""
        return self.ratios > 1.0 + EXCEEDED

    @property
    def worst(self) -> tuple[int, int]:
        """Return the window and the point of the grid with the largest ratio; of an energy, its largest point."""
        window, k = first_largest(self.ratios)
        k = first_largest(self.magnitudes[window, self.bins])[0] if self.joint else k
        return window, int(self.bins[k])

    def __repr__(self) -> str:
        above = int(self.exceeded.any(axis=1).sum())
        most = f"at most {number(float(self.ratios.max()), 4)} of the limit, {above} above it"
        return f"WindowSpectra({plural(len(self.begins), 'window')} of {self.name}, {most})"


@dataclass(frozen=True, eq=False, init=False)
class OutputSpectrum:
    """Frequency constraints on linear outputs y_t = C x_t + D u_t.

    Parameters
    ----------
    C : (outputs, n), or None
    D : (outputs, m), or None
        At least one is given. Without D the signal has T+1 samples, 0 .. T, else T.
    constraints : Band, MagnitudeBound, EnergyBound, or a list of them
        Their component is an output.
    output_names : sequence of str, optional

    Raises
    ------
    ProblemError
        If shapes do not match.

    Examples
    --------
    >>> limited = lfo.spectrum.OutputSpectrum(C=[[1.0, -1.0]], constraints=lfo.low_pass(1.0))
    >>> limited.output_names
    ('y_0',)
    """

    C: Array | None
    D: Array | None
    constraints: tuple[FrequencyConstraint, ...]
    output_names: tuple[str, ...]

    def __init__(
        self,
        C: ArrayLike | None = None,
        D: ArrayLike | None = None,
        constraints: FrequencyConstraint | Sequence[FrequencyConstraint] = (),
        output_names: Sequence[str] | None = None,
    ):
        stated = {"C": C, "D": D}
        rows = {name: real_array(f"output_spectrum.{name}", M) for name, M in stated.items() if M is not None}
        count = len(next(iter(rows.values()), ()))
        if not rows or any(matrix.ndim != 2 or 0 in matrix.shape or len(matrix) != count for matrix in rows.values()):
            shapes = ", ".join(str(matrix.shape) for matrix in rows.values()) or "neither C nor D"
            raise ProblemError("output_spectrum", shapes, "a matrix C or D, or both, with one row per output")
        entries = tuple(constraints) if isinstance(constraints, (list, tuple)) else (constraints,)
        wrong = [entry for entry in entries if not isinstance(entry, FrequencyConstraint) or not entry.on_outputs]
        if wrong or not entries:
            got = brief(wrong[0]) if wrong else "nothing"
            raise ProblemError("output_spectrum.constraints", got, "bands, MagnitudeBound or EnergyBound")
        checked_names = component_names("output_spectrum.output_names", output_names, count, "y")
        assign(self, C=rows.get("C"), D=rows.get("D"), constraints=entries, output_names=checked_names)

    def describe(self, signals: Sequence[str]) -> str:
        """Return the constrained outputs as formulas; ``signals`` names the states, then the controls."""
        used = {j for entry in self.constraints for j in component_indices("", entry.component, self.output_names)}
        rows = np.hstack([matrix for matrix in (self.C, self.D) if matrix is not None])
        offset = len(signals) - rows.shape[1] if self.C is None else 0
        parts = [f"{short_name(self.output_names[j])} = {combination(rows[j], signals[offset:])}" for j in sorted(used)]
        text = ", ".join(parts)
        return text if len(text) <= MOST_TEXT else f"{plural(len(parts), 'linear combination')} of states and controls"

    def translated(self, origin: Array) -> OutputSpectrum:
        """Return the constraints on the outputs of x - origin, origin (n,)."""
        if self.C is None:
            return self
        return self.with_constraints([one.translated(self.C @ origin) for one in self.constraints])

    def augmented(self, n: int, k: int) -> OutputSpectrum:
        """Return the constraints on the same outputs if the states become (x, w), w in R^k."""
        C = None if self.C is None else with_columns(self.C, k)
        return OutputSpectrum(C, self.D, self.constraints, self.output_names)

    def with_constraints(self, constraints: Sequence[FrequencyConstraint]) -> OutputSpectrum:
        """Return the same outputs with other constraints."""
        return OutputSpectrum(self.C, self.D, constraints, self.output_names)

    def with_past(self, x: Array, u: Array) -> OutputSpectrum:
        """Return the constraints on the samples that follow states (k, n) and controls (k, m)."""
        parts = [signal @ matrix.T for matrix, signal in ((self.C, x), (self.D, u)) if matrix is not None]
        past, measured = sum(parts[1:], parts[0]), int(self.D is None)
        return self.with_constraints([entry.with_past(past, measured) for entry in self.constraints])

    @property
    def remembers(self) -> bool:
        """Whether a constraint depends on samples of the past."""
        return any(entry.remembers for entry in self.constraints)

    def values(self, x: Array, u: Array) -> Array:
        """Return the outputs, (T+1, outputs), with a D (T, outputs), of states (T+1, n) and controls (T, m)."""
        of_u = np.zeros((len(x), 1)) if self.D is None else u @ self.D.T
        return of_u if self.C is None else x[: len(of_u)] @ self.C.T + of_u

    def signal(self, n: int, m: int, samples: tuple[int, int], sampling_time: float | None, field: str) -> Signal:
        """Return the outputs as a signal, of so many samples of the states and of the controls."""
        for name, matrix, columns in (("C", self.C, n), ("D", self.D, m)):
            if matrix is not None and matrix.shape[1] != columns:
                raise ProblemError(f"{field}.{name}", f"shape {matrix.shape}", f"{columns} columns")
        length = samples[0] if self.D is None else samples[1]
        return Signal(TermKind.OUTPUT_SPECTRUM, self.C, self.D, self.output_names, length, sampling_time)


def entries_of(content: object) -> Sequence[Any]:
    """Return the content of a field, an entry or several or None, as a sequence."""
    return content if isinstance(content, (list, tuple)) else () if content is None else (content,)


def map_constraints(
    given: object, change: Callable[[FrequencyConstraint], FrequencyConstraint | None]
) -> list[object] | None:
    """Return the entries of a spectrum with changed constraints, without those that become None; None if all do."""
    pairs = [(entry, [new for old in entry.constraints if (new := change(old))]) for entry in entries_of(given)]
    return [entry.with_constraints(changed) for entry, changed in pairs if changed] or None


def named_entries(field: str, content: Entry | Sequence[Entry] | None) -> list[tuple[str, Entry]]:
    """Return the entries of a field, each with its name in messages: the field, or the field and an index."""
    return [(field if entry is content else f"{field}[{i}]", entry) for i, entry in enumerate(entries_of(content))]


def component_words(component: int | str | None, names: Sequence[str]) -> str:
    """Return the name of a component without its unit, or "every component"."""
    if component is None and len(names) > 1:
        return "every component"
    return short_name(names[component_indices("spectrum", component, names)[0]])


def component_indices(field: str, component: int | str | None, component_names: Sequence[str]) -> list[int]:
    """Return the indices of a component: an index, a name with or without its unit, or None for all."""
    count = len(component_names)
    indices = f"an index {'0' if count == 1 else f'0 .. {count - 1}'} or "
    if component is None:
        return list(range(count))
    if isinstance(component, str):
        return [index_of_name(f"{field}.component", component, component_names, indices)]
    if isinstance(component, (int, np.integer)) and not isinstance(component, bool) and 0 <= component < count:
        return [int(component)]
    expected = f"{indices}one of {', '.join(map(repr, component_names))}"
    raise ProblemError(f"{field}.component", brief(component), expected)
