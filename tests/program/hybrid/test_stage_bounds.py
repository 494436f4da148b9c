"""What duals prove stage by stage: what a solution does, and less than any trajectory costs whatever they are."""

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.modes import random_problem
from helpers.seeds import seeds
from lin_freq_ocp.methods.hybrid import TOLERANCES, solve_relaxation
from lin_freq_ocp.program.hybrid import ModeRelaxation, Quadratic

FULL = lfo.QuadraticCost(Q=[[2, 1.5], [1.5, 2]], R=0.3, S=[[0.2], [0.1]], P=[[3, -1], [-1, 1]], x_ref=[0.3, -0.2])


def root(problem):
    relaxation = ModeRelaxation(problem)
    everything = np.ones((problem.horizon, len(problem.dynamics.modes)), dtype=bool)
    return relaxation, relaxation.reach.from_start(everything)


@pytest.mark.parametrize("fields", [{}, {"control_spectrum": lfo.stop_band(bins=[1])}, {"cost": FULL}])
def test_duals_of_a_solution_prove_its_objective(fields):
    relaxation, reach = root(random_problem(4, horizon=5, **fields))
    answer = solve_relaxation(relaxation, reach)
    close = 1e-2 if "cost" in fields else 1e-6  # a Hessian that is not diagonal is bounded from below by one that is
    assert relaxation.proven(reach, answer.duals) == pytest.approx(answer.bound, rel=close)
    assert relaxation.proven(reach, answer.duals) <= answer.bound + 1e-6


@pytest.mark.parametrize("seed", seeds(range(3)))
def test_any_duals_prove_less_than_any_trajectory_costs(seed):
    problem = random_problem(seed, horizon=4, control_spectrum=lfo.stop_band(bins=[2]))
    relaxation, reach = root(problem)
    best, rng = lfo.solve(problem).cost, np.random.default_rng(seed)
    duals = solve_relaxation(relaxation, reach).duals
    for size in (0.01, 0.1, 1.0):
        parts = {part: getattr(duals, part) for part in ("adjoint", "sides", "regions")}
        moved = {part: value * (1 + size * rng.normal(size=value.shape)) for part, value in parts.items()}
        moved["regions"] = np.abs(moved["regions"])
        assert relaxation.proven(reach, replace(duals, **moved)) <= best + 1e-9 * abs(best)


def test_a_cutoff_ends_relaxations_early_with_a_bound_that_holds():
    problem = random_problem(2, horizon=6, kinks=2)
    relaxation, reach = root(problem)
    exact = solve_relaxation(relaxation, reach).bound
    for cutoff in (exact - 0.3 * abs(exact), exact + 0.3 * abs(exact)):
        rough = solve_relaxation(relaxation, reach, TOLERANCES, np.inf, cutoff)
        assert (rough.bound > cutoff) == (exact > cutoff)
        assert rough.bound <= exact + 1e-6 * abs(exact)
        assert rough.bound == pytest.approx(exact, rel=1e-2) or rough.bound > cutoff


def test_problems_with_other_terms_have_no_such_bound():
    problem = random_problem(1, cost=lfo.QuadraticCost(Q=np.eye(2), R=0.1) + lfo.costs.L1Cost(u=0.5))
    relaxation, reach = root(problem)
    assert not relaxation.proves
    assert (
        solve_relaxation(relaxation, reach, TOLERANCES, np.inf, 0.0).bound == solve_relaxation(relaxation, reach).bound
    )


def test_minima_of_quadratics_over_boxes():
    rng = np.random.default_rng(0)
    for diagonal in (True, False):
        root_ = np.diag(rng.uniform(0.5, 2, 3)) if diagonal else rng.normal(size=(3, 3))
        hessian, slope = root_.T @ root_, rng.normal(size=3)
        low, high = -rng.uniform(0, 1, 3), rng.uniform(0, 1, 3)
        found = float(Quadratic(hessian).least(slope, low, high))
        points = rng.uniform(low, high, size=(20_000, 3))
        values = points @ slope + 0.5 * ((points @ hessian) * points).sum(axis=1)
        assert found <= values.min()
        assert found >= values.min() - 0.05 * np.ptp(values)
