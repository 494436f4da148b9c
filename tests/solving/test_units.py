"""Verdicts do not depend on units, on scale, on the origin, or on which large number stands for none: a seeded sample.

The long check is scripts/verify.py --part units.
"""

from collections import Counter
from contextlib import nullcontext, suppress
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks import units
from helpers.random.units import CLASSES, drawn
from helpers.seeds import expensive, seeds
from helpers.sweeps import SHORT
from lin_freq_ocp.certificate import cost_scale, trajectory_sizes


@pytest.mark.parametrize(("change", "seed"), seeds((change, seed) for change in units.CHANGES for seed in (3, 4, 8)))
def test_the_same_problem_in_other_words_has_the_same_verdict(change, seed):
    outcome = units.check(seed, change)
    assert outcome.passed, outcome


@expensive
def test_global_bounds_do_not_compare_states_with_controls():
    """A fixed end priced by slopes of controls: in small units of the state, the bound takes twenty times longer."""
    outcome = units.check(417)
    assert outcome.passed, outcome


def test_the_sample_has_every_class():
    kinds = Counter(drawn(seed).kind for seed in range(60))
    assert set(kinds) == set(CLASSES)


SMALL = lfo.OptimalControlProblem(
    lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]]),
    40,
    lfo.QuadraticCost(R=1e-9),
    lfo.Box(-5, 5),
    initial_state=[0.0, 0.0],
    terminal_state=[1.0, 0.0],
)


def far_from_optimal(problem):
    """Return a trajectory that satisfies everything and costs many times the optimum."""
    optimum = lfo.solve(problem).trajectory
    rng = np.random.default_rng(0)
    reach = np.array([np.linalg.matrix_power(problem.dynamics.A, 39 - t) @ problem.dynamics.B for t in range(40)])
    change = 2 * rng.standard_normal(40)
    change -= np.linalg.lstsq(reach[..., 0].T, reach[..., 0].T @ change, rcond=None)[0]
    return lfo.simulate(problem, optimum.u + change[:, None])


@pytest.mark.parametrize("unit", [1e-15, 1e-9, 1.0, 1e9])
def test_a_point_many_times_too_dear_is_never_optimal_however_small_the_cost(unit):
    problem = replace(SMALL, cost=lfo.QuadraticCost(R=unit))
    bad = far_from_optimal(problem)
    certificate = lfo.certify(problem, bad)
    assert certificate.feasible
    assert certificate.cost > 10 * lfo.solve(problem).cost
    assert not certificate.globally_optimal
    assert certificate.pmp == "violated"
    assert certificate.gap > 0.5


def test_a_bound_that_stands_for_none_forgives_no_teleport():
    """A state that jumps, where the bounds of states and controls are 1e11 at one time."""
    upper = np.full((40, 1), 5.0)
    upper[-1] = 1e11
    problem = replace(SMALL, control_set=lfo.Box(-upper, upper), state_set=lfo.Box(-1e11, 1e11))
    optimum = lfo.solve(problem).trajectory
    x = optimum.x.copy()
    x[20:, 1] += 0.15
    certificate = lfo.certify(problem, lfo.Trajectory(x, optimum.u))
    assert not certificate.feasible
    assert not certificate.globally_optimal


def test_residuals_that_are_worth_something_prove_nothing():
    """A decaying state with a wrong step at its end, small beside its start, from which the cost lives."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.1]], [[1.0]]),
        8,
        lfo.QuadraticCost(R=1.0, p=[1.0]),
        lfo.Box(-1, 1),
        lfo.Box(-1e9, 1e9),
        initial_state=[1e6],
    )
    result = lfo.solve(problem)
    assert result.status == "optimal"
    x = result.trajectory.x.copy()
    x[-1] -= 0.15
    certificate = lfo.certify(problem, lfo.Trajectory(x, result.control), result.multipliers)
    assert certificate.feasible  # 0.15 is small beside 1e6
    assert certificate.worth_of_residuals > 0.05 * certificate.cost_scale
    assert not certificate.globally_optimal
    assert [one.label for one in certificate.failed] == ["N-r"]
    assert certificate.pmp == "violated"


def test_sizes_and_scale_follow_units_and_not_bounds():
    optimum = lfo.solve(SMALL).trajectory
    x, u = trajectory_sizes(SMALL, optimum)
    loose = replace(SMALL, control_set=lfo.Box(-1e15, 1e15), state_set=lfo.Box(-1e12, 1e12))
    for one, other in zip((x, u), trajectory_sizes(loose, optimum), strict=True):
        np.testing.assert_array_equal(one, other)
    dearer = replace(SMALL, cost=lfo.QuadraticCost(R=1.0))
    assert cost_scale(dearer, optimum) == pytest.approx(1e9 * cost_scale(SMALL, optimum))
    assert cost_scale(SMALL, optimum) == pytest.approx(SMALL.value(optimum.x, optimum.u))


@expensive
@pytest.mark.parametrize(("decimals", "level"), [(6, 1e-5)])
def test_an_optimum_that_was_printed_with_few_decimals_is_recognised(decimals, level):
    problem = lfo.library.double_integrator()
    exact = lfo.solve(problem).trajectory
    printed = lfo.Trajectory(np.round(exact.x, decimals), np.round(exact.u, decimals))
    certificate = lfo.certify(problem, printed)
    assert certificate.pmp == "violated"
    assert (certificate.rounded.decimals, certificate.rounded.satisfied_to) == (decimals, level)
    assert f"satisfied to 1e-{round(-np.log10(level))}" in str(certificate)
    assert lfo.certify(problem, printed, tolerance=level).pmp == "satisfied"
    assert lfo.certify(problem, exact).rounded is None


def test_a_trajectory_that_is_wrong_is_not_excused_by_its_decimals():
    problem = SHORT()
    u = np.round(0.9 * lfo.solve(problem).control, 4)
    x = np.round(lfo.simulate(problem, u).x, 4)
    assert lfo.certify(problem, lfo.Trajectory(x, u)).rounded is None


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 0.1, float("nan")])
def test_a_tolerance_that_forgives_everything_is_refused(tolerance):
    with pytest.raises(lfo.errors.UnsupportedError, match="tolerance: got"):
        lfo.certify(SMALL, np.zeros((40, 1)), tolerance=tolerance)


VANISHING = {  # name: cost, x_0, x_T: squares of the states, of the controls or of the multipliers are 0 as numbers
    "tiny controls": (lfo.QuadraticCost(R=1.0), [1e-200, 0.0], [0.0, 0.0]),
    "a tiny cost": (lfo.QuadraticCost(R=1e-300), [0.0, 0.0], [1e-30, 0.0]),
    "a tiny state": (lfo.QuadraticCost(Q=1e-310, R=1e-310), [1e-200, 0.0], None),
    "no cost": (lfo.QuadraticCost(), [0.0, 0.0], [1e-250, 1.0]),
}


@pytest.mark.parametrize("horizon", [1, 8])
@pytest.mark.parametrize("name", seeds(VANISHING))
@pytest.mark.parametrize("method", ["auto", "spectral", "structured", "convex"])
def test_numbers_that_vanish_end_with_an_answer_or_a_refusal(name, method, horizon):
    cost, start, end = VANISHING[name]
    problem = replace(SMALL, horizon=horizon, cost=cost, initial_state=start, terminal_state=end)
    with suppress(lfo.errors.UnsupportedError) if method == "spectral" else nullcontext():
        assert lfo.solve(problem, method, throw=False).status in list(lfo.results.Status)


@pytest.mark.parametrize("size", [1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("method", ["structured", "convex"])
def test_a_norm_that_does_not_weigh_a_state_has_no_size_of_its_own(method, size):
    """The slack of |0 x_1| counted 1: beside it, motions of 1e-9 and their cost were nothing to the solvers."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0, 1.0], [0.0, 1.0]], [[0.5], [1.0]]),
        6,
        lfo.QuadraticCost(Q=1e-3, R=1e-3) + lfo.costs.L1Cost(x=[0.1, 0.0], u=0.2, terminal=1.0),
        control_set=lfo.Box(-1.0, 1.0),
        state_set=lfo.Box(-5.0, 5.0),
        initial_state=[0.7 * size, -0.3 * size],
    )
    result = lfo.solve(problem, method)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(0.1825 * size, rel=1e-8)
