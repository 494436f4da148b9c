"""Derivatives of long problems by adjoint problems: against those by K, against differences, and what has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive, seeds
from lin_freq_ocp.derivatives import AdjointDerivatives, SolutionDerivatives


def regulator(horizon=40, unit=1.0, **changes) -> lfo.OptimalControlProblem:
    """Return an oscillator that is brought towards rest by a bounded control without high frequencies."""
    dynamics = lfo.LinearDynamics([[0.95, 0.3], [-0.3, 0.95]], [[0.0], [0.3 / unit]])
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.2]), R=0.1 / unit**2, q=[0.01, 0.0])
    fields = {"initial_state": [2.0, 0.0], "control_spectrum": lfo.low_pass(cutoff=1.0)} | changes
    return lfo.OptimalControlProblem(dynamics, horizon, cost, lfo.Box(-unit, unit), **fields)


FEATURES = {
    "low pass": {},
    "fixed end": {"terminal_state": [0.0, 0.1]},
    "end in a box": {"terminal_state": lfo.Box([-0.01, None], [0.01, None])},
    "free start": {"initial_state": lfo.Box([2.0, None], [2.0, None])},
    "state bound": {"state_set": lfo.Box([None, -1.0], [None, None])},
    "no bins": {"control_spectrum": None},
    "bins of states": {"state_spectrum": lfo.spectrum.stop_band(bins=[9], component=0)},
}


def both(problem) -> tuple[lfo.Result, AdjointDerivatives, SolutionDerivatives]:
    result = lfo.solve(problem)
    point = problem, result.trajectory, result.multipliers
    return result, AdjointDerivatives(*point), SolutionDerivatives(*point)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("feature", FEATURES)
def test_they_are_those_by_the_factor(feature, unit):
    rng = np.random.default_rng(1)
    result, adjoint, factored = both(regulator(unit=unit, **FEATURES[feature]))
    assert np.abs(result.multipliers.nu).max() + np.abs(result.multipliers.mu[1:-1]).max() > 0  # some bound is active
    weights = rng.standard_normal((41, 2)), rng.standard_normal((40, 1)) / unit
    one, other = adjoint.vjp(*weights), factored.vjp(*weights)
    assert one.exists
    assert other.exists
    assert list(one) == list(other)
    for name, values in other.items():
        assert (np.isnan(one[name]) == np.isnan(values)).all(), name
        size = max(np.abs(np.nan_to_num(values)).max(initial=0.0), 1e-20)  # less is rounding
        np.testing.assert_allclose(np.nan_to_num(one[name] - values), 0.0, atol=1e-7 * size, err_msg=name)
        price = factored.prices[name]
        size = np.abs(np.nan_to_num(price)).max(initial=0.0)
        np.testing.assert_allclose(adjoint.prices[name], price, atol=1e-7 * size, err_msg=name)


@expensive
@pytest.mark.parametrize("horizon", seeds([2000, 20000]))
def test_a_long_problem_has_those_of_differences(horizon):
    problem = regulator(horizon, control_spectrum=lfo.low_pass(cutoff=0.4))
    weights = np.cos(0.01 * np.arange(horizon))[:, None]
    result = lfo.solve(problem)
    assert isinstance(result.derivatives, AdjointDerivatives)
    gradient = result.derivatives.vjp(u=weights)
    assert gradient.exists
    step = 1e-4
    for name, changed in (
        ("initial_state", lambda d: problem.with_ends(initial_state=[2.0 + d, 0.0])),
        ("q", lambda d: replace(problem, cost=replace(problem.cost, q=[0.01 + d, 0.0]))),
    ):
        ahead, behind = ((weights * lfo.solve(changed(d)).control).sum() for d in (step, -step))
        assert gradient[name][0] == pytest.approx((ahead - behind) / (2 * step), rel=1e-5)


@pytest.mark.parametrize("build", [lfo.library.double_integrator, lfo.library.pendulum])
def test_a_sum_that_the_ends_determine_does_not_move(build):
    """From rest to rest the sum of the accelerations is zero: p is zero, and no unit follows from it."""
    problem = build()
    T = problem.horizon
    _, adjoint, factored = both(problem)
    one, other = (found.vjp(u=np.ones((T, 1))) for found in (adjoint, factored))
    assert one.exists
    assert one.error < 1e-11
    size = max(np.abs(np.nan_to_num(values)).max(initial=0.0) for values in other.values())
    for name in ("r", "u_ref", "offset", "initial_state", "terminal_state"):
        np.testing.assert_allclose(one[name], other[name], atol=1e-9 * size, err_msg=name)


@expensive
@pytest.mark.parametrize(
    ("build", "horizon"), [(lfo.library.pendulum, 4800), (lfo.library.double_integrator, 20_000)], ids=["4800", "20000"]
)
def test_a_cotangent_of_a_long_problem_that_the_ends_determine_takes_no_dense_system(build, horizon):
    derivatives = lfo.solve(build(horizon=horizon)).derivatives
    weights = np.random.default_rng(0).standard_normal((horizon, 1))
    for found in (derivatives.vjp(u=np.ones((horizon, 1))), derivatives.vjp(u=weights)):
        assert found.exists
        assert found.error < 1e-11  # a gap of the adjoint problem would leave 1e-6


@pytest.mark.parametrize("called", ["free", "active"])
def test_wrong_signs_are_exchanged(called):
    """Multipliers call a bound free that is active, or the reverse."""
    result = lfo.solve(regulator())
    nu, u = result.multipliers.nu.copy(), result.trajectory.u
    sizes = np.where(nu != 0, np.abs(nu), np.inf) if called == "free" else 1 - np.abs(np.where(nu != 0, 0.0, u))
    t = int(np.argmin(sizes))
    nu[t] = 0.0 if called == "free" else 0.1 * np.sign(u[t])
    trajectory = lfo.Trajectory(result.trajectory.x, np.where(np.arange(40)[:, None] == t, 0.99 * u, u))
    found = AdjointDerivatives(result.problem, trajectory, replace(result.multipliers, nu=nu))
    known = SolutionDerivatives(result.problem, result.trajectory, result.multipliers)
    np.testing.assert_allclose(found.trajectory.u, known.trajectory.u, atol=1e-12)
    assert found.vjp(u=np.ones((40, 1))).exists


def test_a_bound_that_is_met_with_multiplier_zero_is_named():
    free = lfo.solve(regulator(control_spectrum=None))
    u = free.control[:, 0]
    t = int(np.flatnonzero(np.abs(u) < 0.9)[3])
    upper = np.where(np.arange(40) == t, u[t], 1.0)[:, None]
    problem = replace(free.problem, control_set=lfo.Box(-np.ones((40, 1)), upper))
    result, adjoint, factored = both(problem)
    weights = np.zeros((40, 1))
    weights[t] = 1.0
    for found in (adjoint, factored):
        gradient = found.vjp(u=weights)
        assert not gradient.exists
        assert gradient.rows == (f"control set, t = {t}, component 0, upper",)
    assert result.control[t, 0] == pytest.approx(u[t])
    unseen = np.zeros((41, 2))
    unseen[0] = 1.0  # x_0 is fixed
    assert adjoint.vjp(x=unseen).exists


def test_active_bounds_that_depend_on_each_other_have_no_derivative():
    """A control without any bin but the mean is at its bound at all times or never."""
    problem = regulator(control_spectrum=lfo.spectrum.stop_band(bins=range(1, 21)), initial_state=[-60.0, 0.0])
    problem = replace(problem, cost=replace(problem.cost, r=[-50.0]))
    result, adjoint, factored = both(problem)
    np.testing.assert_allclose(result.control, 1.0)
    for found in (adjoint, factored):
        gradient = found.vjp(u=np.ones((40, 1)))
        assert not gradient.exists
        assert "depend on" in gradient.reason


def test_bounds_that_no_trajectory_meets_do_not_settle():
    result = lfo.solve(regulator())
    everywhere = replace(result.multipliers, nu=(-1.0) ** np.arange(40)[:, None])  # a bin that is removed
    found = AdjointDerivatives(result.problem, result.trajectory, everywhere).vjp(u=np.ones((40, 1)))
    assert (found.exists, found.reason) == (False, "the active rows did not settle")


LONG = regulator(2000)


def test_what_needs_the_factor_is_refused():
    derivatives = lfo.solve(LONG).derivatives
    with pytest.raises(lfo.errors.UnsupportedError, match="got a change of initial_state; so many bins are removed"):
        derivatives.jvp(initial_state=[1.0, 0.0])
    with pytest.raises(lfo.errors.UnsupportedError, match="got weights of multipliers; so many bins are removed"):
        derivatives.vjp(multipliers=derivatives.multipliers)
    with pytest.raises(lfo.errors.ProblemError, match=r"u: got shape \(3,\)"):
        derivatives.vjp(u=[1.0, 2.0, 3.0])
    rows = replace(LONG, stage_rows=lfo.StageRows([[1.0, 0.0]], [[1.0]], [9.0], name="sum"))
    with pytest.raises(lfo.errors.UnsupportedError, match="a correction needs about"):
        _ = lfo.solve(rows).derivatives


def test_a_cost_without_curvature_is_refused():
    problem = replace(LONG, cost=lfo.QuadraticCost(Q=np.eye(2)))
    with pytest.raises(lfo.errors.UnsupportedError, match="not strictly convex in the controls"):
        _ = lfo.solve(problem).derivatives
