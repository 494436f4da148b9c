"""What moves leave ringing, over the natural frequency: of the problem, of input shapers, and the limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import LineStyleType

from lin_freq_ocp.base.phrases import number, split_unit
from lin_freq_ocp.comparison.moves import OURS, UNSHAPED, Moves, boxes_of
from lin_freq_ocp.comparison.vibrations import ABOVE, frequencies_around, vibration
from lin_freq_ocp.pages.figures.style import (
    BAND,
    BOUND,
    COMPONENTS,
    INK,
    LABEL_SIZE,
    ROW_HEIGHT,
    STYLES,
    Note,
    new_figure,
    style_axes,
)
from lin_freq_ocp.pages.report.units import aligned
from lin_freq_ocp.problem.terms.semi_infinite import PlantBox
from lin_freq_ocp.problem.trajectory import Trajectory

PANEL_HEIGHT = 1.15 * ROW_HEIGHT
LINES: tuple[LineStyleType, ...] = ((0, (5, 1.8)), (0, (3, 1.2, 1, 1.2)), (0, (7, 2)))  # of the shapers


@dataclass(frozen=True, eq=False)
class Ringing:
    """A trajectory, the box of modes on its samples, and how its line looks."""

    label: str
    box: PlantBox
    trajectory: Trajectory
    color: str
    line: LineStyleType
    width: float


def moves_figure(moves: Moves) -> Figure:
    """Return the vibration that each move leaves, one panel a control."""
    boxes = boxes_of(moves.problem)
    figure = new_figure(PANEL_HEIGHT * len(boxes))
    for k, box in enumerate(boxes):
        name = moves.problem.control_names[box.map.component]
        vibration_panel(figure.add_subplot(len(boxes), 1, k + 1), name, ringing_of(moves, k))
    return figure


def ringing_of(moves: Moves, k: int) -> list[Ringing]:
    """Return what the moves that were found leave of control k."""
    shapers, found = iter(zip(COMPONENTS[1:], LINES * 2, strict=False)), list[Ringing]()
    for move in moves.all:
        if move.measured is None:
            continue
        if move.name in (OURS, UNSHAPED):
            style = STYLES["constrained" if move.name == OURS else "classical"]
            color, line, width = style.color, style.line, style.width + 0.3
        else:
            (color, line), width = next(shapers), 1.5
        label = f"{move.name}: {move.samples} samples, {number(move.seconds, 3)} s"
        box = boxes_of(move.measured.problem)[k]
        found.append(Ringing(label, box, move.measured.trajectory, color, line, width))
    return found


def vibration_panel(ax: Axes, name: str, shown: Sequence[Ringing]) -> None:
    """Draw the vibration over the natural frequency, and the limit within the box that all of them have."""
    box = shown[-1].box
    low, high = float(box.low[0]), float(box.high[0])
    frequencies = frequencies_around(box)
    ax.axvspan(low, high, color=BAND, linewidth=0, zorder=0)
    ax.hlines(box.limit, low, high, color=BOUND, linewidth=2.0, label="limit", zorder=4)
    notes, inside = list[Note](), (frequencies >= low) & (frequencies <= high)
    for one in shown:
        values = vibration(one.box, one.trajectory, frequencies)
        if inside.any() and values[inside].min() > ABOVE * box.limit:
            times = aligned(float(values[inside].max()) / box.limit, 3)
            notes.append(Note(f"{one.label}: leaves the picture, {times} times the limit", one.color))
        ax.plot(frequencies, values, color=one.color, linestyle=one.line, linewidth=one.width, label=one.label)
    ax.set_xlim(frequencies[0], frequencies[-1])
    ax.set_ylim(0, ABOVE * box.limit)
    legend_beside(ax)
    short, unit = split_unit(name)
    y_label = "vibration" + (f" [{unit}]" if unit else "")
    style_axes(ax, f"Residual vibration of {short}", "natural frequency [Hz]", y_label, notes)


def legend_beside(ax: Axes) -> None:
    """Explain the lines of a panel on its right."""
    ax.legend(fontsize=LABEL_SIZE, frameon=False, labelcolor=INK, loc="upper left", bbox_to_anchor=(1.0, 1.0))
