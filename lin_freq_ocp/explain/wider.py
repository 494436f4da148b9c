"""Terms of a problem made wider by an amount, or taken away: sets, masks, energy bounds; and all soft ones."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import assign
from lin_freq_ocp.problem.augmented import listed
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_terms import OutputSpectrum
from lin_freq_ocp.problem.sets.box import Box, Everything, box_of
from lin_freq_ocp.problem.sets.convex import Ball, ConvexSet, Ellipsoid, Intersection, Polyhedron, SecondOrderCone, Soft
from lin_freq_ocp.problem.spectrum.bounds import EnergyBound, MagnitudeBound

SETS = ("state_set", "control_set", "initial_state", "terminal_state")
"""The fields of a problem that hold sets."""


def with_wider_term(problem: OptimalControlProblem, field: str, index: int, amount: float) -> OptimalControlProblem:
    """Return the problem with one entry of a field made wider, or without it if the amount is infinite."""
    given = getattr(problem, field)
    if field in SETS:
        sets = given if isinstance(given, (list, tuple)) else [given]
        wider = [wider_set(one, amount) for one in sets]
        return replace(problem, **{field: wider if isinstance(given, (list, tuple)) else wider[0]})
    entries = list(listed(given))
    wider = (
        _wider_outputs(entries[index], amount) if field == "output_spectrum" else wider_bound(entries[index], amount)
    )
    kept = [*entries[:index], *([] if wider is None else [wider]), *entries[index + 1 :]]
    return replace(problem, **{field: kept or None})


def hard_only(problem: OptimalControlProblem) -> OptimalControlProblem:
    """Return the problem without its soft constraints: whether there is a solution does not depend on them."""
    sets = {field: _hard_part(getattr(problem, field)) for field in SETS}
    spectra = {field: _hard_bounds(getattr(problem, field)) for field in ("state_spectrum", "control_spectrum")}
    outputs = [
        OutputSpectrum(one.C, one.D, kept, one.output_names)
        for one in listed(problem.output_spectrum)
        if (kept := _hard_bounds(one.constraints))
    ]
    rows = [one for one in problem.stage_rows if one.penalty is None]
    return replace(problem, **sets, **spectra, stage_rows=rows, output_spectrum=outputs or None)


def _hard_part(given: Any) -> Any:
    if isinstance(given, (list, tuple)):
        return [_hard_part(one) for one in given]
    if isinstance(given, Intersection):
        return Intersection([_hard_part(member) for member in given.sets])
    return Everything() if isinstance(given, Soft) else given


def _hard_bounds(given: Any) -> list[Any] | None:
    return [one for one in listed(given) if getattr(one, "penalty", None) is None] or None


def wider_set(one: Any, amount: float) -> Any:
    """Return a set whose limits beyond its bounds are higher by an amount; its bounds alone if that is infinite."""
    if not isinstance(one, ConvexSet) or isinstance(one, Soft):
        return one
    if np.isinf(amount):
        return Intersection([box_of(one), *_soft_members(one)])
    if isinstance(one, Intersection):
        return Intersection([wider_set(member, amount) for member in one.sets])
    if isinstance(one, Polyhedron):
        return Polyhedron(one.F, one.g + amount)
    if isinstance(one, SecondOrderCone):
        return SecondOrderCone(one.F, one.g, one.h, one.d + amount)
    assert isinstance(one, (Ball, Ellipsoid))
    return _with(one, radius=one.radius + amount)


def wider_bound(one: Any, amount: float) -> Any:
    """Return a frequency constraint with a higher limit; None if the amount is infinite or it has no limit."""
    if np.isinf(amount):
        return None
    if isinstance(one, MagnitudeBound):
        return _with(one, limit=one.limit + amount)
    if isinstance(one, EnergyBound):
        return _with(one, limit=(np.sqrt(one.limit) + amount) ** 2)
    return one


def with_bounds(given: Any, bounds: Box) -> Any:
    """Return a set, or one per time, with other bounds and all else as it is."""
    if isinstance(given, (list, tuple)):
        boxes = [bounds.at(t) if bounds.lower.ndim > 1 else bounds for t in range(len(given))]
        return [with_bounds(one, box) for one, box in zip(given, boxes, strict=True)]
    members = _beyond_bounds(given)
    return Intersection([bounds, *members]) if members else bounds


def _beyond_bounds(one: Any) -> list[Any]:
    if isinstance(one, Intersection):
        return [member for part in one.sets for member in _beyond_bounds(part)]
    return [one] if isinstance(one, ConvexSet) else []


def _soft_members(one: Any) -> list[Any]:
    return [member for member in _beyond_bounds(one) if isinstance(member, Soft)]


def _wider_outputs(outputs: OutputSpectrum, amount: float) -> OutputSpectrum | None:
    wider = [wider_bound(one, amount) for one in outputs.constraints]
    kept = [one for one in wider if one is not None]
    return OutputSpectrum(outputs.C, outputs.D, kept, outputs.output_names) if kept else None


def _with(one: Any, **fields: Any) -> Any:
    changed = copy(one)
    assign(changed, **fields)
    return changed
