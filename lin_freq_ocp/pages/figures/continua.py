"""Figures of semi-infinite constraints, whose axis is not that of a DFT.

They are residual vibrations, over the natural frequency, with the limit within the box of modes, and spectra of held
signals beyond the Nyquist frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import LineStyleType

from lin_freq_ocp.base.phrases import number, split_unit
from lin_freq_ocp.comparison.moves import HIGHEST_LIMIT, OURS, UNSHAPED, Moves, boxes_of, frequencies_around, vibration
from lin_freq_ocp.pages.figures import look
from lin_freq_ocp.pages.figures.panels import FEW_BINS
from lin_freq_ocp.pages.figures.plot_data import PlotData
from lin_freq_ocp.pages.units import align
from lin_freq_ocp.problem.reformulations import everywhere_of
from lin_freq_ocp.problem.terms.semi_infinite import HeldFrequencies, PlantBox
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Trajectory

PANEL_HEIGHT = 1.15 * look.ROW_HEIGHT
LINES: tuple[LineStyleType, ...] = ((0, (5, 1.8)), (0, (3, 1.2, 1, 1.2)), (0, (7, 2)))  # of the shapers

PER_BIN = 8  # points for each bin
SHOWN_DECADES = 4  # below the largest value


def moves_figure(moves: Moves) -> Figure:
    """Return the residual vibration of each move, one panel for each limit."""
    terms = [term for term, _ in everywhere_of(moves.problem, PlantBox) if term.kind.of == "controls"]
    figure, panels = look.panel_grid(len(terms), PANEL_HEIGHT)
    for k, (ax, term) in enumerate(zip(panels, terms, strict=True)):
        vibration_panel(ax, term.name.removeprefix("residual vibration of "), ringing_of(moves, k))
    return figure


def vibrations_figure(data: PlotData) -> Figure | None:
    """Return what the trajectories leave ringing in boxes of modes; None without any."""
    terms = everywhere_of(data.problem, PlantBox)
    if not terms:
        return None
    figure, panels = look.panel_grid(len(terms), PANEL_HEIGHT)
    for ax, (term, box) in zip(panels, terms, strict=True):
        shown = [Ringing(trace.label, box, trace.trajectory, trace.style) for trace in data.traces]
        vibration_panel(ax, term.name.removeprefix("residual vibration of "), shown)
    return figure


def held_figure(data: PlotData) -> Figure | None:
    """Return the spectra of held signals with a limit, images included; None without any."""
    terms = everywhere_of(data.problem, HeldFrequencies)
    if not terms:
        return None
    figure, panels = look.panel_grid(len(terms), PANEL_HEIGHT)
    for ax, (term, everywhere) in zip(panels, terms, strict=True):
        held_spectrum_panel(ax, data, term, everywhere)
    return figure


def held_spectrum_panel(ax: Axes, data: PlotData, term: Term, everywhere: HeldFrequencies) -> None:
    """Draw |sinc V| of a held signal up to the highest frequency with a limit, and the limit."""
    limits, factor = everywhere.limits, data.frequency.factor
    end = max(float(limits.high.max()), 2 * np.pi)
    bins = int(np.ceil(everywhere.map.samples * end / (2 * np.pi)))
    w, top = np.linspace(0.0, end, PER_BIN * bins), 0.0
    for trace in data.traces:
        signal = everywhere.map.signal(trace.trajectory.x, trace.trajectory.u)
        values = np.abs(everywhere.map.placed(w).transform(signal))
        top = max(top, float(values.max()))
        at = values.reshape(bins, PER_BIN).argmax(1) + PER_BIN * np.arange(bins) if bins > FEW_BINS else slice(None)
        solid = trace.style.of_line(0.65) | {"linestyle": "-", "label": trace.label}
        look.draw_line(ax, factor * w[at], values[at], **solid)
    levels = np.column_stack([limits.at_low, limits.at_high])
    for k, (low, high) in enumerate(zip(limits.low, limits.high, strict=True)):
        ax.axvspan(factor * low, factor * high, color=look.BAND, linewidth=0, zorder=0)
        label = None if k else "limit"
        ax.plot([factor * low, factor * high], levels[k], color=look.BOUND, linewidth=1.8, zorder=6, label=label)
    ax.axvline(factor * np.pi, color=look.MUTED, linewidth=1.0, linestyle=(0, (1, 2)), label="Nyquist")
    ax.set_yscale("log")
    top = max(top, float(levels.max()))
    ax.set_ylim(min(top / 10**SHOWN_DECADES, float(levels.min()) / 10), 2 * top)
    ax.set_xlim(0, factor * end)
    legend_beside(ax)
    short, unit = split_unit(term.name)
    look.style_axes(
        ax, f"{short[0].upper()}{short[1:]}", data.frequency.label, "|sinc V|" + (f" [{unit}]" if unit else "")
    )


@dataclass(frozen=True, eq=False)
class Ringing:
    """A trajectory, the box of modes on its samples, and how its line looks."""

    label: str
    box: PlantBox
    trajectory: Trajectory
    style: look.Style


def ringing_of(moves: Moves, k: int) -> list[Ringing]:
    """Return what the moves that were found leave of control k."""
    shapers, found = iter(zip(look.COMPONENTS[1:], LINES * 2, strict=False)), list[Ringing]()
    for move in moves.all:
        if move.measured is None:
            continue
        style = look.STYLES["constrained" if move.name == OURS else "classical"]
        if move.name in (OURS, UNSHAPED):
            style = replace(style, width=style.width + 0.3)
        else:
            color, line = next(shapers)
            style = replace(style, color=color, line=line, width=1.5)
        label = f"{move.name}: {move.samples} samples, {number(move.seconds, 3)} s"
        found.append(Ringing(label, boxes_of(move.measured.problem)[k], move.measured.trajectory, style))
    return found


def vibration_panel(ax: Axes, name: str, shown: Sequence[Ringing]) -> None:
    """Draw the vibration over the natural frequency, and the limit within the box that all of them have."""
    box = shown[-1].box
    low, high = float(box.low[0]), float(box.high[0])
    frequencies = frequencies_around(box)
    ax.axvspan(low, high, color=look.BAND, linewidth=0, zorder=0)
    ax.hlines(box.limit, low, high, color=look.BOUND, linewidth=2.0, label="limit", zorder=4)
    notes, inside = list[look.Note](), (frequencies >= low) & (frequencies <= high)
    for one in shown:
        values, style = vibration(one.box, one.trajectory, frequencies), one.style
        if inside.any() and values[inside].min() > HIGHEST_LIMIT * box.limit:
            times = align(float(values[inside].max()) / box.limit, 3)
            notes.append(look.Note(f"{one.label}: leaves the picture, {times} times the limit", style.color))
        ax.plot(frequencies, values, color=style.color, linestyle=style.line, linewidth=style.width, label=one.label)
    ax.set_xlim(frequencies[0], frequencies[-1])
    ax.set_ylim(0, HIGHEST_LIMIT * box.limit)
    legend_beside(ax)
    short, unit = split_unit(name)
    y_label = "vibration" + (f" [{unit}]" if unit else "")
    look.style_axes(ax, f"Residual vibration of {short}", "natural frequency [Hz]", y_label, notes)


def legend_beside(ax: Axes) -> None:
    """Explain the lines of a panel on its right."""
    ax.legend(fontsize=look.LABEL_SIZE, frameon=False, labelcolor=look.INK, loc="upper left", bbox_to_anchor=(1.0, 1.0))
