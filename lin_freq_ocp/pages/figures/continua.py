"""Figures of semi-infinite constraints: residual vibrations, and spectra of signals with a zero-order hold.

A residual vibration, of moves or of an input shaper, is drawn over the natural frequency, with its limit within the
box of modes; a spectrum goes on above the Nyquist frequency.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.typing import LineStyleType

from lin_freq_ocp.base.phrases import number, split_unit
from lin_freq_ocp.comparison.moves import HIGHEST_LIMIT, OURS, UNSHAPED, Moves, boxes_of, frequencies_around, vibration
from lin_freq_ocp.comparison.shapers import Impulses, Modes, eigenvalues_of
from lin_freq_ocp.comparison.trajectories import SpectrumAxis
from lin_freq_ocp.pages.figures import look
from lin_freq_ocp.pages.figures.panels import FEW_BINS
from lin_freq_ocp.pages.figures.plot_data import PlotData
from lin_freq_ocp.pages.units import align
from lin_freq_ocp.problem.terms.quantity import Quantity
from lin_freq_ocp.problem.terms.semi_infinite import VibrationLimit, ZeroOrderHoldMask
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.reformulations import semi_infinite_terms

PANEL_HEIGHT = 1.15 * look.ROW_HEIGHT
LINES: tuple[LineStyleType, ...] = ((0, (5, 1.8)), (0, (3, 1.2, 1, 1.2)), (0, (7, 2)))  # of the shapers

Panel = Callable[[Axes], None]  # draws into the axes

SHAPER_HEIGHT = 1.3 * look.ROW_HEIGHT
DRAWN_FREQUENCIES = 801
BEYOND = 1.6  # times the highest frequency of a shaper: the end of the axis
SHOWN = 5.0  # limits that fit into the picture
PER_BIN = 8  # points for each bin
SHOWN_DECADES = 4  # below the largest value


def shaper_figure(impulses: Impulses, modes: Modes, limit: float) -> Figure:
    """Return the vibration after the last impulse, relative to one impulse then, a line for each damping ratio."""
    figure = look.new_figure(SHAPER_HEIGHT)
    ax = figure.add_subplot()
    frequencies = np.linspace(0.0, BEYOND * modes.bands[-1][1], DRAWN_FREQUENCIES)
    for k, (low, high) in enumerate(modes.bands):
        ax.axvspan(low, high, color=look.BAND, linewidth=0, zorder=0)
        ax.hlines(100 * limit, low, high, color=look.BOUND, linewidth=2.0, zorder=4, label="" if k else "limit")
    least, largest = modes.damping
    for damping, color in zip(dict.fromkeys((least, (least + largest) / 2, largest)), look.COMPONENTS, strict=False):
        values = 100 * np.abs(impulses.response(eigenvalues_of(frequencies, np.full(DRAWN_FREQUENCIES, damping))))
        ax.plot(frequencies, values, color=color, linewidth=1.4, label=f"damping ratio {number(damping)}")
    ax.set_xlim(0, frequencies[-1])
    ax.set_ylim(0, 100 * min(SHOWN * limit, 1.0))
    look.style_axes(ax, "Residual vibration", "natural frequency [Hz]", "vibration [%]")
    handles, _ = ax.get_legend_handles_labels()
    look.legend_above(figure, handles)
    return figure


def moves_figure(moves: Moves) -> Figure:
    """Return the residual vibration of each move, one panel for each limit."""
    terms = [term for term, _ in semi_infinite_terms(moves.problem, VibrationLimit) if term.kind.of == "controls"]
    figure, panels = look.panel_grid(len(terms), PANEL_HEIGHT)
    for k, (ax, term) in enumerate(zip(panels, terms, strict=True)):
        vibration_panel(ax, term.name.removeprefix("residual vibration of "), ringing_of(moves, k))
    return figure


def panels_figure(panels: Sequence[Panel]) -> Figure | None:
    """Return a figure with these panels in rows; None without any."""
    if not panels:
        return None
    figure, axes = look.panel_grid(len(panels), PANEL_HEIGHT)
    for ax, panel in zip(axes, panels, strict=True):
        panel(ax)
    return figure


def vibration_panels(data: PlotData) -> list[Panel]:
    """Return a panel for each box of modes, with the residual vibrations of the trajectories."""
    return [
        partial(
            vibration_panel,
            name=term.name.removeprefix("residual vibration of "),
            shown=[Ringing(trace.label, box, trace.trajectory, trace.style) for trace in data.traces],
        )
        for term, box in semi_infinite_terms(data.problem, VibrationLimit)
    ]


def held_panels(data: PlotData) -> list[Panel]:
    """Return a panel for each limited spectrum of a signal with a zero-order hold, images included."""
    terms = semi_infinite_terms(data.problem, ZeroOrderHoldMask)
    return [partial(held_spectrum_panel, data=data, term=term, everywhere=everywhere) for term, everywhere in terms]


def held_spectrum_panel(ax: Axes, data: PlotData, term: Term, everywhere: ZeroOrderHoldMask, letter: str = "") -> None:
    """Draw |sinc V| of a signal with a zero-order hold, and its limit, up to the highest limited frequency."""
    limits, factor = everywhere.limits, data.frequency.factor
    end = max(float(limits.high.max()), 2 * np.pi)
    bins = int(np.ceil(everywhere.map.samples * end / (2 * np.pi)))
    w, top, per_level = np.linspace(0.0, end, PER_BIN * bins), 0.0, float(np.max(term.per_limit))
    axis = SpectrumAxis(Quantity("limit"), term.name)
    if term.statement is not None:
        axis = SpectrumAxis(term.statement.quantity, term.statement.signal, per_level, per_level)
    for trace in data.traces:
        signal = everywhere.map.signal(trace.trajectory.x, trace.trajectory.u)
        values = axis.of_sums(w, np.abs(everywhere.map.at_points(w).transform(signal)))
        top = max(top, float(values.max()))
        at = values.reshape(bins, PER_BIN).argmax(1) + PER_BIN * np.arange(bins) if bins > FEW_BINS else slice(None)
        solid = trace.style.of_line(0.65) | {"linestyle": "-", "label": trace.label}
        look.draw_line(ax, factor * w[at], values[at], **solid)
    levels = axis.of_levels(np.column_stack([limits.at_low, limits.at_high]) / per_level)
    for k, (low, high) in enumerate(zip(limits.low, limits.high, strict=True)):
        ax.axvspan(factor * low, factor * high, color=look.BAND, linewidth=0, zorder=0)
        label = None if k else "limit"
        ax.plot([factor * low, factor * high], levels[k], color=look.BOUND, linewidth=1.8, zorder=6, label=label)
    ax.axvline(factor * np.pi, color=look.MUTED, linewidth=1.0, linestyle=(0, (1, 2)), label="Nyquist")
    ax.set_yscale("log")
    top = max(top, float(levels.max()))
    ax.set_ylim(min(top / 10**SHOWN_DECADES, float(levels.min()) / 10), 2 * top)
    ax.set_xlim(0, factor * end)
    legend_right(ax)
    short = split_unit(term.name)[0]
    label = axis.label.replace(f"|DFT of {split_unit(axis.name)[0]}|", "|sinc V|")
    look.style_axes(ax, f"{letter} {short[0].upper()}{short[1:]}".lstrip(), data.frequency.label, label)


@dataclass(frozen=True, eq=False)
class Ringing:
    """A trajectory, the box of modes for its samples, and the style of its line."""

    label: str
    box: VibrationLimit
    trajectory: Trajectory
    style: look.Style


def ringing_of(moves: Moves, k: int) -> list[Ringing]:
    """Return the moves with a trajectory, for the vibration panel of control k."""
    styles, lines = iter(zip(look.COMPONENTS[1:], LINES * 2, strict=False)), list[Ringing]()
    for move in moves.all:
        if move.measured is None:
            continue
        style = look.STYLES["constrained" if move.name == OURS else "classical"]
        if move.name in (OURS, UNSHAPED):
            style = replace(style, width=style.width + 0.3)
        else:
            color, line = next(styles)
            style = replace(style, color=color, line=line, width=1.5)
        label = f"{move.name}: {move.samples} samples, {number(move.seconds, 3)} s"
        lines.append(Ringing(label, boxes_of(move.measured.problem)[k], move.measured.trajectory, style))
    return lines


def vibration_panel(ax: Axes, name: str, shown: Sequence[Ringing], letter: str = "") -> None:
    """Draw the vibration over the natural frequency, and the limit within the box of modes."""
    box = shown[-1].box
    low, high = float(box.low[0]), float(box.high[0])
    frequencies = frequencies_around(box)
    ax.axvspan(low, high, color=look.BAND, linewidth=0, zorder=0)
    ax.hlines(box.limit, low, high, color=look.BOUND, linewidth=2.0, label="limit", zorder=4)
    notes, inside = list[look.Note](), (frequencies >= low) & (frequencies <= high)
    for line in shown:
        values, style = vibration(line.box, line.trajectory, frequencies), line.style
        if inside.any() and values[inside].min() > HIGHEST_LIMIT * box.limit:
            times = align(float(values[inside].max()) / box.limit, 3)
            notes.append(look.Note(f"{line.label}: leaves the picture, {times} times the limit", style.color))
        ax.plot(frequencies, values, color=style.color, linestyle=style.line, linewidth=style.width, label=line.label)
    ax.set_xlim(frequencies[0], frequencies[-1])
    ax.set_ylim(0, HIGHEST_LIMIT * box.limit)
    legend_right(ax)
    short, unit = split_unit(name)
    y_label = "vibration" + (f" [{unit}]" if unit else "")
    title = f"{letter} Residual vibration of {short}".lstrip()
    look.style_axes(ax, title, "natural frequency [Hz]", y_label, notes)


def legend_right(ax: Axes) -> None:
    """Draw the legend of a panel to its right."""
    ax.legend(fontsize=look.LABEL_SIZE, frameon=False, labelcolor=look.INK, loc="upper left", bbox_to_anchor=(1.0, 1.0))
