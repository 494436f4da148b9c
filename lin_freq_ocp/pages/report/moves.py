"""Input shapers beside the shortest move, in words and in a table."""

from __future__ import annotations

from lin_freq_ocp.base.phrases import NOTHING, listed, number
from lin_freq_ocp.comparison.moves import OURS, Move, Moves
from lin_freq_ocp.pages.report.tables import Cell, ComparisonRows, Group, Row
from lin_freq_ocp.pages.report.units import aligned


def moves_rows(moves: Moves) -> ComparisonRows:
    """Return one column per move: its length, and the vibration that it leaves."""
    found = moves.all

    def longer(move: Move) -> str:
        if move.measured is None or moves.ours.measured is None:
            return NOTHING
        return number(100 * (move.samples / moves.ours.samples - 1), 3)

    def length(move: Move, value: str) -> str:
        return value if move.measured is not None else f"> {value}"

    def vibration(move: Move) -> Cell:
        if move.ratio is None:
            return Cell(NOTHING)
        return Cell(aligned(move.ratio), move.keeps_everything)

    rows = (
        Row("samples", "", tuple(Cell(length(move, str(move.samples))) for move in found)),
        Row("move time", "s", tuple(Cell(length(move, aligned(move.seconds))) for move in found)),
        Row("longer than the optimal move by", "%", tuple(Cell(longer(move)) for move in found)),
        Row("largest vibration, of its limit", "", tuple(map(vibration, found))),
    )
    return ComparisonRows(tuple(move.name for move in found), (Group("", rows),))


def moves_sentence(moves: Moves) -> str:
    """Say how long the moves of the shapers are, and that of the problem."""
    known = [f"{move.name} {move.samples}" for move in moves.shaped if move.measured is not None]
    unknown = [f"{move.name} more than {move.samples}" for move in moves.shaped if move.measured is None]
    ours = moves.ours
    if ours.measured is None:
        own = f"{ours.samples} samples are not known to be enough for any control"
    else:
        own = f"{ours.samples} samples are enough" + (
            f", and {ours.samples - 1} are proven not to be" if moves.proof and ours.samples > 1 else ""
        )
    found = listed(known + unknown)
    return f"with the profiles tried, input shapers of the same robustness need {found} samples; {own}"


def moves_caption(moves: Moves) -> str:
    """Describe the figure of the vibration, and the impulses."""
    impulses = "; ".join(f"{move.name}: {move.description}" for move in moves.shaped)
    return (
        "The amplitude that each move leaves ringing in a mode of this natural frequency, the largest over the damping "
        "ratios of the box; within the shaded frequencies it must not exceed the limit. Every move but the unshaped "
        f"is the shortest found of its kind that keeps all constraints, '{OURS}' that of the problem. Impulses: "
        f"{impulses}."
    )


def moves_title(moves: Moves) -> str:
    """Return the title of the figure, which is also its description where it cannot be seen."""
    within = [move.name for move in moves.all if move.keeps_everything]
    return f"Residual vibration over the natural frequency: {listed(within)} stay below the limit over the whole box"
