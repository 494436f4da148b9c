"""The protocol of frequency constraints on signals: states, controls, or linear outputs of both.

A new frequency constraint is a subclass of ``FrequencyConstraint`` in a file of its own, with ``describe``, ``terms``
and ``augmented``. To be written to problem files it is listed in ``files/problem_tables.py``.
``lin_freq_ocp.testing.check_terms`` checks it. ``OutputSpectrum`` puts such constraints on linear outputs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, assign, brief, component_names, real_array, with_columns, with_fields
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import MOST_TEXT, combination, plural, short_name
from lin_freq_ocp.problem.numbers import Axis, Number
from lin_freq_ocp.problem.terms.semi_infinite import Continuum
from lin_freq_ocp.problem.terms.term import Term, TermKind

Entry = TypeVar("Entry")
LEVELS = -40.0, 20.0, 0.5  # dB: lowest, highest, and a step


class FrequencyConstraint(ABC):
    """A constraint, or a price, on the spectrum of a signal."""

    label: ClassVar[str] = "frequency constraint"  # in words
    component: int | str | None = None  # index or name; None: all
    output_names: Sequence[str] = ()  # of an entry that has outputs of its own
    on_outputs: ClassVar[bool] = True  # whether it may constrain linear outputs
    remembers: ClassVar[bool] = False  # whether it depends on samples of the past
    removes_bins: ClassVar[bool] = False  # whether it is a stop band, and nothing else

    @abstractmethod
    def describe(self, names: Sequence[str]) -> str:
        """Return a text for a signal with components of these names."""

    @abstractmethod
    def terms(self, signal: Signal, field: str, source: tuple[str, int]) -> Iterator[Term]:
        """Yield its terms; errors name ``field``, and ``source`` is the entry of the problem's field."""

    @abstractmethod
    def augmented(self, n: int, k: int) -> Sequence[FrequencyConstraint]:
        """Return the same constraints on x in R^n of the signal (x, w), w in R^k."""

    def on_components(self, n: int) -> list[Self]:
        """Return it once for each component that it constrains, of a signal in R^n."""
        return [self.changed(component=i) for i in (range(n) if self.component is None else [self.component])]

    def changed(self, **fields: object) -> Self:
        """Return a copy with other fields."""
        return with_fields(self, **fields)

    @property
    def title(self) -> str:
        """Return what it is in words."""
        return self.label

    @property
    def levels(self) -> Array | None:
        """Return its limits on magnitudes, of any shape; None if it has none that can be moved."""
        return None

    @property
    def power(self) -> int:
        """Return the power of its levels that is given as limits: 2 for energies."""
        return 1

    def at_levels(self, levels: Array) -> Self:
        """Return it with other limits on magnitudes, of the same shape."""
        return self

    def numbers(self, axis: Axis) -> Iterator[Number]:
        """Yield its values that can be moved: its levels, in dB of its own, if they are above zero."""
        if self.levels is not None and self.levels.any():
            low, high, step = LEVELS
            yield Number("level.{}", "level", "dB", 0.0, low, high, 1, _scale_levels, step)

    def relaxed(self, amount: float) -> Self:
        """Return it with limits that are higher by an amount, if it has some."""
        return self if self.levels is None else self.at_levels(self.levels + amount)

    @property
    def constraints(self) -> Sequence[FrequencyConstraint]:
        """Return the constraints of an entry of the problem: itself; those of outputs are several."""
        return (self,)

    def with_constraints(self, constraints: Sequence[FrequencyConstraint]) -> FrequencyConstraint:
        """Return the entry with one other constraint."""
        return constraints[0]

    @property
    def hard_part(self) -> FrequencyConstraint | None:
        """Return what of it must hold; None if all of it has a price."""
        return self if getattr(self, "penalty", None) is None else None

    def behind(self, past: Array, measured: int) -> FrequencyConstraint:
        """Return it after samples (k, components) of its signal, if it depends on them.

        ``measured`` is the number of samples from time 0 on that are data, too.
        """
        return self

    every_frequency: bool = False  # whether it is infinitely many constraints, of which terms have finitely many
    points: Sequence[Array] | None = None  # of these, one array for each component; None: those to begin with
    points_only: bool = False  # whether nothing is required elsewhere: a relaxation

    def at_frequencies(self, points: Sequence[Array], points_only: bool) -> Self:
        """Return it with other points in its terms, one array for each component; ``points_only``: a relaxation."""
        return self.changed(points=tuple(points), points_only=points_only)

    def semi_infinite_terms(
        self, label: str, signal: Signal, required: Iterable[Continuum], source: tuple[str, int]
    ) -> Iterator[Term]:
        """Yield the term of each component, with what is required of it at every frequency, at the points so far."""
        indices = component_indices(label, self.component, signal.names)
        for k, (i, everywhere) in enumerate(zip(indices, required, strict=True)):
            values, balls = everywhere.at(everywhere.first_points() if self.points is None else self.points[k])
            name, beyond = f"{label} {signal.names[i]}", None if self.points_only else everywhere
            yield Term(name, signal.kind, values, balls, source, everywhere=beyond)

    def softened(self, penalty: float) -> FrequencyConstraint:
        """Return it with a price per unit of excess, unless it has one already, or knows none."""
        return self


def _scale_levels(constraint: FrequencyConstraint, decibels: float) -> FrequencyConstraint:
    levels = constraint.levels
    return constraint if levels is None else constraint.at_levels(levels * 10 ** (decibels / 20))


Constraints = FrequencyConstraint | Sequence[FrequencyConstraint] | None  # of states or controls, as a problem has them


@dataclass(frozen=True, eq=False)
class Signal:
    """The signal y_t = C x_t + D u_t that the frequency constraints of one field apply to."""

    kind: TermKind
    C: Array | None  # (components, n)
    D: Array | None  # (components, m)
    names: Sequence[str]  # of the components
    length: int  # number of samples, from time 0
    sampling_time: float | None

    def rows(self, field: str, component: int | str | None) -> Iterator[tuple[str, Array | None, Array | None]]:
        """Yield name and coefficients of a component, or of all for None; errors name the field."""
        for j in component_indices(field, component, self.names):
            yield self.names[j], None if self.C is None else self.C[j], None if self.D is None else self.D[j]


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
        matrices = [
            None if value is None else real_array(f"output_spectrum.{name}", value)
            for name, value in (("C", C), ("D", D))
        ]
        given = [matrix for matrix in matrices if matrix is not None]
        if not given or any(matrix.ndim != 2 or 0 in matrix.shape or len(matrix) != len(given[0]) for matrix in given):
            shapes = ", ".join(str(matrix.shape) for matrix in given) or "neither C nor D"
            raise ProblemError("output_spectrum", shapes, "a matrix C or D, or both, with one row per output")
        entries = tuple(constraints) if isinstance(constraints, (list, tuple)) else (constraints,)
        wrong = [one for one in entries if not isinstance(one, FrequencyConstraint) or not one.on_outputs]
        if wrong or not entries:
            got = brief(wrong[0]) if wrong else "nothing"
            raise ProblemError("output_spectrum.constraints", got, "bands, MagnitudeBound or EnergyBound")
        checked_names = component_names("output_spectrum.output_names", output_names, len(given[0]), "y")
        assign(self, C=matrices[0], D=matrices[1], constraints=entries, output_names=checked_names)

    def describe(self, signals: Sequence[str]) -> str:
        """Return the outputs that are constrained, for states and then controls of these names."""
        used = {j for one in self.constraints for j in component_indices("", one.component, self.output_names)}
        rows = np.hstack([part for part in (self.C, self.D) if part is not None])
        offset = len(signals) - rows.shape[1] if self.C is None else 0
        parts = [f"{short_name(self.output_names[j])} = {combination(rows[j], signals[offset:])}" for j in sorted(used)]
        text = ", ".join(parts)
        return text if len(text) <= MOST_TEXT else f"{plural(len(parts), 'linear combination')} of states and controls"

    def augmented(self, n: int, k: int) -> OutputSpectrum:
        """Return the constraints on the same outputs of (x, w), w in R^k."""
        C = None if self.C is None else with_columns(self.C, k)
        return OutputSpectrum(C, self.D, self.constraints, self.output_names)

    def with_constraints(self, constraints: Sequence[FrequencyConstraint]) -> OutputSpectrum:
        """Return other constraints on the same outputs."""
        return OutputSpectrum(self.C, self.D, constraints, self.output_names)

    def behind(self, x: Array, u: Array) -> OutputSpectrum:
        """Return the constraints after states (k, n) and controls (k, m)."""
        parts = [signal @ matrix.T for matrix, signal in ((self.C, x), (self.D, u)) if matrix is not None]
        past = sum(parts[1:], parts[0])
        return self.with_constraints([one.behind(past, int(self.D is None)) for one in self.constraints])

    @property
    def remembers(self) -> bool:
        """Whether they depend on samples of the past."""
        return any(one.remembers for one in self.constraints)

    def terms(
        self, n: int, m: int, horizon: int, sampling_time: float | None, field: str, index: int
    ) -> Iterator[Term]:
        """Yield its terms: it is the entry ``index`` of its field, named by ``field``."""
        for name, matrix, columns in (("C", self.C, n), ("D", self.D, m)):
            if matrix is not None and matrix.shape[1] != columns:
                raise ProblemError(f"{field}.{name}", f"shape {matrix.shape}", f"{columns} columns")
        length = horizon + (self.D is None)
        signal = Signal(TermKind.OUTPUT_SPECTRUM, self.C, self.D, self.output_names, length, sampling_time)
        for i, one in enumerate(self.constraints):
            yield from one.terms(signal, f"{field}.constraints[{i}]", ("output_spectrum", index))


def entries_of(given: object) -> Sequence[Any]:
    """Return the content of a field, one entry or several or None, as a sequence."""
    return given if isinstance(given, (list, tuple)) else () if given is None else (given,)


def named_entries(field: str, given: Entry | Sequence[Entry] | None) -> list[tuple[str, Entry]]:
    """Return the entries of a field, each with its name in messages: the field, or the field and an index."""
    return [(field if one is given else f"{field}[{i}]", one) for i, one in enumerate(entries_of(given))]


def component_words(component: int | str | None, names: Sequence[str]) -> str:
    """Return the name of a component, without its unit, or that all are meant."""
    if component is None and len(names) > 1:
        return "every component"
    return short_name(names[component_indices("spectrum", component, names)[0]])


def component_indices(field: str, component: int | str | None, component_names: Sequence[str]) -> list[int]:
    """Return the indices that a component (index, name, or None for all) stands for."""
    count = len(component_names)
    if component is None:
        return list(range(count))
    if isinstance(component, str):
        matches = [i for i, name in enumerate(component_names) if component in (name, name.split(" [")[0])]
        if len(matches) == 1:
            return matches
    elif isinstance(component, (int, np.integer)) and not isinstance(component, bool) and 0 <= component < count:
        return [int(component)]
    raise ProblemError(
        f"{field}.component",
        brief(component),
        f"an index 0 .. {count - 1} or one of {', '.join(map(repr, component_names))}",
    )
