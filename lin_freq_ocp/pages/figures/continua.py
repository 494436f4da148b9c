"""Constraints whose axis is not that of a DFT: spectra of held signals, and residual vibrations."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lin_freq_ocp.base.phrases import split_unit
from lin_freq_ocp.pages.figures.panels import FEW_BINS
from lin_freq_ocp.pages.figures.plot_data import PlotData
from lin_freq_ocp.pages.figures.style import BAND, BOUND, MUTED, new_figure, style_axes, thinned
from lin_freq_ocp.pages.figures.vibration import PANEL_HEIGHT, Ringing, legend_beside, vibration_panel
from lin_freq_ocp.problem.reformulations import everywhere_of
from lin_freq_ocp.problem.terms.semi_infinite import HeldFrequencies, PlantBox
from lin_freq_ocp.problem.terms.term import Term

FINENESS = 8  # points for each bin
DECADES = 4  # below the largest value


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
    w, top = np.linspace(0.0, end, FINENESS * bins), 0.0
    for trace in data.traces:
        signal = everywhere.map.signal(trace.trajectory.x, trace.trajectory.u)
        values = np.abs(everywhere.map.placed(w).transform(signal))
        top, style = max(top, float(values.max())), trace.style
        at = values.reshape(bins, FINENESS).argmax(1) + FINENESS * np.arange(bins) if bins > FEW_BINS else slice(None)
        ax.plot(
            *thinned(factor * w[at], values[at]),
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
    ax.set_ylim(min(top / 10**DECADES, float(levels.min()) / 10), 2 * top)
    ax.set_xlim(0, factor * end)
    legend_beside(ax)
    short, unit = split_unit(term.name)
    style_axes(ax, f"{short[0].upper()}{short[1:]}", data.frequency.label, "|sinc V|" + (f" [{unit}]" if unit else ""))


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
