"""Motions far smaller than the bounds have the verdicts of motions of their size: searches below a known cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.certificate.hybrid import level_boxes, tree_bound
from lin_freq_ocp.program.hybrid import PathRelaxation

SMALL = (1e-7, 1e-9, 1e-11, 1e-13)


def problem_at(start: float, **further: object) -> lfo.OptimalControlProblem:
    """A cart that brakes more while it goes back, which starts this far from its reference; bounds are of order 1."""
    A, B = np.array([[1.0, 1.0], [0.0, 1.0]]), [[0.5], [1.0]]
    modes = [lfo.AffineMode(A + np.diag([0, c]), B, [0, 0], [[0, s]], h=[0]) for c, s in ((-0.1, 1), (0.1, -1))]
    given = {
        "dynamics": lfo.PiecewiseAffineDynamics(modes),
        "cost": lfo.QuadraticCost(Q=np.diag([0.5, 0.1]), R=0.2, P=1.0),
        "control_set": lfo.Box(-1, 1),
        "state_set": lfo.Box(-5, 5),
        "initial_state": [start, 0.0],
    }
    return lfo.OptimalControlProblem(horizon=6, **given | further)


@expensive
@pytest.mark.parametrize("start", SMALL)
@pytest.mark.parametrize("method", ["auto", "miqp"])
def test_a_small_motion_is_proven_optimal(start, method):
    result, of_order_one = lfo.solve(problem_at(start), method), lfo.solve(problem_at(0.1))
    assert result.status == "optimal"
    assert result.cost / start**2 == pytest.approx(of_order_one.cost / 0.1**2, rel=2e-6)
    assert result.trajectory.u / start == pytest.approx(of_order_one.trajectory.u / 0.1, abs=1e-3)
    assert lfo.certify(result.problem, result).globally_optimal


@expensive
@pytest.mark.at_tolerance("a search ends when its gap suffices")
@pytest.mark.parametrize("start", SMALL)
def test_a_small_motion_to_rest_is_proven_where_rest_is_not_feasible(start):
    result = lfo.solve(problem_at(start, terminal_state=[0.0, 0.0]))
    of_order_one = lfo.solve(problem_at(0.1, terminal_state=[0.0, 0.0]))
    assert result.status == "optimal"
    assert result.cost / start**2 == pytest.approx(of_order_one.cost / 0.1**2, rel=2e-6)


@expensive
def test_bounds_that_are_far_add_no_nodes():
    trees = [lfo.solve(problem_at(start)).tree for start in (0.1, 1e-3, 1e-5, *SMALL)]
    assert {len(tree.nodes) for tree in trees} == {1}
    assert all(tree.level < np.inf for tree in trees)


@expensive
def test_a_loop_that_comes_to_rest_keeps_its_relaxations_and_is_proven(monkeypatch):
    reused, moved = [], PathRelaxation.moved
    monkeypatch.setattr(PathRelaxation, "moved", lambda one, problem: reused.append(problem) or moved(one, problem))
    controller, step, x = lfo.RecedingHorizon(problem_at(1.0)), problem_at(1.0).dynamics.stepper(1), np.array([1e-6, 0])
    for k in range(12):
        x = step(0, x, controller.step(x)) if k != 10 else np.array([0.7, 0.2])
    assert set(controller.log.statuses) == {"optimal"}
    assert len(reused) >= 9  # the first step has none to reuse


@expensive
@pytest.mark.parametrize("start", [1e-10, 1e-12, 1e-14])
def test_rounding_of_the_coordinates_decides_far_from_zero(start):
    reference = lfo.QuadraticCost(Q=np.diag([0.5, 0.1]), R=0.2, P=1.0, x_ref=[0.6, 0.0])
    result = lfo.solve(problem_at(0.6 + start, cost=reference))
    of_order_one = lfo.solve(problem_at(0.1))
    lost = np.spacing(0.6) / start  # digits of the distance
    assert result.status == "optimal"
    assert result.cost / start**2 == pytest.approx(of_order_one.cost / 0.1**2, rel=2e-6 + 20 * lost)


def test_trajectories_outside_the_box_of_a_level_cost_more():
    Q, S, rng = np.array([[0.5, 0.3], [0.3, 0.4]]), np.array([[0.1], [-0.05]]), np.random.default_rng(3)
    cost = lfo.QuadraticCost(Q=Q, R=0.2, S=S, P=np.diag([1.0, 0.0]), x_ref=[0.6, 0.1], u_ref=0.2)
    problem, level = problem_at(0.5, cost=cost), 1e-3
    boxes = level_boxes(problem, level)
    for _ in range(300):
        x, u = np.tile([0.6, 0.1], (7, 1)), np.full((6, 1), 0.2)
        box, signal = [(boxes[0], x), (boxes[1], u)][rng.integers(2)]
        t, j = rng.integers(len(signal)), rng.integers(signal.shape[1])
        signal[t] += 0.02 * rng.standard_normal(signal.shape[1])  # other components may make it cheaper
        u[min(t, 5)] += 0.02 * rng.standard_normal()
        side = rng.choice([box.lower[t, j], box.upper[t, j]])
        signal[t, j] += 1.0001 * (side - signal[t, j])
        if (t, j) != (6, 1):  # without a cost, it has its own bounds
            assert problem.value(x, u) >= level
    assert boxes[0].upper[6, 1] == 5.0


def test_a_tree_below_a_level_proves_no_more_than_the_level():
    problem = problem_at(1e-7)
    result = lfo.solve(problem)
    tree, half = result.tree, result.cost / 2
    assert tree.level > result.cost
    assert tree_bound(problem, tree).value == pytest.approx(result.cost, rel=1e-6)
    assert tree_bound(problem, replace(tree, level=half)).value <= half
    assert level_boxes(replace(problem, cost=lfo.QuadraticCost(Q=0.5, R=0.2, q=[0.1, 0.0])), half) is None


STATED = {
    "a fixed control": {"control_set": [lfo.Box(0.1, 0.1) if t == 2 else lfo.Box(-1, 1) for t in range(6)]},
    "linked ends": {"terminal_state": lfo.sets.LinkedEnds([[-0.4, 0.0]], [[1.0, 0.0]], [-0.1])},
}


@expensive
@pytest.mark.parametrize("name", STATED)
def test_small_references_are_no_size_of_a_motion_that_other_data_cause(name):
    tiny = lfo.QuadraticCost(Q=np.diag([0.5, 0.1]), R=0.2, P=1.0, x_ref=[0.0, -2e-13], u_ref=1e-13)
    results = [lfo.solve(problem_at(0.0, **STATED[name], **cost)) for cost in ({}, {"cost": tiny})]
    assert [result.status for result in results] == ["optimal", "optimal"]
    assert results[1].cost == pytest.approx(results[0].cost, rel=1e-8)
