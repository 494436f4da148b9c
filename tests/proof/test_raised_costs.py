"""Hessians that are semidefinite up to rounding become so exactly."""

from collections import Counter

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.rounded_products import KINDS, exact_optimum, rounded_product
from helpers.seeds import expensive, seeds
from lin_freq_ocp.base import is_semidefinite, stack_signals
from lin_freq_ocp.certificate import Region
from lin_freq_ocp.proof import check, convex_problem, raised_by


def problem_of(Q):
    dynamics = lfo.LinearDynamics(np.eye(3) + 0.1 * np.eye(3, k=1), np.eye(3, 1, -2))
    return lfo.OptimalControlProblem(dynamics, 12, lfo.QuadraticCost(Q=Q, R=1.0), initial_state=[1.0, 0.5, 0.0])


def test_a_product_that_was_rounded_is_raised_by_roundings():
    C = np.array([[0.1, 0.7, -0.3]])
    given = C.T @ C
    assert not is_semidefinite(given)
    found = convex_problem(problem_of(given)).quadratic.Q
    assert is_semidefinite(found)
    assert np.abs(found - given).max() < 1e-13
    result = lfo.solve(problem_of(given))
    assert result.enclosure.width < 1e-10 * result.cost


def test_what_is_semidefinite_stays_as_it_is():
    problem = problem_of([[2.0, 1.0, 0.0], [1.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    assert convex_problem(problem) is problem


def test_what_is_not_semidefinite_stays_so():
    problem = problem_of([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert convex_problem(problem) is problem


SEEDS = range(24)


@pytest.mark.parametrize("seed", seeds(SEEDS))
def test_the_interval_contains_the_optimal_cost_of_the_numbers_as_they_stand(seed):
    """J* in rational numbers, of Hessians c c' that are indefinite by rounding: also below zero, and far from it."""
    problem, _ = rounded_product(seed)
    result, exact = lfo.solve(problem, throw=False), exact_optimum(problem)
    assert exact is not None
    assert result.status == "optimal"
    assert result.certificate.bound.kind == "rigorous"
    assert result.lower_bound <= exact <= result.cost + result.certificate.allowed_gap
    assert result.enclosure.lower <= exact <= result.enclosure.upper
    sizes = np.abs(result.trajectory.x) + np.abs(problem.quadratic.x_ref), np.abs(result.trajectory.u)
    assert result.enclosure.width <= 1e-10 * problem.quadratic.magnitudes.value(*sizes)


def test_the_sample_has_every_kind_and_costs_below_zero():
    problems = [rounded_product(seed) for seed in SEEDS]
    assert set(Counter(kind for _, kind in problems)) == set(KINDS)
    assert min(exact_optimum(problem) for problem, _ in problems) < 0
    assert sum(not is_semidefinite(problem.quadratic.Q) for problem, _ in problems) >= 8


def test_no_bound_is_rigorous_where_rounding_lets_the_cost_fall_for_ever():
    """Nothing bounds x_0 along the direction in which the rounded Hessian is negative."""
    c = np.array([0.3, -0.7])
    cost = lfo.QuadraticCost(Q=np.outer(c, c), R=1.0)
    assert not is_semidefinite(cost.Q)
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics(np.eye(2), np.zeros((2, 1))), 3, cost)
    result = lfo.solve(problem, throw=False)
    assert result.lower_bound is None or result.certificate.bound.kind == "numerical"
    assert result.enclosure.lower == -np.inf


@expensive
@pytest.mark.parametrize("horizon_of_checks", [20_000, 1])
def test_the_claim_is_not_raised_to_what_the_checker_does_not_prove(horizon_of_checks, monkeypatch, tmp_path):
    """The cost is never negative, but neither bounds nor the rounded Hessian limit the states of the raised problem."""
    substitute(monkeypatch, "proof.LONGEST_CHECK", horizon_of_checks)
    rng, ends = np.random.default_rng(1), {"initial_state": [1, 0.3], "terminal_state": [0.2, 0.1]}
    c = rng.standard_normal((2, 1))
    dynamics = lfo.LinearDynamics(rng.standard_normal((2, 2)), rng.standard_normal((2, 2)))
    cost, band = lfo.QuadraticCost(Q=c @ c.T, P=c @ c.T), lfo.stop_band(bins=[2])
    result = lfo.solve(lfo.OptimalControlProblem(dynamics, 4, cost, **ends, control_spectrum=band), throw=False)
    assert result.lower_bound > 0
    assert result.certificate.bound.kind == "numerical"
    result.write_proof(tmp_path / "run.proof")
    with (tmp_path / "run.proof").open("rb") as stream:
        check(stream, lambda summary: None)


def test_the_rise_is_charged_at_what_it_costs_in_a_region():
    given = problem_of(np.outer([0.1, 0.7, -0.3], [0.1, 0.7, -0.3]))
    raised = convex_problem(given)
    rng = np.random.default_rng(0)
    for size in (1e-3, 1.0, 1e6):
        x, u = size * rng.uniform(-1, 1, (13, 3)), size * rng.uniform(-1, 1, (12, 1))
        inside = size * stack_signals(np.ones((13, 3)), np.ones((12, 1)))
        region = Region((-inside, inside), np.inf, "")
        extended = x.astype(np.longdouble), u.astype(np.longdouble)
        by = raised.value(*extended) - given.value(*extended)
        assert 0 <= by <= raised_by(given, raised, region) <= 1e-12 * size**2
    everywhere = Region((-np.inf * np.ones((13, 4)), np.inf * np.ones((13, 4))), np.inf, "")
    assert raised_by(given, raised, everywhere) == np.inf
    assert raised_by(given, given, everywhere) == 0
