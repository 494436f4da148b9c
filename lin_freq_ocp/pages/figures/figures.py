"""Figures of a result and of a comparison; they need no display and change no global setting."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from string import ascii_lowercase

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import NullFormatter

from lin_freq_ocp.base.arrays import NO_BOUND, Array
from lin_freq_ocp.base.errors import SolveError
from lin_freq_ocp.base.phrases import number, short_name, split_unit
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.comparison.compare import ComparisonOutcome
from lin_freq_ocp.comparison.filters import has_frequency_constraint
from lin_freq_ocp.comparison.trajectories import (
    CLASSICAL,
    CONSTRAINED,
    MeasuredTrajectory,
    ProblemSignal,
    measured_solution,
    solution_label,
)
from lin_freq_ocp.pages.figures import look
from lin_freq_ocp.pages.figures.continua import PANEL_HEIGHT, Panel, held_panels, vibration_panels
from lin_freq_ocp.pages.figures.modes import mode_legend
from lin_freq_ocp.pages.figures.panels import (
    frequency_axis,
    phase_panel,
    rows_panel,
    shade_stop_band,
    spectrum_panel,
    states_panel,
    time_panel,
)
from lin_freq_ocp.pages.figures.plot_data import Obstacle, PlotData, Trace
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.uncertainty.disturbance import Disturbance
from lin_freq_ocp.uncertainty.plants import Plants
from lin_freq_ocp.uncertainty.protocol import RobustProblem

LEGEND_HEIGHT = 0.5  # inches for the legend above the panels
STATE_ROW_HEIGHT = 0.78 * look.ROW_HEIGHT

MOST_PANELS = 6  # more states than this share panels by unit
SMALLEST_SHOWN = 1e-6  # stage gaps below this fraction of the largest are rounding; drawn at the lower edge
ROUNDING = 1e-12  # the largest stage gap is at least this fraction of the allowed gap


def result_figure(result: Outcome) -> Figure:
    """Return the figure of a solution, with panels of everything that it constrains."""
    return four_panels(result_data(result), alone=True)


def comparison_figure(comparison: ComparisonOutcome) -> Figure:
    """Return the four panels of the paper's Figure 3: controls, their spectra, two phase portraits."""
    return four_panels(comparison_data(comparison))


def result_data(result: Outcome) -> PlotData:
    """Return the solution as plot data; SolveError if it has no trajectory."""
    given = problem = result.problem
    if isinstance(problem, RobustProblem) and problem.state_dim == problem.given.state_dim:
        given = problem.given
    shown = measured_solution(solution_label(result), given, result)
    if shown is None:
        raise SolveError(f"The solve ended without a trajectory to show ({result.status}).", result)
    plan = Trace(shown.label, shown, look.STYLES[CONSTRAINED])
    if given is problem or not isinstance(problem, RobustProblem):
        return PlotData(problem, (plan,))
    uncertainty, worst_of = problem.uncertainty, "worst plant"
    data = PlotData(given, (plan,))
    if isinstance(uncertainty, Disturbance):
        worst_of, data = "worst load", replace(data, tightened=problem)
        data = replace(data, largest=uncertainty.largest_spectra(given, shown.trajectory))
    worst = uncertainty.worst(given, shown.trajectory, None).closest
    if worst is None or worst.trajectory is None:
        return data
    under = MeasuredTrajectory(worst_of, given, worst.trajectory)
    return replace(data, traces=(Trace(worst_of, under, look.STYLES["filtered"], f"for {worst.name}"), plan))


def comparison_data(comparison: ComparisonOutcome) -> PlotData:
    """Return the classical, the filtered and the constrained trajectory, those that exist, as plot data."""
    filtered, solution, traces = comparison.shown_filter, comparison.constrained_solution, list[Trace]()
    if solution is None or has_frequency_constraint(comparison.problem):
        traces.append(Trace(CLASSICAL, comparison.classical_solution, look.STYLES[CLASSICAL]))
    if filtered is not None:
        traces.append(Trace("filtered", filtered.replay, look.STYLES["filtered"], filtered.replay.label, overlay=True))
    if solution is not None:
        traces.append(Trace(solution.label, solution, look.STYLES[CONSTRAINED]))
    return PlotData(comparison.problem, tuple(traces))


def four_panels(data: PlotData, alone: bool = False) -> Figure:
    """Return each control over time next to its spectrum, and two views of the states below.

    A solution that is shown alone also has panels of all states, the spectra of states and outputs with a limit, joint
    rows such as rates, residual vibrations, and spectra after a zero-order hold.
    """
    problem, states = data.problem, data.states
    limited = [*(state for state in states if state.stop.any()), *data.outputs] if alone else []
    letters = (f"({''.join(pair)})" for size in (1, 2) for pair in product(ascii_lowercase, repeat=size))
    rows = list[tuple[float, list[Panel]]]()  # height and panels of each row

    def add_panels(height: float, panels: Sequence[Callable[..., None]], columns: int = 2) -> None:
        for start in range(0, len(panels), columns):
            row = panels[start : start + columns]
            rows.append((height, [partial(panel, letter=next(letters)) for panel in row]))

    for control in data.controls:
        panels = [partial(panel, data=data, component=control) for panel in (time_panel, spectrum_panel)]
        add_panels(look.ROW_HEIGHT, panels)
    # Two phase portraits, those with obstacles first; without two pairs, the first state over time, unless all follow
    plants = len(problem.uncertainty.plants) if isinstance(problem.uncertainty, Plants) else 1
    pairs = [[states[i] for i in pair] for pair in phase_pairs(problem.state_dim, data.obstacles, plants)]
    views: list[Callable[..., None]] = [partial(phase_panel, data=data, pair=pair) for pair in pairs]
    views += [] if alone or len(views) == 2 else [partial(time_panel, data=data, component=states[0])]
    add_panels(look.ROW_HEIGHT, views)
    if alone:
        add_panels(
            STATE_ROW_HEIGHT, [partial(states_panel, data=data, states=group) for group in _groups_of_states(data)]
        )
        add_panels(STATE_ROW_HEIGHT, [partial(rows_panel, data=data, row=row) for row in data.joint_rows])
        add_panels(look.ROW_HEIGHT, [partial(spectrum_panel, data=data, component=signal) for signal in limited])
        add_panels(PANEL_HEIGHT, [*vibration_panels(data), *held_panels(data)], columns=1)
    with_band = bool(problem.control_band.any() or limited)
    legend = _legend_handles(data, problem.state_dim > 1, with_band, with_bounds=True)
    height = sum(height for height, _ in rows)
    figure = look.new_figure(height + LEGEND_HEIGHT * look.legend_rows(legend) + mode_legend(data).height)
    grid = figure.add_gridspec(len(rows), 2, height_ratios=[height for height, _ in rows])
    for i, (_, panels) in enumerate(rows):
        for j, panel in enumerate(panels):
            panel(figure.add_subplot(grid[i, j] if len(panels) == 2 else grid[i, :]))
    look.legend_above(figure, legend, handlelength=2.6)
    mode_legend(data).draw(figure)
    return figure


def _groups_of_states(data: PlotData) -> list[list[ProblemSignal]]:
    """Return the states of each panel: one each if they are few, otherwise some with the same unit."""
    if len(data.states) <= MOST_PANELS or len(data.traces) > 1:
        return [[state] for state in data.states]
    of_unit: dict[str, list[ProblemSignal]] = {}
    for state in data.states:
        of_unit.setdefault(split_unit(state.name)[1], []).append(state)
    size = len(look.COMPONENTS)
    return [states[at : at + size] for states in of_unit.values() for at in range(0, len(states), size)]


def phase_pairs(n: int, obstacles: Sequence[Obstacle] = (), plants: int = 1) -> list[tuple[int, int]]:
    """Return at most two pairs of states, first those of obstacles; the states may be those of several plants.

    For an even number n of a plant, i and i + n/2 follow (positions with speeds); otherwise neighbours.
    """
    own, half = n // plants, n // plants // 2
    pairs = [(i, i + half) for i in range(half)] if own % 2 == 0 else [(i, i + 1) for i in range(own - 1)]
    of_plants = [(first + i, first + j) for first in range(0, n, own) for i, j in pairs]
    return list(dict.fromkeys([*(obstacle.pair for obstacle in obstacles), *of_plants]))[:2]


def states_figure(data: PlotData) -> Figure:
    """Return every state over time with its bounds."""
    height = LEGEND_HEIGHT + mode_legend(data).height
    figure, panels = look.panel_grid(len(data.states), STATE_ROW_HEIGHT, height, columns=2)
    for state, ax in zip(data.states, panels, strict=True):
        time_panel(ax, data, state)
    look.legend_above(figure, _legend_handles(data, with_bounds=True), handlelength=2.6)
    mode_legend(data).draw(figure)
    return figure


def spectra_figure(data: PlotData, signals: Sequence[ProblemSignal]) -> Figure:
    """Return the spectra of one or more states or outputs."""
    figure, panels = look.panel_grid(len(signals), look.ROW_HEIGHT, LEGEND_HEIGHT, columns=2)
    for signal, ax in zip(signals, panels, strict=True):
        spectrum_panel(ax, data, signal)
    look.legend_above(figure, _legend_handles(data, with_band=True), handlelength=2.6)
    return figure


def gap_figure(data: PlotData, certificate: Certificate) -> Figure | None:
    """Return the contribution of each stage to the gap between cost and global bound; None without a bound."""
    gaps = certificate.stage_gaps
    if gaps is None or not np.isfinite(gaps).all():
        return None
    figure = look.new_figure(0.85 * look.ROW_HEIGHT)
    ax = figure.add_subplot()
    allowed = certificate.allowed_gap
    floor = max(SMALLEST_SHOWN * max(float(gaps.max()), ROUNDING * allowed), float(gaps[gaps > 0].min(initial=allowed)))
    times, low = data.time.factor * np.arange(len(gaps)), gaps < floor
    color, at_floor = look.STYLES[CONSTRAINED].color, np.full(int(low.sum()), floor)
    ax.plot(*look.thin_out(times[~low], gaps[~low]), "o", color=color, markersize=3.2, markeredgewidth=0)
    ax.plot(*look.thin_out(times[low], at_floor), "v", color=color, markersize=4, markerfacecolor="none")
    ax.axhline(allowed, color=look.MUTED, linewidth=1.1, linestyle=(0, (5, 2)))
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
        fontsize=look.LABEL_SIZE,
        color=look.MUTED,
        ha="right",
        va="bottom",
    )
    look.style_axes(ax, "Gap per stage", data.time.label, "part of the gap [cost]")
    return figure


def price_figure(data: PlotData, prices: tuple[Array, Array]) -> Figure:
    """Return |d J* / d bin| of one or more removed or bounded bins over their frequency."""
    kinds = [
        (price, [signal for signal in signals if signal.stop.any()], signal_kind, length)
        for price, signals, signal_kind, length in (
            (prices[0], data.controls, "control", data.problem.horizon),
            (prices[1], data.states, "state", data.problem.state_samples),
        )
    ]
    kinds = [kind for kind in kinds if kind[1]]
    figure, panels = look.panel_grid(len(kinds), 0.85 * look.ROW_HEIGHT)
    for ax, (price, components, signal_kind, length) in zip(panels, kinds, strict=True):
        frequency = data.frequency.factor * 2 * np.pi * np.arange(len(price)) / length
        for i, component in enumerate(components):
            stop = component.stop
            shade_stop_band(ax, stop, length, data.frequency.factor)
            x, y = look.thin_out(frequency[stop], price[stop, component.index])  # one stem per stopped bin
            color, marker = look.COMPONENTS[i % len(look.COMPONENTS)], look.MARKERS[i % len(look.MARKERS)]
            ax.vlines(x, 0, y, color=color, linewidth=1.0, alpha=0.7)
            ax.plot(x, y, label=short_name(component.name), marker=marker, linestyle="none", color=color, markersize=5)
        highest = float(price[:, [component.index for component in components]].max())
        ax.set_ylim(0, 1.08 * highest or 1.0)
        if len(components) > 1:
            ax.legend(fontsize=look.LABEL_SIZE, frameon=False, labelcolor=look.INK)
        units = {split_unit(component.name)[1] for component in components}
        unit = f" [cost per {units.pop()}]" if len(units) == 1 and "" not in units else " [cost per unit]"
        look.style_axes(ax, f"Price of each removed {signal_kind} bin", data.frequency.label, f"|dJ* / d bin|{unit}")
        frequency_axis(ax, data)
        stopped = frequency[np.any([component.stop for component in components], axis=0)]
        margin = 0.12 * (stopped[-1] - stopped[0]) or 0.12 * stopped[0]
        low, high = ax.get_xlim()
        if margin > 0:  # frequencies far from all stopped bins are not shown
            ax.set_xlim(max(low, stopped[0] - margin), min(high, stopped[-1] + margin))
    return figure


def _legend_handles(
    data: PlotData, with_ends: bool = False, with_band: bool = False, with_bounds: bool = False
) -> list[Artist]:
    handles, entry = list[Artist](), look.legend_line
    for trace in data.traces:
        style, label = trace.style, f"{trace.label} ({trace.detail})" if trace.detail else trace.label
        handles.append(entry(label, color=style.color, linestyle=style.line, linewidth=style.width + 0.3))
    signals = [*data.controls, *data.states, *data.outputs]
    rows = [line for signal in signals for line in signal.row_bounds] if with_bounds else []
    levels = [line for signal in signals for line in signal.levels] if with_band else []
    boxes = [bound for signal in signals for bound in signal.bounds] if with_bounds else []
    if any((np.abs(bound) < NO_BOUND).any() for bound in boxes) or any(not line.soft for line in [*rows, *levels]):
        handles.append(entry("bound", color=look.BOUND))
    if with_bounds and data.tightened is not None:
        handles.append(Patch(facecolor=look.BAND, label="margin for loads"))
    if data.largest is not None:
        handles.append(entry("largest bin for all loads", color=look.MUTED, linestyle=look.REFERENCE_LINE))
    if any(line.soft for line in [*rows, *levels]):
        handles.append(entry("soft bound", color=look.BOUND, linestyle=look.SOFT))
    if with_bounds and any(len(data.control_levels(signal)) for signal in data.controls):
        handles.append(entry("level", color=look.BOUND, linestyle=look.LEVEL_LINE, linewidth=0.9))
    if with_bounds and any(signal.references for signal in signals):
        handles.append(entry("reference", color=look.REFERENCE, linestyle=look.REFERENCE_LINE))
    if with_band:
        handles.append(Patch(facecolor=look.BAND, label="stopped or bounded bins" if levels else "stop band"))
    if names := {one.constraint.name: None for one in data.obstacles if with_bounds}:
        handles.append(Patch(facecolor=look.GRID, edgecolor=look.BOUND, label=f"excluded: {', '.join(names)}"))
    if with_ends:
        handles.append(entry("start", linestyle="none", marker="o", color=look.INK, markerfacecolor=look.PAPER))
        handles.append(entry("end", linestyle="none", marker="s", color=look.INK, markerfacecolor=look.INK))
    return handles
