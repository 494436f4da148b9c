"""Short horizons: the model of all bounded values at once, against what working rows say of each other one by one."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.spectral_plants import LARGE_BOX, START, T, problem_of
from lin_freq_ocp.methods.spectral import (
    Rows,
    Structure,
    Violations,
    WholeHorizon,
    WorkingSet,
    lti_problem,
    natural_units,
)

JOINT = lfo.StageRows([[1.0, 0, 0.5]], [[1.0, -1.0]], [1.0])
COST = lfo.QuadraticCost(Q=0.3, R=np.diag([1.0, 2.0]), P=np.eye(3))
FIXED_INSIDE = [LARGE_BOX] * 9 + [lfo.Box([-1.4, 0.1, -0.4], [1.2, 0.1, 0.4])] + [LARGE_BOX] * (T - 9)

PROBLEMS = {
    "controls": {},
    "controls and joint rows": {"stage_rows": JOINT},
    "states, the end in a box": {"state_set": LARGE_BOX, "cost": COST, "terminal_state": lfo.Box([-1, 0.1, -1], 0.5)},
    "states, the end free, a state band": {
        "state_set": LARGE_BOX,
        "cost": COST,
        "terminal_state": None,
        "state_spectrum": lfo.stop_band(bins=[11, 12], component=2),
    },
    "a value fixed inside": {"state_set": FIXED_INSIDE, "stage_rows": JOINT},
    "an integrator": {"dynamics": lfo.LinearDynamics(np.diag([1.0, 0.5, 0.2]), np.ones((3, 2)) + np.eye(3, 2))},
}


@pytest.fixture(params=PROBLEMS)
def model(request) -> tuple[Structure, WholeHorizon, WorkingSet]:
    """Return a structure, the model of its bounded values, and all of these as working rows."""
    problem = problem_of(**({"initial_state": START} | PROBLEMS[request.param]))
    lti = lti_problem(problem, natural_units(problem))
    structure = Structure(lti)
    assert not structure.kkt.compliant
    whole = structure.whole_horizon(Violations(lti).rows)
    assert whole is not None
    working = WorkingSet(structure.kkt, lti)
    acting = np.flatnonzero((whole.t < T) | np.isnan(lti.end[np.where(whole.t < T, 0, whole.f)]))
    working.add(whole.t[acting], whole.f[acting], np.ones(len(acting)))
    np.testing.assert_array_equal(whole.flat_indices(working.t, working.f), acting)
    return structure, whole, working


def test_the_model_says_what_working_rows_say(model):
    structure, whole, working = model
    indices = whole.flat_indices(working.t, working.f)
    np.testing.assert_allclose(whole.coupling[:, indices], working.coupling, rtol=0, atol=1e-12)
    expected = working.gram + working.coupling.T @ structure.kkt.inverse @ working.coupling
    size = np.abs(expected).max()
    some = np.random.default_rng(0).choice(len(indices), 7, replace=False)
    mu = np.random.default_rng(1).standard_normal(7)
    np.testing.assert_allclose(whole.gram(indices), expected, rtol=0, atol=1e-11 * size)
    response = whole.response(indices[some], mu)[indices]
    np.testing.assert_allclose(response, expected[:, some] @ mu, rtol=0, atol=1e-11 * size)


def test_rows_named_twice_count_once(model):
    _, whole, working = model
    t, f, sign, _ = working.rows()
    twice = Rows(np.tile(t, 2), np.tile(f, 2), np.concatenate([sign, -sign]))
    indices, signs, weights = whole.distinct(twice)
    np.testing.assert_array_equal(indices, np.sort(whole.flat_indices(t, f)))
    np.testing.assert_array_equal(signs, 1.0)  # the first of two
    np.testing.assert_array_equal(weights, 0.0)


def test_bounds_that_appear_make_another_model():
    """A solver keeps the model for the rows that have bounds; new bounds on other rows need another one."""
    problem = problem_of()
    solver = lfo.SpectralSolver(problem)
    assert solver.solve().status == "optimal"
    bounded = solver.solve(bounds={"state_set": lfo.Box([-1.1, -0.53, -0.3], [1.05, 0.65, 0.42])})
    reference = lfo.solve(bounded.problem, method="convex")
    assert bounded.status == "optimal"
    cost = bounded.problem.cost.value(bounded.trajectory.x, bounded.trajectory.u)
    assert cost == pytest.approx(reference.cost, rel=1e-8)
    assert cost > 1.001 * lfo.solve(problem).cost
