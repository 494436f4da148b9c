"""Derivatives of many optima at once are those of each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo

EACH = ("initial_state", "x_ref", "u_ref")
RNG = np.random.default_rng(0)
STARTS = RNG.standard_normal((6, 3))
A, B = np.eye(3) + 0.2 * RNG.standard_normal((3, 3)), RNG.standard_normal((3, 2))
PROBLEM = lfo.OptimalControlProblem(
    lfo.LinearDynamics(
        np.eye(3) + 0.2 * RNG.standard_normal((3, 3)), RNG.standard_normal((3, 2)), offset=[0.1, 0, 0.2]
    ),
    12,
    lfo.QuadraticCost(Q=1.0, R=1.0, P=2.0, S=0.1 * np.ones((3, 2)), q=[0.1, 0, 0], x_ref=[0.2, 0, 0]),
    control_set=lfo.Box(-0.6, 0.6),
    initial_state=np.zeros(3),
)


def require_sums(problem: lfo.OptimalControlProblem, **batch: object) -> None:
    solutions = lfo.solve_many(problem, **batch)
    rng = np.random.default_rng(1)
    weights = {"x": rng.standard_normal(solutions.states.shape), "u": rng.standard_normal(solutions.controls.shape)}
    found = solutions.vjp(**weights)
    each = [solutions[i].derivatives.vjp(**{name: w[i] for name, w in weights.items()}) for i in range(len(solutions))]
    assert found.exists.tolist() == [one.exists for one in each]
    assert set(found) == set(each[0])
    for name in found:
        parts = np.stack([one[name] for one in each])
        wanted = parts if name in EACH else parts.sum(0)
        np.testing.assert_allclose(found[name], wanted, rtol=1e-9, atol=1e-10 * np.abs(wanted).max() + 1e-20)


def test_one_recursion_has_the_derivatives_of_all():
    require_sums(PROBLEM, initial_states=STARTS)


def test_references_of_each():
    references = [{"x_ref": 0.1 * start} for start in STARTS]
    require_sums(PROBLEM, initial_states=STARTS, references=references)


def test_other_problems_one_by_one():
    banded = replace(PROBLEM, control_spectrum=lfo.stop_band(bins=[3]))
    require_sums(banded, initial_states=0.3 * STARTS[:2])


def test_controls_with_equal_bounds_have_prices_of_either_sign():
    lower, upper = np.full((12, 2), -0.6), np.full((12, 2), 0.6)
    for t, i, value in ((4, 0, 0.1), (6, 1, -0.1), (8, 0, 0.6)):
        lower[t, i] = upper[t, i] = value
    require_sums(replace(PROBLEM, control_set=lfo.Box(lower, upper)), initial_states=STARTS)


def test_a_control_that_touches_its_bound_has_no_derivative():
    free = lfo.solve(replace(PROBLEM, control_set=None, initial_state=STARTS[0])).derivatives.trajectory.u
    bounds = np.full((12, 2), 9.0)
    bounds[3, 1] = free[3, 1]
    problem = replace(PROBLEM, control_set=lfo.Box(-9.0 * np.ones((12, 2)), bounds))
    found = lfo.solve_many(problem, STARTS[[0, 0]]).vjp(u=np.ones((2, 12, 2)))
    assert found.exists.tolist() == [False, False]
    assert found.reasons[0] == "active with multiplier zero"


def test_an_infeasible_problem_among_them():
    problem = replace(PROBLEM, terminal_state=[9e3, 0, 0])
    with pytest.raises(lfo.errors.SolveError, match="problem 0 ended as"):
        lfo.solve_many(problem, STARTS[:1]).vjp(u=np.ones((1, 12, 2)))


def test_weights_that_do_not_fit():
    with pytest.raises(lfo.errors.ProblemError, match=r"u: got shape \(12, 2\); expected shape \(2, 12, 2\)"):
        lfo.solve_many(PROBLEM, STARTS[:2]).vjp(u=np.ones((12, 2)))
