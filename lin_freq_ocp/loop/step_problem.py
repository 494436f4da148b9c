"""The problem of a step: a free first state, frequency constraints that see the past, and soft constraints.

Past states and controls are data. A spectrogram without a length sees as many past samples as it was stated with. A
spectrogram of short windows sees the samples of the windows that have not ended yet: windows stay at fixed times.

A step solves the problem with soft constraints where the hard ones contradict each other. A penalty above the
multipliers of the constraints is exact: where they can be satisfied, they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, partial

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask, brief, positive_number
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.problem.costs.quadratic import PREVIEWED
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import Box, Everything, box_of, map_sets
from lin_freq_ocp.problem.sets.convex import softened_set
from lin_freq_ocp.problem.spectrum.base import entries_of, map_constraints
from lin_freq_ocp.problem.spectrum.bounds import softened_constraint
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.limits import SPECTRA, intersection
from lin_freq_ocp.transform.reformulations import Translation

ROUNDING = 1e-7  # an excess below this fraction of a constraint's terms is that of a solver's accuracy
EXACTLY_WITHIN = 1e-12  # a row this close to its limit, relative to its terms, is compared in exact arithmetic
FIELDS = ("state_set", "terminal_state", "stage_rows", *SPECTRA)  # that can be soft


def free_first_state(problem: OptimalControlProblem) -> OptimalControlProblem:
    """Return the problem without its state set and rows of the state alone at time 0."""
    given, T = problem.state_set, problem.horizon
    changes: dict[str, object] = {"stage_rows": [rows.free_first_state(T) for rows in problem.stage_rows]}
    if isinstance(given, Sequence) or (given is not None and given.members):
        later = list(given[1:]) if isinstance(given, Sequence) else [given] * T
        changes["state_set"] = [Everything(), *later]
    elif given is not None:
        lower, upper = problem.state_boxes.lower.copy(), problem.state_boxes.upper.copy()
        lower[0], upper[0] = -np.inf, np.inf
        changes["state_set"] = Box(lower, upper)
    return problem.derived(**changes) if given is not None or problem.stage_rows else problem


def with_past(problem: OptimalControlProblem, x: Array, u: Array, rest: Array | None = None) -> OptimalControlProblem:
    """Return the problem whose frequency constraints also see the last k states x (k, n) and controls u (k, m).

    ``rest`` (T, m) are the controls of the rest of the last plan, zeros without one: see ``hold_last``.
    """
    known = np.zeros((problem.horizon, problem.control_dim)) if rest is None else rest
    return replace(
        problem,
        control_spectrum=[one.with_past(u, 0).hold_last(known) for one in entries_of(problem.control_spectrum)] or None,
        state_spectrum=[one.with_past(x, 1) for one in entries_of(problem.state_spectrum)] or None,
        output_spectrum=[one.with_past(x, u) for one in entries_of(problem.output_spectrum)] or None,
    )


def known_states(dynamics: LinearDynamics) -> Mask:
    """Return the states, (n,), that follow from the controls before alone, such as the last control itself.

    Those that the dynamics name as known are among them. None where all states would: a loop measures some.
    """
    A, known = dynamics.gains()[0], np.isin(dynamics.state_names, dynamics.known_states or ())
    for _ in range(dynamics.state_dim):
        known = ~(A[:, ~known] != 0).any(axis=1)
    return known & ~known.all()


def first_known_states(problem: OptimalControlProblem, known: Mask) -> Array:
    """Return the states that follow from the controls alone at the first step: of the initial state, zero without."""
    begin = problem.initial_box
    return np.where(begin.fixed, begin.lower, 0.0)[known]


def complete_reference(problem: OptimalControlProblem, known: Mask, given: Array) -> Array:
    """Return x_ref, (..., n), from that of the measured states; states that follow from controls keep their own."""
    own = problem.quadratic.x_ref
    complete = np.array(np.broadcast_to(own, (*max(own.shape[:-1], given.shape[:-1]), own.shape[-1])))
    complete[..., ~known] = given
    return complete


@dataclass(frozen=True, eq=False)
class ControlLimits:
    """The hard limits of a problem on its first control: bounds, and rows c'x_0 + d u_j <= e on one control each.

    ``clip`` moves a control inside all of them exactly, not up to rounding. Bounds prevail over rows.
    """

    lower: Array  # (m,)
    upper: Array  # (m,)
    acting: Indices  # the control of each row, (rows,)
    C: Array  # (rows, n)
    d: Array  # (rows,), not zero
    e: Array  # (rows,)

    @classmethod
    def of(cls, problem: OptimalControlProblem) -> ControlLimits:
        """Return the limits of a problem at time 0."""
        stage, n = problem.stage_sets.at(0), problem.state_dim
        of_u = stage.matrix[:, n:]
        on_one = (np.count_nonzero(of_u, axis=1) == 1) & np.isfinite(stage.limits)
        acting = of_u[on_one].astype(bool).argmax(axis=1)
        d = of_u[on_one, acting]
        return cls(stage.lower[n:], stage.upper[n:], acting, stage.matrix[on_one, :n], d, stage.limits[on_one])

    def violated(self, x: Array, u: Array, rounding: float) -> bool:
        """Whether a control exceeds a limit at the state x by more than a part of the terms of the limit."""
        on_rows = self.C @ x + self.d * u[self.acting] - self.e
        size = np.abs(self.C) @ np.abs(x) + np.abs(self.e)
        outside = (u < self.lower - rounding * np.abs(self.lower)) | (u > self.upper + rounding * np.abs(self.upper))
        return bool(outside.any() or (on_rows > rounding * size).any())

    def clip(self, x: Array, u: Array) -> Array:
        """Return the control, (m,), moved inside the rows at the state x, (n,), and then inside the bounds."""
        inside = u
        if len(self.e):
            inside = np.array(u)
            terms = np.column_stack([self.C * x, self.d * u[self.acting], -self.e])  # summed without threads of BLAS
            for i in np.flatnonzero(terms.sum(axis=1) > -EXACTLY_WITHIN * np.abs(terms).sum(axis=1)).tolist():
                inside[self.acting[i]] = self._move_inside(i, x, float(inside[self.acting[i]]))
        return np.minimum(np.maximum(inside, self.lower), self.upper)

    def _move_inside(self, i: int, x: Array, u: float) -> float:
        """Return the number next to u that satisfies row i, in exact arithmetic."""
        exact = Fraction(self.e[i]) - sum(Fraction(c) * Fraction(value) for c, value in zip(self.C[i], x, strict=True))
        d = Fraction(self.d[i])
        if d * Fraction(u) <= exact:
            return u
        bound = float(exact / d)
        return bound if d * Fraction(bound) <= exact else float(np.nextafter(bound, -np.inf if d > 0 else np.inf))


def depends_on_past(problem: OptimalControlProblem) -> bool:
    """Whether frequency constraints of a problem depend on samples of the past."""
    return any(one.remembers for field in SPECTRA for one in entries_of(getattr(problem, field)))


def limits_of_plans(problem: OptimalControlProblem) -> str:
    """Return which frequency constraints hold for each plan only, in a sentence; empty if there is none."""
    fields = [field for field in SPECTRA if not all(one.remembers for one in entries_of(getattr(problem, field)))]
    if not fields:
        return ""
    return (
        f"{' and '.join(fields)}: holds for each plan, but the loop applies only the first control of each plan: this "
        "implies nothing for the applied signal. closed_loop and Spectrogram of lfo.spectrum limit the applied signal."
    )


def data_per_time(problem: OptimalControlProblem) -> str:
    """Return which data are given per time, and what a loop makes of them, in a sentence; empty if there are none."""
    cost, sets = problem.quadratic, {"state_set": problem.state_set, "control_set": problem.control_set}
    given = {f"cost.{name}": getattr(cost, name).ndim > 1 for name in PREVIEWED}
    if problem.uncertainty is None:  # its margins grow over each plan
        given |= {field: any(one.bounds[0].ndim > 1 for one in entries_of(entry)) for field, entry in sets.items()}
    given["dynamics.offset"] = np.ndim(getattr(problem.form, "offset", 0.0)) > 1  # nonlinear dynamics have none
    fields = [field for field, per_time in given.items() if per_time]
    if not fields:
        return ""
    return (
        f"{' and '.join(fields)}: given per time; every step of a loop plans with these values from the first one on. "
        "Give a step what it foresees: references=, bounds=, disturbance=."
    )


def checked_penalties(penalties: Mapping[str, float] | None) -> dict[str, float]:
    """Return the penalty of each field; ProblemError if a field cannot be soft, or a penalty is not above zero."""
    if penalties is not None and not isinstance(penalties, Mapping):
        raise ProblemError("soft", brief(penalties), "a mapping from fields of the problem to penalties")
    for field in penalties or {}:
        if field not in FIELDS:
            advice = "Bounds of controls are those of the actuator." if field == "control_set" else ""
            raise ProblemError(f"soft.{field}", "a field that cannot be soft", f"one of {', '.join(FIELDS)}", advice)
    return {field: positive_number(f"soft.{field}", penalty) for field, penalty in (penalties or {}).items()}


def soften(problem: OptimalControlProblem, penalties: Mapping[str, float]) -> OptimalControlProblem:
    """Return the problem whose hard constraints in these fields cost the penalty per unit of violation."""
    changes: dict[str, object] = {}
    for field, penalty in penalties.items():
        given = getattr(problem, field)
        if field in SPECTRA:
            changes[field] = map_constraints(given, partial(softened_constraint, penalty))
        elif field == "stage_rows":
            changes[field] = [rows.softened(penalty) for rows in given]
        else:
            per_time = isinstance(given, ConvexSet) and given.bounds[0].ndim > 1
            soften_once = cache(partial(softened_set, penalty))  # the terms of a set that repeats are then made once
            changes[field] = map_sets(_sets_at(given) if per_time else given, soften_once)
    return problem.derived(**changes)


def _sets_at(given: ConvexSet) -> list[ConvexSet]:
    """Return the set of each time of a set whose bounds are given per time; where they repeat, the same object."""
    box, found = box_of(given), list[ConvexSet]()
    for t in range(len(box.lower)):
        repeats = t > 0 and all(np.array_equal(side[t], side[t - 1]) for side in box.bounds)
        found.append(found[-1] if repeats else intersection(box.at(t), given.members))
    return found


def excess(translation: Translation, trajectory: Trajectory, least: float = ROUNDING) -> dict[str, float]:
    """Return the violation of each soft constraint by its name, in the unit of its limit and summed over time.

    Constraints that are violated by at most ``least`` times their terms are left out.
    """
    violations, moved = dict[str, float](), translation.start(trajectory)
    for term in translation.problem.terms:
        if not term.hard and not term.kind.is_cost:
            price = np.max(term.penalty.weights * np.asarray(term.per_limit)[..., None])  # of a level
            by = float((term.cost(moved.x, moved.u) / price).sum())
            size = float(np.max(term.map.sizes(moved.x, moved.u), initial=0.0))
            violations |= {term.name: by} if by > least * size else {}
    return violations
