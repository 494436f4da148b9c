"""Loops of robust problems: every step has a plan, whatever the loads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks import robust_loops
from helpers.generated import CompiledController, write_log
from helpers.seeds import expensive, seeds
from helpers.tubes import A, B, tube
from lin_freq_ocp.methods import compiler

W = 0.15
LOAD = lfo.Disturbance(lfo.Box(-W, W))
DRAWS = {
    "random corners": lambda rng, k, x: rng.choice([-W, W], 2),
    "the same corner for 20 steps": lambda rng, k, x: np.full(2, W if k // 20 % 2 else -W),
    "away from the middle": lambda rng, k, x: W * np.sign(x + 1e-9),
}


@expensive
@pytest.mark.parametrize("seed", seeds(range(12)))
def test_a_loop_near_the_largest_loads_that_it_bears_has_a_plan_at_every_step(seed):
    """A sample of scripts/verify.py, whose loops have 1000 steps."""
    found = robust_loops.check(seed, steps=60)
    assert found.passed, found


@expensive
@pytest.mark.parametrize("seed", seeds(range(8)))
def test_a_loop_under_three_times_the_loads_is_seen_to_fail(seed):
    """Of all kinds of loads but those that stay in the middle of the set."""
    found = robust_loops.check(seed, steps=60, share=3.0)
    assert not found.passed
    assert found.planned < found.steps or found.excess > 0.01


@expensive
@pytest.mark.parametrize("name", DRAWS)
def test_every_step_to_an_invariant_end_has_a_plan_whatever_the_loads(name):
    plan = lfo.robust(tube(initial_state=None), LOAD, end="invariant")
    assert plan.stage_rows[-1].rows == 8
    controller = lfo.RecedingHorizon(plan, certify="later")
    x, rng, over = np.array([-7.0, -2.0]), np.random.default_rng(0), []
    for k in range(300):
        u = controller.step(x)
        x = A @ x + B @ u + DRAWS[name](rng, k, x)
        over.append(max((x - 2).max(), ([-10, -2] - x).max(), abs(u[0]) - 1))
    assert max(over) < 1e-9
    assert set(controller.log.sources) == {"plan"}


@expensive
@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_an_invariant_end_does_not_depend_on_units(unit):
    plain, S = tube(initial_state=None), np.diag([unit, 1.0])
    moved = replace(
        plain,
        dynamics=lfo.LinearDynamics(S @ A @ np.linalg.inv(S), S @ B),
        cost=lfo.QuadraticCost(Q=np.linalg.inv(S @ S), R=0.1, P=3 * np.linalg.inv(S @ S)),
        state_set=lfo.Box(S @ [-10, -2], S @ [2, 2]),
    )
    K = LOAD.feedback(plain)
    loads = lfo.Disturbance(lfo.Box(-W, W), gain=K), lfo.Disturbance(lfo.Box(-W, W), S, gain=K @ np.linalg.inv(S))
    one, two = (lfo.robust(*case, end="invariant").stage_rows[-1] for case in zip((plain, moved), loads, strict=True))
    assert one.rows == two.rows == 8
    scaled = [rows.C @ unit / rows.e[-1][:, None] for rows, unit in ((one, np.eye(2)), (two, S))]
    np.testing.assert_allclose(*(np.sort(part, axis=0) for part in scaled), rtol=1e-6, atol=1e-9)


@expensive
@pytest.mark.parametrize("extreme", [True, False])
def test_loads_at_which_the_controller_of_the_example_leaves_its_limits(extreme):
    """HiroIshida/robust-tube-mpc, issue 19: loads of 0.2."""
    controller = lfo.RecedingHorizon(
        lfo.robust(tube(initial_state=None), lfo.Disturbance(lfo.Box(-0.2, 0.2)), end="invariant"), certify="later"
    )
    x, rng = np.array([-5.0, -2.0]), np.random.default_rng(1)
    for _ in range(300):
        u = controller.step(x)
        x = A @ x + B @ u + 0.2 * (np.sign(x + 1e-9) if extreme else rng.choice([-1.0, 1.0], 2))
        assert max((x - 2).max(), ([-10, -2] - x).max(), abs(u[0]) - 1) < 1e-9
    assert set(controller.log.sources) == {"plan"}


@pytest.mark.parametrize("seed", seeds(range(20)))
def test_each_step_of_a_shrinking_horizon_has_a_plan_and_the_end_is_reached(seed):
    """An end that is a set, and the same gain at each step; no invariant set is needed."""
    T, rng = 12, np.random.default_rng(seed)
    problem = tube(T, initial_state=[-5.0, -1.0], terminal_state=lfo.Box([-1.5, -1], [1.5, 1]))
    load = lfo.Disturbance(lfo.Box(-0.1, 0.1), gain=lfo.Disturbance(lfo.Box(-0.1, 0.1)).feedback(problem))
    x, over = np.array([-5.0, -1.0]), []
    for k in range(T):
        u = lfo.solve(lfo.robust(replace(problem, horizon=T - k, initial_state=x), load)).trajectory.u[0]
        x = A @ x + B @ u + (rng.choice([-0.1, 0.1], 2) if seed else np.array([0.1, 0.1]))
        over.append(max(abs(u[0]) - 1, (x - 2).max(), ([-10, -2] - x).max()))
    assert max(over) < 1e-7
    assert (np.abs(x) <= np.array([1.5, 1.0]) + 1e-7).all()


@expensive
def test_the_published_double_integrator_stays_below_half_a_metre():
    """LinearMPC.jl, "Robust MPC": 0.1 s, 25 steps, loads of 0.005 in both states; without margins it reaches 0.56 m."""
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=1.0, P=np.diag([1.0, 0.0]), x_ref=[0.5, 0.0])
    plant = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]], sampling_time=0.1)
    problem = lfo.OptimalControlProblem(plant, 25, cost, lfo.Box(-0.2, 0.2), lfo.Box([-0.5, None], [0.5, None]))
    tight = lfo.robust(problem, lfo.Disturbance(lfo.Box(-0.005, 0.005)))

    def largest(given, draw):
        controller = lfo.RecedingHorizon(given, certify="later", soft={"state_set": 1e4})
        x, reached = np.zeros(2), []
        for _ in range(80):
            x = plant.A @ x + plant.B @ controller.step(x) + draw()
            reached.append(x[0])
        return max(reached)

    rng = np.random.default_rng(0)
    assert 0.499 < largest(tight, lambda: 0.005) < 0.5 + 1e-9
    assert largest(problem, lambda: 0.005) == pytest.approx(0.5608, abs=1e-4)
    assert largest(tight, lambda: rng.uniform(-0.005, 0.005, 2)) < 0.46


def test_a_delay_of_the_loop_is_refused_for_a_robust_problem():
    plan = lfo.robust(tube(initial_state=None), LOAD)
    with pytest.raises(lfo.errors.UnsupportedError, match=r"delay: got 1.*State the delay as a state"):
        lfo.RecedingHorizon(plan, delay=1)


@expensive
@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_generated_c_of_a_robust_problem_equals_python_and_its_log_certifies(tmp_path):
    given = lfo.RecedingHorizon(lfo.robust(tube(initial_state=None), LOAD, end="invariant"), certify="later")
    lfo.generate(given, tmp_path, "double")
    step, x, rng = CompiledController(tmp_path, "double", 2, 1, 10), np.array([-7.0, -2.0]), np.random.default_rng(5)
    states, controls, statuses = [], [], []
    for _ in range(25):
        status, u = step.step(x)
        if len(states) < 5:
            assert u == pytest.approx(given.step(x), abs=1e-9)
        states.append(x)
        controls.append(u.copy())
        statuses.append(status)
        x = A @ x + B @ u + rng.choice([-W, W], 2)
        assert max((x - 2).max(), ([-10, -2] - x).max(), abs(u[0]) - 1) < 1e-9
    log = write_log(tmp_path / "log.csv", np.array(states), np.array(controls), statuses)
    certified = lfo.certify_log(given, log)
    assert certified.proven.all()
    assert certified.differences.max() < 1e-9
