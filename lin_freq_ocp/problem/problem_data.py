"""The fields of a problem, and dimensions, bounds, stopped bins and terms that follow from them.

Terms are made of sets, rows, costs and frequency constraints.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import fields as of_class
from functools import cached_property
from typing import Self, TypeVar, cast

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask, assign, brief, seal, stack_signals, with_fields
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.costs.quadratic import Cost, QuadraticCost
from lin_freq_ocp.problem.dynamics.base import Dynamics
from lin_freq_ocp.problem.dynamics.response import Response
from lin_freq_ocp.problem.forms import form_of
from lin_freq_ocp.problem.sets.base import ConvexSet, Part
from lin_freq_ocp.problem.sets.box import END_TOLERANCE, Box, SetOrSets, bounds_over_time, box_of, end_within
from lin_freq_ocp.problem.sets.path_constraint import path_constraints
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.bands import stopped_bins, time_signal
from lin_freq_ocp.problem.spectrum.base import (
    Constraints,
    FrequencyConstraint,
    OutputSpectrum,
    Signal,
    entries_of,
    named_entries,
)
from lin_freq_ocp.problem.terms.maps import StageMap
from lin_freq_ocp.problem.terms.penalties import HalfSpaces
from lin_freq_ocp.problem.terms.penalty import HARD
from lin_freq_ocp.problem.terms.term import Link, Term, TermKind


@dataclass(frozen=True, eq=False, init=False)
class ProblemData:
    """The fields of ``OptimalControlProblem``, with names, dimensions, bounds and stopped bins."""

    dynamics: Dynamics
    horizon: int
    cost: Cost
    control_set: SetOrSets
    state_set: SetOrSets
    initial_state: ConvexSet
    terminal_state: ConvexSet
    control_spectrum: Constraints
    state_spectrum: Constraints
    stage_rows: tuple[StageRows, ...]
    output_spectrum: OutputSpectrum | Sequence[OutputSpectrum] | None
    name: str
    uncertainty = cast("object", None)  # against which ``robust`` has tightened the limits
    warned = False  # of bands, by the problem from which this one is derived

    def derived(self, **fields: object) -> Self:
        """Return a problem with other fields, checked, without warnings of bands: those are for the user's problem."""
        copy, given = object.__new__(type(self)), {one.name: getattr(self, one.name) for one in of_class(self)}
        assign(copy, warned=True)
        copy.__init__(**given | fields)
        return copy

    def margin_at(self, block: str, times: Sequence[int]) -> float:
        """Return by how much ``robust`` has tightened a limit, a block of a conflict, at some times at most."""
        return 0.0

    @property
    def origin(self) -> Array | None:
        """Return the position of zero states in the coordinates of the user (``Translation``); None for zero."""
        return self.__dict__.get("_origin")

    @cached_property
    def state_dim(self) -> int:
        """The number n of states."""
        return self.dynamics.state_dim

    @cached_property
    def control_dim(self) -> int:
        """The number m of controls."""
        return self.dynamics.control_dim

    @cached_property
    def form(self) -> Dynamics:
        """The dynamics that methods and the judge take, with modes for levels and for costs by formulas."""
        return form_of(self.dynamics, self.control_set, self.cost, bool(path_constraints(self.stage_rows)))

    @cached_property
    def mode_names(self) -> tuple[str, ...]:
        """The name of every mode of the form; empty for a problem without modes."""
        return self.form.mode_names

    @cached_property
    def response(self) -> Response | None:
        """The map from all controls to all states; None where states follow by a recursion."""
        return self.form.response(self.horizon)

    @cached_property
    def level_sizes(self) -> Array:
        """The largest absolute level of each control, (m,); 0 for a control without levels."""
        choices = self.form.choices
        return np.zeros(self.control_dim) if choices is None else np.nan_to_num(np.abs(choices)).max(axis=0)

    @property
    def control_hull(self) -> SetOrSets:
        """Return the control set; of levels, their convex hull."""
        return self.control_set.hull if isinstance(self.control_set, ConvexSet) else self.control_set

    @property
    def sampling_time(self) -> float | None:
        """Return the seconds per step, if given."""
        return self.dynamics.sampling_time

    @property
    def times(self) -> Array:
        """Return the times of the states, (T+1,): in seconds with a sampling time, else in steps."""
        return np.arange(self.horizon + 1, dtype=np.float64) * (self.sampling_time or 1.0)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the state components, with units."""
        return self.dynamics.state_names

    @property
    def control_names(self) -> tuple[str, ...]:
        """Return the names of the control components, with units."""
        return self.dynamics.control_names

    @cached_property
    def quadratic(self) -> QuadraticCost:
        """The quadratic part of the cost."""
        return self.cost.quadratic

    @property
    def initial_box(self) -> Box:
        """Return the bounds of the initial set."""
        return box_of(self.initial_state).at_dimension(self.state_dim, "initial_state")

    @property
    def terminal_box(self) -> Box:
        """Return the bounds of the terminal set."""
        return box_of(self.terminal_state).at_dimension(self.state_dim, "terminal_state")

    @property
    def fixed_ends(self) -> dict[int, Array]:
        """Return the states at the ends where they are single points."""
        times = (0, self.horizon)
        return {t: end.lower for t, end in zip(times, self.ends, strict=True) if end.fixed.all()}

    @property
    def links(self) -> tuple[Link, ...]:
        """Return the equations on both ends, those that the dynamics imply last."""
        given = self.terminal_state.links(self.state_dim, self.horizon)
        implied = self.form.links(self.horizon)
        if given and any(one.periodic for one in implied):
            advice = "Its outputs are periodic by themselves: x_T = x_0."
            raise ProblemError("terminal_state", given[0].name, "none with a periodic FrequencyResponse", advice)
        return (*given, *implied)

    @cached_property
    def state_boxes(self) -> Box:
        """The bounds of the state set of each time, (T+1, n), without the initial and the terminal set."""
        return bounds_over_time("state_set", self.state_set, self.state_dim, self.horizon + 1)

    @property
    def ends(self) -> tuple[Box, Box]:
        """Return the bounds of X_0 and X_T, (n,): of the initial and the terminal set, within those of their times."""
        return self.met_ends[0][0], self.met_ends[1][0]

    @cached_property
    def hard_state_sets(self) -> bool:
        """Whether a state set has, beyond its box, a part that must hold: where an end satisfies it, it is no term."""
        sets = {id(one): one for one in entries_of(self.state_set)}
        return any(one is not None and bool(one.hard_members) for one in sets.values())

    @cached_property
    def met_ends(self) -> tuple[tuple[Box, Mask], tuple[Box, Mask]]:
        """The bounds of both ends, and the components, (n,), in which an end lies outside the state set of its time.

        In these components the bounds are those of the end, and the bounds of the state set are terms.
        """
        boxes = self.state_boxes
        return end_within(self.initial_box, boxes.at(0)), end_within(self.terminal_box, boxes.at(-1))

    @cached_property
    def state_tube(self) -> Box:
        """X_0 .. X_T, bounds of shape (T+1, n): the state set of each time, with the initial and terminal sets."""
        return self.state_boxes.with_ends(*self.ends)

    @cached_property
    def control_tube(self) -> Box:
        """U_0 .. U_{T-1}, bounds of shape (T, m)."""
        return bounds_over_time("control_set", self.control_set, self.control_dim, self.horizon)

    @cached_property
    def signal_bounds(self) -> tuple[Array, Array]:
        """The bounds of z_t = (x_t, u_t), lower and upper, (T+1, n + m), with zeros for u_T."""
        lower, upper = map(stack_signals, self.state_tube.bounds, self.control_tube.bounds)
        return seal(lower), seal(upper)

    @cached_property
    def control_stop(self) -> Mask:
        """Which bins are removed from which control: shape (T//2 + 1, m)."""
        constraints, names = self.control_spectrum, self.control_names
        return stopped_bins("control_spectrum", constraints, self.horizon, names, self.sampling_time)

    @cached_property
    def state_samples(self) -> int:
        """The number N of samples in spectra of states: T with periodic ends, where x_T repeats x_0, else T+1."""
        return self.horizon + 1 - any(one.repeats for one in self.links)

    def in_time(self, rho_x: ComplexArray) -> Array:
        """Return (R' rho_x)_t, (T+1, n), for rho_x (N//2 + 1, n); zero at a last state that spectra leave out."""
        signal = time_signal(rho_x, self.state_samples)
        last = np.zeros((self.horizon + 1 - len(signal), self.state_dim), dtype=signal.dtype)
        return np.concatenate([signal, last])

    @cached_property
    def state_stop(self) -> Mask:
        """Which bins are removed from which state: shape (N//2 + 1, n), N = ``state_samples``."""
        constraints, names = self.state_spectrum, self.state_names
        return stopped_bins("state_spectrum", constraints, self.state_samples, names, self.sampling_time)


Data = TypeVar("Data", bound=ProblemData)
OF_ENDS = "met_ends", "state_tube", "signal_bounds"
OF_FORM = "form", "mode_names", "response", "level_sizes"
# The cached properties that depend on a field and not on all of them
DEPENDENT = {
    "dynamics": (*OF_FORM, "linear", "equations", "borders", "gap"),
    "cost": (*OF_FORM, "quadratic"),
    "stage_rows": (*OF_FORM, "terms"),
    "state_set": ("state_boxes", *OF_ENDS, "hard_state_sets", "terms"),
    "initial_state": OF_ENDS,  # and the terms, in the cases that ``with_ends`` names
    "terminal_state": OF_ENDS,
}


def replace_fields(problem: Data, **fields: object) -> Data:
    """Return a problem with other fields, unchecked, and without the cached properties that depend on them."""
    copy = with_fields(problem, **fields)
    for name in (name for field in fields for name in DEPENDENT.get(field, ())):
        copy.__dict__.pop(name, None)
    return copy


def limited_signals(problem: ProblemData, states: int, controls: int) -> dict[str, Signal]:
    """Return the signals, with so many samples, of which these two fields limit the spectra."""
    x, u, step = np.eye(problem.state_dim), np.eye(problem.control_dim), problem.sampling_time
    return {
        "state_spectrum": Signal(TermKind.STATE_SPECTRUM, x, None, problem.state_names, states, step),
        "control_spectrum": Signal(TermKind.CONTROL_SPECTRUM, None, u, problem.control_names, controls, step),
    }


def frequency_constraints(
    problem: ProblemData, given: Mapping[str, object] | None = None, samples: tuple[int, int] | None = None
) -> Iterator[tuple[tuple[str, int], str, FrequencyConstraint, Signal]]:
    """Yield each frequency constraint: the field and the index of its entry, its name in messages, and its signal.

    The fields are those of the problem, or ``given``; the signals have the samples of a plan, or so many of the states
    and of the controls.
    """
    T, of_outputs = problem.horizon, "output_spectrum"
    fields = vars(problem) if given is None else given
    for field, signal in limited_signals(problem, *(samples or (problem.state_samples, T))).items():
        for i, (where, one) in enumerate(named_entries(field, fields[field])):
            yield (field, i), where, cast("FrequencyConstraint", one), signal
    for i, (where, outputs) in enumerate(named_entries(of_outputs, fields[of_outputs])):
        if not isinstance(outputs, OutputSpectrum):
            raise ProblemError(of_outputs, brief(outputs), "OutputSpectrum, a list of them, or None")
        dimensions = problem.state_dim, problem.control_dim
        signal = outputs.signal(*dimensions, samples or (T + 1, T), problem.sampling_time, where)
        for name, one in named_entries(f"{where}.constraints", outputs.constraints):
            yield (of_outputs, i), name, one, signal


def terms_of(problem: ProblemData) -> tuple[Term, ...]:
    """Return everything beyond the quadratic cost, boxes and stop bands; see ``OptimalControlProblem.terms``."""
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    ends = dict(zip((0, T), problem.ends, strict=True))
    boxes, identity = problem.state_boxes, np.eye(n)
    unmet_bounds = [  # bounds of the state set that no point of an end satisfies, a term for each end and component
        Term(
            f"state bound on {problem.state_names[i]}",
            TermKind.STATE_SET,
            StageMap(np.array([t]), np.stack([identity[i], -identity[i]]), None, np.zeros(2)),
            HalfSpaces(np.array([[boxes.upper[t, i], -boxes.lower[t, i]]]), HARD),
        )
        for t, (_, outside) in zip((0, T), problem.met_ends, strict=True)
        for i in np.flatnonzero(outside)
    ]
    stated = len(problem.terminal_state.links(n, T))  # of the links: the others follow from the dynamics
    sources = [("terminal_state", 0) if i < stated else None for i in range(len(problem.links))]
    found = [
        *(rows.term(T) for rows in problem.stage_rows),
        *unmet_bounds,
        *set_terms("state_set", problem.state_set, n, np.arange(T + 1), ends),
        *set_terms("initial_state", problem.initial_state, n, np.array([0]), ends),
        *set_terms("terminal_state", problem.terminal_state, n, np.array([T]), ends),
        *(
            Term(link.name, TermKind.LINKED_ENDS, link.values, link.penalty, source)
            for link, source in zip(problem.links, sources, strict=True)
        ),
        *set_terms("control_set", problem.control_set, m, np.arange(T), {}),
        *(
            term
            for entry, where, one, signal in frequency_constraints(problem)
            for term in one.terms(signal, where, entry)
        ),
        *problem.cost.terms(n, m, T),
    ]
    counts, seen = Counter(term.name for term in found), Counter[str]()
    for k, term in enumerate(found):  # a name that occurs again gets its band, or a number
        if term.band and counts[term.name] > 1:
            term = found[k] = replace(term, name=f"{term.name} at {term.band}")
        seen[term.name] += 1
        if seen[term.name] > 1:
            found[k] = replace(term, name=f"{term.name} {seen[term.name]}")
    return tuple(found)


def set_terms(field: str, given: SetOrSets, dimension: int, times: Indices, ends: dict[int, Box]) -> list[Term]:
    """Return the terms of the sets of one signal, of one field of the problem, beyond their boxes.

    At the ``ends`` (time to bounds), a hard part that their fixed components satisfy, up to rounding, has no term.
    """
    per_time = isinstance(given, Sequence)
    sets = zip(given, times[:, None].tolist(), strict=False) if per_time else [(given, times.tolist())] if given else ()
    parts: dict[tuple[object, ...], list[tuple[int, Part]]] = {}
    parts_of: dict[int, tuple[Part, ...]] = {}
    for i, (one, held) in enumerate(sets):
        if not one.members:
            continue
        if one.dimension not in (None, dimension):
            where = f"{field}[{i}]" if per_time else field
            raise ProblemError(where, f"a set in {one.dimension} dimensions", f"a set in {dimension}")
        if id(one) not in parts_of:
            links = one.links(dimension, 1)
            if links and field != "terminal_state":  # equations on both ends are no set of one state or control
                advice = "Periodic and LinkedEnds are given as terminal_state."
                raise ProblemError(field, links[0].name, "a set of one state or control", advice)
            parts_of[id(one)] = one.parts(dimension)
        for k, part in enumerate(parts_of[id(one)]):
            timed = [(t, part) for t in held if t not in ends or not _is_met(part, ends[t])]
            if timed:
                parts.setdefault((k, part.F.shape, part.penalty.signature), []).extend(timed)
    of_state, name, terms = field != "control_set", field.replace("_", " "), list[Term]()
    kind = TermKind.STATE_SET if of_state else TermKind.CONTROL_SET
    for i, timed in enumerate(parts.values()):  # the same part of a set at several times is one term
        same = [part for _, part in timed]
        F, c = _merge_equal([part.F for part in same]), _merge_equal([part.c for part in same])
        rows = StageMap(np.array([t for t, _ in timed]), F if of_state else None, None if of_state else F, c)
        penalty = same[0].penalty.stacked([part.penalty for part in same])
        terms.append(Term(name if i == 0 else f"{name} {i + 1}", kind, rows, penalty, (field, 0)))
    return terms


def _is_met(part: Part, end: Box) -> bool:
    """Whether all values of an end satisfy a hard part, up to rounding; a soft part has a price at every value."""
    if not part.penalty.hard or not end.fixed[part.F.any(axis=0)].all():
        return False
    value = np.where(end.fixed, end.lower, 0.0)
    violation = float(part.penalty.violation(part.values(value[None])).max())
    return violation <= END_TOLERANCE * float((np.abs(part.F) @ np.abs(value) + np.abs(part.c)).max())


def _merge_equal(arrays: list[Array]) -> Array:
    """Return the array if all are equal, else all of them, one per time."""
    first = arrays[0]
    return first if all(one is first or np.array_equal(one, first) for one in arrays) else np.array(arrays)


def bounded_bins(terms: Sequence[Term], kind: TermKind, shape: tuple[int, int]) -> Mask:
    """Return the bins, (bins, components), that the magnitude and energy bounds of a spectrum limit.

    A point of a finer grid counts as its nearest bin.
    """
    bounded = np.zeros(shape, dtype=bool)
    for term in terms:
        if term.kind == kind and term.map.spectrum is not None:
            bounded[term.map.spectrum.nearest_bins, term.map.spectrum.component] = True
    return seal(bounded)
