"""What users meet every day: pictures in notebooks and scripts, objects in notebooks, times and data frames."""

from __future__ import annotations

import sys
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.image import imread

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.base import number


@pytest.fixture(scope="module")
def result() -> lfo.results.Result:
    dynamics = lfo.LinearDynamics(
        [[1, 0.1], [0, 1]],
        [[0.005], [0.1]],
        sampling_time=0.1,
        state_names=["<b>x</b> [m]", "V & co"],
        control_names=["I [A]"],
    )
    problem = lfo.OptimalControlProblem(
        dynamics, 12, lfo.QuadraticCost(R=1), initial_state=[0, 0], terminal_state=[1, 0], name="<script>alert</script>"
    )
    return lfo.solve(problem)


def test_times_are_seconds_with_a_sampling_time_and_steps_without(result):
    assert result.times == pytest.approx(np.linspace(0, 1.2, 13))
    assert result.problem.times.shape == (result.problem.horizon + 1,)
    without = lfo.OptimalControlProblem(lfo.LinearDynamics([[1]], [[1]]), 3, lfo.QuadraticCost(R=1))
    assert without.times.tolist() == [0, 1, 2, 3]


def test_a_frame_has_the_trajectory_under_its_names(result):
    frame = result.to_frame()
    assert list(frame.columns) == ["<b>x</b> [m]", "V & co", "I [A]"]
    assert frame.index.name == "time [s]"
    assert frame.index.to_numpy() == pytest.approx(result.times)
    assert frame["V & co"].to_numpy().tolist() == result.trajectory.x[:, 1].tolist()
    assert frame["I [A]"].to_numpy()[:-1].tolist() == result.control[:, 0].tolist()
    assert np.isnan(frame["I [A]"].to_numpy()[-1])


def test_without_pandas_a_frame_says_what_to_install(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(
        lfo.errors.MissingExtraError, match=r"'lin-freq-ocp\[pandas\]', or in a clone: pip install -e '\.\[pandas\]'"
    ):
        result.to_frame()


def test_notebooks_show_objects_as_escaped_tables(result):
    comparison, sweep = (
        lfo.compare(result.problem, filters=[]),
        lfo.sweep(result.problem, {"horizon": [result.problem.horizon]}),
    )
    shortest = lfo.minimum_time(lfo.library.double_integrator(cutoff_hz=None), horizons=(181, 182))
    arrays = (result.trajectory, result.sensitivities)
    many = lfo.solve_many(result.problem, [[0, 0], [1, 0]])
    loop = lfo.RecedingHorizon(result.problem).run([0, 0], steps=2)
    conflict = lfo.results.Explanation(("bound on <b>I</b>",), True, ())
    others = (many, loop, conflict, result.problem.dynamics)
    for one in (result, result.certificate, result.problem, comparison, sweep, shortest, *arrays, *others):
        html = one._repr_html_()
        assert html.startswith("<table>")
        assert html.endswith("</table>")
        assert "<script" not in html
        assert "<b>" not in html
        assert "://" not in html
        assert len(html) < 8000
        assert not any(word in html for word in ("color", "background", "<style", "src="))  # as the page has them
    assert "&lt;script&gt;" in result.problem._repr_html_()
    assert f"{result.cost:.12g}" in result._repr_html_()
    assert "½ u&#x27; R u" in result.problem._repr_html_()
    assert "182 is feasible; 181 is proven infeasible" in shortest._repr_html_()
    assert str(result.trajectory.x.shape) in result.trajectory._repr_html_()
    assert "offset" in result.sensitivities._repr_html_()
    assert ">2 optimal<" in many._repr_html_()
    assert ">2 optimal<" in loop._repr_html_()
    assert "bound on &lt;b&gt;I" in conflict._repr_html_()
    assert "A x + B u, 2 states, 1 control" in result.problem.dynamics._repr_html_()
    many = lfo.OptimalControlProblem(lfo.LinearDynamics(np.eye(90), np.eye(90)), 3, lfo.QuadraticCost(R=1))
    assert many._repr_html_().count("<tr>") < 30


def test_printed_objects_are_short_and_show_what_they_hold():
    result = lfo.solve(lfo.library.double_integrator())
    assert repr(result.trajectory).startswith("Trajectory(x (201, 2) from ")
    assert "control_bins (101, 1) magnitudes from 0 to " in repr(result.sensitivities)
    grid = {"horizon": [10, 200], "cutoff_hz": [None, 5.0]}
    first, *points = str(lfo.sweep(lfo.library.double_integrator, grid)).splitlines()
    assert first == "double_integrator: 4 of 4 points"
    assert points[0].startswith("horizon = 10, cutoff_hz = none   infeasible")
    assert points[3].startswith("horizon = 200, cutoff_hz = 5     optimal, cost 6.38576, gap ")
    shortest = lfo.minimum_time(lfo.library.double_integrator(cutoff_hz=None), horizons=(181, 182))
    assert repr(shortest).startswith("MinimumTime(horizon=182, horizons=(181, 182), proof='182 is feasible; 181 is")


def test_a_batch_prints_how_many_are_optimal_the_largest_gap_and_the_time():
    many = lfo.solve_many(lfo.library.double_integrator(horizon=200), [[0, 0], [0.1, 0], [50, 0], "no state"])
    title, *lines = str(many).splitlines()
    facts = dict(line.split(maxsplit=1) for line in lines)
    assert title == f"{many.problem}: 4 problems"
    assert (facts["status"], facts["proven"]) == ("2 optimal, 1 infeasible, 1 error", "3 of 4")
    worst = int(np.nanargmax(many.gaps))
    assert facts["gap"] == f"at most {number(many.gaps[worst], 2)}, of solutions[{worst}]"
    assert facts["time"] == f"{sum(item.seconds or 0 for item in many.items):.3g} s for all solves"
    assert repr(many) == "Solutions(2 optimal, 1 infeasible, 1 error)"


def test_a_loop_prints_how_its_steps_ended_and_why_it_stopped():
    step = lfo.RecedingHorizon(lfo.library.double_integrator(cutoff_hz=None)).run([0, 0], steps=2).steps[0]
    later = replace(step, status=None, gap=np.nan, solve_seconds=0.5, certify_seconds=0.25)
    steps = [replace(step, gap=1e-9, solve_seconds=0.001, certify_seconds=0.002), later, step]
    loop = lfo.results.ClosedLoop(lfo.library.double_integrator(), steps, stopped="no plan")
    facts = dict(line.split(maxsplit=1) for line in str(loop).splitlines()[1:])
    assert facts["status"] == "2 optimal, 1 not judged"
    assert facts["gap"] == "at most 1.0e-9, at step 0"
    assert facts["stopped"] == "no plan"
    assert facts["time"].endswith("ms a step, at most 7.5e+02 ms")


def test_a_long_sweep_prints_its_first_points_and_counts_the_others():
    row = {"parameters": {"horizon": 1}, "status": "error", "proven": False, "cost": None, "gap": None, "message": "no"}
    sweep = lfo.results.Sweep("toy", {"horizon": tuple(range(30))}, (row,) * 30, {})
    lines = str(sweep).splitlines()
    assert lines[1] == "horizon = 1  error, not proven, no"
    assert (len(lines), lines[-1]) == (26, "... 6 more")


@expensive
def test_a_notebook_shows_a_figure_without_pyplot(result):
    figure = result.plot()
    image = imread(BytesIO(figure._repr_png_()))
    assert image.shape[1] > 600
    assert image.std() > 0.01
    assert figure.canvas.manager is None
    assert not pyplot.get_fignums()


@expensive
def test_a_script_saves_and_shows_a_figure(result, tmp_path: Path, monkeypatch):
    figure = result.plot()
    figure.savefig(tmp_path / "picture.png")
    assert imread(tmp_path / "picture.png").std() > 0.01
    pyplot.switch_backend("agg")
    with pytest.warns(UserWarning, match="no windows"):
        figure.show()
    assert not pyplot.get_fignums()
    monkeypatch.setattr(pyplot, "get_backend", lambda: "a backend with windows")
    shown = list[int]()
    monkeypatch.setattr(pyplot, "show", lambda: shown.extend(pyplot.get_fignums()))
    figure.show()
    assert len(shown) == 1
    assert pyplot.figure(shown[0]) is figure
    pyplot.close("all")


def test_states_are_drawn_over_time(result):
    drawn = [line.get_xydata() for ax in result.plot().axes for line in ax.lines]
    for i in range(2):
        wanted = np.column_stack([result.times, result.trajectory.x[:, i]])
        assert any(line.shape == wanted.shape and np.allclose(line, wanted) for line in drawn)
