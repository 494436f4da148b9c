# ruff: noqa: D102
"""The limits of a problem: all constraints that can be relaxed, and all numbers of them that can be changed.

Explanations, live pages, sweeps and proofs change a problem by this list. A ``Limit`` is a constraint that can be
relaxed by an amount: bounds, joint rows, stop bands, sets, frequency constraints. Its ``numbers`` are the values that a
user may choose. Methods without a docstring are described by ``Limit``.

The classes that own the numbers change them: ``Box`` its bounds, ``StageRows`` its limits, a ``ConvexSet`` by
``relaxed``, a ``FrequencyConstraint`` its ``levels`` and its other ``numbers``. A class of your own overrides these.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, isfinite
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, brief
from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.base.phrases import AT_LEAST, AT_MOST, split_unit
from lin_freq_ocp.problem.numbers import NOTCHES, Axis, Number
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet, Intersection
from lin_freq_ocp.problem.sets.box import Box, SetOrSets, box_of, map_sets
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.bands import Band, bands_of, bins_far_from_passed, low_pass
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, OutputSpectrum, component_words, entries_of
from lin_freq_ocp.transform.sizes import stated_sizes

SPECTRA = "state_spectrum", "control_spectrum", "output_spectrum"
BOXES = {  # the fields that hold sets, and where a problem has their bounds
    "state_set": "state_boxes",
    "initial_state": "initial_box",
    "terminal_state": "terminal_box",
    "control_set": "control_tube",
}
# First words of the keys of numbers, but for those of ends, which are fields of a problem
NUMBER_WORDS = ("bound", "lower", "upper", "state_bound", "state_lower", "state_upper", "rows", "level", "edge")
CUTOFFS = "cutoff", "cutoff_hz"  # of low passes in place of a control_spectrum; in rad/sample, and in Hz
LEAST_PART, LARGEST_PART = 0.1, 3.0  # of bounds and limits, to which they are moved


@dataclass(frozen=True, eq=False)
class Limit(ABC):
    """A constraint of a problem that can be relaxed by an amount. A soft one has numbers, but no problem without it."""

    problem: OptimalControlProblem
    name: str  # in conflicts and cures
    field: str  # of the problem
    index: int  # of a component; or of rows or an entry in their field
    whole: ClassVar[bool] = False  # whether amounts are numbers of bins
    moves: ClassVar[str] = "wider"  # the change in words
    before: ClassVar[str] = ""  # the text before its values

    @property
    @abstractmethod
    def constrains(self) -> bool:
        """Whether it is a hard constraint."""

    @property
    @abstractmethod
    def size(self) -> float:
        """The size of the limited quantity, the unit of amounts."""

    @abstractmethod
    def relaxed(self, problem: OptimalControlProblem, amount: float) -> OptimalControlProblem:
        """Return a problem with this limit relaxed by an amount, or without it if the amount is infinite."""

    @abstractmethod
    def shown(self, relaxed: OptimalControlProblem, amount: float) -> tuple[str, str] | None:
        """Return its values before and after in words; None if they depend on time."""

    def words(self, relaxed: OptimalControlProblem, amount: float, reached: Array) -> str:
        """Return the change in words; ``reached``, (n,), is the end of a trajectory of the relaxed problem."""
        shown = self.shown(relaxed, amount)
        if shown is None:
            return f"{self.moves} by {amount:.6g}"
        note = f" (by {amount:.2g}: nearly feasible)" if shown[0] == shown[1] else ""  # rounding hides the amount
        return f"{self.before}{shown[0]} -> {shown[1]}{note}"

    @property
    def end(self) -> int | None:
        """The index of the end in a trajectory, 0 or -1; None if the limit is no end."""
        return None

    @property
    def order(self) -> int:
        """The rank in which limits are dropped, the highest first: the removal of an entry shifts the later ones."""
        return 0

    @property
    def parts(self) -> Sequence[Limit]:
        """The limits that can be relaxed one by one."""
        return (self,)

    def rows(self) -> StageRows | None:
        """Return its rows on (x_t, delta) and u_t, relaxed by amounts delta; None if it has other constraints."""
        return None

    def numbers(self) -> Iterator[Number]:
        """Yield the values that a user may choose."""
        return iter(())


class BoundLimit(Limit):
    """The bounds of one component of states or controls at all times."""

    moves = "bounds wider"

    @property
    def constrains(self) -> bool:
        tube, components = self.tube, list(self.sizes)
        return any(np.isfinite(side[:, components]).any() for side in (tube.lower, tube.upper))

    @property
    def sizes(self) -> Mapping[int, float]:
        """Its components, and the relaxation of each for an amount of 1."""
        return {self.index: 1.0}

    @property
    def tube(self) -> Box:
        """The bounds of all times, (times, components)."""
        return getattr(self.problem, BOXES[self.field])

    @property
    def size(self) -> float:
        return float(stated_sizes(self.problem)[self.field == "control_set"][self.index])

    def relaxed(self, problem: OptimalControlProblem, amount: float) -> OptimalControlProblem:
        box, sizes = getattr(problem, BOXES[self.field]), self.sizes
        by = np.zeros(box.lower.shape[-1])
        by[list(sizes)] = amount * np.array(list(sizes.values()))
        moved = replace_bounds(getattr(problem, self.field), Box(box.lower - by, box.upper + by))
        return problem.derived(**{self.field: moved})

    def rows(self) -> StageRows:
        problem, tube, found = self.problem, self.tube, list[tuple[Array, Array, Array]]()
        n, m, T = problem.state_dim, problem.control_dim, problem.horizon
        for (i, size), unit in zip(self.sizes.items(), np.eye(len(self.sizes)), strict=True):
            lower, upper, less = tube.lower[:, i], tube.upper[:, i], -size * unit
            if len(lower) == T:
                sides = [(np.zeros(n), np.eye(m)[i], lower, upper)]
            else:  # bounds on x_T are rows on A x + B u of the step before
                (A, B, d), last = problem.linear.at(T - 1), np.arange(T) == T - 1
                before = np.where(last, lower[T] - d[i], -np.inf), np.where(last, upper[T] - d[i], np.inf)
                sides = [(np.eye(n)[i], np.zeros(m), lower[:T], upper[:T]), (A[i], B[i], *before)]
            for C, D, low, high in sides:
                found += [(np.append(C, less), D, high), (np.append(-C, less), -D, -low)]
        of_x, of_u, limits = map(np.array, zip(*(one for one in found if np.isfinite(one[2]).any()), strict=True))
        return StageRows(of_x, of_u, limits.T, "relaxed")

    def shown(self, relaxed: OptimalControlProblem, amount: float) -> tuple[str, str] | None:
        boxes = self.tube, getattr(relaxed, BOXES[self.field])
        sides = [(box.lower[:, self.index], box.upper[:, self.index]) for box in boxes]
        before, after = (f"[{lower[0]:.6g}, {upper[0]:.6g}]" for lower, upper in sides)
        return (before, after) if all((side == side[0]).all() for side in sides[0]) else None

    def numbers(self) -> Iterator[Number]:
        """Yield constant bounds: one number if they are symmetric, else one for each side."""
        problem, given, tube, i = self.problem, getattr(self.problem, self.field), self.tube, self.index
        (low, high), n = (float(side[0, i]) for side in (tube.lower, tube.upper)), tube.lower.shape[1]
        constant = (tube.lower[:, i] == low).all() and (tube.upper[:, i] == high).all()
        if not isinstance(given, ConvexSet) or given.levels_of(n) or not constant or not low < high:
            return
        word, names = ("state_", problem.state_names) if self.field == "state_set" else ("", problem.control_names)
        label, unit = split_unit(names[i])
        both, middle = isfinite(high - low), (low + high) / 2
        below, above = (high - low if both else max(abs(side), self.size) for side in (low, high))
        after, before = (middle - below / NOTCHES, middle + above / NOTCHES) if both else (low + below, high - above)
        found = [
            ("lower", f"{label} {AT_LEAST}", low, low - below, after, -1, (1, 0)),
            ("upper", f"{label} {AT_MOST}", high, before, high + above, 1, (0, 1)),
        ]
        if low == -high:
            found = [("bound", f"|{label}| {AT_MOST}", high, LEAST_PART * high, LARGEST_PART * high, 1, (-1, 1))]
        for side, text, value, first, last, direction, signs in found:
            if isfinite(value):
                put = partial(_move_bounds, n, i, signs)
                yield Number(f"{word}{side}.{i}", text, unit, value, first, last, direction, put, field=self.field)


class EndLimit(BoundLimit):
    """The bounds of all components of an end; an amount is relative to the sizes of the states."""

    @property
    def end(self) -> int:
        return self.index

    @property
    def sizes(self) -> Mapping[int, float]:
        return dict(enumerate(stated_sizes(self.problem)[0].tolist()))

    @property
    def box(self) -> Box:
        """The bounds of the end."""
        return getattr(self.problem, BOXES[self.field])

    @property
    def tube(self) -> Box:
        lower = np.full((self.problem.horizon + 1, self.problem.state_dim), -np.inf)
        upper = -lower
        lower[self.index], upper[self.index] = self.box.lower, self.box.upper
        return Box(lower, upper)

    @property
    def size(self) -> float:
        return 1.0

    def words(self, relaxed: OptimalControlProblem, amount: float, reached: Array) -> str:
        box = self.box
        before = " x ".join(f"[{low:.6g}, {high:.6g}]" for low, high in zip(box.lower, box.upper, strict=True))
        if box.fixed.all():
            before = np.array2string(box.lower, precision=6, separator=", ")
        after = np.array2string(reached, precision=6, separator=", ")
        return f"{before} -> {after} (least sum of the changes, each divided by the size of its state)"

    def numbers(self) -> Iterator[Number]:
        """Yield the fixed components of an end that is a box, within the bounds of the states."""
        problem, box, states, sizes = self.problem, self.box, self.problem.state_boxes, self.sizes
        if getattr(problem, self.field).members:
            return
        for i in map(int, np.flatnonzero(box.fixed)):
            (label, unit), value = split_unit(problem.state_names[i]), float(box.lower[i])
            reach = max(2 * abs(value), sizes[i])
            low, high = (float(side[self.index, i]) for side in (states.lower, states.upper))
            low, high = (low if isfinite(low) else -reach), (high if isfinite(high) else reach)
            if low <= value <= high and low < high:
                put, text = partial(_move_bounds, len(box.lower), i, (1, 1)), f"{self.name.split()[0]} {label}"
                yield Number(f"{self.field}.{i}", text, unit, value, low, high, 0, put, field=self.field)


@dataclass(frozen=True, eq=False)
class RowLimit(Limit):
    """A family of joint rows, or one row of it, at all times; a family is relaxed row by row."""

    chosen: Sequence[int] = ()  # rows of the family
    moves = "limits higher"
    before = "<= "

    @property
    def family(self) -> StageRows:
        """The family."""
        return self.problem.stage_rows[self.index]

    @property
    def constrains(self) -> bool:
        return self.family.penalty is None

    @property
    def parts(self) -> Sequence[Limit]:
        named = ((f"row {i} of {self.family.name}", i) for i in range(self.family.rows))
        return [RowLimit(self.problem, name, self.field, self.index, [i]) for name, i in named]

    @property
    def size(self) -> float:
        return float(self.family.sizes(*stated_sizes(self.problem))[self.chosen].max())

    def relaxed(self, problem: OptimalControlProblem, amount: float) -> OptimalControlProblem:
        rows = list(problem.stage_rows)
        limits = rows[self.index].e.copy()
        limits[..., self.chosen] += amount
        rows[self.index] = rows[self.index].with_limits(limits)
        return problem.derived(stage_rows=rows)

    def rows(self) -> StageRows:
        T, matrices, limits = self.problem.horizon, (self.family.C, self.family.D), self.family.e
        C, D = (np.broadcast_to(part, (T, *part.shape[-2:]))[:, self.chosen] for part in matrices)
        limits = np.broadcast_to(limits, (T, limits.shape[-1]))[:, self.chosen]
        return StageRows(np.concatenate([C, np.full((*C.shape[:2], 1), -1.0)], axis=2), D, limits, "relaxed")

    def shown(self, relaxed: OptimalControlProblem, amount: float) -> tuple[str, str] | None:
        limits = self.family.e[..., self.chosen]
        limit = float(np.max(limits))
        return (f"{limit:.6g}", f"{limit + amount:.6g}") if np.ptp(limits) == 0 else None

    def numbers(self) -> Iterator[Number]:
        """Yield the limit of the family: a value if all are the same, else a percentage of the given ones."""
        name, limits = self.family.name, self.family.e[np.isfinite(self.family.e)]
        if not limits.size or limits.min() < 0 or not limits.any():
            return
        label, value, unit = f"limits of {name}", 100.0, "%"
        if (limits == limits[0]).all():
            label, value, unit = f"{name} {AT_MOST}", float(limits[0]), self._unit()
        key, ends = f"rows.{self.index}", (LEAST_PART * value, LARGEST_PART * value)
        yield Number(key, label, unit, value, *ends, 1, partial(_scale_limits, name, value), field=self.field)

    def _unit(self) -> str:
        """Return the unit of the rows if they are sums of components in the same unit; else an empty text."""
        parts = [matrix.reshape(-1, matrix.shape[-1]) for matrix in (self.family.C, self.family.D)]
        used = np.concatenate([np.abs(part).max(axis=0) > 0 for part in parts])
        names = zip((*self.problem.state_names, *self.problem.control_names), used, strict=True)
        units = {split_unit(name)[1] for name, in_rows in names if in_rows}
        sums = all(np.isin(part, (-1, 0, 1)).all() for part in parts)
        return units.pop() if len(units) == 1 and sums else ""


class BandLimit(Limit):
    """The stop band of a state or a control; an amount is the number of outermost bins that become free."""

    whole = True

    @property
    def constrains(self) -> bool:
        return bool(self._removed_bins(self.problem)[:, self.index].any())

    @property
    def size(self) -> float:
        return float(len(self._removed_bins(self.problem)))

    def relaxed(self, problem: OptimalControlProblem, amount: float) -> OptimalControlProblem:
        stop = np.array(self._removed_bins(problem))
        stop[:, self.index] = bins_far_from_passed(stop[:, self.index], amount)
        others = [one for one in entries_of(getattr(problem, self.field)) if not one.removes_bins]
        return problem.derived(**{self.field: [*bands_of(stop), *others]})

    def shown(self, relaxed: OptimalControlProblem, amount: float) -> tuple[str, str]:
        stopped, later = (self._removed_bins(problem)[:, self.index] for problem in (self.problem, relaxed))
        before, after = np.flatnonzero(~stopped), np.flatnonzero(~later)
        if not len(before) or stopped[: before.max()].any() or not stopped[before.max() + 1 :].all():
            return f"{len(before)}", f"{len(after)} passed bins of {len(stopped)}"
        problem, step = self.problem, self.problem.sampling_time  # the stop band of a low pass
        samples = problem.state_samples if self.field == "state_spectrum" else problem.horizon
        factor, unit = (2 * np.pi / samples, "rad/sample") if step is None else (1 / (step * samples), "Hz")
        return f"cut-off {factor * before.max():.6g}", f"{factor * after.max():.6g} {unit}"

    def _removed_bins(self, problem: OptimalControlProblem) -> Mask:
        return problem.state_stop if self.field == "state_spectrum" else problem.control_stop


class TermLimit(Limit):
    """The terms of an entry of a field; an amount raises their limits."""

    before = "limit "

    @property
    def constrains(self) -> bool:
        return bool(self.name)  # the names of its hard terms

    @property
    def limit(self) -> float:
        """The largest limit of its terms."""
        terms = [term for term in self.problem.terms if term.source == (self.field, self.index)]
        return max(float(np.max(term.penalty.sizes())) for term in terms)

    @property
    def size(self) -> float:
        return self.limit or 1.0

    def shown(self, relaxed: OptimalControlProblem, amount: float) -> tuple[str, str] | None:
        limit = self.limit
        return (f"{limit:.6g}", f"{limit + amount:.6g}") if limit else None


class SetLimit(TermLimit):
    """The sets of a field, bounds apart."""

    def relaxed(self, problem: OptimalControlProblem, amount: float) -> OptimalControlProblem:
        dimension = problem.control_dim if self.field == "control_set" else problem.state_dim

        def relax(given: ConvexSet) -> ConvexSet:
            if np.isinf(amount):
                return intersection(box_of(given), [member for member in given.members if member.soft])
            return intersection(box_of(given), [member.relaxed(amount, dimension) for member in given.members])

        return problem.derived(**{self.field: map_sets(getattr(problem, self.field), relax)})


class EntryLimit(TermLimit):
    """A frequency constraint of states, of controls or of outputs; amounts are levels, of an energy its root."""

    @property
    def order(self) -> int:
        return self.index + 1

    @property
    def given(self) -> FrequencyConstraint | OutputSpectrum:
        """The entry."""
        return entries_of(getattr(self.problem, self.field))[self.index]

    @property
    def limit(self) -> float:
        return max(one.highest for one in self.given.constraints)

    def shown(self, relaxed: OptimalControlProblem, amount: float) -> tuple[str, str] | None:
        one, limit = max(self.given.constraints, key=lambda one: one.highest), self.limit
        return (one.shown(limit, self._names), one.shown(limit + amount, self._names)) if limit else None

    def relaxed(self, problem: OptimalControlProblem, amount: float) -> OptimalControlProblem:
        entries = list(entries_of(getattr(problem, self.field)))
        entry = entries.pop(self.index)
        if np.isfinite(amount):
            entries.insert(self.index, entry.with_constraints([one.relaxed(amount) for one in entry.constraints]))
        return problem.derived(**{self.field: entries or None})

    def numbers(self) -> Iterator[Number]:
        """Yield the edges of its bands, and its levels in dB relative to those of the problem."""
        axis = Axis.of(self.problem.horizon, self.problem.sampling_time)
        of_outputs = self.field == "output_spectrum"
        for j, one in enumerate(self.given.constraints):
            place = f"{self.field}.{self.index}{f'.{j}' if of_outputs else ''}"
            of = f"of the {one.title} of {component_words(one.component, self._names)}"
            for number in one.numbers(axis):
                key, put = number.key.format(place), partial(self._change, j, number.put)
                yield replace(number, key=key, label=f"{number.label} {of}", put=put, field=self.field)

    @property
    def _names(self) -> Sequence[str]:
        """The names of the components of its signal."""
        return getattr(self.problem, self.field.replace("spectrum", "names"), self.given.output_names)

    def _change(self, j: int, put: Callable[..., object], given: object, value: float) -> list[object]:
        """Return the field with a changed constraint."""
        entries = list(entries_of(given))
        constraints = list(entries[self.index].constraints)
        constraints[j] = put(constraints[j], value)
        entries[self.index] = entries[self.index].with_constraints(constraints)
        return entries


def all_limits(problem: OptimalControlProblem) -> list[Limit]:
    """Return the limits of a problem: ends, bounds, joint rows, stop bands, sets and frequency constraints."""
    named: dict[tuple[str, int], list[str]] = {}  # one for each entry of a field
    for term in problem.terms:
        if term.hard and term.source is not None:
            named.setdefault(term.source, []).append(term.name)
    signals = ("state", problem.state_names), ("control", problem.control_names)
    components = [(side, name, i) for side, names in signals for i, name in enumerate(names)]
    entries = [(field, i) for field in SPECTRA for i in range(len(entries_of(getattr(problem, field))))]
    return [
        EndLimit(problem, "initial state", "initial_state", 0),
        EndLimit(problem, "terminal state", "terminal_state", -1),
        *(BoundLimit(problem, f"{side} bound on {name}", f"{side}_set", i) for side, name, i in components),
        *(RowLimit(problem, rows.name, "stage_rows", i, range(rows.rows)) for i, rows in enumerate(problem.stage_rows)),
        *(BandLimit(problem, f"{side} stop band on {name}", f"{side}_spectrum", i) for side, name, i in components),
        *(of_source(problem, source, ", ".join(names)) for source, names in named.items() if source[0] in BOXES),
        *(of_source(problem, source, ", ".join(named.get(source, ()))) for source in entries),
    ]


def of_source(problem: OptimalControlProblem, source: tuple[str, int], name: str) -> Limit:
    """Return the limit of an entry of a field, the source of its terms; the name is empty if none of them is hard."""
    return (SetLimit if source[0] in BOXES else EntryLimit)(problem, name, *source)


def constraints(problem: OptimalControlProblem) -> list[Limit]:
    """Return the hard constraints, dynamics apart, in parts that can be relaxed one by one."""
    return [part for limit in all_limits(problem) if limit.constrains for part in limit.parts]


def drop_limits(problem: OptimalControlProblem, dropped: Collection[Limit]) -> OptimalControlProblem:
    """Return the problem without some of its limits; entries first, the last one first, as removal shifts them."""
    for limit in sorted(dropped, key=lambda limit: -limit.order):
        problem = limit.relaxed(problem, np.inf)
    return problem


def numbers(problem: OptimalControlProblem) -> dict[str, Number]:
    """Return all numbers of the limits of a problem by their keys."""
    found = {number.key: number for limit in all_limits(problem) for number in limit.numbers()}
    cutoff = _cutoff(problem)
    if cutoff is None:
        return found
    found.pop("edge.control_spectrum.0.1", None)  # the edge of the one low pass, which is the cut-off
    return {cutoff.key: cutoff} | found


def changed_fields(problem: OptimalControlProblem, values: Mapping[str, float]) -> dict[str, object]:
    """Return the changed fields of a problem for new values of its numbers; ProblemError if a number is unknown."""
    known, fields = numbers(problem) if values else {}, dict[str, object]()
    for key, value in values.items():
        if key not in known:
            raise ProblemError(key, "no number of that name", f"one of {', '.join(known)}", suggestion(key, known))
        if not isinstance(value, (int, float, np.number)) or isinstance(value, bool):
            raise ProblemError(key, brief(value), "a number")
        field = known[key].field
        fields[field] = known[key].put(fields.get(field, getattr(problem, field)), value)
    return fields


def _cutoff(problem: OptimalControlProblem) -> Number | None:
    """Return the cut-off of the one low pass of the controls, at most one; its highest value stands for none."""
    axis, entries = Axis.of(problem.horizon, problem.sampling_time), entries_of(problem.control_spectrum)
    band = entries[0] if len(entries) == 1 and entries[0].removes_bins else None
    if entries and (band is None or band.kind != "low_pass"):
        return None
    value, component = (band.edges[1] * axis.per_unit(band.unit), band.component) if band else (axis.nyquist, None)
    high = value + ceil((axis.nyquist - value) / axis.step) * axis.step

    def set_cutoff(given: object, new: float) -> Band | None:
        return None if new >= high else cutoff_band(CUTOFFS[axis.unit == "Hz"], new, component)

    text = "cut-off of the controls"
    return Number("cutoff", text, axis.unit, value, axis.step, high, 1, set_cutoff, axis.step, "control_spectrum")


def cutoff_band(name: str, value: float | None, component: int | str | None = None) -> Band | None:
    """Return the low pass of a cut-off in rad/sample or in Hz, one of ``CUTOFFS``; None for none."""
    return None if value is None else low_pass(**{name: value}, component=component)


def replace_bounds(given: SetOrSets, bounds: Box) -> SetOrSets:
    """Return a set, or one per time, with other bounds and the same members."""
    if isinstance(given, Sequence):
        boxes = [bounds.at(t) if bounds.lower.ndim > 1 else bounds for t in range(len(given))]
        return [intersection(box, one.members if one else ()) for one, box in zip(given, boxes, strict=True)]
    return intersection(bounds, given.members if given else ())


def intersection(bounds: Box, members: Sequence[ConvexSet]) -> ConvexSet:
    """Return the set with these bounds and members."""
    return Intersection([bounds, *members]) if members else bounds


def _scale_limits(name: str, value: float, families: Sequence[StageRows], new: float) -> list[StageRows]:
    """Return families of rows, that of a name with its limits times new / value."""
    return [rows.with_limits(rows.e * (new / value)) if rows.name == name else rows for rows in families]


def _move_bounds(dimension: int, index: int, signs: tuple[int, int], given: ConvexSet, value: float) -> SetOrSets:
    """Return a set with the lower and the upper bound of a component at a value times a sign; 0 keeps a bound."""
    box = box_of(given).at_dimension(dimension, "bounds")
    sides = [side.copy() for side in (box.lower, box.upper)]
    for side, sign in zip(sides, signs, strict=True):
        side[..., index] = sign * value if sign else side[..., index]
    return replace_bounds(given, Box(*sides))
