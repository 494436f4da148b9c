"""A loop over modes: each step begins with the tree of the step before, and ends as it would alone."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.compilers import needs_kernel
from helpers.seeds import expensive
from lin_freq_ocp.loop import free_first_state
from lin_freq_ocp.methods.hybrid import TreeSearch


def wall(horizon=10):
    return lfo.library.pendulum_with_wall(horizon=horizon, initial_state=(0.09, 0.3))


def states(steps, jumps):
    """Return measured states of a disturbed loop: at a jump the pendulum is thrown to the other side of the border."""
    rng = np.random.default_rng(0)
    controller, x, step = lfo.RecedingHorizon(wall()), np.array([0.09, 0.3]), wall().dynamics.stepper(1)
    found = []
    for k in range(steps):
        x = np.array([0.12, 0.1]) if k in jumps and x[0] < 0.1 else np.array([0.05, 0.6]) if k in jumps else x
        found.append(x)
        x = step(0, x, controller.step(x)) + 0.004 * rng.standard_normal(2)
    return found, controller.log


@expensive
@pytest.mark.parametrize("jumps", [(), (2, 4)], ids=["disturbed", "into another mode"])
def test_steps_cost_what_their_problems_cost_alone(jumps):
    measured, log = states(6, jumps)
    free = free_first_state(wall())
    alone = [lfo.solve(free.with_ends(x)) for x in measured]
    np.testing.assert_allclose(log.costs, [one.cost for one in alone], rtol=2e-6)
    assert set(log.statuses) == {"optimal"}
    assert (log.gaps <= 1e-6).all()


@expensive
@needs_kernel
def test_later_steps_solve_fewer_relaxations_than_from_the_plan_alone(monkeypatch):
    problem = lfo.library.buck_affine(horizon=6)
    x = problem.initial_box.lower
    with_tree = lfo.RecedingHorizon(problem).run(x, 4)
    monkeypatch.setattr(TreeSearch, "cover_after_step", lambda search: ())
    without = lfo.RecedingHorizon(problem).run(x, 4)
    np.testing.assert_allclose(with_tree.costs, without.costs, rtol=2e-6)
    assert with_tree.nodes[0] == without.nodes[0] > 1
    assert with_tree.nodes[1:].sum() < without.nodes[1:].sum()


@expensive
def test_a_reference_that_changes_keeps_the_splits_alone():
    problem, x = wall(6), np.array([0.09, 0.3])
    controller = lfo.RecedingHorizon(problem)
    for k in range(3):
        references = {"x_ref": np.full((7, 2), 0.01 * k)}
        controller.step(x, references=references)
        alone = lfo.solve(free_first_state(problem).with_references(references).with_ends(x))
        assert controller.log.costs[-1] == pytest.approx(alone.cost, rel=2e-6)
        assert controller.log.statuses[-1] == "optimal"


@expensive
def test_without_modes_no_relaxations_are_counted():
    assert lfo.RecedingHorizon(lfo.library.double_integrator()).run([0.0, 0.0], 2).nodes.tolist() == [0, 0]


def test_the_level_of_a_loop_falls_with_its_state():
    """From 1 down to 1e-16: programs of the first costs saw no motion, and every seventh step searched twice."""
    modes = [lfo.AffineMode([[a]], [[1.0]], G=[[sign]], h=[0.0]) for a, sign in ((0.9, -1.0), (1.3, 1.0))]
    dynamics, bounds = lfo.PiecewiseAffineDynamics(modes), (lfo.Box(-1, 1), lfo.Box(-10, 10))
    problem = lfo.OptimalControlProblem(dynamics, 5, lfo.QuadraticCost(Q=1.0, R=1.0), *bounds)
    run = lfo.RecedingHorizon(problem).run([1.0], 36)
    assert abs(run.final_state[0]) < 1e-15
    assert set(run.statuses) == {"optimal"}
    assert run.nodes.max() <= 4
    assert run.nodes.mean() < 3.5
