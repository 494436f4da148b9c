"""Figures draw the data of a comparison, and nothing else."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from scipy.signal import get_window

import lin_freq_ocp as lfo
from helpers.compared_pages import case, price_axes
from helpers.drawings import LAID_OUT
from helpers.seeds import expensive, seeds
from lin_freq_ocp import Box, LinearDynamics, OptimalControlProblem, QuadraticCost, compare, solve
from lin_freq_ocp.errors import SolveError
from lin_freq_ocp.pages import (
    MOST_DRAWN,
    STYLES,
    PlotData,
    comparison_data,
    comparison_figure,
    finding_of,
    gap_figure,
    parts_of_the_gap,
    phase_pairs,
    result_figure,
    states_figure,
    thin_out,
    view,
)
from lin_freq_ocp.problem import padded_spectrum, problem_facts


def test_every_control_has_its_panels():
    figure = comparison_figure(case("two controls"))
    assert len(figure.axes) == 6
    assert figure.axes[2].get_ylabel() == "pull \\$b\\$"
    assert figure.axes[0].get_xlabel() == "step t"
    assert figure.axes[1].get_xlabel() == "frequency [rad/sample]"
    assert "no stop band here" in [one.get_text() for one in figure.axes[3].texts]


def test_panels_draw_the_data():
    comparison = case("pendulum")
    trajectory = comparison.constrained.trajectory
    assert trajectory is not None
    figure = comparison_figure(comparison)
    blue = STYLES["constrained"].color
    control, spectrum, portrait, _ = figure.axes
    (drawn,) = (line for line in control.lines if line.get_color() == blue)
    np.testing.assert_array_equal(drawn.get_ydata()[:-1], trajectory.u[:, 0])
    np.testing.assert_allclose(drawn.get_xdata(), 0.01 * np.arange(241))
    lines = {line.get_marker(): line for line in spectrum.lines if line.get_color() == blue}
    magnitude, floor = np.abs(np.fft.rfft(trajectory.u[:, 0])), lines["v"].get_ydata()[0]
    np.testing.assert_allclose(lines["o"].get_ydata(), magnitude[magnitude >= floor])
    np.testing.assert_allclose(lines["v"].get_xdata(), np.flatnonzero(magnitude < floor) / 2.4)
    assert set(range(97, 121)) <= set(np.round(2.4 * lines["v"].get_xdata()).astype(int))
    between = padded_spectrum(trajectory.u)[1][:, 0]
    inside = (lines["None"].get_xdata() > 97 / 2.4) & (lines["None"].get_xdata() < 50)
    assert comparison.constrained_measures is not None
    peak = lines["None"].get_ydata()[inside].max()
    assert peak == pytest.approx(comparison.constrained_measures.stopband_peak)
    assert lines["None"].get_ydata().max() == between.max()
    curve = next(line for line in portrait.lines if line.get_color() == blue)
    np.testing.assert_array_equal(curve.get_xydata(), trajectory.x[:, [0, 2]])


def test_a_limit_with_a_window_is_drawn_with_the_windowed_spectrum():
    """Without the window, a spectrum that satisfies its mask is drawn far above it."""

    def drawn(*spectrum: object) -> tuple[np.ndarray, Axes, list[Line2D]]:
        """Return the control, the panel of its spectrum, and the limits in the panel."""
        dynamics = LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], control_names="force [N]")
        problem = OptimalControlProblem(
            dynamics, 40, QuadraticCost(R=1.0), initial_state=[0, 0], terminal_state=[1, 0], control_spectrum=spectrum
        )
        result = solve(problem)
        axes = result_figure(result).axes[1]
        return result.control[:, 0], axes, [line for line in axes.lines if line.get_linewidth() == 1.6]  # limits

    band, weights = lfo.low_pass(1.0), get_window("hann", 40, fftbins=False)
    hann = lfo.MagnitudeBound(amplitude=0.02, band=band, window="hann")
    control, axes, (limit,) = drawn(hann)
    assert axes.get_ylabel() == "amplitude of windowed force [N]"
    assert limit.get_ydata() == pytest.approx(0.02)
    (bins,) = (line for line in axes.lines if line.get_marker() == "o")
    inner = bins.get_xdata() > 0
    at = np.rint(bins.get_xdata()[inner] * 40 / (2 * np.pi)).astype(int)
    values = np.abs(np.fft.rfft(weights * control)) / (weights.sum() / 2)
    assert bins.get_ydata()[inner][at < 20] == pytest.approx(values[at[at < 20]])
    # Limits of different windows cannot share a picture, and zero bins are zero without a window.
    assert not drawn(hann, lfo.low_pass(2.0))[2]
    assert len(drawn(hann, lfo.MagnitudeBound(amplitude=0.5, band=band))[2]) == 1


def test_a_trajectory_that_flies_off_does_not_squeeze_the_others():
    comparison = case("pendulum")
    trajectory = comparison.constrained.trajectory
    assert trajectory is not None
    _, _, position, angle = comparison_figure(comparison).axes
    low, high = angle.get_xlim()
    assert np.ptp(trajectory.x[:, 1]) > 0.8 * (high - low)
    assert any("leaves the picture; ends 16.7 rad and 74.7 rad/s away" in one.get_text() for one in angle.texts)
    assert any("ends 0.813 m" in one.get_text() for one in position.texts)


def test_view_keeps_trajectories_and_near_overlays():
    main, far, near = np.array([0.0, 1.0]), np.array([0.0, 9.0]), np.array([-0.4, 0.0])
    bounds = np.array([-np.inf, 1.5, 40.0])
    seen = view([main], [far], bounds)
    assert seen.outside
    assert seen.low < 0
    assert 1.5 < seen.high < 2
    seen = view([main], [near], bounds)
    assert not seen.outside
    assert seen.low < -0.4
    constant = view([np.array([3.0, 3.0])], [], np.array([]))
    assert constant.low < 3 < constant.high


def test_without_a_brick_wall_the_first_filter_is_shown():
    comparison = case("pendulum")
    alone = replace(comparison, filtered=comparison.filtered[3:4])
    trace = comparison_data(alone).traces[1]
    assert (trace.label, trace.detail) == ("filtered", "moving average")
    assert trace.trajectory is comparison.filtered[3].replay.trajectory
    nothing = replace(comparison, filtered=())
    assert finding_of(nothing).filtering == ""
    assert [trace.label for trace in comparison_data(nothing).traces] == ["classical", "constrained"]


@expensive
def test_result_figure_shows_one_solution():
    result = case("state band").constrained
    figure = result.plot()
    assert len(figure.axes) == 6  # control, spectrum, phase portrait, two states, spectrum of the speed
    assert result_figure(replace(result, status="limit")).legends[0].get_texts()[0].get_text() == "best point"
    with pytest.raises(SolveError, match="without a trajectory"):
        result_figure(case("infeasible").constrained)


@pytest.mark.parametrize(("n", "panels"), seeds([(1, 3), (2, 5), (3, 7), (4, 8), (5, 9), (9, 6)]))
def test_any_number_of_states_can_be_drawn(n: int, panels: int):
    problem = OptimalControlProblem(
        LinearDynamics(0.9 * np.eye(n) + 0.1 * np.eye(n, k=1), np.ones((n, 1))),
        horizon=6,
        cost=QuadraticCost(Q=1.0, R=1.0),
        state_set=[Box(-2 - 0.1 * t, 2) for t in range(7)],
        initial_state=np.ones(n),
    )
    result = solve(problem)
    figure = result_figure(result)
    assert len(figure.axes) == panels
    assert len(phase_pairs(n)) == {1: 0, 2: 1}.get(n, 2)
    assert len(states_figure(comparison_data(compare(problem))).axes) == n
    assert (
        "state: x_0",
        "bounds that depend on time: lower -2.6 to -2, upper 2; starts at 1; ends anywhere",
    ) in problem_facts(problem)


def test_positions_are_paired_with_their_speeds():
    assert phase_pairs(4) == [(0, 2), (1, 3)]
    assert phase_pairs(8) == [(0, 4), (1, 5)]
    assert phase_pairs(3) == [(0, 1), (1, 2)]
    assert phase_pairs(1) == []


def test_states_of_several_plants_are_paired_within_a_plant():
    assert phase_pairs(4, plants=2) == [(0, 1), (2, 3)]
    assert phase_pairs(12, plants=3) == [(0, 2), (1, 3)]
    assert phase_pairs(6, plants=2) == [(0, 1), (1, 2)]
    assert phase_pairs(3, plants=3) == []
    plant = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]], state_names="position [m], speed [m/s]")
    end = Box([0, -1], [0.02, 1])
    problem = OptimalControlProblem(plant, 6, QuadraticCost(R=1.0), initial_state=[0, 0], terminal_state=end)
    plants = lfo.Plants([plant, replace(plant, B=1.001 * plant.B)])
    figure = result_figure(solve(lfo.robust(problem, plants)))
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert [title[4:] for title in titles if " and " in title] == [
        f"position of plant {k} and speed of plant {k}" for k in (1, 2)
    ]


def test_prices_and_gaps_are_the_multipliers_and_stage_gaps():
    comparison = case("pendulum")
    result = comparison.constrained
    assert result.multipliers is not None
    assert result.certificate is not None
    (ax,) = price_axes(comparison)
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), np.abs(result.multipliers.rho_u[97:, 0]))
    np.testing.assert_allclose(ax.lines[0].get_xdata(), np.arange(97, 121) / 2.4)
    figure = gap_figure(comparison_data(comparison), result.certificate)
    assert figure is not None
    gaps = result.certificate.stage_gaps
    assert gaps is not None
    points, lower_edge = figure.axes[0].lines[:2]
    np.testing.assert_array_equal(points.get_ydata(), gaps[gaps > 1e-6 * gaps.max()])
    assert len(lower_edge.get_ydata()) == len(gaps) - len(points.get_ydata())
    unbounded = replace(result.certificate, bound=None)
    assert gap_figure(comparison_data(comparison), unbounded) is None
    assert parts_of_the_gap(unbounded) == ""


@expensive
def test_the_layout_keeps_labels_apart_and_inside(monkeypatch):
    """The other tests draw without the layout."""
    monkeypatch.setattr(ConstrainedLayoutEngine, "execute", LAID_OUT)
    figure = comparison_figure(case("two controls"))
    figure.draw_without_rendering()
    panels = [ax.get_tightbbox() for ax in figure.axes]
    for i, panel in enumerate(panels):
        assert figure.bbox.x0 <= panel.x0 < panel.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= panel.y0 < panel.y1 <= figure.bbox.y1
        assert not any(panel.overlaps(other) for other in panels[:i])


def test_long_signals_keep_their_extremes():
    t = np.arange(50_000.0)
    y = np.sin(t / 7) + (t == 31_234) * 5
    x, thin = thin_out(t, y)
    assert len(thin) <= MOST_DRAWN + 2
    assert thin.max() == y.max()
    assert x[thin.argmax()] == 31_234
    assert (x[0], x[-1]) == (0, 49_999)
    assert np.all(np.diff(x) > 0)
    same = thin_out(t[:10], y[:10])
    assert same[1] is not None
    np.testing.assert_array_equal(same[0], t[:10])


def test_plotting_libraries_are_imported_late():
    code = "import sys, lin_freq_ocp; print({'matplotlib', 'jinja2', 'lin_freq_ocp.pages.report'} & set(sys.modules))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "set()"


def car(**of_problem: object) -> OptimalControlProblem:
    dynamics = LinearDynamics.from_continuous(
        np.eye(4, k=2), np.eye(4, 2, k=-2), sampling_time=0.1, state_names=["x [m]", "y [m]", "v_x [m/s]", "v_y [m/s]"]
    )
    given = {"horizon": 20, "cost": QuadraticCost(R=1.0), "control_set": Box(-8, 8)}
    ends = {"initial_state": [-1, 0.1, 0, 0], "terminal_state": [1, 0, 0, 0]}
    return OptimalControlProblem(dynamics, **(given | ends | of_problem))


@expensive
def test_obstacles_are_shaded_in_the_plane_of_their_two_states():
    disc = lfo.sets.PathConstraint(["0.25 - x_0**2 - x_1**2", "x_1 - 3"], name="post")
    figure = result_figure(solve(car(stage_rows=disc)))
    plane = next(ax for ax in figure.axes if ax.get_title(loc="left").endswith("x and y"))
    shaded = plane.collections[0].get_paths()
    assert any(path.contains_point((0, 0)) for path in shaded)
    assert any(path.contains_point((0.45, 0)) for path in shaded)
    assert not any(path.contains_point((x, 0.1)) for path in shaded for x in (-1, -0.6, 0.6, 1))
    assert plane.get_aspect() == 1.0
    (low, high), (bottom, top) = plane.get_xlim(), plane.get_ylim()
    assert high - low == pytest.approx(2 * (top - bottom))
    assert "excluded: post" in [text.get_text() for text in figure.legends[0].get_texts()]


@expensive
def test_a_path_constraint_is_drawn_over_time_with_its_limits():
    speed = lfo.sets.PathConstraint("x_2**2 + x_3**2", name="speed squared", upper=1.5)
    result = solve(car(stage_rows=speed))
    panel = next(ax for ax in result_figure(result).axes if "speed squared" in ax.get_title(loc="left"))
    (limit, values) = panel.lines
    assert set(limit.get_ydata()) == {1.5}
    np.testing.assert_allclose(values.get_ydata()[:-1], (result.trajectory.x[:-1, 2:] ** 2).sum(axis=1))


def test_only_obstacles_of_two_states_that_stand_still_are_shaded():
    moving = lfo.sets.PathConstraint("0.04 - (x_0 - 0.1*t)**2 - x_1**2", name="moving")
    later = lfo.sets.PathConstraint(
        "0.04 - x_0**2 - x_1**2", name="later", upper=np.repeat([[np.inf], [0.0]], 10, axis=0)
    )
    of_control = lfo.sets.PathConstraint("x_0*u_0 - 9", name="power")
    of_three = lfo.sets.PathConstraint("x_0*x_1*x_2 - 9", name="of three")
    still = lfo.sets.PathConstraint("0.04 - x_1**2 - x_2**2", name="still", upper=np.zeros((20, 1)))
    problem = car(stage_rows=[moving, later, of_control, of_three, still])
    assert [(obstacle.pair, obstacle.constraint.name) for obstacle in PlotData(problem, ()).obstacles] == [
        ((1, 2), "still")
    ]
    assert phase_pairs(4, PlotData(problem, ()).obstacles) == [(1, 2), (0, 2)]
