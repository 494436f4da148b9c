"""One panel each: a component in time, two states against each other, a spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import shorten

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter
from matplotlib.typing import LineStyleType

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.base.phrases import number, short_name, split_unit
from lin_freq_ocp.comparison.trajectories import Line, Signal
from lin_freq_ocp.pages.figures.modes import shade_modes
from lin_freq_ocp.pages.figures.plot_data import (
    BAND,
    BOUND,
    COMPONENTS,
    INK,
    LABEL_SIZE,
    PAPER,
    REFERENCE,
    REFERENCE_LINE,
    SOFT,
    Note,
    PlotData,
    Trace,
    View,
    plain,
    style_axes,
    thin_out,
)
from lin_freq_ocp.problem.measures import ZERO_PADDING, padded_spectrum, stopped_runs

LABEL_CHARACTERS = 30  # A longer name is cut off where several share a legend
DECADES = 5  # decades of a spectrum below its largest value; what is smaller is drawn at the lower edge
HIDDEN_LIMIT = 30  # A limit of a spectrum that is more than so many times its largest value leaves the picture
# Up to so many bins, the zero-padded spectrum is drawn as it is; beyond, the largest value between neighbours.
FEW_BINS = 48


def control_panel(ax: Axes, data: PlotData, j: int, title: str) -> None:
    """Draw control j in time, held over each step, within its bounds."""
    control = data.controls[j]
    _draw_in_time(ax, data, control)
    unit = split_unit(control.name)[1]
    largest = [f"{number(trace.measured.largest(control), 3)} {trace.label}" for trace in data.traces]
    note = Note(f"largest{f' [{unit}]' if unit else ''}: {', '.join(largest)}")
    style_axes(ax, title, data.time.label, control.name, [note])


def state_panel(ax: Axes, data: PlotData, i: int, title: str) -> None:
    """Draw state i in time, within its bounds."""
    state = data.states[i]
    _draw_in_time(ax, data, state)
    style_axes(ax, title, data.time.label, state.name, data.notes([state]))


def states_panel(ax: Axes, data: PlotData, indices: Sequence[int], letter: str) -> None:
    """Draw some states of the main in time: one as ``state_panel`` does, more in a colour each."""
    states = [data.states[i] for i in indices]
    if len(states) == 1:
        state_panel(ax, data, indices[0], f"{letter} {short_name(states[0].name)}")
        return
    shade_modes(ax, data)
    for state, color in zip(states, COMPONENTS, strict=False):
        values = data.main.of(state)
        times = data.time.factor * np.arange(len(values))
        label = plain(shorten(short_name(state.name), LABEL_CHARACTERS, placeholder="\N{HORIZONTAL ELLIPSIS}"))
        ax.plot(*thin_out(times, values), color=color, linewidth=1.5, label=label)
    ax.margins(x=0.015)
    ax.legend(fontsize=LABEL_SIZE, frameon=False, labelcolor=INK, ncols=2)
    unit = split_unit(states[0].name)[1]
    names = f"{short_name(states[0].name)} to {short_name(states[-1].name)}"
    title = shorten(f"{letter} {names}", 2 * LABEL_CHARACTERS, placeholder="\N{HORIZONTAL ELLIPSIS}")
    style_axes(ax, title, data.time.label, f"[{unit}]" if unit else "state", data.notes(states))


def phase_panel(ax: Axes, data: PlotData, i: int, j: int, title: str) -> None:
    """Draw state j over state i, with their bounds as a box, the common start and every end."""
    pair = data.states[i], data.states[j]
    views = [data.view(one) for one in pair]
    _draw_box(ax, pair, views)
    shown = data.showing(pair[0])
    for trace in shown:
        style = trace.style
        x, y = (trace.of(one) for one in pair)
        ax.plot(x, y, color=style.color, linestyle=style.line, linewidth=style.width, zorder=style.order)
        ax.plot(x[-1], y[-1], "s", color=style.color, markersize=7, markeredgecolor=PAPER, zorder=style.order + 4)
    x, y = (shown[-1].of(one)[0] for one in pair)
    ax.plot(x, y, "o", markerfacecolor=PAPER, markeredgecolor=INK, markeredgewidth=1.5, markersize=7, zorder=10)
    ax.set_xlim(views[0].low, views[0].high)
    ax.set_ylim(views[1].low, views[1].high)
    style_axes(ax, title, pair[0].name, pair[1].name, data.notes(pair))


def spectrum_panel(ax: Axes, data: PlotData, component: Signal, title: str) -> None:
    """Draw the spectrum of a component, its DFT bins as points and what lies between them as a line."""
    traces = data.showing(component)
    padded = [padded_spectrum(trace.of(component)[: component.samples, None]) for trace in traces]
    top = max(float(magnitude.max()) for _, magnitude in padded) or 1.0
    floor = float(10.0 ** (np.ceil(np.log10(top)) - DECADES))
    length = component.samples
    shade_stop_band(ax, component.stop, length, data.frequency.factor)
    highest = _draw_levels(ax, data, component, floor, HIDDEN_LIMIT * top)
    for trace, spectrum in zip(traces, padded, strict=True):
        omega, magnitude = spectrum[0], spectrum[1][:, 0]
        gaps = (len(omega) - 1) // ZERO_PADDING
        if gaps > FEW_BINS:  # whose lobes would fill the panel: the top of every lobe
            lobes = magnitude[: gaps * ZERO_PADDING].reshape(gaps, ZERO_PADDING)
            omega, magnitude = omega[np.arange(gaps) * ZERO_PADDING + lobes.argmax(1)], lobes.max(1)
        ax.plot(
            *thin_out(data.frequency.factor * omega, np.maximum(magnitude, floor)),
            color=trace.style.color,
            linewidth=0.65 * trace.style.width,
            zorder=trace.style.order,
        )
        frequency = data.frequency.factor * 2 * np.pi * np.arange(length // 2 + 1) / length
        _draw_bins(ax, trace, frequency, np.abs(np.fft.rfft(trace.of(component)[:length])), floor)
        touching = component.touching(trace.trajectory)
        if len(touching.at):  # where a spectrum reaches the limit of a mask at every frequency
            at = data.frequency.factor * touching.at
            points = Line2D(at, touching.values, linestyle="none", color=trace.style.color)
            points.set(marker="o", markersize=4, markerfacecolor="none", zorder=trace.style.order + 2)
            ax.add_line(points)
    ax.set_yscale("log")
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_ylim(floor / 1.6, 3 * max(top, highest))
    short, unit = split_unit(component.name)
    y_label = f"|DFT of {short}|" + (f" [{unit}]" if unit else "")
    style_axes(ax, title, data.frequency.label, y_label, [_spectrum_note(traces, component)])
    frequency_axis(ax, data)


def _draw_levels(ax: Axes, data: PlotData, component: Signal, floor: float, ceiling: float) -> float:
    """Draw the limits of the spectrum, and return the highest that the axis is to show."""
    highest = 0.0
    for line in component.levels:
        cuts = np.flatnonzero(np.diff(line.at) > 1.5 * np.diff(line.at).min(initial=np.inf)) + 1
        for at, level in zip(np.split(line.at, cuts), np.split(line.values, cuts), strict=True):
            x, y = thin_out(data.frequency.factor * at, np.maximum(level, floor))
            style, marker = SOFT if line.soft else "-", "_" if len(at) == 1 else None
            ax.plot(x, y, color=BOUND, linewidth=1.6, linestyle=style, marker=marker, markersize=9, zorder=2.5)
        near = line.values[line.values <= ceiling]
        highest = max(highest, float(near.max(initial=0.0)))
    return highest


def shade_stop_band(ax: Axes, stop: Mask, length: int, factor: float) -> None:
    """Shade the stopped bins, each with half the way to its neighbours."""
    for first, last in stopped_runs(stop):
        low, high = np.clip(2 * np.pi * np.array([first - 0.5, last + 0.5]) / length, 0, np.pi)
        ax.axvspan(factor * low, factor * high, color=BAND, linewidth=0, zorder=0)


def frequency_axis(ax: Axes, data: PlotData) -> None:
    """Range from 0 to Nyquist; in rad/sample with fifths of pi."""
    nyquist = data.frequency.factor * np.pi
    ax.set_xlim(-0.012 * nyquist, 1.012 * nyquist)
    if data.problem.sampling_time is None:
        ax.xaxis.set_major_locator(FixedLocator(list(np.pi * np.arange(6) / 5)))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / np.pi:.1f} \N{GREEK SMALL LETTER PI}"))


def _draw_in_time(ax: Axes, data: PlotData, component: Signal) -> None:
    """Draw a component of all traces, with its bounds and references, before the modes of the main trajectory."""
    shade_modes(ax, data)
    held = not component.is_state
    drawing = "steps-post" if held else "default"
    for bound in component.bounds:
        if np.isfinite(bound).any():
            values = _repeat_last(np.where(np.isfinite(bound), bound, np.nan), held)
            times = data.time.factor * np.arange(len(values))
            ax.plot(times, values, color=BOUND, linewidth=1.2, drawstyle=drawing, zorder=2)
    for line in component.row_bounds:
        _draw_line(ax, data, line, held, BOUND, SOFT if line.soft else "-")
    for line in component.references:
        _draw_line(ax, data, line, held, REFERENCE, REFERENCE_LINE)
    for trace in data.showing(component):
        values, style = _repeat_last(trace.of(component), held), trace.style
        ax.plot(
            *thin_out(data.time.factor * np.arange(len(values)), values),
            color=style.color,
            linestyle=style.line,
            linewidth=style.width,
            zorder=style.order,
            drawstyle=drawing,
        )
    seen = data.view(component)
    ax.set_ylim(seen.low, seen.high)
    ax.margins(x=0.015)


def _draw_line(ax: Axes, data: PlotData, line: Line, held: bool, color: str, style: LineStyleType) -> None:
    """Draw a bound or reference over time; at a single time, as a point."""
    values, step = line.values, 1 if held else 0
    values = np.append(values, [values[-1]] * step)
    times = data.time.factor * np.append(line.at, [line.at[-1] + 1] * step)
    marker = "D" if np.isfinite(values).sum() <= 1 + step else ""
    drawing = "steps-post" if held else "default"
    (drawn,) = ax.plot(
        *thin_out(times, values), color=color, linestyle=style, linewidth=1.2, marker=marker, markersize=4.5
    )
    drawn.set(drawstyle=drawing, zorder=2)


def _repeat_last(values: Array, held: bool) -> Array:
    """Repeat the last control: it acts until the end of its step."""
    return np.append(values, values[-1]) if held else values


def _draw_box(ax: Axes, pair: Sequence[Signal], views: Sequence[View]) -> None:
    """Draw the bounds of two states as a box, where they do not depend on time; open sides lie out of sight."""
    bounds = [state.bounds for state in pair]
    if any((bound != bound[0]).any() for both in bounds for bound in both):
        return
    low, high = list[float](), list[float]()
    for (lower, upper), seen in zip(bounds, views, strict=True):
        low.append(max(float(lower[0]), seen.low - (seen.high - seen.low)))
        high.append(min(float(upper[0]), seen.high + (seen.high - seen.low)))
    box = Rectangle((low[0], low[1]), high[0] - low[0], high[1] - low[1])
    box.set(fill=False, edgecolor=BOUND, linewidth=1.2, zorder=2)
    ax.add_patch(box)


def _draw_bins(ax: Axes, trace: Trace, frequency: Array, magnitude: Array, floor: float) -> None:
    """Draw the bins as points, and those too small for the axis as hollow triangles at its lower edge."""
    low, style = magnitude < floor, trace.style
    edge = np.full(int(low.sum()), floor)
    looks: Sequence[tuple[Array, Array, dict[str, object]]] = (
        (frequency[~low], magnitude[~low], {"marker": style.marker, "markersize": 2.6, "markeredgewidth": 0}),
        (frequency[low], edge, {"marker": "v", "markersize": 4, "markeredgewidth": 0.8, "markerfacecolor": "none"}),
    )
    for x, y, look in looks:
        points = Line2D(*thin_out(x, y), linestyle="none", color=style.color, zorder=style.order + 1)
        points.set(**look)
        ax.add_line(points)


def _spectrum_note(traces: Sequence[Trace], component: Signal) -> Note:
    """Say how far the stop band is from empty between its bins."""
    if not component.stop.any():
        limited = "; its limit is not about bins" if component.limited_beyond_bins else ""
        return Note(f"no stop band here{limited}")
    named = [f"{number(trace.measured.stopband_peak(component), 3)} {trace.label}" for trace in traces]
    return Note(f"{'peak among the bounded bins' if component.levels else 'stop-band peak'}: {', '.join(named)}")
