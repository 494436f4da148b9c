"""Figures of a result or a comparison; they need no display and change no global setting."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import ceil
from string import ascii_lowercase

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import NullFormatter

from lin_freq_ocp.analysis.sensitivities import bin_prices
from lin_freq_ocp.certificate.sizes import GAP_TOLERANCE
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.comparison.compare import ComparisonOutcome
from lin_freq_ocp.errors import SolveError
from lin_freq_ocp.phrases import NO_BOUND, number, short_name, split_unit
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.report.entries import has_frequency_constraint, shown_filter, solution_label
from lin_freq_ocp.report.figures.panels import (
    control_panel,
    frequency_axis,
    phase_panel,
    shade_stop_band,
    spectrum_panel,
    state_panel,
    states_panel,
)
from lin_freq_ocp.report.figures.scene import Component, Scene
from lin_freq_ocp.report.figures.style import (
    BAND,
    BOUND,
    COMPONENTS,
    CONSTRAINED,
    INK,
    LABEL_SIZE,
    MARKERS,
    MUTED,
    PAPER,
    REFERENCE,
    REFERENCE_LINE,
    ROW_HEIGHT,
    SOFT,
    STYLES,
    Trace,
    dress,
    legend_above,
    legend_rows,
    new_figure,
    thinned,
)
from lin_freq_ocp.report.modes.panels import mode_legend
from lin_freq_ocp.report.modes.spans import mode_sequence, sequence_of
from lin_freq_ocp.solving.outcome import Outcome

LEGEND_HEIGHT = 0.5
"""Inches for the legend above the panels."""

STATE_ROW_HEIGHT = 0.78 * ROW_HEIGHT

MOST_PANELS = 6
"""Up to so many states have a panel each; of more, those of the same unit share one."""

SMALLEST_SHOWN = 1e-6
"""Stage gaps below this fraction of the largest are rounding, and drawn at the lower edge."""

ROUNDING = 1e-12
"""Fraction of the allowed gap that counts as the largest stage gap, if all of them are smaller."""


def result_figure(result: Outcome) -> Figure:
    """Return controls, their spectra, two phase portraits and all states in time of one solution.

    Raises
    ------
    SolveError
        If the result has no trajectory.
    """
    return four_panels(result_scene(result), with_states=True)


def comparison_figure(comparison: ComparisonOutcome, filter_name: str | None = None) -> Figure:
    """Return the four panels of the paper's Figure 3: controls, their spectra, two phase portraits.

    Parameters
    ----------
    comparison : ComparisonOutcome
    filter_name : str, optional
        The filter to show; default the brick wall, if it was asked for, else the first.

    Raises
    ------
    ProblemError
        If the comparison has no filter of that name.
    """
    return four_panels(comparison_scene(comparison, filter_name))


def result_scene(result: Outcome) -> Scene:
    """Return the solution as a scene; SolveError if it has no trajectory."""
    if result.trajectory is None:
        raise SolveError(f"The solve ended without a trajectory to show ({result.status}).", result)
    return Scene(result.problem, (_solved(solution_label(result), result),))


def comparison_scene(comparison: ComparisonOutcome, filter_name: str | None = None) -> Scene:
    """Return what there is of the classical, the filtered and the constrained trajectory."""
    problem, constrained = comparison.problem, comparison.constrained
    one = shown_filter(comparison, filter_name)
    if not has_frequency_constraint(problem) and constrained.trajectory is not None:
        return result_scene(constrained)
    traces = list[Trace]()
    if comparison.classical.trajectory is not None:
        traces.append(_solved("classical", comparison.classical))
    if one is not None:
        detail, shown = one.name.replace("_", " "), one.replay.meaningful
        modes = mode_sequence(problem, one.replay.trajectory) if shown else None
        stopped = bool(one.replay.stopped)
        traces.append(Trace("filtered", one.replay.trajectory, STYLES["filtered"], detail, shown, True, modes, stopped))
    if constrained.trajectory is not None:
        traces.append(_solved("constrained", constrained))
    return Scene(problem, tuple(traces))


def _solved(label: str, result: Outcome) -> Trace:
    """Return a solution, which has a trajectory, as a trace."""
    assert result.trajectory is not None
    style = STYLES["classical" if label == "classical" else "constrained"]
    return Trace(label, result.trajectory, style, sequence=sequence_of(result))


def four_panels(scene: Scene, with_states: bool = False) -> Figure:
    """Return each control in time beside its spectrum, and two views of the states below; on request, all in time."""
    problem = scene.problem
    controls, groups = problem.control_dim, _groups_of_states(scene) if with_states else []
    state_rows = ceil(len(groups) / 2)
    views = 0 if with_states and problem.state_dim == 1 else 1
    heights = [ROW_HEIGHT] * (controls + views) + [STATE_ROW_HEIGHT] * state_rows
    legend = _legend_handles(scene, problem.state_dim > 1, bool(problem.control_band.any()), with_bounds=True)
    figure = new_figure(sum(heights) + LEGEND_HEIGHT * legend_rows(legend) + mode_legend(scene).height)
    grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
    letters = (f"({''.join(one)})" for size in (1, 2) for one in product(ascii_lowercase, repeat=size))
    for j, name in enumerate(problem.control_names):
        control_panel(figure.add_subplot(grid[j, 0]), scene, j, f"{next(letters)} {short_name(name)}")
        spectrum_panel(
            figure.add_subplot(grid[j, 1]), scene, scene.control(j), f"{next(letters)} Spectrum of {short_name(name)}"
        )
    if with_states and problem.state_dim == 2:
        title = f"{next(letters)} {' and '.join(map(short_name, problem.state_names))}"
        phase_panel(figure.add_subplot(grid[controls, :]), scene, 0, 1, title)
    else:
        for column in range(2 * views):
            _draw_states(figure, grid, scene, column, controls, next(letters))
    for k, group in enumerate(groups):
        row, alone = controls + views + k // 2, k == len(groups) - 1 and not k % 2
        ax = figure.add_subplot(grid[row, :] if alone else grid[row, k % 2])
        states_panel(ax, scene, group, next(letters))
    legend_above(figure, legend, handlelength=2.6)
    mode_legend(scene).draw(figure)
    return figure


def _groups_of_states(scene: Scene) -> list[list[int]]:
    """Return the states that share a panel: few have one each, of many those of the same unit, some at a time."""
    problem = scene.problem
    if problem.state_dim <= MOST_PANELS or len(scene.traces) > 1:
        return [[i] for i in range(problem.state_dim)]
    of_unit: dict[str, list[int]] = {}
    for i, name in enumerate(problem.state_names):
        of_unit.setdefault(split_unit(name)[1], []).append(i)
    size = len(COMPONENTS)
    return [states[at : at + size] for states in of_unit.values() for at in range(0, len(states), size)]


def phase_pairs(n: int) -> list[tuple[int, int]]:
    """Return at most two pairs of states: i with i + n/2 (positions with their speeds) for even n, else neighbours."""
    half = n // 2
    pairs = [(i, i + half) for i in range(half)] if n % 2 == 0 else [(i, i + 1) for i in range(n - 1)]
    return pairs[:2]


def _draw_states(figure: Figure, grid: GridSpec, scene: Scene, column: int, row: int, letter: str) -> None:
    """Draw a phase portrait into a row; where there are not two, the first state in time."""
    names, pairs = scene.problem.state_names, phase_pairs(scene.problem.state_dim)
    if column < len(pairs):
        i, j = pairs[column]
        title = f"{letter} {short_name(names[i])} and {short_name(names[j])}"
        phase_panel(figure.add_subplot(grid[row, column]), scene, i, j, title)
    elif pairs:
        state_panel(figure.add_subplot(grid[row, column]), scene, 0, f"{letter} {short_name(names[0])}")
    elif column == 0:
        state_panel(figure.add_subplot(grid[row, :]), scene, 0, f"{letter} {short_name(names[0])}")


def states_figure(scene: Scene) -> Figure:
    """Return every state in time, within its bounds."""
    names = scene.problem.state_names
    figure, panels = _two_columns(len(names), STATE_ROW_HEIGHT, mode_legend(scene).height)
    for i, (name, ax) in enumerate(zip(names, panels, strict=True)):
        state_panel(ax, scene, i, short_name(name))
    _legend(figure, scene, with_ends=False, with_band=False)
    mode_legend(scene).draw(figure)
    return figure


def state_spectra_figure(scene: Scene) -> Figure:
    """Return the spectra of the states that have a stop band (there must be one)."""
    stopped = [int(i) for i in np.flatnonzero(scene.problem.state_band.any(0))]
    figure, panels = _two_columns(len(stopped), ROW_HEIGHT)
    for i, ax in zip(stopped, panels, strict=True):
        spectrum_panel(ax, scene, scene.state(i), f"Spectrum of {short_name(scene.problem.state_names[i])}")
    _legend(figure, scene, with_ends=False, with_band=True, with_bounds=False)
    return figure


def output_spectra_figure(scene: Scene) -> Figure:
    """Return the spectra of the outputs that have a frequency constraint (there must be one)."""
    outputs = scene.outputs()
    figure, panels = _two_columns(len(outputs), ROW_HEIGHT)
    for output, ax in zip(outputs, panels, strict=True):
        spectrum_panel(ax, scene, output, f"Spectrum of {short_name(output.name)}")
    _legend(figure, scene, with_ends=False, with_band=True, with_bounds=False)
    return figure


def gap_figure(scene: Scene, certificate: Certificate) -> Figure | None:
    """Return what each stage adds to the gap between cost and global bound; None without a bound."""
    gaps = certificate.stage_gaps
    if gaps is None or not np.isfinite(gaps).all():
        return None
    figure = new_figure(0.85 * ROW_HEIGHT)
    ax = figure.add_subplot()
    allowed = GAP_TOLERANCE * certificate.cost_scale
    floor = max(SMALLEST_SHOWN * max(float(gaps.max()), ROUNDING * allowed), float(gaps[gaps > 0].min(initial=allowed)))
    times, low = scene.time.factor * np.arange(len(gaps)), gaps < floor
    ax.plot(*thinned(times[~low], gaps[~low]), "o", color=CONSTRAINED, markersize=3.2, markeredgewidth=0)
    ax.plot(
        *thinned(times[low], np.full(int(low.sum()), floor)),
        "v",
        color=CONSTRAINED,
        markersize=4,
        markerfacecolor="none",
    )
    ax.axhline(allowed, color=MUTED, linewidth=1.1, linestyle=(0, (5, 2)))
    ax.set_yscale("log")
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_ylim(floor / 4, 60 * max(allowed, float(gaps.max())))
    ax.margins(x=0.015)
    ax.annotate(
        f"allowed for all stages together: {number(allowed, 2)}",
        (1, allowed),
        xycoords=("axes fraction", "data"),
        xytext=(-4, 3),
        textcoords="offset points",
        fontsize=LABEL_SIZE,
        color=MUTED,
        ha="right",
        va="bottom",
    )
    dress(ax, "Gap per stage", scene.time.label, "part of the gap [cost]")
    return figure


def price_figure(scene: Scene, multipliers: Multipliers) -> Figure:
    """Return |d J* / d bin| of every removed or bounded bin over its frequency (there must be one)."""
    problem, prices = scene.problem, bin_prices(scene.problem, multipliers)
    kinds = [
        (price, [component(int(i)) for i in np.flatnonzero(stop.any(0))], what, length)
        for price, component, stop, what, length in (
            (prices[0], scene.control, problem.control_band, "control", problem.horizon),
            (prices[1], scene.state, problem.state_band, "state", problem.horizon + 1),
        )
        if stop.any()
    ]
    figure = new_figure(0.85 * ROW_HEIGHT * len(kinds))
    for row, (price, components, what, length) in enumerate(kinds):
        ax = figure.add_subplot(len(kinds), 1, row + 1)
        frequency = scene.frequency.factor * 2 * np.pi * np.arange(len(price)) / length
        for i, one in enumerate(components):
            shade_stop_band(ax, one.stop, length, scene.frequency.factor)
            _draw_prices(ax, one, frequency, price[:, one.index], i)
        highest = float(price[:, [one.index for one in components]].max())
        ax.set_ylim(0, 1.08 * highest or 1.0)
        if len(components) > 1:
            ax.legend(fontsize=LABEL_SIZE, frameon=False, labelcolor=INK)
        units = {split_unit(one.name)[1] for one in components}
        unit = f" [cost per {units.pop()}]" if len(units) == 1 and "" not in units else " [cost per unit]"
        dress(ax, f"Price of each removed {what} bin", scene.frequency.label, f"|dJ* / d bin|{unit}")
        frequency_axis(ax, scene)
        _look_at(ax, frequency[np.any([one.stop for one in components], axis=0)])
    return figure


def _look_at(ax: Axes, frequency: np.ndarray) -> None:
    """Leave out what is far from all stopped bins."""
    margin = 0.12 * (frequency[-1] - frequency[0]) or 0.12 * frequency[0]
    low, high = ax.get_xlim()
    if margin > 0:
        ax.set_xlim(max(low, frequency[0] - margin), min(high, frequency[-1] + margin))


def _draw_prices(ax: Axes, component: Component, frequency: np.ndarray, price: np.ndarray, i: int) -> None:
    """Draw one stem per stopped bin."""
    color = COMPONENTS[i % len(COMPONENTS)]
    x, y = thinned(frequency[component.stop], price[component.stop])
    ax.vlines(x, 0, y, color=color, linewidth=1.0, alpha=0.7)
    ax.plot(
        x,
        y,
        marker=MARKERS[i % len(MARKERS)],
        linestyle="none",
        color=color,
        markersize=5,
        label=short_name(component.name),
    )


def _two_columns(count: int, height: float, below: float = 0.0) -> tuple[Figure, list[Axes]]:
    """Return a figure and so many panels in two columns; a single one takes both."""
    rows = ceil(count / 2)
    figure = new_figure(height * rows + LEGEND_HEIGHT + below)
    columns = min(count, 2)
    return figure, [figure.add_subplot(rows, columns, i + 1) for i in range(count)]


def _has_bounds(scene: Scene) -> bool:
    boxes = scene.problem.control_tube, scene.state_bounds
    return any(bool((np.abs(bound) < NO_BOUND).any()) for box in boxes for bound in (box.lower, box.upper))


def _legend(figure: Figure, scene: Scene, with_ends: bool, with_band: bool, with_bounds: bool = True) -> None:
    """Explain lines and markers above the panels."""
    legend_above(figure, _legend_handles(scene, with_ends, with_band, with_bounds), handlelength=2.6)


def _legend_handles(scene: Scene, with_ends: bool, with_band: bool, with_bounds: bool) -> list[Artist]:
    handles: list[Artist] = []
    for trace in scene.traces:
        style, label = trace.style, f"{trace.label} ({trace.detail})" if trace.detail else trace.label
        handles.append(
            Line2D([], [], color=style.color, linestyle=style.line, linewidth=style.width + 0.3, label=label)
        )
    components = scene.components()
    rows = [line for one in components for line in one.row_bounds] if with_bounds else []
    levels = [line for one in components for line in one.levels] if with_band else []
    if (with_bounds and _has_bounds(scene)) or any(not line.soft for line in [*rows, *levels]):
        handles.append(Line2D([], [], color=BOUND, linewidth=1.2, label="bound"))
    if any(line.soft for line in [*rows, *levels]):
        handles.append(Line2D([], [], color=BOUND, linewidth=1.2, linestyle=SOFT, label="soft bound"))
    if with_bounds and any(one.references for one in components):
        handles.append(Line2D([], [], color=REFERENCE, linewidth=1.2, linestyle=REFERENCE_LINE, label="reference"))
    if with_band:
        handles.append(Patch(facecolor=BAND, label="stopped or bounded bins" if levels else "stop band"))
    if with_ends:
        markers: Sequence[tuple[str, str, str]] = (("o", PAPER, "start"), ("s", INK, "end"))
        for marker, face, label in markers:
            handles.append(
                Line2D([], [], linestyle="none", marker=marker, color=INK, markerfacecolor=face, label=label)
            )
    return handles
