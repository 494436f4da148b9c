"""Figures of semi-infinite constraints, whose axis is not that of a DFT.

They are residual vibrations, over the natural frequency, with the limit within the box of modes, and spectra of held
signals beyond the Nyquist frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import LineStyleType

from lin_freq_ocp.base.phrases import number, split_unit
from lin_freq_ocp.comparison.moves import HIGHEST_LIMIT, OURS, UNSHAPED, Moves, boxes_of, frequencies_around, vibration
from lin_freq_ocp.pages.figures.panels import FEW_BINS
from lin_freq_ocp.pages.figures.plot_data import (
    BAND,
    BOUND,
    COMPONENTS,
    INK,
    LABEL_SIZE,
    MUTED,
    ROW_HEIGHT,
    STYLES,
    Note,
    PlotData,
    new_figure,
    style_axes,
    thin_out,
)
from lin_freq_ocp.pages.units import align
from lin_freq_ocp.problem.reformulations import everywhere_of
from lin_freq_ocp.problem.terms.semi_infinite import HeldFrequencies, PlantBox
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Trajectory

PANEL_HEIGHT = 1.15 * ROW_HEIGHT
LINES: tuple[LineStyleType, ...] = ((0, (5, 1.8)), (0, (3, 1.2, 1, 1.2)), (0, (7, 2)))  # of the shapers

PER_BIN = 8  # points for each bin
SHOWN_DECADES = 4  # below the largest value


def moves_figure(moves: Moves) -> Figure:
    """Return the vibration that each move leaves, one panel a control."""
    boxes = boxes_of(moves.problem)
    figure = new_figure(PANEL_HEIGHT * len(boxes))
    for k, box in enumerate(boxes):
        name = moves.problem.control_names[box.map.component]
        vibration_panel(figure.add_subplot(len(boxes), 1, k + 1), name, ringing_of(moves, k))
    return figure


def vibrations_figure(data: PlotData) -> Figure | None:
    """Return what the trajectories leave ringing in boxes of modes; None without any."""
    terms = everywhere_of(data.problem, PlantBox)
    if not terms:
        return None
    figure = new_figure(PANEL_HEIGHT * len(terms))
    for k, (term, box) in enumerate(terms):
        shown = [
            Ringing(trace.label, box, trace.trajectory, trace.style.color, trace.style.line, trace.style.width)
            for trace in data.traces
        ]
        name = term.name.removeprefix("residual vibration of ")
        vibration_panel(figure.add_subplot(len(terms), 1, k + 1), name, shown)
    return figure


def held_figure(data: PlotData) -> Figure | None:
    """Return the spectra of held signals with a limit, images included; None without any."""
    terms = everywhere_of(data.problem, HeldFrequencies)
    if not terms:
        return None
    figure = new_figure(PANEL_HEIGHT * len(terms))
    for k, (term, everywhere) in enumerate(terms):
        _held_panel(figure.add_subplot(len(terms), 1, k + 1), data, term, everywhere)
    return figure


def _held_panel(ax: Axes, data: PlotData, term: Term, everywhere: HeldFrequencies) -> None:
    limits, factor = everywhere.limits, data.frequency.factor
    end = max(float(limits.high.max()), 2 * np.pi)
    bins = int(np.ceil(everywhere.map.samples * end / (2 * np.pi)))
    w, top = np.linspace(0.0, end, PER_BIN * bins), 0.0
    for trace in data.traces:
        signal = everywhere.map.signal(trace.trajectory.x, trace.trajectory.u)
        values = np.abs(everywhere.map.placed(w).transform(signal))
        top, style = max(top, float(values.max())), trace.style
        at = values.reshape(bins, PER_BIN).argmax(1) + PER_BIN * np.arange(bins) if bins > FEW_BINS else slice(None)
        ax.plot(
            *thin_out(factor * w[at], values[at]),
            color=style.color,
            linewidth=0.65 * style.width,
            zorder=style.order,
            label=trace.label,
        )
    for low, high in zip(limits.low, limits.high, strict=True):
        ax.axvspan(factor * low, factor * high, color=BAND, linewidth=0, zorder=0)
    levels = np.column_stack([limits.at_low, limits.at_high])
    for k, (low, high) in enumerate(zip(limits.low, limits.high, strict=True)):
        label = None if k else "limit"
        ax.plot([factor * low, factor * high], levels[k], color=BOUND, linewidth=1.8, zorder=6, label=label)
    ax.axvline(factor * np.pi, color=MUTED, linewidth=1.0, linestyle=(0, (1, 2)), label="Nyquist")
    ax.set_yscale("log")
    top = max(top, float(levels.max()))
    ax.set_ylim(min(top / 10**SHOWN_DECADES, float(levels.min()) / 10), 2 * top)
    ax.set_xlim(0, factor * end)
    legend_beside(ax)
    short, unit = split_unit(term.name)
    style_axes(ax, f"{short[0].upper()}{short[1:]}", data.frequency.label, "|sinc V|" + (f" [{unit}]" if unit else ""))


@dataclass(frozen=True, eq=False)
class Ringing:
    """A trajectory, the box of modes on its samples, and how its line looks."""

    label: str
    box: PlantBox
    trajectory: Trajectory
    color: str
    line: LineStyleType
    width: float


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
        if inside.any() and values[inside].min() > HIGHEST_LIMIT * box.limit:
            times = align(float(values[inside].max()) / box.limit, 3)
            notes.append(Note(f"{one.label}: leaves the picture, {times} times the limit", one.color))
        ax.plot(frequencies, values, color=one.color, linestyle=one.line, linewidth=one.width, label=one.label)
    ax.set_xlim(frequencies[0], frequencies[-1])
    ax.set_ylim(0, HIGHEST_LIMIT * box.limit)
    legend_beside(ax)
    short, unit = split_unit(name)
    y_label = "vibration" + (f" [{unit}]" if unit else "")
    style_axes(ax, f"Residual vibration of {short}", "natural frequency [Hz]", y_label, notes)


def legend_beside(ax: Axes) -> None:
    """Explain the lines of a panel on its right."""
    ax.legend(fontsize=LABEL_SIZE, frameon=False, labelcolor=INK, loc="upper left", bbox_to_anchor=(1.0, 1.0))
