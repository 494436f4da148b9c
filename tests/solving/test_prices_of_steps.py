"""Linear costs of a step, or of one of many problems, as references: the same as those of the problem itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import seeds

T = 12
COST = lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), R=np.diag([0.1, 0.2]), x_ref=[3.0, 0.0])


def store(**changes) -> lfo.OptimalControlProblem:
    """Return a store of heat with a heater and a pump, which must not run empty."""
    dynamics = lfo.LinearDynamics(
        [[0.9, 0.1], [0.0, 0.8]],
        [[0.3, 0.0], [0.1, 0.4]],
        state_names=["store [kWh]", "flow [kW]"],
        control_names=["heat [kW]", "pump [kW]"],
    )
    fields = {"control_set": lfo.Box(0.0, 2.0), "state_set": lfo.Box([-1.0, None], None), "initial_state": [1.0, 0.0]}
    return lfo.OptimalControlProblem(dynamics, T, **({"cost": COST} | fields | changes))


def far(problem: lfo.OptimalControlProblem, distance: float) -> lfo.OptimalControlProblem:
    """Return the problem with its first state counted from far away."""
    shift, A = np.array([distance, 0.0]), problem.linear.A
    return replace(
        problem,
        dynamics=replace(problem.linear, offset=shift - A @ shift),
        cost=replace(problem.cost, x_ref=problem.cost.x_ref + shift),
        state_set=lfo.Box([distance - 1.0, None], None),
        initial_state=problem.initial_box.lower + shift,
    )


PROBLEMS = {
    "quadratic": store(),
    "linear alone": store(
        cost=lfo.QuadraticCost(q=[0.1, 0.0], r=[1.0, 1.0]), terminal_state=lfo.Box([2.0, None], None)
    ),
    "no states in the cost": store(cost=lfo.QuadraticCost(R=0.1)),
    "stop band": store(control_spectrum=lfo.low_pass(1.5)),
    "mask": store(control_spectrum=lfo.MagnitudeBound(3.0, bins=[3, 4])),
    "rate limit": lfo.rate_limited(store(), 0.7, previous=0.0),
    "levels": store(control_set=lfo.FiniteSet([[0, 1], [0, 1]])),
    "far from zero": far(store(), 1e6),
}


def prices(problem: lfo.OptimalControlProblem, seed: int) -> dict[str, np.ndarray]:
    rng, n = np.random.default_rng(seed), problem.state_dim
    of_states = np.hstack([rng.uniform(-1, 1, (T, 2)), np.zeros((T, n - 2))])
    return {"r": rng.uniform(-1, 3, (T, 2)), "q": of_states if seed % 2 else of_states[0]}


def with_prices(problem: lfo.OptimalControlProblem, given: dict[str, np.ndarray]) -> lfo.results.Result:
    cost = lfo.costs.CostSum([replace(problem.quadratic, **given), *problem.cost.norms])
    return lfo.solve(replace(problem, cost=cost))


@pytest.mark.filterwarnings("ignore::lin_freq_ocp.errors.ClosedLoopWarning")
@pytest.mark.parametrize("name", seeds(PROBLEMS, always=["far from zero"]))
def test_a_solver_a_loop_and_a_batch_take_prices(name):
    problem, count = PROBLEMS[name], 3
    given = [prices(problem, seed) for seed in range(count)]
    alone = [with_prices(problem, one) for one in given]
    solver, loop, later = (
        lfo.Solver(problem),
        lfo.RecedingHorizon(problem),
        lfo.RecedingHorizon(problem, certify="later"),
    )
    start = problem.initial_box.lower
    together = lfo.solve_many(problem, np.tile(start, (count, 1)), references=given)
    for one, expected, of_batch in zip(given, alone, together, strict=True):
        first = expected.trajectory.u[0]
        assert solver.solve(references=one).cost == pytest.approx(expected.cost, rel=1e-8)
        assert of_batch.cost == pytest.approx(expected.cost, rel=1e-8)
        for each in (loop, later):
            np.testing.assert_allclose(each.step(start, references=one), first, atol=1e-4)
    later.certify()
    assert set(loop.log.statuses) == set(later.log.statuses) == {"optimal"}


@pytest.mark.parametrize("method", ["spectral", "structured", "convex"])
def test_each_method_solves_again_with_prices(method):
    problem = PROBLEMS["quadratic"]
    solver = lfo.Solver(problem, method)
    for seed in range(3):
        given = prices(problem, seed)
        assert solver.solve(references=given).cost == pytest.approx(with_prices(problem, given).cost, rel=1e-7)


def test_prices_by_name_are_those_of_their_components():
    loop, heat = lfo.RecedingHorizon(store()), np.linspace(0, 3, T)
    named = loop.step([1.0, 0.0], references={"r": {"heat": heat}, "q": {"store": -0.5}})
    expected = with_prices(store(), {"r": np.column_stack([heat, np.zeros(T)]), "q": np.array([-0.5, 0.0])})
    np.testing.assert_allclose(named, expected.trajectory.u[0], atol=1e-6)


def test_a_run_sees_the_prices_of_each_horizon():
    given = np.random.default_rng(0).uniform(0, 3, (T + 4, 2))
    log = lfo.RecedingHorizon(store()).run([1.0, 0.0], 4, references={"r": given})
    for k, control in enumerate(log.controls):
        problem = replace(store(), initial_state=log.states[k])
        np.testing.assert_allclose(control, with_prices(problem, {"r": given[k : k + T]}).trajectory.u[0], atol=1e-6)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"R": 1.0}, "references.R: got an unknown key; expected x_ref or u_ref or q or r"),
        ({"r": np.ones(3)}, r"cost.r: got shape \(3,\); expected shape \(2,\)"),
        ({"r": {"heet": 2.0}}, "references.r: got 'heet'"),
        ({"q": [np.nan, 0.0]}, "cost.q"),
    ],
)
def test_other_prices_are_refused(given, words):
    with pytest.raises(lfo.errors.ProblemError, match=words):
        lfo.RecedingHorizon(store()).step([1.0, 0.0], references=given)
