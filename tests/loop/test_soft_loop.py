"""Loops with soft constraints: what they apply is the plan of the softened problem, or is called something else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.loops import pendulum
from helpers.seeds import seeds
from lin_freq_ocp.loop import soften
from lin_freq_ocp.methods.structured import solve_structured

PENALTIES = 1e2, 1e3, 1e5


def random_problem(seed: int) -> lfo.OptimalControlProblem:
    """Return a problem whose plans miss its state set from far away, with a cone that is active or a mask."""
    rng = np.random.default_rng(seed)
    A, B = np.eye(2) + 0.4 * rng.standard_normal((2, 2)), rng.standard_normal((2, 1))
    bound, limit, T = rng.uniform(0.3, 1.0, 2), rng.uniform(0.3, 0.8), int(rng.integers(3, 6))
    fields = {"state_set": lfo.Box(-bound, bound), "control_set": lfo.Box(-limit, limit), "initial_state": [0, 0]}
    mask = lfo.MagnitudeBound(rng.uniform(0.3, 1.0), bins=[int(rng.integers(1, T // 2 + 1))])
    fields |= {"control_spectrum": mask} if seed % 3 else {"control_set": lfo.sets.Ball(limit)}
    cost = lfo.QuadraticCost(R=rng.uniform(0.1, 1.0))
    return lfo.OptimalControlProblem(lfo.LinearDynamics(A, B, sampling_time=0.1), T, cost, **fields)


@pytest.mark.parametrize("seed", seeds(range(9)))
def test_a_softened_plan_is_that_of_the_softened_problem(seed):
    problem, penalty = random_problem(seed), {"state_set": PENALTIES[seed % 3]}
    loop = lfo.RecedingHorizon(problem, method="structured", soft=penalty)
    state = np.random.default_rng(seed).uniform(3.0, 5.0, 2)
    for _ in range(2):
        control, step = loop.step(state), loop.log.steps[-1]
        upper = np.vstack([[np.inf, np.inf], *[problem.state_set.upper] * problem.horizon])
        posed = soften(replace(problem, initial_state=state, state_set=lfo.Box(-upper, upper)), penalty)
        best = lfo.solve(posed)
        assert step.status == "infeasible"
        assert step.source == "softened problem"
        assert step.satisfied
        assert step.gap < 1e-6
        assert control == pytest.approx(best.control[0], abs=1e-5)
        assert step.cost == pytest.approx(best.cost, rel=1e-7)
        state = problem.linear.A @ state + problem.linear.B @ control


@pytest.mark.parametrize("penalty", [1.0, 1e3, 1e6])
def test_the_structured_method_takes_few_steps_whatever_a_price_is(penalty):
    """Rows with a price of 1e6 begin with products of slacks and multipliers as large as those of the mask."""
    problem = soften(replace(random_problem(1), initial_state=[4.0, 4.0]), {"state_set": penalty})
    (candidate,) = solve_structured(problem)
    assert candidate.status == "optimal"
    assert int(candidate.message.split()[2]) <= 15


def test_a_step_without_a_solution_is_proven_by_the_rows_that_stopped_the_plan(monkeypatch):
    """No other method is asked for a proof: the ray of the condensed method is one."""
    fail = lambda *given, **options: pytest.fail("solved again")  # noqa: E731
    monkeypatch.setattr(lfo.SpectralSolver, "solve", fail)
    problem = pendulum(60)
    loop = lfo.RecedingHorizon(problem, soft={"state_set": 1e3})
    for state in ([0.0, 0.0, 0.3, 0.0], [0.9, 0.3, 1.5, 1.5], [0.0, 0.0, 0.3, 0.0]):
        loop.step(state)
    assert loop.log.sources == ("plan", "softened problem", "plan")
    assert loop.log.statuses == ("optimal", "infeasible", "optimal")
    assert loop.log.satisfied.all()
