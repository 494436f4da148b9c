"""The terms of a problem, from the sets, rows, costs and frequency constraints that it was given."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lin_freq_ocp.arrays import Array, Indices, Mask, assign, brief, names, real_array
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.phrases import MOST_TEXT, combination, plural, short_name
from lin_freq_ocp.problem.costs.norms import CostSum
from lin_freq_ocp.problem.sets.box import INSIDE
from lin_freq_ocp.problem.sets.convex import HARD, ConvexSet, Part, dimension_of
from lin_freq_ocp.problem.spectrum.bands import Band, component_indices
from lin_freq_ocp.problem.spectrum.bounds import EnergyBound, LinearConstraint, MagnitudeBound
from lin_freq_ocp.problem.terms.maps import SpectrumMap, StageMap, SumMap
from lin_freq_ocp.problem.terms.penalties import Below, Cone, Norm, Penalty, hard, weight_of
from lin_freq_ocp.problem.terms.stage_rows import StageRows
from lin_freq_ocp.problem.terms.term import Term

if TYPE_CHECKING:
    from lin_freq_ocp.problem.ocp import OptimalControlProblem

BEYOND_BANDS = (MagnitudeBound, EnergyBound, LinearConstraint)
"""What may stand beside bands in control_spectrum and state_spectrum."""


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
    """

    C: Array | None
    D: Array | None
    constraints: tuple[Any, ...]
    output_names: tuple[str, ...]

    def __init__(self, C: Any = None, D: Any = None, constraints: Any = (), output_names: Sequence[str] | None = None):
        matrices = [
            None if value is None else real_array(f"output_spectrum.{name}", value)
            for name, value in (("C", C), ("D", D))
        ]
        given = [matrix for matrix in matrices if matrix is not None]
        if not given or any(matrix.ndim != 2 or 0 in matrix.shape or len(matrix) != len(given[0]) for matrix in given):
            shapes = ", ".join(str(matrix.shape) for matrix in given) or "neither C nor D"
            raise ProblemError("output_spectrum", shapes, "a matrix C or D, or both, with one row per output")
        listed = tuple(constraints) if isinstance(constraints, (list, tuple)) else (constraints,)
        wrong = [one for one in listed if not isinstance(one, (Band, MagnitudeBound, EnergyBound))]
        if wrong or not listed:
            got = brief(wrong[0]) if wrong else "nothing"
            raise ProblemError("output_spectrum.constraints", got, "bands, MagnitudeBound or EnergyBound")
        count = len(given[0])
        assign(
            self,
            C=matrices[0],
            D=matrices[1],
            constraints=listed,
            output_names=names("output_spectrum.output_names", output_names, count, "y"),
        )

    def describe(self, signals: Sequence[str]) -> str:
        """Return the outputs that are constrained, for states and then controls of these names."""
        used = list[int]()
        for one in self.constraints:
            used += component_indices("output_spectrum", one.component, self.output_names)
        rows = np.hstack([part for part in (self.C, self.D) if part is not None])
        offset = len(signals) - rows.shape[1] if self.C is None else 0
        parts = [
            f"{short_name(self.output_names[j])} = {combination(rows[j], signals[offset:])}" for j in sorted(set(used))
        ]
        text = ", ".join(parts)
        return text if len(text) <= MOST_TEXT else f"{plural(len(parts), 'linear combination')} of states and controls"


def set_terms(kind: str, given: Any, dimension: int, times: Indices, fixed: dict[int, Array]) -> list[Term]:
    """Return the terms of the sets of one signal beyond their boxes.

    Parameters
    ----------
    kind : str
        Field of the problem.
    given : set, sequence of sets (one per time), or None
    times : times that the set or sets hold at
    fixed : mapping from time to value
        Where the signal is fixed: there a hard set is made a constraint only if the value lies outside.

    Raises
    ------
    ProblemError
        If a dimension does not fit.
    """
    listed = given if isinstance(given, (list, tuple)) else [given] * len(times)
    parts: dict[tuple[object, ...], list[tuple[int, Part]]] = {}
    parts_of: dict[int, tuple[Part, ...]] = {}
    for i, (one, t) in enumerate(zip(listed, times, strict=True)):
        if not isinstance(one, ConvexSet):
            continue
        own, where = dimension_of(one), f"{kind}[{i}]" if isinstance(given, (list, tuple)) else kind
        if own not in (None, dimension):
            raise ProblemError(where, f"a set in {own} dimensions", f"a set in {dimension}")
        if id(one) not in parts_of:
            parts_of[id(one)] = one.parts(dimension)
        for k, part in enumerate(parts_of[id(one)]):
            if t in fixed and hard(part.penalty.weight) and _inside(part, fixed[t]):
                continue
            parts.setdefault((k, *_signature(part)), []).append((int(t), part))
    of_state = kind != "control_set"
    kind_of_term = "control set" if kind == "control_set" else "state set"
    return [
        Term(_numbered(kind.replace("_", " "), i), kind_of_term, _stacked(found, of_state), _together(found), (kind, 0))
        for i, found in enumerate(parts.values())
    ]


def terms_of(problem: OptimalControlProblem) -> tuple[Term, ...]:
    """Return everything beyond the quadratic cost, boxes and stop bands; see ``OptimalControlProblem.terms``."""
    n, m, T, step = problem.state_dim, problem.control_dim, problem.horizon, problem.sampling_time
    fixed = problem.fixed_ends
    found = [
        *row_terms(problem.stage_rows, T),
        *missed_bounds(problem),
        *set_terms("state_set", problem.state_set, n, np.arange(T + 1), fixed),
        *set_terms("initial_state", problem.initial_state, n, np.array([0]), fixed),
        *set_terms("terminal_state", problem.terminal_state, n, np.array([T]), fixed),
        *set_terms("control_set", problem.control_set, m, np.arange(T), {}),
        *spectrum_terms("state_spectrum", problem.state_spectrum, T + 1, problem.state_names, step, of_state=True),
        *spectrum_terms("control_spectrum", problem.control_spectrum, T, problem.control_names, step, of_state=False),
    ]
    for i, outputs in enumerate(_listed(problem.output_spectrum)):
        where = "output_spectrum" if outputs is problem.output_spectrum else f"output_spectrum[{i}]"
        found += output_terms(where, outputs, n, m, T, step, i)
    if isinstance(problem.cost, CostSum):
        found += problem.cost.terms(n, m, T)
    return uniquely_named(found)


def missed_bounds(problem: OptimalControlProblem) -> Iterator[Term]:
    """Yield the bounds of the state set that no point of an end keeps, one term for each end and component."""
    boxes, identity = problem.state_boxes, np.eye(problem.state_dim)
    for t, (_, beyond) in zip((0, problem.horizon), problem.met_ends, strict=True):
        for i in np.flatnonzero(beyond):
            limits = np.array([boxes.upper[t, i], -boxes.lower[t, i]])
            rows = StageMap(np.array([t]), np.stack([identity[i], -identity[i]]), None, np.zeros(2))
            yield Term(f"state bound on {problem.state_names[i]}", "state set", rows, Below(limits[None], HARD))


def _listed(given: Any) -> Sequence[OutputSpectrum]:
    listed: Sequence[Any] = () if given is None else given if isinstance(given, (list, tuple)) else (given,)
    for one in listed:
        if not isinstance(one, OutputSpectrum):
            raise ProblemError("output_spectrum", brief(one), "OutputSpectrum, a list of them, or None")
    return listed


def row_terms(families: Sequence[StageRows], horizon: int) -> list[Term]:
    """Return the joint rows as terms."""
    return [
        Term(
            rows.name,
            "stage rows",
            StageMap(np.arange(horizon), rows.C, rows.D, np.zeros(rows.rows)),
            Below(np.where(rows.bounded(horizon), rows.e, np.inf), weight_of(rows.penalty)),
        )
        for rows in families
    ]


def spectrum_terms(
    field: str, given: Any, length: int, component_names: Sequence[str], sampling_time: float | None, of_state: bool
) -> list[Term]:
    """Return the terms of the frequency constraints of states or controls beyond stop bands."""
    listed = given if isinstance(given, (list, tuple)) else () if given is None else (given,)
    identity, kind = np.eye(len(component_names)), field.replace("_", " ")
    found: list[Term] = []
    for i, one in enumerate(listed):
        where = f"{field}[{i}]" if given is listed else field
        if isinstance(one, LinearConstraint):
            expected = (length, one.coefficients.shape[1], len(component_names))
            if one.coefficients.shape != expected:
                raise ProblemError(f"{where}.coefficients", f"shape {one.coefficients.shape}", f"shape {expected}")
            matrices = (one.coefficients, None) if of_state else (None, one.coefficients)
            equation = Norm(2, np.zeros(()), weight_of(one.penalty))
            sums = SumMap(*matrices, one.constant)
            found.append(Term(f"linear constraint of {kind}", kind, sums, equation, (field, i)))
        elif isinstance(one, (MagnitudeBound, EnergyBound)):
            for j in component_indices(where, one.component, component_names):
                row = (identity[j], None) if of_state else (None, identity[j])
                found.append(_bounded(where, one, row, length, sampling_time, kind, component_names[j], (field, i)))
    return found


def output_terms(
    field: str, given: OutputSpectrum, n: int, m: int, horizon: int, sampling_time: float | None, index: int
) -> Iterator[Term]:
    """Yield the terms of frequency constraints on outputs, the entry ``index`` of its field, named by ``field``."""
    source = "output_spectrum", index
    for name, matrix, columns in (("C", given.C, n), ("D", given.D, m)):
        if matrix is not None and matrix.shape[1] != columns:
            raise ProblemError(f"{field}.{name}", f"shape {matrix.shape}", f"{columns} columns")
    length, kind = horizon + (given.D is None), "output spectrum"
    for i, one in enumerate(given.constraints):
        where = f"{field}.constraints[{i}]"
        for j in component_indices(where, one.component, given.output_names):
            row = None if given.C is None else given.C[j], None if given.D is None else given.D[j]
            if isinstance(one, Band):
                bins = np.flatnonzero(one.stopped(length, sampling_time, where))
                if not len(bins):  # of which a warning has told
                    continue
                stopped = SpectrumMap(*row, np.ones(length), length, bins, together=True)
                zero = Norm(2, np.zeros(()), np.asarray(np.inf))
                yield Term(f"stop band on {given.output_names[j]}", kind, stopped, zero, source)
            else:
                yield _bounded(where, one, row, length, sampling_time, kind, given.output_names[j], source)


def bounded_bins(terms: Sequence[Term], kind: str, shape: tuple[int, int]) -> Mask:
    """Return which bins of which component the magnitude and energy bounds of a spectrum are about, (bins, components).

    A point of a finer grid belongs to the nearest bin.
    """
    bounded = np.zeros(shape, dtype=bool)
    for term in terms:
        if term.kind == kind and isinstance(term.map, SpectrumMap):
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


def _bounded(
    where: str,
    one: MagnitudeBound | EnergyBound,
    row: tuple[Array | None, Array | None],
    length: int,
    sampling_time: float | None,
    kind: str,
    name: str,
    source: tuple[str, int],
) -> Term:
    bins = one.bins(length, sampling_time, where)
    window, points, weight = one.samples(length, where), one.points(length), weight_of(one.penalty)
    if isinstance(one, EnergyBound):
        energy = SpectrumMap(row[0], row[1], window, points, bins, together=True)
        return Term(f"energy bound on {name}", kind, energy, Norm(2, one.root(), weight), source, one.factor)
    magnitudes = SpectrumMap(row[0], row[1], window, points, bins)
    return Term(f"mask on {name}", kind, magnitudes, Norm(2, one.limits(len(bins), where), weight), source, one.factor)


def _inside(part: Part, value: Array) -> bool:
    """Whether a value satisfies a part of a set, up to rounding."""
    excess = float(part.penalty.violation((part.F @ value + part.c)[None]).max())
    return excess <= INSIDE * float((np.abs(part.F) @ np.abs(value) + np.abs(part.c)).max())


def _signature(part: Part) -> tuple[object, ...]:
    """Return what parts of different times must share to be one term."""
    order = part.penalty.order if isinstance(part.penalty, Norm) else None
    return part.F.shape, type(part.penalty), order, bool(np.isinf(part.penalty.weight).all())


def _stacked(found: list[tuple[int, Part]], of_state: bool) -> StageMap:
    times = np.array([t for t, _ in found])
    F, c = _once([part.F for _, part in found]), _once([part.c for _, part in found])
    return StageMap(times, F if of_state else None, None if of_state else F, c)


def _once(arrays: list[Array]) -> Array:
    """Return the array if all are equal, else all of them, one per time."""
    first = arrays[0]
    return first if all(one is first or np.array_equal(one, first) for one in arrays) else np.array(arrays)


def _together(found: list[tuple[int, Part]]) -> Penalty:
    penalties = [part.penalty for _, part in found]
    first = penalties[0]
    weights = np.array([np.asarray(penalty.weight, dtype=float) for penalty in penalties])
    if isinstance(first, Below):
        limits = np.array([penalty.limit for penalty in penalties if isinstance(penalty, Below)])
        return Below(limits, weights.reshape(len(penalties), -1))
    if isinstance(first, Norm):
        radii = np.array([penalty.radius for penalty in penalties if isinstance(penalty, Norm)])
        return Norm(first.order, radii, weights)
    return Cone()


def _numbered(name: str, i: int) -> str:
    return name if i == 0 else f"{name} {i + 1}"
