"""The constraints of a problem as named blocks, each of which can be taken away or made wider."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.arrays import Array, Mask
from lin_freq_ocp.explanation.wider import with_bounds, with_wider_term
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import Band, bands_of
from lin_freq_ocp.problem.spectrum.base import listed
from lin_freq_ocp.problem.terms.stage_rows import StageRows

ENDS = ("initial state", "terminal state")


@dataclass(frozen=True)
class Block:
    """One block of constraints.

    Attributes
    ----------
    kind : str
        "initial state", "terminal state", "state bound", "control bound", "row", "state stop band",
        "control stop band" or "term".
    name : str
        As it stands in a Conflict.
    index : int
        The component, the row of its family, or the index of a term in its field.
    family : str
        Of a row: the name of its stage rows; of a term: the problem's field it was given in.
    """

    kind: str
    name: str
    index: int = 0
    family: str = ""


def blocks(problem: OptimalControlProblem) -> list[Block]:
    """Return all blocks that constrain anything, apart from the dynamics."""
    boxes = zip(ENDS, (problem.initial_box, problem.terminal_box), strict=True)
    rows = [rows for rows in problem.stage_rows if rows.penalty is None]
    return [
        *(Block(kind, kind) for kind, end in boxes if _bounded(end).any()),
        *_components("state bound", _bounded(problem.state_boxes), problem.state_names),
        *_components("control bound", _bounded(problem.control_tube), problem.control_names),
        *(Block("row", f"row {i} of {one.name}", i, one.name) for one in rows for i in range(one.rows)),
        *_components("state stop band", np.any(problem.state_stop, axis=0), problem.state_names),
        *_components("control stop band", np.any(problem.control_stop, axis=0), problem.control_names),
        *_terms(problem),
    ]


def _components(kind: str, there: Mask, names: Sequence[str]) -> list[Block]:
    return [Block(kind, f"{kind} on {names[i]}", i) for i in map(int, np.flatnonzero(there))]


def _terms(problem: OptimalControlProblem) -> Iterator[Block]:
    """Yield what can be taken away or made wider beyond bounds, rows and bands: one block for each entry of a field."""
    names: dict[tuple[str, int], list[str]] = {}
    for term in problem.terms:
        if term.hard and term.source is not None:
            names.setdefault(term.source, []).append(term.name)
    for (field, index), together in names.items():
        yield Block("term", ", ".join(together), index, field)


def _bounded(box: Box) -> Mask:
    """Return which components have a bound at some time."""
    finite = np.isfinite(box.lower) | np.isfinite(box.upper)
    return np.asarray(np.atleast_2d(finite).any(0))


def without(problem: OptimalControlProblem, dropped: Collection[Block]) -> OptimalControlProblem:
    """Return the problem without these blocks; terms first, the last index first, because removal shifts indices."""
    for block in sorted(dropped, key=lambda block: (block.kind != "term", -block.index)):
        problem = widened(problem, block, np.inf)
    return problem


def widened(problem: OptimalControlProblem, block: Block, amount: float | Array) -> OptimalControlProblem:
    """Return the problem with a block moved outwards by an amount, or taken away if it is infinite.

    Ends take an amount per state; stop bands the number of their outermost bins that are passed.
    """
    if block.kind in ENDS:
        field = block.kind.replace(" ", "_")
        end, given = (problem.initial_box, problem.terminal_box)[ENDS.index(block.kind)], getattr(problem, field)
        return replace(problem, **{field: with_bounds(given, Box(end.lower - amount, end.upper + amount))})
    if block.kind == "row":
        return replace(problem, stage_rows=[_moved(rows, block, amount) for rows in problem.stage_rows])
    if block.kind.endswith("stop band"):
        return _narrowed(problem, block, amount)
    if block.kind == "term":
        return with_wider_term(problem, block.family, block.index, float(np.max(amount)))
    field = "state_set" if block.kind == "state bound" else "control_set"
    tube = problem.state_boxes if block.kind == "state bound" else problem.control_tube
    lower, upper = tube.lower.copy(), tube.upper.copy()
    lower[:, block.index] -= amount
    upper[:, block.index] += amount
    return replace(problem, **{field: with_bounds(getattr(problem, field), Box(lower, upper))})


def _moved(rows: StageRows, block: Block, amount: float | Array) -> StageRows:
    if rows.name != block.family:
        return rows
    limits = rows.e.copy()
    limits[..., block.index] += amount
    return StageRows(rows.C, rows.D, limits, rows.name, rows.penalty)


def _narrowed(problem: OptimalControlProblem, block: Block, bins: float | Array) -> OptimalControlProblem:
    """Return the problem with the stopped bins of one component that lie within ``bins`` of passed ones passed, too."""
    field = "state_spectrum" if block.kind == "state stop band" else "control_spectrum"
    stop = np.array(problem.state_stop if block.kind == "state stop band" else problem.control_stop)
    stop[:, block.index] = kept_stopped(stop[:, block.index], float(np.max(bins)))
    others = [one for one in listed(getattr(problem, field)) if not isinstance(one, Band)]
    return replace(problem, **{field: [*bands_of(stop), *others]})


def kept_stopped(stopped: Mask, bins: float) -> Mask:
    """Return which stopped bins lie farther than ``bins`` from every passed one; all bins, if none is passed."""
    if not np.isfinite(bins):
        return np.zeros_like(stopped)
    k, passed = np.arange(len(stopped)), np.flatnonzero(~stopped)
    if not len(passed):
        return stopped & (k >= bins)  # nothing is passed: begin at the lowest bins
    return stopped & (np.abs(k[:, None] - passed).min(1) > bins)
