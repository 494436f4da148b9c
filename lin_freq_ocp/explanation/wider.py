"""Terms of a problem made wider by an amount, or taken away: sets, masks, energy bounds; and all soft ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet, Intersection
from lin_freq_ocp.problem.sets.box import Box, box_of
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, listed
from lin_freq_ocp.problem.spectrum.outputs import OutputSpectrum

SETS = ("state_set", "control_set", "initial_state", "terminal_state")
"""The fields of a problem that hold sets."""


def with_wider_term(problem: OptimalControlProblem, field: str, index: int, amount: float) -> OptimalControlProblem:
    """Return the problem with one entry of a field made wider, or without it if the amount is infinite."""
    given = getattr(problem, field)
    if field in SETS:
        sets = given if isinstance(given, (list, tuple)) else [given]
        dimension = problem.control_dim if field == "control_set" else problem.state_dim
        wider = [None if one is None else wider_set(one, amount, dimension) for one in sets]
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
    if given is None or isinstance(given, (list, tuple)):
        return None if given is None else [_hard_part(one) for one in given]
    return _members(box_of(given), [one for one in given.members if not one.soft])


def _hard_bounds(given: Any) -> list[Any] | None:
    return [one for one in listed(given) if getattr(one, "penalty", None) is None] or None


def wider_set(one: ConvexSet, amount: float, dimension: int) -> ConvexSet:
    """Return a set whose limits beyond its bounds are higher by an amount; its bounds alone if that is infinite."""
    if np.isinf(amount):
        return _members(box_of(one), [member for member in one.members if member.soft])
    return _members(box_of(one), [member.widened(amount, dimension) for member in one.members])


def wider_bound(one: FrequencyConstraint, amount: float) -> FrequencyConstraint | None:
    """Return a frequency constraint with a higher limit; None if the amount is infinite."""
    return None if np.isinf(amount) else one.widened(amount)


def with_bounds(given: Any, bounds: Box) -> Any:
    """Return a set, or one per time, with other bounds and all else as it is."""
    if isinstance(given, (list, tuple)):
        boxes = [bounds.at(t) if bounds.lower.ndim > 1 else bounds for t in range(len(given))]
        return [with_bounds(one, box) for one, box in zip(given, boxes, strict=True)]
    return _members(bounds, [] if given is None else given.members)


def _members(bounds: Box, members: Sequence[ConvexSet]) -> ConvexSet:
    return Intersection([bounds, *members]) if members else bounds


def _wider_outputs(outputs: OutputSpectrum, amount: float) -> OutputSpectrum | None:
    wider = [wider_bound(one, amount) for one in outputs.constraints]
    kept = [one for one in wider if one is not None]
    return OutputSpectrum(outputs.C, outputs.D, kept, outputs.output_names) if kept else None
