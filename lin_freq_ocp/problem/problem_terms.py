"""The terms of a problem, from the sets, rows, costs and frequency constraints that it was given."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask, brief
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.problem_data import ProblemData
from lin_freq_ocp.problem.sets.base import ConvexSet, Part
from lin_freq_ocp.problem.sets.box import END_TOLERANCE, SetOrSets
from lin_freq_ocp.problem.spectrum.base import Constraints, Signal, entries_of
from lin_freq_ocp.problem.spectrum.outputs import OutputSpectrum
from lin_freq_ocp.problem.terms.maps import StageMap
from lin_freq_ocp.problem.terms.penalties import HalfSpaces
from lin_freq_ocp.problem.terms.penalty import HARD, weight_of
from lin_freq_ocp.problem.terms.stage_rows import StageRows
from lin_freq_ocp.problem.terms.term import Term, TermKind


def terms_of(problem: ProblemData) -> tuple[Term, ...]:
    """Return everything beyond the quadratic cost, boxes and stop bands; see ``OptimalControlProblem.terms``."""
    n, m, T, step = problem.state_dim, problem.control_dim, problem.horizon, problem.sampling_time
    fixed = problem.fixed_ends
    states = Signal(TermKind.STATE_SPECTRUM, np.eye(n), None, problem.state_names, problem.state_samples, step)
    controls = Signal(TermKind.CONTROL_SPECTRUM, None, np.eye(m), problem.control_names, T, step)
    found = [
        *row_terms(problem.stage_rows, T),
        *missed_bounds(problem),
        *set_terms("state_set", problem.state_set, n, np.arange(T + 1), fixed),
        *set_terms("initial_state", problem.initial_state, n, np.array([0]), fixed),
        *set_terms("terminal_state", problem.terminal_state, n, np.array([T]), fixed),
        *link_terms(problem),
        *set_terms("control_set", problem.control_set, m, np.arange(T), {}),
        *spectrum_terms("state_spectrum", problem.state_spectrum, states),
        *spectrum_terms("control_spectrum", problem.control_spectrum, controls),
    ]
    for i, outputs in enumerate(entries_of(problem.output_spectrum)):
        where = "output_spectrum" if outputs is problem.output_spectrum else f"output_spectrum[{i}]"
        if not isinstance(outputs, OutputSpectrum):
            raise ProblemError("output_spectrum", brief(outputs), "OutputSpectrum, a list of them, or None")
        found += outputs.terms(n, m, T, step, where, i)
    return uniquely_named([*found, *problem.cost.terms(n, m, T)])


def set_terms(field: str, given: SetOrSets, dimension: int, times: Indices, fixed: dict[int, Array]) -> list[Term]:
    """Return the terms of the sets of one signal, of one field of the problem, beyond their boxes.

    Where the signal is ``fixed`` (time to value), a hard set is made a constraint only if the value lies outside.
    """
    per_time = isinstance(given, Sequence)
    sets = given if per_time else [given] * len(times)
    parts: dict[tuple[object, ...], list[tuple[int, Part]]] = {}
    parts_of: dict[int, tuple[Part, ...]] = {}
    for i, (one, t) in enumerate(zip(sets, times, strict=True)):
        if one is None or not one.members:
            continue
        if one.dimension not in (None, dimension):
            where = f"{field}[{i}]" if per_time else field
            raise ProblemError(where, f"a set in {one.dimension} dimensions", f"a set in {dimension}")
        if id(one) not in parts_of:
            _require_place(field, one, dimension)
            parts_of[id(one)] = one.parts(dimension)
        for k, part in enumerate(parts_of[id(one)]):
            if t in fixed and part.penalty.hard and _inside(part, fixed[t]):
                continue
            parts.setdefault((k, part.F.shape, part.penalty.signature), []).append((int(t), part))
    of_state, name = field != "control_set", field.replace("_", " ")
    kind = TermKind.STATE_SET if of_state else TermKind.CONTROL_SET
    return [
        _stacked(name if i == 0 else f"{name} {i + 1}", kind, of_state, found, (field, 0))
        for i, found in enumerate(parts.values())
    ]


def link_terms(problem: ProblemData) -> Iterator[Term]:
    """Yield the equations on both ends together."""
    implied = problem.links[len(problem.terminal_state.links(problem.state_dim, problem.horizon)) :]
    for one in (*problem.terminal_state.links(problem.state_dim, problem.horizon), *implied):
        source = None if one in implied else ("terminal_state", 0)
        yield Term(one.name, TermKind.LINKED_ENDS, one.values, one.penalty, source)


def missed_bounds(problem: ProblemData) -> Iterator[Term]:
    """Yield the bounds of the state set that no point of an end keeps, one term for each end and component."""
    boxes, identity = problem.state_boxes, np.eye(problem.state_dim)
    for t, (_, beyond) in zip((0, problem.horizon), problem.met_ends, strict=True):
        for i in np.flatnonzero(beyond):
            limits = np.array([boxes.upper[t, i], -boxes.lower[t, i]])
            rows = StageMap(np.array([t]), np.stack([identity[i], -identity[i]]), None, np.zeros(2))
            name = f"state bound on {problem.state_names[i]}"
            yield Term(name, TermKind.STATE_SET, rows, HalfSpaces(limits[None], HARD))


def row_terms(families: Sequence[StageRows], horizon: int) -> list[Term]:
    """Return the joint rows as terms."""
    return [
        Term(
            rows.name,
            TermKind.STAGE_ROWS,
            StageMap(np.arange(horizon), rows.C, rows.D, np.zeros(rows.rows)),
            HalfSpaces(np.where(rows.bounded(horizon), rows.e, np.inf), weight_of(rows.penalty)),
        )
        for rows in families
    ]


def spectrum_terms(field: str, given: Constraints, signal: Signal) -> Iterator[Term]:
    """Yield the terms of the frequency constraints of states or controls beyond stop bands."""
    for i, one in enumerate(entries_of(given)):
        yield from one.terms(signal, f"{field}[{i}]" if one is not given else field, (field, i))


def bounded_bins(terms: Sequence[Term], kind: TermKind, shape: tuple[int, int]) -> Mask:
    """Return which bins of which component the magnitude and energy bounds of a spectrum are about, (bins, components).

    A point of a finer grid belongs to the nearest bin.
    """
    bounded = np.zeros(shape, dtype=bool)
    for term in terms:
        if term.kind == kind:
            bounded[term.map.nearest_bins, term.map.component] = True
    bounded.flags.writeable = False
    return bounded


def uniquely_named(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Return the terms, with a number behind names that would stand twice."""
    seen: dict[str, int] = {}
    unique: list[Term] = []
    for term in terms:
        seen[term.name] = seen.get(term.name, 0) + 1
        count = seen[term.name]
        unique.append(replace(term, name=f"{term.name} {count}") if count > 1 else term)
    return tuple(unique)


def _require_place(field: str, one: ConvexSet, dimension: int) -> None:
    """Raise ProblemError if equations on both ends are given as a set of one state or control."""
    links = one.links(dimension, 1)
    if links and field != "terminal_state":
        advice = "Periodic and LinkedEnds are given as terminal_state."
        raise ProblemError(field, links[0].name, "a set of one state or control", advice)


def _inside(part: Part, value: Array) -> bool:
    """Whether a value satisfies a part of a set, up to rounding."""
    excess = float(part.penalty.violation(part.values(value[None])).max())
    return excess <= END_TOLERANCE * float((np.abs(part.F) @ np.abs(value) + np.abs(part.c)).max())


def _stacked(name: str, kind: TermKind, of_state: bool, found: list[tuple[int, Part]], source: tuple[str, int]) -> Term:
    """Return the term of the same part of a set at several times."""
    times, parts = np.array([t for t, _ in found]), [part for _, part in found]
    F, c = _constant([part.F for part in parts]), _constant([part.c for part in parts])
    rows = StageMap(times, F if of_state else None, None if of_state else F, c)
    return Term(name, kind, rows, parts[0].penalty.stacked([part.penalty for part in parts]), source)


def _constant(arrays: list[Array]) -> Array:
    """Return the array if all are equal, else all of them, one per time."""
    first = arrays[0]
    return first if all(one is first or np.array_equal(one, first) for one in arrays) else np.array(arrays)
