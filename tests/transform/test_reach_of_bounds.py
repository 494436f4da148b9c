"""How far bounds and dynamics let two trajectories lie apart, and the size of the cost that follows from it."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.transform import motions_at_rest, reach_of_bounds, search_scale, stated_sizes

T = 9


def random_dynamics(kind: str, rng: np.random.Generator):
    A, B = rng.normal(size=(3, 3)) / 2, rng.normal(size=(3, 2))
    if kind == "constant":
        return lfo.LinearDynamics(A, B, rng.normal(size=3))
    if kind == "of time":
        return lfo.LinearDynamics(rng.normal(size=(T, 3, 3)) / 2, B, rng.normal(size=(T, 3)))
    sides = [lfo.AffineMode(A + side * np.diag([0.3, 0, 0]), B, G=[[side, 0, 0]], h=[0.0]) for side in (1.0, -1.0)]
    return lfo.PiecewiseAffineDynamics(sides)


@pytest.mark.parametrize("kind", ["constant", "of time", "modes"])
@pytest.mark.parametrize("free", [False, True])
def test_no_two_trajectories_within_the_bounds_lie_further_apart(kind, free):
    rng = np.random.default_rng(3)
    start = lfo.Box([-1.0, 0.0, 2.0], [1.0, 0.5, 2.0]) if free else [1.0, -2.0, 0.0]
    box = lfo.Box([-1.0, 0.5], [2.0, 0.5])
    problem = lfo.OptimalControlProblem(
        random_dynamics(kind, rng), T, lfo.QuadraticCost(R=1.0), box, initial_state=start
    )
    reach = reach_of_bounds(problem)
    farthest = np.zeros_like(reach)
    for _ in range(40):
        pair = []
        for _ in range(2):
            corner = rng.integers(0, 2, size=(T, 2))
            first = problem.initial_box
            x_0 = np.where(rng.integers(0, 2, size=3), first.lower, first.upper)
            moved = lfo.simulate(problem, np.where(corner, box.lower, box.upper), x_0)
            pair.append(np.hstack([moved.x, np.vstack([moved.u, np.zeros(2)])]))
        farthest = np.maximum(farthest, np.abs(pair[0] - pair[1]))
    assert (farthest <= reach * (1 + 1e-9) + 1e-12).all()
    if kind == "constant":
        assert (farthest >= 0.3 * reach).all()


@pytest.mark.parametrize("kind", ["constant", "of time"])
@pytest.mark.parametrize("steps", [1, 2, 7, 8, 9, 40])
def test_the_motion_at_rest_is_that_of_controls_at_their_references(kind, steps):
    rng = np.random.default_rng(4)
    A = rng.normal(size=(steps, 3, 3)) / 3 if kind == "of time" else rng.normal(size=(3, 3)) / 3
    dynamics = lfo.LinearDynamics(A, rng.normal(size=(3, 2)), rng.normal(size=(steps, 3)))
    references, starts = rng.normal(size=(steps, 2)), rng.normal(size=(5, 3))
    problem = lfo.OptimalControlProblem(dynamics, steps, lfo.QuadraticCost(R=1.0, u_ref=references))
    held, moved = motions_at_rest(problem, starts)
    for start, stays, moves in zip(starts, held, moved, strict=True):
        assert (stays == start).all()
        assert moves == pytest.approx(lfo.simulate(problem, references, start).x, abs=1e-12)


@pytest.mark.parametrize("modes", [False, True])
def test_a_reference_out_of_reach_is_no_size_of_a_state_nor_of_its_price(modes):
    """Within T steps, the state moves by T; all it can change of the price of a distance of 1e6 is that."""
    side = [lfo.AffineMode([[1.0]], [[1.0]], G=[[sign]], h=[0.0]) for sign in (-1.0, 1.0)]
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(side) if modes else lfo.LinearDynamics([[1.0]], [[1.0]]),
        T,
        lfo.QuadraticCost(Q=1e-9, x_ref=[1e6]) + lfo.costs.L1Cost(x=1.0, x_ref=[1e6]),
        lfo.Box(-1.0, 1.0),
        initial_state=[0.5],
    )
    assert stated_sizes(problem)[0] <= 2 * T + 1
    trajectory = lfo.simulate(problem, np.ones((T, 1)))
    assert T < search_scale(problem, trajectory) < 100 * T < 1e-3 * problem.value(trajectory.x, trajectory.u)
