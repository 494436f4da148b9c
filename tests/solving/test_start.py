"""solve(start=): a search begins with a trajectory, controls or modes, ends no worse, and nobody ignores it.

A block with dry friction, T = 30: to slide all the way and to stick at the end is the obvious order; the search alone
does not find it within a few nodes. Costs of mode sequences are those of ``with_modes``, which are convex programs.
"""

import itertools
import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.seeds import expensive, seeds
from lin_freq_ocp import cli
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.transform.hybrid import piecewise_smooth

HORIZON, STEP = 30, 0.1
SLIDE, STICK = 0, 1
OBVIOUS = np.repeat([SLIDE, STICK], [20, 10])
NODES = 4

SPEED = f"x_1 + {STEP}*u_0"
FRICTION = [f"x_0 + {STEP}*x_1", f"max({SPEED} - {STEP}, min(0, {SPEED} + {STEP}))"]


def block(smooth=False, horizon=HORIZON):
    """Return a block that a force moves by 1 m against Coulomb's friction of 1 N, from rest to rest."""
    if smooth:
        dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(FRICTION, 2, 1, STEP)
    else:
        x, u = lfo.signals(2, 1)
        pushed = x[1] + STEP * u[0]
        speed = lfo.maximum(pushed - STEP, lfo.minimum(0, pushed + STEP, names=["stick", "left"]), names=["right", ""])
        dynamics = lfo.PiecewiseAffineDynamics.from_formulas([x[0] + STEP * x[1], speed], 2, 1, STEP)
    return lfo.OptimalControlProblem(
        dynamics,
        horizon,
        lfo.QuadraticCost(R=0.1),
        control_set=lfo.Box(-3, 3),
        state_set=lfo.Box([-5, -5], [5, 5]),
        initial_state=[0.0, 0.0],
        terminal_state=[1.0, 0.0],
        name="block",
    )


@pytest.fixture(scope="module")
def obvious():
    """The best trajectory of the obvious order."""
    return lfo.solve(block().with_modes(OBVIOUS))


def forms(result):
    return {"modes": OBVIOUS, "list": OBVIOUS.tolist(), "controls": result.trajectory.u, "result": result} | {
        "trajectory": result.trajectory
    }


@pytest.mark.parametrize("form", seeds(["modes", "list", "controls", "trajectory", "result"]))
def test_branch_and_bound_begins_with_the_best_trajectory_of_the_modes_of_its_start(obvious, form):
    result = lfo.solve(block(), node_limit=NODES, start=forms(obvious)[form], throw=False)
    assert result.status == "limit"
    assert result.certificate.feasible
    assert result.cost <= obvious.cost * (1 + 1e-6)


def test_without_a_start_as_many_nodes_find_less(obvious):
    alone = lfo.solve(block(), node_limit=NODES, throw=False)
    assert alone.cost is None or alone.cost > 1.05 * obvious.cost


@expensive
def test_a_search_in_parts_begins_with_the_start(obvious):
    with ThreadPoolExecutor(1) as executor:
        limits = {"node_limit": 1, "executor": executor, "throw": False}
        assert lfo.solve(block(), start=OBVIOUS, **limits).cost <= obvious.cost * (1 + 1e-6)


@expensive
def test_a_start_changes_no_optimum():
    cost = lfo.QuadraticCost(R=0.1, Q=1.0)
    problem = replace(block(horizon=6), cost=cost, initial_state=[0.3, 0.5], terminal_state=None)
    best = lfo.solve(problem, method="enumerate").cost
    for start in (np.full(6, STICK), np.zeros((6, 1)), np.zeros(6, dtype=int)):
        assert lfo.solve(problem, start=start).cost == pytest.approx(best, rel=1e-6)


@expensive
@pytest.mark.parametrize("looks", [1, 40])
def test_the_local_search_ends_no_worse_than_its_start(obvious, looks):
    """The modes of the formulas have an order of their own; the trajectory is the same."""
    problem = block(smooth=True)
    with use_clock(Clock(1.0)):
        result = lfo.solve(problem, "nonsmooth", time_limit=float(looks), start=obvious.trajectory, throw=False)
    assert result.certificate.feasible
    assert result.cost <= obvious.cost * (1 + 1e-5)


@expensive
def test_the_local_search_takes_controls_and_modes_first(obvious):
    problem, tried = block(smooth=True), []
    modes = piecewise_smooth(problem).sequence_of(obvious.trajectory.x, obvious.trajectory.u)
    for start in (obvious.trajectory.u, modes):
        limits = {"time_limit": 30.0, "throw": False, "progress": tried.append}
        with use_clock(Clock(1.0)):
            result = lfo.solve(problem, method="nonsmooth", start=start, **limits)
        assert result.cost <= obvious.cost * (1 + 1e-5)
    assert np.isfinite(tried[0].cost)  # as early as that, there is a trajectory


LINEAR = lfo.OptimalControlProblem(
    lfo.LinearDynamics([[1.0]], [[1.0]]), 3, lfo.QuadraticCost(R=1.0), initial_state=[1.0]
)


@pytest.mark.parametrize(
    ("problem", "method"),
    [(LINEAR, method) for method in ("auto", "convex", "spectral")]
    + [(block(horizon=3), method) for method in ("enumerate", "miqp")],
)
def test_methods_without_a_search_refuse_a_start(problem, method):
    with pytest.raises(lfo.errors.UnsupportedError, match="start: got one"):
        lfo.solve(problem, method=method, start=np.zeros((3, 1)))


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ([0, 1], "shape"),
        ([0, 1, 7], "mode numbers from 0 to 2"),
        ([0, 1, -1], "mode numbers from 0 to 2"),
        ([0.0, 1.0, 2.0], "Mode numbers are integers"),
        (np.zeros((2, 1)), "shape"),
        (np.zeros((3, 2)), "shape"),
        (np.zeros((3, 1, 1)), "shape"),
        ([[np.nan], [0.0], [0.0]], "start"),
        ([[1], [2, 3]], "controls of shape"),
        ([["a"], ["b"], ["c"]], "controls of shape"),
        ("somewhere", "a Trajectory"),
        (3, "a Trajectory"),
        (lfo.Trajectory(np.zeros((3, 2)), np.zeros((2, 1))), "x .*, u"),
        ({"x": np.zeros((4, 2))}, "table of x"),
        ({"x": np.zeros((4, 2)), "u": [["a"]] * 3}, "start: trajectory.u"),
    ],
)
@pytest.mark.parametrize("smooth", [False, True])
def test_bad_starts_are_refused_by_name(start, words, smooth):
    with pytest.raises(lfo.errors.ProblemError, match=words) as caught:
        lfo.solve(block(smooth, 3), start=start)
    assert caught.value.field.startswith("start")


def test_controls_that_cannot_be_simulated_are_refused():
    modes = [lfo.AffineMode([[2.0]], [[1.0]], None, [[sign], [-sign]], None, [0.0, 9.0]) for sign in (1.0, -1.0)]
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes),
        6,
        lfo.QuadraticCost(R=1.0),
        control_set=lfo.Box(-1, 1),
        state_set=lfo.Box(-9, 9),
        initial_state=[1.0],
    )
    with pytest.raises(lfo.errors.ProblemError, match="start: got controls that cannot be simulated"):
        lfo.solve(problem, start=np.ones((6, 1)))
    with pytest.raises(lfo.errors.ProblemError, match="start: initial_state"):
        lfo.solve(replace(problem, initial_state=None), start=np.ones((6, 1)))


@expensive
def test_a_dumped_run_begins_where_it_began(obvious, tmp_path):
    for start, place in itertools.product((OBVIOUS, obvious.trajectory), (tmp_path / "run.zip",)):
        result = lfo.solve(block(), node_limit=2, start=start, throw=False)
        result.dump(place)
        again = lfo.load_run(place).solve()
        assert again.cost == result.cost <= obvious.cost * (1 + 1e-6)


@expensive
def test_the_command_line_takes_a_start_from_a_file(obvious, tmp_path, capsys):
    problem, trajectory = tmp_path / "block.toml", tmp_path / "obvious.csv"
    lfo.write_problem(block(), problem)
    obvious.to_csv(trajectory)
    with pytest.raises(SystemExit) as ended:
        cli.main(["solve", str(problem), "--node-limit", "2", "--start", str(trajectory), "--json"])
    assert ended.value.code == 3
    cost = json.loads(capsys.readouterr().out)["cost"]
    assert cost <= obvious.cost * (1 + 1e-6)
    with pytest.raises(SystemExit) as ended:
        cli.main(["solve", str(problem), "--start", str(tmp_path / "nothing.npz")])
    assert ended.value.code == 2
    assert "nothing.npz" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        cli.main(["solve", str(problem), "--method", "enumerate", "--start", str(trajectory)])
    assert ended.value.code == 2
    assert "start: got one" in capsys.readouterr().err
