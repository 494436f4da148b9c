"""The figure of a closed loop: signals, spectra of the controls over time, limited windows, and times of the steps."""

from __future__ import annotations

from math import ceil

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lin_freq_ocp.base.arrays import NO_BOUND, Array
from lin_freq_ocp.base.phrases import number, plural, short_name
from lin_freq_ocp.loop.record import LoopRecord, Source
from lin_freq_ocp.pages.figures import look
from lin_freq_ocp.pages.units import frequency_scale, time_scale
from lin_freq_ocp.problem.spectrum.base import EXCEEDED, WindowSpectra

LONGEST_WINDOW = 64  # samples of a window of the spectrogram; an eighth of the loop, if that is less
LEAST_WINDOW = 8
DECIBELS = 60  # range of the colours below the largest value


def loop_figure(loop: LoopRecord) -> Figure:
    """Return each control over time next to its spectrogram, states, limited windows, times of the steps, and gaps.

    States that follow from the controls alone are left out.
    """
    n, m, limited = loop.problem.state_dim, loop.problem.control_dim, loop.spectra()
    states = np.arange(n) if loop.known is None else np.flatnonzero(~loop.known)
    above = m + ceil(len(states) / 2)
    rows = above + len(limited) + 1
    figure = look.new_figure(0.8 * look.ROW_HEIGHT * rows)
    grid = figure.add_gridspec(rows, 2)
    for j in range(m):
        _in_time(figure.add_subplot(grid[j, 0]), loop, j)
        _spectrogram(figure.add_subplot(grid[j, 1]), loop, j)
    for place, i in enumerate(states.tolist()):
        alone = place == len(states) - 1 and place % 2 == 0
        ax = figure.add_subplot(grid[m + place // 2, :] if alone else grid[m + place // 2, place % 2])
        _in_time(ax, loop, i, of_state=True)
    for row, spectra in enumerate(limited, start=above):
        _windows(figure.add_subplot(grid[row, 0]), loop, spectra)
        _windows_in_time(figure.add_subplot(grid[row, 1]), loop, spectra)
    ax, steps = figure.add_subplot(grid[-1, 0]), np.arange(float(len(loop.steps)))
    for values, label, color in (
        (loop.solve_seconds, "solve", look.COMPONENTS[0]),
        (loop.certify_seconds, "certificate", look.COMPONENTS[2]),
    ):
        ax.semilogy(*look.thin_out(steps, 1e3 * np.maximum(values, 1e-7)), ".", color=color, markersize=4, label=label)
    ax.legend(fontsize=look.LABEL_SIZE, frameon=False, labelcolor=look.INK)
    median = number(1e3 * float(np.median(loop.solve_seconds)), 3) if len(steps) else "0"
    note = look.Note(f"median without certificate: {median} ms")
    look.style_axes(ax, "Times of the steps", "step", "time [ms]", [note])
    ax, gaps = figure.add_subplot(grid[-1, 1]), loop.gaps
    known, color = np.isfinite(gaps), look.COMPONENTS[0]
    ax.semilogy(*look.thin_out(steps[known], np.maximum(gaps[known], 1e-17)), ".", color=color, markersize=4)
    for step in steps[~known]:
        ax.axvline(step, color=look.MUTED, linewidth=0.8)
    note = look.Note(f"conditions satisfied at {int(loop.satisfied.sum())} of {plural(len(steps), 'step')}")
    look.style_axes(ax, "Certificates", "step", "relative gap", [note])
    return figure


def _clock(loop: LoopRecord, count: int) -> tuple[Array, str]:
    """Return the first times of the loop, and the label of their axis."""
    scale = time_scale(loop.problem, len(loop.states))
    return scale.factor * np.arange(float(count)), scale.label


def _in_time(ax: Axes, loop: LoopRecord, i: int, of_state: bool = False) -> None:
    """Draw a component with its bounds at the first planned time, and the reference of a state in the cost."""
    problem = loop.problem
    if of_state:
        values, name, box = loop.states[:, i], problem.state_names[i], problem.state_boxes.at(1)
    else:
        values, name, box = loop.controls[:, i], problem.control_names[i], problem.control_tube.at(0)
    times, label = _clock(loop, len(values))
    drawing = "default" if of_state else "steps-post"
    look.draw_line(ax, times, values, color=look.COMPONENTS[0], linewidth=1.5, drawstyle=drawing)
    for limit in (box.lower[i], box.upper[i]):
        if abs(limit) < NO_BOUND:
            ax.axhline(float(limit), color=look.BOUND, linewidth=1.1)
    if of_state and problem.quadratic.weighs[0][i]:
        tracked = np.array([np.nan if step.reference is None else step.reference[i] for step in loop.steps])
        at = times[0] + (times[1] - times[0] if len(times) > 1 else 0.0) * (np.arange(len(tracked)) + loop.delay)
        look.draw_line(ax, at, tracked, color=look.REFERENCE, linestyle=look.REFERENCE_LINE, linewidth=1.1)
    unplanned = np.flatnonzero([source is not Source.PLAN for source in loop.sources])
    ax.plot(times[unplanned], values[unplanned], "x", color=look.FILTERED, markersize=5)
    crosses = look.Note(f"crosses: {plural(len(unplanned), 'step')} without a plan of the problem itself")
    ax.margins(x=0.015)
    look.style_axes(ax, short_name(name), label, name, [crosses] if len(unplanned) and not of_state else [])


def _spectrogram(ax: Axes, loop: LoopRecord, j: int) -> None:
    """Draw |DFT| of Hann windows of a control over their middle times, in dB of the largest value."""
    control, step = loop.controls[:, j], loop.problem.sampling_time
    length = min(LONGEST_WINDOW, max(len(control) // 8, LEAST_WINDOW), len(control))
    title, (times, label) = f"Spectrogram of {short_name(loop.problem.control_names[j])}", _clock(loop, len(control))
    unit = "frequency [rad/sample]" if step is None else "frequency [Hz]"
    if not length:  # no step has a control
        look.style_axes(ax, title, label, unit)
        return
    windows = np.lib.stride_tricks.sliding_window_view(control, length)
    frames = windows * np.hanning(length)
    spectra = np.abs(np.fft.rfft(frames, axis=1))
    largest = float(spectra.max(initial=0.0)) or 1.0
    decibels = 20 * np.log10(np.maximum(spectra / largest, 10 ** (-DECIBELS / 20)))
    frequencies = np.arange(spectra.shape[1]) / length * (2 * np.pi if step is None else 1 / step)
    middle = times[: len(frames)] + times[length - 1] / 2
    drawn = ax.pcolormesh(middle, frequencies, decibels.T, shading="nearest", cmap="cividis", rasterized=True)
    ax.set_ylim(0, frequencies[-1])
    bar = ax.figure.colorbar(drawn, ax=ax, pad=0.02)
    bar.ax.tick_params(labelsize=look.TICK_SIZE, colors=look.INK)
    bar.set_label("dB", fontsize=look.LABEL_SIZE, color=look.INK)
    note = look.Note(f"Hann windows of {length} samples; 0 dB: {number(largest, 3)}")
    look.style_axes(ax, title, label, unit, [note])


def _windows(ax: Axes, loop: LoopRecord, spectra: WindowSpectra) -> None:
    """Draw the largest amplitude of all windows and that of the worst one over the frequency, with band and level."""
    scale, size = frequency_scale(loop.problem), spectra.amplitude
    frequencies, (window, _) = scale.factor * spectra.frequencies, spectra.worst
    bounded = frequencies[spectra.bins]
    for first, last in spectra.bands:
        ax.axvspan(frequencies[first], frequencies[last], color=look.BAND, linewidth=0)
    largest, worst = size * spectra.magnitudes.max(axis=0), size * spectra.magnitudes[window]
    floor = max(float(largest.max()), np.finfo(float).tiny) * 10 ** (-DECIBELS / 20)
    for values, color, label in (
        (largest, look.COMPONENTS[2], f"largest of {plural(len(spectra.begins), 'window')}"),
        (worst, look.CONSTRAINED, "worst window"),
    ):
        drawn = np.maximum(values, floor)
        look.draw_line(ax, frequencies, drawn, color=color, linewidth=1.3, label=label)
    if not spectra.joint:
        levels = np.full(len(frequencies), np.nan)
        levels[spectra.bins] = size * spectra.limits
        look.draw_line(ax, frequencies, levels, color=look.BOUND, linewidth=1.6, label="level")
        broken = spectra.exceeded.any(axis=0)
        ax.plot(bounded[broken], largest[spectra.bins[broken]], "x", color=look.FILTERED, markersize=5)
    ax.set_yscale("log")
    ax.margins(x=0.015)
    ax.legend(fontsize=look.LABEL_SIZE, frameon=False, labelcolor=look.INK)
    notes = [look.Note(f"Windows of {spectra.length} samples; shaded: the limited band")]
    count = int(spectra.exceeded.any(axis=1).sum())
    if count:
        notes.append(look.Note(f"{plural(count, 'window')} above the level; crosses: where", look.FILTERED))
    title = f"Applied windows of {short_name(spectra.name)}"
    look.style_axes(ax, title, scale.label, f"amplitude of {spectra.name}", notes)


def _windows_in_time(ax: Axes, loop: LoopRecord, spectra: WindowSpectra) -> None:
    """Draw the largest amplitude of each window relative to its level, at its last sample; raised levels are shaded."""
    ends, ratios = spectra.begins + spectra.length - 1, spectra.ratios.max(axis=1)
    times, label = _clock(loop, max(len(loop.steps), int(ends[-1]) + 1))
    raised = np.array([step.raised for step in loop.steps], dtype=bool)
    whole = ax.get_xaxis_transform()
    ax.fill_between(times[: len(raised)], 0, 1, raised, step="post", transform=whole, color=look.BAND)
    ax.axhline(1.0, color=look.BOUND, linewidth=1.6)
    look.draw_line(ax, times[ends], ratios, color=look.COMPONENTS[2], marker=".", markersize=4, linewidth=1.0)
    broken = ratios > 1.0 + EXCEEDED
    ax.plot(times[ends[broken]], ratios[broken], "x", color=look.FILTERED, markersize=5)
    ax.set_ylim(bottom=0.0)
    ax.margins(x=0.015)
    count = plural(int(raised.sum()), "step")
    notes = [look.Note(f"shaded: the past exceeds the level, which is raised, at {count}")] if raised.any() else []
    title = f"Applied windows of {short_name(spectra.name)} over time"
    look.style_axes(ax, title, f"{label}, of the last sample", "largest, relative to the level", notes)
