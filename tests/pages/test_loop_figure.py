"""The figure and the page of a loop: references, windows over frequency and time, raised levels, drawn states."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from matplotlib.colors import to_hex

import lin_freq_ocp as lfo
from helpers.compilers import needs_kernel
from helpers.seeds import expensive
from lin_freq_ocp.methods import compiler

STEP, LENGTH = 0.05, 16
REFERENCE, WINDOWS = "#8250df", "#009e73"  # of lines


@cache
def loop(delay: int = 1) -> lfo.results.ClosedLoop:
    """Return a loop with a rate limit, a limit in a band, a previewed reference, and controls that others applied."""
    plant = lfo.LinearDynamics(
        [[1.0, STEP], [0.0, 0.98]], [[0.0], [0.4]], sampling_time=STEP, state_names=["angle [rad]", "speed"]
    )
    limit = lfo.spectrum.closed_loop(
        lfo.spectrum.notch(centre_hz=4, width_hz=3), 0.05, STEP, LENGTH, 3, past=np.zeros(LENGTH - 1)
    )
    cost = lfo.QuadraticCost(Q=np.diag([5.0, 0.0]), R=0.02, P=np.diag([100.0, 0.0]))
    problem = lfo.OptimalControlProblem(
        plant, 10, cost, lfo.Box(-1, 1), initial_state=[0.0, 0.0], control_spectrum=limit, name="drive"
    )
    controller = lfo.RecedingHorizon(lfo.rate_limited(problem, 0.8, previous=0.0), certify="later", delay=delay)
    for k in range(50):
        reference = np.zeros((11, 2))
        reference[:, 0] = 0.1 * (k + delay + np.arange(11))
        applied = [(-1.0) ** (k // 3)] if 20 < k <= 24 else None
        controller.step(np.zeros(2), references={"x_ref": reference}, applied=applied)
    return controller.log


def panels() -> dict[str, object]:
    """Return the panels of the figure by their titles."""
    return {ax.get_title(loc="left"): ax for ax in loop().plot().axes}


def lines(ax, color: str) -> list:
    return [line for line in ax.lines if to_hex(line.get_color()) == color]


@expensive
def test_states_that_follow_from_the_controls_are_not_drawn():
    shown = panels()
    assert {"torque", "u_0", "angle", "speed"} & set(shown) == {"u_0", "angle", "speed"}
    assert not [title for title in shown if "before" in title]
    assert loop().states.shape[1] == 3


@expensive
@needs_kernel
@pytest.mark.parametrize("delay", [0, 1])
def test_the_reference_stands_where_the_plan_begins(delay):
    (ax,) = (ax for ax in loop(delay).plot().axes if ax.get_title(loc="left") == "angle")
    (line,) = lines(ax, REFERENCE)
    np.testing.assert_allclose(line.get_xdata(), STEP * (np.arange(50) + delay))
    np.testing.assert_allclose(line.get_ydata(), 0.1 * (np.arange(50) + delay))
    assert not lines(panels()["speed"], REFERENCE)  # it costs nothing


@expensive
@pytest.mark.skipif(compiler() is None, reason="no C compiler: programs raise no level")
def test_windows_are_drawn_over_time_with_the_steps_whose_level_was_raised(tmp_path):
    ax, log = panels()["Applied windows of u_0 over time"], loop()
    (found,) = log.spectra()
    (line,) = lines(ax, WINDOWS)
    np.testing.assert_allclose(line.get_xdata(), STEP * (found.begins + LENGTH - 1))
    np.testing.assert_allclose(line.get_ydata(), found.ratios.max(axis=1))
    (crosses,) = (line for line in ax.lines if line.get_marker() == "x")
    assert len(crosses.get_xdata()) == found.exceeded.any(axis=1).sum() > 0
    raised = np.flatnonzero([step.raised for step in log.steps])
    assert 5 < len(raised) < 40
    shaded = [path.vertices[:, 0] for path in ax.collections[0].get_paths()]
    assert min(x.min() for x in shaded) == pytest.approx(STEP * raised[0])
    assert max(x.max() for x in shaded) == pytest.approx(STEP * raised[-1])
    assert f"is raised, at {len(raised)} steps" in " ".join(text.get_text() for text in ax.texts)
    page = log.save(tmp_path).read_text()
    assert "steps whose level was raised" in page
    assert f"<dd>{len(raised)} <small>by what the past exceeds</small></dd>" in page


def test_a_signal_with_a_limit_has_two_panels():
    titles = [title for title in panels() if title.startswith("Applied windows")]
    assert titles == ["Applied windows of u_0", "Applied windows of u_0 over time"]
