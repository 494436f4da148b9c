"""Derivatives of long problems by adjoint problems: against those by K, against differences, and what has none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks.derivatives import exact, inner, moved, random_change
from helpers.seeds import expensive, seeds
from lin_freq_ocp import SpectralSolver
from lin_freq_ocp.derivatives import AdjointDerivatives, LongKKT, SolutionDerivatives


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
    step = adjoint.jvp(r=[1.0])
    assert (step.exists, step.left, step.right) == (False, None, None)
    with pytest.raises(lfo.errors.UnsupportedError, match="depend on each other"):
        _ = step.u


def test_bounds_that_no_trajectory_meets_do_not_settle():
    result = lfo.solve(regulator())
    everywhere = replace(result.multipliers, nu=(-1.0) ** np.arange(40)[:, None])  # a bin that is removed
    found = AdjointDerivatives(result.problem, result.trajectory, everywhere).vjp(u=np.ones((40, 1)))
    assert (found.exists, found.reason) == (False, "the active rows did not settle")


def test_a_solution_whose_error_is_not_known_calls_no_bound_weak(monkeypatch):
    """All bounds had been weak, and the system with all of them as equations took 27 GB."""
    solve, result = LongKKT.solve, lfo.solve(regulator())
    monkeypatch.setattr(LongKKT, "solve", lambda kkt, right: replace(solve(kkt, right), error=(np.inf, np.inf)))
    found = AdjointDerivatives(result.problem, result.trajectory, result.multipliers)
    change = found.jvp(initial_state=[1.0, 0.0])
    assert (change.exists, change.reason) == (False, "the active rows did not settle")
    assert change.holds is None


@pytest.mark.parametrize("size", [1e-12, 1e-6, 1.0, 1e6])
def test_a_derivative_is_linear_in_the_change_to_all_its_digits(size):
    _, adjoint, factored = both(regulator(terminal_state=[0.0, 0.1]))
    change = {"q": size * np.array([1.0, -2.0]), "r": [3.0 * size]}
    one, other = adjoint.jvp(**change), factored.jvp(**change)
    np.testing.assert_allclose(one.u, other.u, rtol=0, atol=1e-11 * np.abs(other.u).max())
    np.testing.assert_allclose(one.x, other.x, rtol=0, atol=1e-11 * np.abs(other.x).max())


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_a_change_of_large_multipliers_leaves_digits_of_small_controls(unit):
    """What changes multipliers of active bounds by 1e7 moves no control, and q moves them by numbers of order 1."""
    problem = regulator(unit=unit, terminal_state=[0.0, 0.1])
    problem = replace(problem, cost=replace(problem.cost, r=np.zeros((40, 1))))
    result, adjoint, factored = both(problem)
    at_bounds = np.where(result.multipliers.nu != 0, 1e7 / unit, 0.0)
    at_bounds[np.abs(np.abs(result.control) - unit) > 1e-6 * unit] = 0.0
    assert at_bounds.any()
    one, other = (found.jvp(q=[1.0, 0.0], r=at_bounds) for found in (adjoint, factored))
    assert one.exists
    assert one.error < 1e-11
    np.testing.assert_allclose(one.u, other.u, rtol=0, atol=1e-13 * np.abs(other.u).max())
    np.testing.assert_allclose(one.x, other.x, rtol=0, atol=1e-13 * np.abs(other.x).max())
    np.testing.assert_allclose(np.fft.rfft(one.u, axis=0)[problem.control_stop], 0.0, atol=1e-12 * np.abs(one.u).max())


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_small_weights_beside_large_linear_costs_are_no_differences(unit):
    problem = regulator(unit=unit, terminal_state=[0.0, 0.1])
    cost = lfo.QuadraticCost(R=1e-7 / unit**2, q=[1.0, 0.0], p=[1e3, 0.0])
    _, adjoint, factored = both(replace(problem, cost=cost))
    one, other = (found.jvp(Q=np.eye(2)).multipliers.eta for found in (adjoint, factored))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-11 * np.abs(other).max())


def apart(found: lfo.results.Multipliers, known: lfo.results.Multipliers) -> float:
    """Return the largest difference of two changes of multipliers, relative to the size of each part."""
    parts = [(getattr(found, name), getattr(known, name)) for name in ("eta", "mu", "nu", "rho_u", "rho_x")]
    return max(float(np.abs(one - other).max() / (np.abs(other).max() or 1.0)) for one, other in parts)


@pytest.mark.parametrize("unit", seeds([1e-6, 1.0, 1e6]))
@pytest.mark.parametrize("feature", FEATURES)
def test_changes_move_the_optimum_as_by_the_factor(feature, unit):
    """A change of each datum: signals, multipliers, cost and how far it holds; and the transpose of ``vjp``."""
    rng = np.random.default_rng(1)
    _, adjoint, factored = both(regulator(unit=unit, **FEATURES[feature]))
    weights = {"x": rng.standard_normal((41, 2)), "u": rng.standard_normal((40, 1)) / unit}
    gradient, moving = adjoint.vjp(**weights), 0
    for name in gradient:
        change = {name: np.where(np.isnan(gradient[name]), 0.0, random_change(factored, (name,), rng)[name])}
        one, other = adjoint.jvp(**change), factored.jvp(**change)
        assert one.exists
        assert one.left is one.right
        size, price = (np.abs(np.nan_to_num(slope[name])).max() for slope in (gradient, adjoint.prices))
        terms = np.append(weights["x"] * one.x, weights["u"] * one.u)
        assert terms.sum() == pytest.approx(inner(gradient, change), abs=1e-11 * np.abs(terms).sum() + 1e-15 * size)
        assert one.cost == pytest.approx(other.cost, rel=1e-9, abs=1e-12 * price)
        if not np.abs(one.u).max():  # no row sees the change, or the price of a fixed end alone
            assert np.abs(other.u).max() < 1e-15 * unit
            continue
        moving += 1
        for found, known in ((one.x, other.x), (one.u, other.u)):
            np.testing.assert_allclose(found, known, atol=1e-10 * np.abs(known).max(), err_msg=name)
        assert apart(one.multipliers, other.multipliers) < 1e-9, name
        assert one.ends == other.ends, name
        assert one.holds == (other.holds and pytest.approx(other.holds, rel=1e-7)), name
    assert moving >= 13


@pytest.mark.parametrize("feature", FEATURES)
def test_weights_of_multipliers_are_those_by_the_factor(feature):
    rng = np.random.default_rng(2)
    _, adjoint, factored = both(regulator(**FEATURES[feature]))
    step = factored.jvp(initial_state=[1.0, 0.5], offset=rng.standard_normal((40, 2)))
    one, other = (found.vjp(multipliers=step.multipliers) for found in (adjoint, factored))
    for name, values in other.items():
        size = np.abs(np.nan_to_num(values)).max(initial=0.0)
        np.testing.assert_allclose(one[name], values, atol=1e-9 * size + 1e-12, err_msg=name)


def touching(*times: int) -> tuple[lfo.OptimalControlProblem, np.ndarray]:
    """Return a regulator whose free control at some times meets its upper bound with multiplier zero, and the times."""
    free = lfo.solve(regulator(control_spectrum=lfo.low_pass(cutoff=1.5)))
    chosen = np.flatnonzero(np.abs(free.control[:, 0]) < 0.9)[list(times)]
    upper = np.ones((40, 1))
    upper[chosen] = free.derivatives.trajectory.u[chosen]
    return replace(free.problem, control_set=lfo.Box(-np.ones((40, 1)), upper)), chosen


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("frequency", [0.3, 1.2])
def test_both_sides_of_a_kink(frequency, unit):
    """Three bounds are met; on each side some hold a change and others let it go, and both are those by the factor."""
    problem, times = touching(3, 8, 15)
    _, adjoint, factored = both(problem)
    change = {"offset": unit * np.stack([np.cos(frequency * np.arange(40.0)), np.zeros(40)], axis=1)}
    one, other = adjoint.jvp(**change), factored.jvp(**change)
    assert (one.exists, other.exists, one.holds) == (False, False, None)
    assert set(one.rows) <= {f"control set, t = {t}, component 0, upper" for t in times}
    assert one.rows
    held = list[int]()
    for found, known in ((one.left, other.left), (one.right, other.right)):
        np.testing.assert_allclose(found.u, known.u, atol=1e-12 * np.abs(known.u).max())
        assert apart(found.multipliers, known.multipliers) < 1e-11
        held.append(int(np.sum(np.abs(found.u[times]) < 1e-12 * unit)))
    assert 0 < min(held) <= max(held) < 3
    bound = np.zeros((40, 1))
    bound[times[0]] = 1.0
    for side in ({"control_upper": bound}, {"control_upper": -bound}):
        one, other = adjoint.jvp(**side), factored.jvp(**side)
        np.testing.assert_allclose(one.left.u, other.left.u, atol=1e-12)
        np.testing.assert_allclose(one.right.u, other.right.u, atol=1e-12)


def test_a_change_that_a_weak_row_does_not_see_has_a_derivative():
    problem, _ = touching(3)
    _, adjoint, factored = both(problem)
    step, known = adjoint.jvp(control_lower=np.eye(40, 1)), factored.jvp(control_lower=np.eye(40, 1))
    assert step.exists
    assert known.exists
    np.testing.assert_allclose(step.u, known.u, atol=1e-12)


def test_second_derivatives_of_the_cost_of_a_long_problem():
    _, adjoint, factored = both(regulator())
    step = adjoint.jvp(initial_state=[1.0, 0.0])
    found, known = (one.prices_along(initial_state=[1.0, 0.0]) for one in (adjoint, factored))
    for name in ("offset", "A", "u_ref", "control_upper"):
        np.testing.assert_allclose(found[name], known[name], atol=1e-10 * np.abs(known[name]).max())
        np.testing.assert_array_equal(adjoint.prices_along(step, initial_state=[1.0, 0.0])[name], found[name])


def test_states_that_cost_far_more_than_controls_are_not_denied_a_derivative():
    """A random right-hand side in the units of the states moved controls by 1e7: its rows seemed to be dependent."""
    _, adjoint, factored = both(lfo.library.quadcopter())
    weights = np.random.default_rng(0).standard_normal((60, 4))
    one, other = adjoint.vjp(u=weights), factored.vjp(u=weights)
    assert one.exists
    for name in ("A", "R", "x_ref", "initial_state"):
        np.testing.assert_allclose(one[name], other[name], atol=1e-8 * np.abs(np.nan_to_num(other[name])).max())


def test_a_factor_is_taken_where_it_is_faster_or_says_more():
    dependent = regulator(200, control_spectrum=lfo.spectrum.stop_band(bins=range(1, 101)), initial_state=[-60.0, 0.0])
    dependent = replace(dependent, cost=replace(dependent.cost, r=[-50.0]))
    flat = replace(regulator(300), cost=lfo.QuadraticCost(Q=np.eye(2), R=[[0.0]]))
    kinds = [type(lfo.solve(problem).derivatives) for problem in (regulator(), regulator(200), dependent, flat)]
    assert kinds == [SolutionDerivatives, AdjointDerivatives, SolutionDerivatives, SolutionDerivatives]
    assert lfo.solve(dependent).derivatives.vjp(u=np.ones((200, 1))).rows


LONG = regulator(2000)


@pytest.fixture
def rounds(monkeypatch):
    """Return the list of the rounds of each solve of the Fourier-domain method that another one prepared."""
    solve, found = SpectralSolver.solve_similar, list[int]()

    def noting(solver, problem, *others):
        found.append((answer := solve(solver, problem, *others)).rounds)
        return answer

    monkeypatch.setattr(SpectralSolver, "solve_similar", noting)
    return found


def test_a_further_right_hand_side_takes_one_solve(rounds):
    derivatives = lfo.solve(LONG).derivatives
    rounds.clear()
    gradient = derivatives.vjp(u=np.cos(np.arange(2000.0))[:, None])
    assert rounds == [1]
    assert gradient.error < 1e-11


def test_equations_alone_take_few_rounds(rounds):
    """Unknowns along which the cost is nearly flat took 30 steps, each longer than the one before."""
    assert lfo.solve(lfo.library.double_integrator(horizon=20_000)).derivatives.vjp(u=np.ones((20_000, 1))).exists
    assert len(rounds) > 3
    assert max(rounds) <= 3


def test_how_far_a_change_of_a_long_problem_holds():
    """The optimum is affine up to 0.99 of the step, and other rows are active beyond it."""
    found = lfo.solve(LONG).derivatives
    assert isinstance(found, AdjointDerivatives)
    change = np.array([1.0, 0.3])
    step = found.jvp(initial_state=change)
    assert step.exists
    for end, name in zip(step.holds, step.ends, strict=True):
        inside, outside = (exact(LONG.with_ends([2.0, 0.0] + part * end * change)) for part in (0.99, 1.01))
        known = found.trajectory.u + 0.99 * end * step.u
        np.testing.assert_allclose(inside.trajectory.u, known, atol=1e-10 * np.abs(known).max())
        t = int(name.split("t = ")[1].split(",")[0])
        assert bool(inside.multipliers.nu[t]) == bool(found.multipliers.nu[t])
        assert bool(outside.multipliers.nu[t]) != bool(found.multipliers.nu[t])


def test_a_change_of_matrices_of_a_long_problem_by_differences():
    found, rng = lfo.solve(LONG).derivatives, np.random.default_rng(0)
    change = random_change(found, ("A", "B", "Q", "R"), rng)
    step, size = found.jvp(**change), 1e-3
    assert step.exists
    assert step.holds is None
    ahead, behind = (exact(moved(LONG, change, s)).trajectory.u for s in (size, -size))
    np.testing.assert_allclose(step.u, (ahead - behind) / (2 * size), atol=1e-5 * np.abs(step.u).max())


def test_weights_that_do_not_fit_and_rows_are_refused():
    derivatives = lfo.solve(LONG).derivatives
    with pytest.raises(lfo.errors.ProblemError, match="multipliers: got 3; expected Multipliers"):
        derivatives.vjp(multipliers=3)
    with pytest.raises(lfo.errors.ProblemError, match=r"u: got shape \(3,\)"):
        derivatives.vjp(u=[1.0, 2.0, 3.0])
    rows = replace(LONG, stage_rows=lfo.StageRows([[1.0, 0.0]], [[1.0]], [9.0], name="sum"))
    with pytest.raises(lfo.errors.UnsupportedError, match="got 'sum' beside so many rows of bins that"):
        _ = lfo.solve(rows).derivatives


@expensive
def test_a_mask_of_many_bins_is_refused_by_name():
    mask = lfo.MagnitudeBound(3.0, bins=range(5, 400))
    masked = replace(LONG, control_spectrum=[lfo.low_pass(cutoff=1.5), mask])
    result = lfo.solve(masked)
    with pytest.raises(lfo.errors.UnsupportedError, match="got 'mask on u_0' beside so many rows"):
        _ = result.derivatives
    assert result.sensitivities.limits["mask on u_0"].shape == (395, 1)


def test_a_cost_without_curvature_is_refused():
    problem = replace(LONG, cost=lfo.QuadraticCost(Q=np.eye(2)))
    with pytest.raises(lfo.errors.UnsupportedError, match="not strictly convex in the controls"):
        _ = lfo.solve(problem).derivatives
