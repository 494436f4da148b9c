"""What moves leave ringing, over the natural frequency: of the problem, of input shapers, and the limit."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.comparison.moves import OURS, UNSHAPED, Move, Moves, boxes_of
from lin_freq_ocp.problem.terms.continua.vibration import PlantBox
from lin_freq_ocp.report.figures.style import (
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
from lin_freq_ocp.report.units import aligned
from lin_freq_ocp.text.phrases import number, short_name, split_unit

FREQUENCIES, DAMPINGS = 401, 9  # at which the vibration is drawn, and over which its largest value is taken
BESIDE = 1.5  # widths of the box that are drawn on each of its sides
LEAST_BESIDE = 0.25  # of its highest frequency, if it is narrow
ABOVE = 3.0  # limits that fit into the picture
LINES = ((0, (5, 1.8)), (0, (3, 1.2, 1, 1.2)), (0, (7, 2)))  # of the shapers


def vibration_figure(moves: Moves) -> Figure:
    """Return the largest vibration over all damping ratios, at each natural frequency, one panel a control."""
    boxes = boxes_of(moves.problem)
    figure = new_figure(ROW_HEIGHT * 1.15 * len(boxes))
    for k, box in enumerate(boxes):
        _panel(figure.add_subplot(len(boxes), 1, k + 1), moves, k, box)
    return figure


def _panel(ax: Axes, moves: Moves, k: int, box: PlantBox) -> None:
    low, high = float(box.low[0]), float(box.high[0])
    beside = max(BESIDE * (high - low), LEAST_BESIDE * high)
    frequencies = np.linspace(max(low - beside, 0.05 * low), high + beside, FREQUENCIES)
    ax.axvspan(low, high, color=BAND, linewidth=0, zorder=0)
    ax.hlines(box.limit, low, high, color=BOUND, linewidth=2.0, label="limit", zorder=4)
    shapers = iter(zip(COMPONENTS[1:], LINES * 2, strict=False))
    for move in moves.all:
        if move.measured is None:
            continue
        if move.name in (OURS, UNSHAPED):
            style = STYLES["constrained" if move.name == OURS else "classical"]
            color, line, width = style.color, style.line, style.width + 0.3
        else:
            (color, line), width = next(shapers), 1.5
        label = f"{move.name}: {move.samples} samples, {number(move.seconds, 3)} s"
        ax.plot(frequencies, vibration(move, k, frequencies), color=color, linestyle=line, linewidth=width, label=label)
    ax.set_xlim(frequencies[0], frequencies[-1])
    ax.set_ylim(0, ABOVE * box.limit)
    ax.legend(fontsize=LABEL_SIZE, frameon=False, labelcolor=INK, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    name = moves.problem.control_names[box.map.component]
    unit = split_unit(name)[1]
    away = [move for move in moves.all if move.ratio is not None and move.ratio > ABOVE]
    notes = [Note(f"{move.name} leaves the picture: {aligned(move.ratio, 3)} times the limit") for move in away]
    y_label = "vibration" + (f" [{unit}]" if unit else "")
    style_axes(ax, f"Residual vibration of {short_name(name)}", "natural frequency [Hz]", y_label, notes)


def vibration(move: Move, k: int, frequencies: Array) -> Array:
    """Return the vibration that a move leaves at natural frequencies, the largest over the box's damping ratios."""
    assert move.measured is not None
    box, trajectory = boxes_of(move.measured.problem)[k], move.measured.trajectory
    dampings = np.linspace(box.low[1], box.high[1], DAMPINGS)
    modes = np.stack(np.meshgrid(frequencies, dampings, indexing="ij"), axis=-1).reshape(-1, 2)
    signal = box.map.signal(trajectory.x, trajectory.u)
    return np.abs(box.map.placed(modes).transform(signal)).reshape(len(frequencies), -1).max(axis=1)
