"""Bounds of states and controls that rows and the next state imply: no point that a mode allows lies outside."""

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp.transform.hybrid import boxes_of_steps


def problem_of(rng):
    """Return a problem of two modes, states in a box and rows; of each control, one side is bounded, both, or none."""
    n, m, T = 2, 2, 3
    modes = [
        lfo.AffineMode(rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=n), G=[[side, 0.0]], h=[0.0])
        for side in (1.0, -1.0)
    ]
    lower, upper = np.where(rng.random((2, m)) < 0.6, np.inf, rng.uniform(0.0, 2.0, (2, m))) * [[-1.0], [1.0]]
    rows = lfo.StageRows(C=rng.normal(size=(3, n)), D=rng.normal(size=(3, m)), e=rng.uniform(0.1, 2.0, 3))
    dynamics = lfo.PiecewiseAffineDynamics(modes)
    sets = {"control_set": lfo.Box(lower, upper), "state_set": lfo.Box([-3, -3], [3, 3]), "stage_rows": rows}
    return lfo.OptimalControlProblem(dynamics, T, lfo.QuadraticCost(R=1.0), **sets), rows, modes


@pytest.mark.parametrize("seed", seeds(range(24)))
def test_no_point_that_a_mode_allows_is_outside(seed):
    rng = np.random.default_rng(seed)
    problem, rows, modes = problem_of(rng)
    low, high = boxes_of_steps(problem)
    assert low.shape == high.shape == (3, 2, 4)
    tube, held = problem.control_tube, 0
    reach = np.where(np.isfinite(high[0]), np.abs(high[0]), 0.0).max()
    for scale in (0.5, 2.0, 8.0, min(2.0 * reach, 1e3)):
        points = scale * rng.uniform(-1.0, 1.0, (2000, 4))
        points[:, :2] = rng.uniform(-3.0, 3.0, (2000, 2))
        x, u = points[:, :2], points[:, 2:]
        allowed = (x @ np.transpose(rows.C) + u @ np.transpose(rows.D) <= rows.e).all(axis=1)
        allowed &= ((u >= tube.lower[0]) & (u <= tube.upper[0])).all(axis=1)
        for k, mode in enumerate(modes):
            A, B, d = mode.linear.at(0)
            image = x @ A.T + u @ B.T + d
            inside = points[allowed & (np.abs(image) <= 3.0).all(axis=1)]
            held += len(inside)
            assert ((inside >= low[0, k]) & (inside <= high[0, k])).all()
    assert held > 50


def test_rows_and_the_next_state_bound_controls():
    """u_0 + u_1 <= 1 with both at least 0 is a box; a state in [-3, 3] that a control alone moves bounds that one."""
    mode = {"A": np.eye(2), "B": np.eye(2)}
    modes = [lfo.AffineMode(**mode, G=[[side, 0.0]], h=[0.0]) for side in (1.0, -1.0)]
    dynamics, cost = lfo.PiecewiseAffineDynamics(modes), lfo.QuadraticCost(R=1.0)
    rows = lfo.StageRows(D=[[1.0, 1.0]], e=[1.0])
    one_sided = {"control_set": lfo.Box([0.0, 0.0], [np.inf, np.inf]), "stage_rows": rows}
    low, high = boxes_of_steps(lfo.OptimalControlProblem(dynamics, 2, cost, **one_sided))
    np.testing.assert_allclose(low[..., 2:], 0.0)
    np.testing.assert_allclose(high[..., 2:], 1.0, rtol=1e-9)
    boxed = lfo.OptimalControlProblem(dynamics, 2, cost, state_set=lfo.Box([-3, -np.inf], [3, np.inf]))
    low, high = boxes_of_steps(boxed)
    np.testing.assert_allclose(high[..., 2], 6.0, rtol=1e-9)
    assert (high[..., 3] >= 1e100).all()
