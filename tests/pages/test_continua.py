"""Figures of held spectra and residual vibrations: what is drawn, and below which limit."""

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.pages import (
    comparison_data,
    draw_figures,
    held_panels,
    joint_rows,
    panels_figure,
    render_page,
    result_data,
    vibration_panels,
)
from lin_freq_ocp.problem import VibrationLimit
from lin_freq_ocp.transform import semi_infinite_terms

FREE = lfo.library.double_integrator(horizon=60, sampling_time=0.04, cutoff_hz=None, speed_bound=None)
HELD = lfo.MagnitudeBound([[3, 1.0], [20, 0.5]], band=lfo.low_pass(cutoff_hz=3.0), every_frequency=True, hold=True)
CALM = lfo.ResidualVibration(frequency=(0.9, 1.1), damping=(0.0, 0.1), limit=0.02)


@pytest.fixture(scope="module")
def held():
    return lfo.compare(replace(FREE, control_spectrum=HELD), [])


def lines(ax):
    return {line.get_label(): line for line in ax.get_lines()}


@expensive
def test_a_held_spectrum_is_drawn_beyond_nyquist_below_its_limit(held):
    (ax,) = panels_figure(held_panels(comparison_data(held))).axes
    drawn = lines(ax)
    assert {"classical", "constrained", "limit", "Nyquist"} <= set(drawn)
    f, values = drawn["constrained"].get_data()
    assert f[-1] > 44
    u = held.constrained.control[:, 0]
    expected = np.abs(np.sinc(0.04 * f) * (np.exp(-2j * np.pi * 0.04 * np.outer(f, np.arange(60))) @ u))
    np.testing.assert_allclose(values, expected, rtol=1e-6, atol=1e-9)
    bounded = f >= 3.0
    assert (values <= np.interp(f, [3, 20], [1.0, 0.5]) * (1 + 1e-6))[bounded].all()
    assert drawn["Nyquist"].get_xdata()[0] == pytest.approx(12.5)
    assert drawn["limit"].get_ydata()[0] == pytest.approx(1.0)


@expensive
def test_the_page_shows_it_and_says_that_filters_do_not_apply(held):
    drawings = tuple(draw_figures(held))
    (drawing,) = (one for one in drawings if one.name == "held_spectra")
    assert 'aria-label="Spectra after the zero-order hold, with their limits"' in drawing.inline
    page = render_page(held, drawings)
    assert "is not about bins" in page
    assert "held_spectra-" in page


@expensive
def test_a_box_without_shapers_is_drawn_all_the_same():
    longer = replace(FREE, horizon=80, control_set=[FREE.control_set] * 80)
    comparison = lfo.compare(replace(longer, control_spectrum=CALM), [])
    assert comparison.moves is None
    data = comparison_data(comparison)
    assert panels_figure(held_panels(data)) is None
    (ax,) = panels_figure(vibration_panels(data)).axes
    f, values = lines(ax)["constrained"].get_data()
    assert values[(f >= 0.9) & (f <= 1.1)].max() <= 0.02 * (1 + 1e-6)
    (limit,) = (one for one in ax.collections if one.get_label() == "limit")
    assert limit.get_segments()[0] == pytest.approx(np.array([[0.9, 0.02], [1.1, 0.02]]))
    drawings = tuple(draw_figures(comparison))
    assert "vibration" in {one.name for one in drawings}
    assert "Residual vibration over the natural frequency" in render_page(comparison, drawings)


@expensive
@pytest.mark.parametrize(("constraint", "words"), [(CALM, "; its limit is not about bins"), (None, "")])
def test_the_panel_of_the_spectrum_says_that_there_is_no_band(constraint, words):
    longer = replace(FREE, horizon=80, control_spectrum=constraint)
    ax = lfo.solve(longer).plot().axes[1]
    assert f"no stop band here{words}" in [one.get_text() for one in ax.texts]


def test_without_any_nothing_is_drawn():
    data = comparison_data(lfo.compare(FREE, []))
    assert panels_figure(held_panels(data)) is None
    assert panels_figure(vibration_panels(data)) is None


@expensive
def test_the_figure_of_a_result_has_a_panel_for_everything_that_constrains():
    problem = lfo.rate_limited(lfo.library.printer_move(horizon=30, sampling_time=0.01), 4.0)
    result = lfo.solve(problem)
    figure = result.plot()
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert titles[-2:] == ["(h) rate limit", "(i) Residual vibration of acceleration"]
    rates, vibration = figure.axes[-2:]
    drawn = {tuple(np.unique(line.get_ydata())): line for line in rates.lines}
    assert (4.0,) in drawn
    assert (-4.0,) in drawn
    change = np.diff(result.trajectory.u[:, 0])
    (shown,) = (line.get_ydata() for line in rates.lines if len(np.unique(line.get_ydata())) > 1)
    np.testing.assert_allclose(shown[1:-1], change, atol=1e-9)
    assert "acceleration - acceleration before" in [text.get_text() for text in rates.texts]
    ((_, box),) = semi_infinite_terms(problem, VibrationLimit)
    assert {line.get_label() for line in vibration.lines} == {"optimal"}
    low, high = box.low[0], box.high[0]
    (line,) = vibration.lines
    inside = (line.get_xdata() >= low) & (line.get_xdata() <= high)
    assert line.get_ydata()[inside].max() <= box.limit * (1 + 1e-6)


def test_levels_are_drawn_and_joint_rows_with_one_side_have_one_bound():
    dynamics = lfo.LinearDynamics([[0.5, 0.0], [0.0, 0.5]], [[1.0], [0.0]])
    rows = lfo.StageRows([[1.0, 1.0], [1.0, 0.0]], [[2.0], [0.0]], [3.0, 9.0], name="sum [N]")
    problem = lfo.OptimalControlProblem(
        dynamics, 4, lfo.QuadraticCost(R=1.0), control_set=lfo.FiniteSet([-1, 0, 1]), stage_rows=rows
    )
    (row,) = joint_rows(problem)
    assert row.words == "2 u_0 + x_0 + x_1"
    assert (row.upper[0], row.lower[0]) == (3.0, -np.inf)
    data = result_data(lfo.solve(replace(problem, initial_state=[1.0, 0.0])))
    np.testing.assert_array_equal(data.control_levels(data.controls[0]), [-1.0, 0.0, 1.0])
    assert not len(data.control_levels(data.states[0]))
    assert np.isfinite(row.margin(data.main.trajectory))
