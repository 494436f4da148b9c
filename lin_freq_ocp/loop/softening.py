"""A problem with some of its constraints soft: what a step solves where the constraints contradict each other.

A penalty above the multipliers of the constraints is exact: where they can be satisfied, they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import brief, positive_number
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.explanation.blocks import GivenSet
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reformulations import translation_of
from lin_freq_ocp.problem.sets.base import ConvexSet, Intersection
from lin_freq_ocp.problem.sets.box import Box, box_of
from lin_freq_ocp.problem.sets.convex import Soft
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.bands import Band
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, OutputSpectrum, entries_of
from lin_freq_ocp.problem.spectrum.bounds import MagnitudeBound
from lin_freq_ocp.problem.trajectory import Trajectory

ROUNDING = 1e-7  # an excess below this fraction of a constraint's terms is that of a solver's accuracy
FIELDS = ("state_set", "terminal_state", "stage_rows", "control_spectrum", "state_spectrum", "output_spectrum")


def checked_penalties(given: Mapping[str, float] | None) -> dict[str, float]:
    """Return the penalty of each field; ProblemError if a field cannot be soft, or a penalty is not above zero."""
    if given is not None and not isinstance(given, Mapping):
        raise ProblemError("soft", brief(given), "a mapping from fields of the problem to penalties")
    for field in given or {}:
        if field not in FIELDS:
            advice = "Bounds of controls are those of the actuator." if field == "control_set" else ""
            raise ProblemError(f"soft.{field}", "a field that cannot be soft", f"one of {', '.join(FIELDS)}", advice)
    return {field: positive_number(f"soft.{field}", penalty) for field, penalty in (given or {}).items()}


def softened(problem: OptimalControlProblem, penalties: Mapping[str, float]) -> OptimalControlProblem:
    """Return the problem where what is hard in these fields costs the penalty per unit of excess."""
    changes: dict[str, object] = {}
    for field, penalty in penalties.items():
        given = getattr(problem, field)
        if field in ("state_set", "terminal_state"):
            changes[field] = _sets(given, penalty)
        elif field == "stage_rows":
            changes[field] = [_rows(rows, penalty) for rows in given]
        elif field == "output_spectrum":
            changes[field] = [_outputs(one, penalty) for one in entries_of(given)] or None
        else:
            changes[field] = [_bound(one, penalty) for one in entries_of(given)] or None
    return replace(problem, **changes)


def excess(problem: OptimalControlProblem, trajectory: Trajectory) -> dict[str, float]:
    """Return by how much soft constraints are exceeded, in the units of their limits and summed over time, by name."""
    found, near = dict[str, float](), translation_of(problem)
    trajectory = near.translated(trajectory)
    for term in near.problem.terms:
        if not term.hard and not term.kind.is_cost:
            by = float((term.cost(trajectory.x, trajectory.u) / (np.max(term.penalty.weights) * term.per_limit)).sum())
            size = float(np.max(term.map.sizes(trajectory.x, trajectory.u), initial=0.0))
            found |= {term.name: by} if by > ROUNDING * size else {}
    return found


def _sets(given: GivenSet, penalty: float) -> GivenSet:
    if isinstance(given, Sequence):
        return [one and _soft(one, penalty) for one in given]
    if given is not None and given.bounds[0].ndim > 1:
        return [_soft(_at(given, t), penalty) for t in range(len(given.bounds[0]))]
    return given and _soft(given, penalty)


def _at(given: ConvexSet, t: int) -> ConvexSet:
    """Return a set whose bounds are given per time at one of the times."""
    bounds = box_of(given).at(t)
    return Intersection([bounds, *given.members]) if given.members else bounds


def _soft(given: ConvexSet, penalty: float) -> ConvexSet:
    box = box_of(given)
    hard: list[ConvexSet] = [member for member in given.members if not member.soft]
    if np.isfinite(box.lower).any() or np.isfinite(box.upper).any():
        hard.insert(0, Box(box.lower, box.upper))
    members = [member for member in given.members if member.soft] + [Soft(one, penalty) for one in hard]
    return Intersection(members) if members else given


def _rows(rows: StageRows, penalty: float) -> StageRows:
    return rows if rows.penalty is not None else StageRows(rows.C, rows.D, rows.e, rows.name, penalty)


def _bound(given: FrequencyConstraint, penalty: float) -> FrequencyConstraint:
    return MagnitudeBound(0.0, band=given, penalty=penalty) if isinstance(given, Band) else given.softened(penalty)


def _outputs(outputs: OutputSpectrum, penalty: float) -> OutputSpectrum:
    bounds = [_bound(one, penalty) for one in outputs.constraints]
    return OutputSpectrum(outputs.C, outputs.D, bounds, outputs.output_names)
