"""The constraints of a problem as named blocks, each of which can be dropped or relaxed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet, Intersection
from lin_freq_ocp.problem.sets.box import Box, box_of
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.bands import Band, bands_of
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, OutputSpectrum, entries_of

ENDS = ("initial state", "terminal state")
SETS = ("state_set", "control_set", "initial_state", "terminal_state")  # the fields of a problem that hold sets

GivenSet = (
    ConvexSet | Sequence[ConvexSet | None] | None
)  # as a field of a problem holds it: None, for all times, or each


@dataclass(frozen=True)
class Block:
    """One block of constraints; ``name`` as in a Conflict."""

    kind: str  # in ENDS, "state bound", "control bound", "row", "state stop band", "control stop band" or "term"
    name: str
    index: int = 0  # the component, the row of its family, or the index of a term in its field
    family: str = ""  # of a row: the name of its stage rows; of a term: the problem's field that it was given in


def blocks(problem: OptimalControlProblem) -> list[Block]:
    """Return all blocks that constrain anything, apart from the dynamics."""

    def components(kind: str, constrained: Mask, names: Sequence[str]) -> list[Block]:
        return [Block(kind, f"{kind} on {names[i]}", i) for i in map(int, np.flatnonzero(constrained))]

    boxes = zip(ENDS, (problem.initial_box, problem.terminal_box), strict=True)
    terms: dict[tuple[str, int], list[str]] = {}  # one block for each entry of a field
    for term in problem.terms:
        if term.hard and term.source is not None:
            terms.setdefault(term.source, []).append(term.name)
    return [
        *(Block(kind, kind) for kind, end in boxes if _bounded_components(end).any()),
        *components("state bound", _bounded_components(problem.state_boxes), problem.state_names),
        *components("control bound", _bounded_components(problem.control_tube), problem.control_names),
        *(
            Block("row", f"row {i} of {rows.name}", i, rows.name)
            for rows in problem.stage_rows
            if rows.penalty is None
            for i in range(rows.rows)
        ),
        *components("state stop band", np.any(problem.state_stop, axis=0), problem.state_names),
        *components("control stop band", np.any(problem.control_stop, axis=0), problem.control_names),
        *(Block("term", ", ".join(names), index, field) for (field, index), names in terms.items()),
    ]


def _bounded_components(box: Box) -> Mask:
    """Return which components have a bound at some time."""
    return np.asarray(np.atleast_2d(np.isfinite(box.lower) | np.isfinite(box.upper)).any(0))


def drop_blocks(problem: OptimalControlProblem, dropped: Collection[Block]) -> OptimalControlProblem:
    """Return the problem without these blocks; terms first, the last index first, because removal shifts indices."""
    for block in sorted(dropped, key=lambda block: (block.kind != "term", -block.index)):
        problem = relax_block(problem, block, np.inf)
    return problem


def relax_block(problem: OptimalControlProblem, block: Block, amount: float | Array) -> OptimalControlProblem:
    """Return the problem with a block moved outwards by an amount, or dropped if it is infinite.

    Ends take an amount per state; stop bands the number of their outermost bins that are passed.
    """
    if block.kind in ENDS:
        field = block.kind.replace(" ", "_")
        end, given = (problem.initial_box, problem.terminal_box)[ENDS.index(block.kind)], getattr(problem, field)
        return replace(problem, **{field: replace_bounds(given, Box(end.lower - amount, end.upper + amount))})
    if block.kind == "row":
        families = list(problem.stage_rows)
        k = next(k for k, rows in enumerate(families) if rows.name == block.family)
        limits = families[k].e.copy()
        limits[..., block.index] += amount
        families[k] = StageRows(families[k].C, families[k].D, limits, block.family, families[k].penalty)
        return replace(problem, stage_rows=families)
    of_states = block.kind.startswith("state")
    if block.kind.endswith("stop band"):  # the stopped bins within ``amount`` of passed bins are passed, too
        field = "state_spectrum" if of_states else "control_spectrum"
        stop = np.array(problem.state_stop if of_states else problem.control_stop)
        stop[:, block.index] = kept_stopped(stop[:, block.index], float(np.max(amount)))
        others = [one for one in entries_of(getattr(problem, field)) if not isinstance(one, Band)]
        return replace(problem, **{field: [*bands_of(stop), *others]})
    if block.kind == "term":
        return _relaxed_term(problem, block, float(np.max(amount)))
    field, tube = ("state_set", problem.state_boxes) if of_states else ("control_set", problem.control_tube)
    lower, upper = tube.lower.copy(), tube.upper.copy()
    lower[:, block.index] -= amount
    upper[:, block.index] += amount
    return replace(problem, **{field: replace_bounds(getattr(problem, field), Box(lower, upper))})


def replace_bounds(given: GivenSet, bounds: Box) -> GivenSet:
    """Return a set, or one per time, with other bounds and the same other members."""
    if isinstance(given, Sequence):
        boxes = [bounds.at(t) if bounds.lower.ndim > 1 else bounds for t in range(len(given))]
        return [_intersection(box, one.members if one else ()) for one, box in zip(given, boxes, strict=True)]
    return _intersection(bounds, given.members if given else ())


def _intersection(bounds: Box, members: Sequence[ConvexSet]) -> ConvexSet:
    return Intersection([bounds, *members]) if members else bounds


def kept_stopped(stopped: Mask, bins: float) -> Mask:
    """Return which stopped bins lie farther than ``bins`` from every passed one; bin 0 counts as one if none is."""
    if not np.isfinite(bins):
        return np.zeros_like(stopped)
    k, passed = np.arange(len(stopped)), np.flatnonzero(~stopped)
    if not len(passed):
        return stopped & (k >= bins)
    return stopped & (np.abs(k[:, None] - passed).min(1) > bins)


def _relaxed_term(problem: OptimalControlProblem, block: Block, amount: float) -> OptimalControlProblem:
    """Return the problem with one entry of a field relaxed by an amount, or dropped if it is infinite."""
    field, given = block.family, getattr(problem, block.family)
    if field in SETS:
        dimension = problem.control_dim if field == "control_set" else problem.state_dim
        if isinstance(given, Sequence):
            return replace(problem, **{field: [one and _relaxed_set(one, amount, dimension) for one in given]})
        return replace(problem, **{field: _relaxed_set(given, amount, dimension)})
    entries = list(entries_of(given))
    entry = entries.pop(block.index)
    if np.isfinite(amount) and field == "output_spectrum":
        bounds = [bound.widened(amount) for bound in entry.constraints]
        entries.insert(block.index, OutputSpectrum(entry.C, entry.D, bounds, entry.output_names))
    elif np.isfinite(amount):
        entries.insert(block.index, entry.widened(amount))
    return replace(problem, **{field: entries or None})


def _relaxed_set(given: ConvexSet, amount: float, dimension: int) -> ConvexSet:
    """Return a set whose limits beyond its bounds are higher by an amount; without hard limits if it is infinite."""
    if np.isinf(amount):
        return _intersection(box_of(given), [member for member in given.members if member.soft])
    return _intersection(box_of(given), [member.widened(amount, dimension) for member in given.members])


def hard_only(problem: OptimalControlProblem) -> OptimalControlProblem:
    """Return the problem without its soft constraints: whether there is a solution does not depend on them."""

    def hard_bounds(given: object) -> list[FrequencyConstraint]:
        return [one for one in entries_of(given) if getattr(one, "penalty", None) is None]

    def hard_set(given: ConvexSet | None) -> ConvexSet | None:
        return given and _intersection(box_of(given), [member for member in given.members if not member.soft])

    def hard_sets(given: GivenSet) -> GivenSet:
        return [hard_set(one) for one in given] if isinstance(given, Sequence) else hard_set(given)

    outputs = [
        OutputSpectrum(one.C, one.D, kept, one.output_names)
        for one in entries_of(problem.output_spectrum)
        if (kept := hard_bounds(one.constraints))
    ]
    return replace(
        problem,
        **{field: hard_sets(getattr(problem, field)) for field in SETS},
        state_spectrum=hard_bounds(problem.state_spectrum) or None,
        control_spectrum=hard_bounds(problem.control_spectrum) or None,
        stage_rows=[one for one in problem.stage_rows if one.penalty is None],
        output_spectrum=outputs or None,
    )
