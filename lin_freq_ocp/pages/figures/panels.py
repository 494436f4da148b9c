"""Single panels: a component over time, a phase portrait, a spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from textwrap import shorten

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.base.phrases import number, short_name, split_unit
from lin_freq_ocp.comparison.trajectories import ProblemSignal
from lin_freq_ocp.pages.figures import look
from lin_freq_ocp.pages.figures.modes import shade_modes
from lin_freq_ocp.pages.figures.plot_data import JointRow, Obstacle, PlotData, View, view
from lin_freq_ocp.problem.measures import ZERO_PADDING, padded_spectrum, stopped_runs

LABEL_CHARACTERS = 30  # a longer name is cut off in a legend of several
DECADES = 5  # decades of a spectrum below its largest value; smaller values are drawn at the lower edge
HIDDEN_LIMIT = 30  # a limit of more than so many times the largest value of the spectrum is not shown
# Up to so many bins, the whole zero-padded spectrum is drawn; for more, the largest value between neighbours.
FEW_BINS = 48
GRID_POINTS = 241  # of each axis, between which the border of an obstacle is drawn straight
PROPORTION = 2.0  # width over height of a panel whose axes have one scale


def time_panel(ax: Axes, data: PlotData, component: ProblemSignal, letter: str = "") -> None:
    """Draw a control or state of all traces over time, with its bounds, on the tints of the main trajectory's modes."""
    shade_modes(ax, data)
    zero_order_hold = not component.is_state  # each control acts until the end of its step
    drawing = "steps-post" if zero_order_hold else "default"

    def draw(at: Array, values: Array, **properties: object) -> None:
        """Draw values over steps, with a time at which the last step of a control ends."""
        if zero_order_hold:
            at, values = np.append(at, at[-1] + 1), np.append(values, values[-1])
        look.draw_line(ax, data.time.factor * at, values, drawstyle=drawing, **properties)

    for bound in component.bounds:
        if np.isfinite(bound).any():
            values = np.where(np.isfinite(bound), bound, np.nan)
            draw(np.arange(float(len(values))), values, color=look.BOUND, linewidth=1.2, zorder=2)
    tight = None if data.tightened is None else replace(component, problem=data.tightened).bounds
    for sides in () if tight is None else zip(component.bounds, tight, strict=True):
        if np.isfinite(sides[0]).any():
            ends = [np.append(side, side[-1:]) if zero_order_hold else side for side in sides]
            at, step = data.time.factor * np.arange(len(ends[0])), "post" if zero_order_hold else None
            ax.fill_between(at, ends[0], ends[1], step=step, color=look.BAND, linewidth=0, zorder=0)
    for level in data.control_levels(component):
        ax.axhline(float(level), color=look.BOUND, linestyle=look.LEVEL_LINE, linewidth=0.9, zorder=1)
    limits = [(line, look.BOUND, look.SOFT if line.soft else "-") for line in component.row_bounds]
    for line, color, style in [
        *limits,
        *((line, look.REFERENCE, look.REFERENCE_LINE) for line in component.references),
    ]:
        marker = "D" if np.isfinite(line.values).sum() <= 1 else ""  # of a single time
        shape: dict[str, object] = {"linestyle": style, "linewidth": 1.2, "marker": marker, "markersize": 4.5}
        draw(line.at, line.values, color=color, zorder=2, **shape)
    for trace in data.showing(component):
        values = trace.of(component)
        draw(np.arange(float(len(values))), values, **trace.style.of_line())
    seen = data.view(component)
    ax.set_ylim(seen.low, seen.high)
    ax.margins(x=0.015)
    notes = data.notes([component])
    if zero_order_hold:
        unit = split_unit(component.name)[1]
        largest = [f"{number(trace.measured.largest(component), 3)} {trace.label}" for trace in data.traces]
        notes = [look.Note(f"largest{f' [{unit}]' if unit else ''}: {', '.join(largest)}")]
    look.style_axes(ax, f"{letter} {short_name(component.name)}".lstrip(), data.time.label, component.name, notes)


def states_panel(ax: Axes, data: PlotData, states: Sequence[ProblemSignal], letter: str = "") -> None:
    """Draw states of the main trajectory over time: a single one as ``time_panel`` does, several in a colour each."""
    if len(states) == 1:
        time_panel(ax, data, states[0], letter)
        return
    shade_modes(ax, data)
    for state, color in zip(states, look.COMPONENTS, strict=False):
        values = data.main.of(state)
        times = data.time.factor * np.arange(len(values))
        label = look.plain(shorten(short_name(state.name), LABEL_CHARACTERS, placeholder="\N{HORIZONTAL ELLIPSIS}"))
        look.draw_line(ax, times, values, color=color, linewidth=1.5, label=label)
    ax.margins(x=0.015)
    ax.legend(fontsize=look.LABEL_SIZE, frameon=False, labelcolor=look.INK, ncols=2)
    unit = split_unit(states[0].name)[1]
    names = f"{short_name(states[0].name)} to {short_name(states[-1].name)}"
    title = shorten(f"{letter} {names}", 2 * LABEL_CHARACTERS, placeholder="\N{HORIZONTAL ELLIPSIS}")
    look.style_axes(ax, title, data.time.label, f"[{unit}]" if unit else "state", data.notes(states))


def rows_panel(ax: Axes, data: PlotData, row: JointRow, letter: str = "") -> None:
    """Draw a joint row of all traces over time, with its bounds."""
    shade_modes(ax, data)
    times = data.time.factor * np.arange(data.problem.horizon + 1.0)

    def draw(values: Array, **properties: object) -> None:
        look.draw_line(ax, times, np.append(values, values[-1]), drawstyle="steps-post", **properties)

    for bound in (row.lower, row.upper):
        if np.isfinite(bound).any():
            style = "-" if row.family.penalty is None else look.SOFT
            draw(
                np.where(np.isfinite(bound), bound, np.nan), color=look.BOUND, linewidth=1.2, linestyle=style, zorder=2
            )
    traces = [trace for trace in data.traces if trace.measured.meaningful]
    for trace in traces:
        draw(row.values(trace.trajectory), **trace.style.of_line())
    seen = view([row.values(trace.trajectory) for trace in traces], [], np.concatenate([row.lower, row.upper]))
    ax.set_ylim(seen.low, seen.high)
    ax.margins(x=0.015)
    name, unit = row.family.name, f" [{row.unit}]" if row.unit else ""
    look.style_axes(ax, f"{letter} {name}".lstrip(), data.time.label, f"{name}{unit}", [look.Note(row.words)])


def phase_panel(ax: Axes, data: PlotData, pair: Sequence[ProblemSignal], letter: str = "") -> None:
    """Draw the second state over the first: their bounds as a box, the common start, and the end of each trace."""
    views = [data.view(state) for state in pair]
    obstacles = [one for one in data.obstacles if one.pair == tuple(state.index for state in pair)]
    if obstacles and len({split_unit(state.name)[1] for state in pair}) == 1:
        ax.set_aspect("equal")
        width = max(views[0].length, PROPORTION * views[1].length)
        views = [seen.with_length(length) for seen, length in zip(views, (width, width / PROPORTION), strict=True)]
    bounds = [state.bounds for state in pair]
    if not any((bound != bound[0]).any() for both in bounds for bound in both):  # a box, whose open sides lie outside
        low = [max(float(lower[0]), 2 * seen.low - seen.high) for (lower, _), seen in zip(bounds, views, strict=True)]
        high = [min(float(upper[0]), 2 * seen.high - seen.low) for (_, upper), seen in zip(bounds, views, strict=True)]
        box = Rectangle((low[0], low[1]), high[0] - low[0], high[1] - low[1])
        box.set(fill=False, edgecolor=look.BOUND, linewidth=1.2, zorder=2)
        ax.add_patch(box)
    for obstacle in obstacles:
        shade_obstacle(ax, obstacle, views)
    shown = data.showing(pair[0])
    for trace in shown:
        style = trace.style
        x, y = (trace.of(state) for state in pair)
        ax.plot(x, y)[0].set(**style.of_line())
        ax.plot(x[-1], y[-1], "s", color=style.color, markersize=7, markeredgecolor=look.PAPER, zorder=style.order + 4)
    x, y = (shown[-1].of(state)[0] for state in pair)
    (start,) = ax.plot(x, y, "o", markerfacecolor=look.PAPER, markeredgecolor=look.INK, markersize=7, zorder=10)
    start.set_markeredgewidth(1.5)
    ax.set_xlim(views[0].low, views[0].high)
    ax.set_ylim(views[1].low, views[1].high)
    title = f"{letter} {' and '.join(short_name(state.name) for state in pair)}"
    look.style_axes(ax, title, pair[0].name, pair[1].name, data.notes(pair))


def shade_obstacle(ax: Axes, obstacle: Obstacle, views: Sequence[View]) -> None:
    """Shade what a path constraint excludes within the ranges of both axes."""
    x, y = (np.linspace(seen.low, seen.high, GRID_POINTS) for seen in views)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    excess = np.ma.masked_invalid(obstacle.excess(points.reshape(-1, 2)).reshape(points.shape[:2]))
    if excess.max() > 0:
        ax.contourf(x, y, excess, [0.0, excess.max()], colors=[look.GRID], zorder=0.5)
        ax.contour(x, y, excess, [0.0], colors=[look.BOUND], linewidths=1.2, zorder=2)


def spectrum_panel(ax: Axes, data: PlotData, component: ProblemSignal, letter: str = "") -> None:
    """Draw the spectrum of a component: its DFT bins as points, the zero-padded spectrum between them as a line."""
    traces = data.showing(component)
    axis, signals = component.axis, [component.drawn_samples(trace.trajectory)[:, None] for trace in traces]
    padded = [(omega, axis.of_sums(omega, sums[:, 0])) for omega, sums in map(padded_spectrum, signals)]
    top = max(float(magnitude.max()) for _, magnitude in padded) or 1.0
    floor = float(10.0 ** (np.ceil(np.log10(top)) - DECADES))
    length, factor = component.samples, data.frequency.factor
    shade_stop_band(ax, component.stop, length, factor)
    highest = 0.0
    for line in component.levels:
        shape: dict[str, object] = {"linewidth": 1.6, "linestyle": look.SOFT if line.soft else "-", "markersize": 9}
        shape |= {"marker": "_" if len(line.at) == 1 else "", "color": look.BOUND, "zorder": 2.5}
        look.draw_line(ax, factor * line.at, np.maximum(line.values, floor), **shape)
        highest = max(highest, float(line.values[line.values <= HIDDEN_LIMIT * top].max(initial=0.0)))
    at_bins = 2 * np.pi * np.arange(length // 2 + 1) / length
    for trace, signal, (omega, magnitude) in zip(traces, signals, padded, strict=True):
        style = trace.style
        gaps = (len(omega) - 1) // ZERO_PADDING
        if gaps > FEW_BINS:  # the lobes would fill the panel: draw the top of each
            lobes = magnitude[: gaps * ZERO_PADDING].reshape(gaps, ZERO_PADDING)
            omega, magnitude = omega[np.arange(gaps) * ZERO_PADDING + lobes.argmax(1)], lobes.max(1)
        look.draw_line(ax, factor * omega, np.maximum(magnitude, floor), **style.of_line(0.65) | {"linestyle": "-"})
        # Bins are points; those too small for the axis are hollow triangles at its lower edge.
        frequency, order = factor * at_bins, style.order
        bins = axis.of_sums(at_bins, np.abs(np.fft.rfft(signal[:, 0])))
        low = bins < floor
        hollow: dict[str, object] = {"markersize": 4, "markerfacecolor": "none", "linestyle": "none"}
        filled = hollow | {"markersize": 2.6, "markerfacecolor": style.color, "markeredgewidth": 0}
        look.draw_line(
            ax, frequency[~low], bins[~low], marker=style.marker, color=style.color, zorder=order + 1, **filled
        )
        at_edge = np.full(int(low.sum()), floor)
        look.draw_line(
            ax, frequency[low], at_edge, marker="v", markeredgewidth=0.8, color=style.color, zorder=order + 1, **hollow
        )
        touching = component.touching(trace.trajectory)
        if len(touching.at):  # frequencies at which the spectrum reaches a mask at every frequency
            look.draw_line(
                ax, factor * touching.at, touching.values, marker="o", color=style.color, zorder=order + 2, **hollow
            )
    if data.largest is not None and not component.is_state and component in data.controls:
        most = axis.of_sums(at_bins, data.largest[:, component.index])
        look.draw_line(ax, factor * at_bins, most, color=look.MUTED, linestyle=look.REFERENCE_LINE, linewidth=1.2)
        highest = max(highest, float(most.max()))
    ax.set_yscale("log")
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_ylim(floor / 1.6, 3 * max(top, highest))
    if axis.in_decibels:
        ax.yaxis.set_major_formatter(FuncFormatter(lambda level, _: f"{20 * np.log10(level):g}"))
    if component.stop.any():  # the largest magnitude between the bins of the stop band
        peaks = [(component.stopband_peak(trace.trajectory) or 0.0) / axis.inner for trace in traces]
        shown = [float(axis.quantity.stated(np.asarray(peak))) for peak in peaks]
        named = [f"{number(peak, 3)} {trace.label}" for peak, trace in zip(shown, traces, strict=True)]
        note = f"{'peak among the bounded bins' if component.levels else 'stop-band peak'}: {', '.join(named)}"
    else:
        note = f"no stop band here{'; its limit is not about bins' if component.limited_beyond_bins else ''}"
    title = f"{letter} Spectrum of {short_name(component.name)}".lstrip()
    look.style_axes(ax, title, data.frequency.label, axis.label, [look.Note(note)])
    frequency_axis(ax, data)


def shade_stop_band(ax: Axes, stop: Mask, length: int, factor: float) -> None:
    """Shade the stopped bins, each with half the way to its neighbours."""
    for first, last in stopped_runs(stop):
        low, high = np.clip(2 * np.pi * np.array([first - 0.5, last + 0.5]) / length, 0, np.pi)
        ax.axvspan(factor * low, factor * high, color=look.BAND, linewidth=0, zorder=0)


def frequency_axis(ax: Axes, data: PlotData) -> None:
    """Set the range of an axis from 0 to the Nyquist frequency; in rad/sample, ticks are fifths of pi."""
    nyquist = data.frequency.factor * np.pi
    ax.set_xlim(-0.012 * nyquist, 1.012 * nyquist)
    if data.problem.sampling_time is None:
        ax.xaxis.set_major_locator(FixedLocator(list(np.pi * np.arange(6) / 5)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / np.pi:.1f} \N{GREEK SMALL LETTER PI}"))
