"""The judge: it accepts optima, and each of its conditions rejects the error that it is there for."""

from dataclasses import replace
from fractions import Fraction

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import examples, expensive
from lin_freq_ocp.base import RISES, first_largest, is_semidefinite
from lin_freq_ocp.certificate import (
    DATA_ROUNDING,
    box_minimum,
    cost_is_never_negative,
    diagonal_curvature,
    extremal_at,
    judge,
    optimum_box,
    prove_infeasible,
    ray_bound,
    trajectory_sizes,
    unit_rounding,
)
from lin_freq_ocp.methods import solve_convex
from lin_freq_ocp.program import stop_band_rows
from lin_freq_ocp.testing import STATED, reference_problem

JUDGED = ["paper, constrained", "velocity bound", "slow sampling, constrained"]


def changed(multipliers, **fields):
    names = ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x")
    return lfo.results.Multipliers(**({name: getattr(multipliers, name) for name in names} | fields))


def moved(trajectory, x=None, u=None):
    """Add to single entries: {(t, component): amount}."""
    new_x, new_u = trajectory.x.copy(), trajectory.u.copy()
    for array, changes in ((new_x, x or {}), (new_u, u or {})):
        for place, amount in changes.items():
            array[place] += amount
    return lfo.Trajectory(new_x, new_u)


def active_state(result):
    """The time and component, strictly inside the horizon, with the largest multiplier of a state bound."""
    inside = np.abs(result.multipliers.mu[1:-1])
    t, i = first_largest(inside)
    return t + 1, i


def active_control(result):
    return first_largest(np.abs(result.multipliers.nu[:, 0]))[0]


def failures(certificate, label, name=""):
    return [one for one in certificate.conditions if one.label == label and name in one.name and not one.passed]


@pytest.mark.parametrize("name", JUDGED)
def test_an_optimum_passes(solved, name):
    certificate = solved(name).certificate
    assert certificate.pmp == "satisfied"
    assert certificate.normal
    assert certificate.globally_optimal
    assert all(one.relative < 1e-6 for one in certificate.conditions)
    assert {one.label for one in certificate.conditions} == {
        "C-i", "C-ii", "C-iii", "C-iv", "C-v", "C-vi", "C-vii", "N-r", "S-x", "S-u", "N-x", "N-u",
    }  # fmt: skip


@pytest.mark.parametrize("name", JUDGED[1:])
def test_the_problems_have_active_state_bounds_inside(solved, name):
    result = solved(name)
    t, i = active_state(result)
    assert abs(result.multipliers.mu[t, i]) > 1e-3 * np.abs(result.multipliers.eta).max()


@pytest.mark.parametrize("name", JUDGED)
class TestEachConditionFails:
    """One mutation per condition: the label, and where there is one place, the time."""

    def judge(self, result, trajectory=None, **fields):
        return judge(result.problem, trajectory or result.trajectory, changed(result.multipliers, **fields))

    def test_eta_C_of_two(self, solved, name):
        assert failures(self.judge(solved(name), eta_C=2.0), "C-i")

    def test_all_multipliers_zero(self, solved, name):
        result = solved(name)
        zero = {f: 0 * getattr(result.multipliers, f) for f in ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x")}
        certificate = self.judge(result, **zero)
        assert failures(certificate, "C-ii")
        assert certificate.pmp == "violated"

    def test_u_nudged(self, solved, name):
        result = solved(name)
        t = int(np.argmin(np.abs(result.control[:, 0])))
        certificate = self.judge(result, moved(result.trajectory, u={(t, 0): 0.2}))
        assert failures(certificate, "C-iii", "state equation")[0].time == t
        assert failures(certificate, "C-v", "stationary")[0].time == t
        assert failures(certificate, "C-vii")

    def test_adjoint_sign_flipped(self, solved, name):
        result = solved(name)
        certificate = self.judge(result, eta=-result.multipliers.eta)
        assert failures(certificate, "C-v", "stationary")
        assert failures(certificate, "C-iv", "at 0")
        assert failures(certificate, "C-iv", "at T")

    def test_adjoint_shifted_by_one(self, solved, name):
        result = solved(name)
        certificate = self.judge(result, eta=np.roll(result.multipliers.eta, 1, axis=0))
        assert failures(certificate, "C-v", "stationary")

    def test_trajectory_shifted_by_one(self, solved, name):
        result = solved(name)
        shifted = lfo.Trajectory(np.roll(result.trajectory.x, 1, axis=0), result.trajectory.u)
        certificate = self.judge(result, shifted)
        assert failures(certificate, "C-iii", "state equation")
        assert failures(certificate, "S-x")[0].time in (0, result.problem.horizon)

    def test_mu_zeroed(self, solved, name):
        result = solved(name)
        certificate = self.judge(result, mu=0 * result.multipliers.mu)
        assert failures(certificate, "C-iv", "at 0")[0].time == 0
        assert failures(certificate, "C-iv", "at T")[0].time == result.problem.horizon

    def test_nu_zeroed(self, solved, name):
        result = solved(name)
        certificate = self.judge(result, nu=0 * result.multipliers.nu)
        failed = failures(certificate, "C-v", "stationary")[0]
        assert failed.residual == pytest.approx(np.abs(result.multipliers.nu).max())
        assert abs(result.multipliers.nu[failed.time, 0]) == pytest.approx(failed.residual)

    def test_rho_zeroed(self, solved, name):
        result = solved(name)
        certificate = self.judge(result, rho_u=0 * result.multipliers.rho_u)
        assert failures(certificate, "C-v", "stationary")

    def test_one_bin_dropped(self, solved, name):
        result = solved(name)
        rho = result.multipliers.rho_u.copy()
        rho[np.argmax(np.abs(rho))] = 0
        assert failures(self.judge(result, rho_u=rho), "C-v", "stationary")

    def test_endpoint_moved(self, solved, name):
        result = solved(name)
        T = result.problem.horizon
        certificate = self.judge(result, moved(result.trajectory, x={(T, 1): 1e-4}))
        failed = failures(certificate, "S-x")[0]
        assert (failed.time, failed.component) == (T, 1)

    def test_state_outside_its_bound(self, solved, name):
        result = solved(name)
        t, i = result.problem.horizon // 2, 2
        outside = result.problem.state_tube.upper[t, i] + 1e-4 - result.trajectory.x[t, i]
        failed = failures(self.judge(result, moved(result.trajectory, x={(t, i): outside})), "S-x")[0]
        assert (failed.time, failed.component) == (t, i)

    def test_control_outside_its_bound(self, solved, name):
        result = solved(name)
        t = 17
        outside = result.problem.control_tube.upper[t, 0] + 1e-4 - result.control[t, 0]
        assert failures(self.judge(result, moved(result.trajectory, u={(t, 0): outside})), "S-u")[0].time == t

    def test_nu_of_the_wrong_sign(self, solved, name):
        result = solved(name)
        t = active_control(result)
        nu = result.multipliers.nu.copy()
        nu[t] *= -1
        assert failures(self.judge(result, nu=nu), "N-u")[0].time == t

    def test_a_multiplier_on_a_free_bin_is_refused(self, solved, name):
        result = solved(name)
        rho = result.multipliers.rho_u.copy()
        rho[3, 0] = 1.0
        with pytest.raises(lfo.errors.ProblemError, match=r"rho_u\[3, 0\].*Bin 3 is free"):
            self.judge(result, rho_u=rho)

    @expensive
    def test_rows_shifted_by_one_bin(self, solved, name, monkeypatch):
        problem = solved(name).problem
        honest = stop_band_rows

        def shifted(map, *others):
            rows = honest(replace(map, bins=map.bins - 1), *others)
            return replace(rows, targets=np.full(len(rows.targets), -1))

        substitute(monkeypatch, "program.stop_band_rows", shifted)
        candidate = solve_convex(problem, "clarabel")
        certificate = judge(problem, candidate.trajectory, candidate.multipliers)
        assert failures(certificate, "C-vii")[0].time == problem.horizon // 2


@pytest.mark.parametrize("name", JUDGED[1:])
class TestStateMultipliersFail:
    def test_mu_zeroed_inside(self, solved, name):
        result = solved(name)
        mu = result.multipliers.mu.copy()
        mu[1:-1] = 0
        certificate = judge(result.problem, result.trajectory, changed(result.multipliers, mu=mu))
        assert failures(certificate, "C-iii", "adjoint")[0].time == active_state(result)[0]

    def test_mu_of_the_wrong_sign(self, solved, name):
        result = solved(name)
        mu = result.multipliers.mu.copy()
        mu[active_state(result)] *= -1
        failed = failures(judge(result.problem, result.trajectory, changed(result.multipliers, mu=mu)), "N-x")[0]
        assert (failed.time, failed.component) == active_state(result)


def test_state_bins_are_judged():
    problem = lfo.library.two_mass_spring()
    result = lfo.solve(problem)
    assert result.certificate.pmp == "satisfied"
    assert np.abs(result.multipliers.rho_x).max() > 0
    unconstrained = lfo.solve(replace(problem, state_spectrum=None))
    certificate = judge(problem, unconstrained.trajectory, unconstrained.multipliers)
    failed = failures(certificate, "C-vi")[0]
    assert problem.state_stop[failed.time, failed.component]
    dropped = changed(result.multipliers, rho_x=0 * result.multipliers.rho_x)
    assert failures(judge(problem, result.trajectory, dropped), "C-iii", "adjoint")


@pytest.mark.parametrize("name", STATED)
def test_bound_of_any_multipliers_is_below_the_optimum(name):
    """D(eta) <= J* however wrong the multipliers, and J - D is the sum of its stage gaps and residual terms."""
    problem = reference_problem(name)
    result = lfo.solve(problem)
    rng = np.random.default_rng(5)
    for size in (0.0, 1e-3, 1.0):
        noisy = {f: getattr(result.multipliers, f) * (1 + size * rng.standard_normal()) for f in ("eta", "rho_u")}
        certificate = judge(problem, result.trajectory, changed(result.multipliers, **noisy))
        bound = certificate.bound
        assert bound.value <= result.cost * (1 + 1e-9)
        parts = bound.stage_gaps.sum() - bound.dynamics_term - bound.frequency_term + bound.rounding
        if bound.value > 0:
            assert result.cost - bound.value == pytest.approx(parts, rel=1e-9, abs=1e-9 * abs(result.cost))
        else:
            assert parts >= result.cost
    assert np.all(bound.stage_gaps > -1e-6 * abs(result.cost))


def test_bound_with_a_wrong_sign_is_useless(solved):
    result = solved("paper, constrained")
    certificate = judge(result.problem, result.trajectory, changed(result.multipliers, eta=-result.multipliers.eta))
    assert certificate.lower_bound == 0
    assert certificate.gap == 1


@pytest.mark.parametrize(("above", "proven"), [(1e-9, True), (1e-4, False)])
def test_a_cost_below_the_bound_is_paid_for_by_residuals_and_proves_nothing(solved, above, proven):
    certificate = solved("paper, constrained").certificate
    value = certificate.cost + above * certificate.cost_scale
    assert replace(certificate, bound=replace(certificate.bound, value=value)).globally_optimal is proven


def test_a_numerical_bound_and_residuals_of_worth_prove_nothing(solved):
    certificate = solved("paper, constrained").certificate
    assert certificate.globally_optimal
    assert not replace(certificate, bound=replace(certificate.bound, kind="numerical")).globally_optimal
    assert not replace(certificate, worth_of_residuals=1e-4 * certificate.cost_scale).globally_optimal


@pytest.mark.parametrize(("below", "proven"), [(0.0, True), (1e-9, False)])
def test_residuals_that_no_multiplier_prices_prove_nothing(below, proven):
    """The control must move the end, and pays for it; a residual of the dynamics moves it for nothing."""
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[1.0]]), 1, lfo.QuadraticCost(R=1.0))
    problem = problem.with_ends([1.0], [1.0 - below])
    trajectory = lfo.Trajectory(np.array([[1.0], [1.0 - below]]), np.zeros((1, 1)))
    certificate = judge(problem, trajectory, multipliers_of(problem))
    assert (certificate.feasible, certificate.gap) == (True, 0.0)
    assert certificate.globally_optimal is proven


matrices = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@expensive
@settings(derandomize=True, max_examples=examples(60), deadline=None)
@given(rng=matrices, size=st.integers(1, 5), rank=st.integers(0, 5))
def test_curvature_is_below_the_hessian(rng, size, rank):
    factor = rng.standard_normal((min(rank, size), size)) * 10.0 ** rng.integers(-4, 5, size)
    hessian = factor.T @ factor
    curvature = diagonal_curvature(hessian)
    root = np.sqrt(np.where(np.diag(hessian) > 0, np.diag(hessian), 1))
    rest = (hessian - np.diag(curvature)) / np.outer(root, root)
    assert np.linalg.eigvalsh(rest)[0] >= -1e-12
    assert np.all(curvature >= -RISES[-1] * np.diag(hessian))
    assert np.all(curvature >= 0) or not is_semidefinite(hessian)
    assert is_semidefinite(hessian, RISES[-1])


def is_exactly_semidefinite(matrix):
    """Whether a symmetric matrix of fractions is positive semidefinite, by elimination."""
    rows = [list(row) for row in matrix]
    while rows:
        pivot, *rest = rows[0]
        if pivot < 0 or (pivot == 0 and any(rest)):
            return False
        factors = [row[0] / pivot if pivot else 0 for row in rows[1:]]
        rows = [
            [a - f * b for a, b in zip(row[1:], rest, strict=True)] for row, f in zip(rows[1:], factors, strict=True)
        ]
    return True


@pytest.mark.parametrize("rank", [1, 2, 3])
def test_curvature_is_below_the_hessian_in_exact_arithmetic(rank):
    """Products of rounded factors: of full rank, and singular up to rounding."""
    rng = np.random.default_rng(rank)
    for factor in rng.standard_normal((12, rank, 3)):
        hessian = factor.T @ factor
        hessian = (hessian + hessian.T) / 2
        rest = [[Fraction(value) for value in row] for row in hessian.tolist()]
        for k, value in enumerate(diagonal_curvature(hessian).tolist()):
            rest[k][k] -= Fraction(value)
        assert is_exactly_semidefinite(rest)


def test_curvature_of_components_that_are_not_coupled_is_their_own():
    coupled = np.array([[1.0, 0.0, -1.0, 0.0], [0.0, 4.0, 0.0, 2.0], [-1.0, 0.0, 1.0, 0.0], [0.0, 2.0, 0.0, 4.0]])
    assert diagonal_curvature(coupled) == pytest.approx([0.0, 2.0, 0.0, 2.0])
    several = diagonal_curvature(np.stack([coupled, np.diag([3.0, 0.0, 1.0, 5.0])]))
    assert several == pytest.approx(np.array([[0.0, 2.0, 0.0, 2.0], [3.0, 0.0, 1.0, 5.0]]))
    assert diagonal_curvature(np.array([[0.0, 1e-20], [1e-20, 1.0]])) is None


def test_curvature_of_a_diagonal_hessian_is_exact_and_of_an_indefinite_one_does_not_exist():
    assert diagonal_curvature(np.diag([3.0, 0.0, 1e-9])) == pytest.approx([3.0, 0.0, 1e-9], abs=0)
    assert diagonal_curvature(np.diag([1.0, -1e-3])) is None
    assert diagonal_curvature(np.array([[1.0, 2.0], [2.0, 1.0]])) is None


@settings(derandomize=True, max_examples=examples(100), deadline=None)
@given(rng=matrices)
def test_box_minimum_against_a_grid(rng):
    slope, curvature = rng.standard_normal(), rng.choice([0.0, 1.0, 1e-3, -1e-3])
    lower = -rng.uniform(0, 2)
    upper = lower + rng.uniform(0, 3)
    grid = np.linspace(lower, upper, 4001)
    least = (slope * grid + curvature * grid**2 / 2).min()
    found = box_minimum(*(np.array([value]) for value in (slope, curvature, lower, upper)))[0]
    assert found <= least + 1e-12
    assert found == pytest.approx(least, abs=1e-5)


def test_box_minimum_without_bounds():
    infinite = np.full(5, np.inf)
    found = box_minimum(np.array([0.0, 1.0, -1.0, 2.0, 0.0]), np.array([0.0, 0.0, 0.0, 4.0, -1.0]), -infinite, infinite)
    assert found.tolist() == [0.0, -np.inf, -np.inf, -0.5, -np.inf]


def test_bound_over_implied_sets_is_rigorous_where_nothing_is_bounded():
    problem = lfo.library.pendulum(state_bounds=(None,) * 4, control_bound=None)
    certificate = lfo.solve(problem).certificate
    assert certificate.bound.kind == "rigorous"
    assert certificate.bound.sets == "trajectories that cost no more than this one"
    assert certificate.gap < 1e-6


@expensive
def test_bound_is_called_numerical_where_no_set_bounds_the_states():
    problem = lfo.library.pendulum(sampling_time=0.1, state_bounds=(None,) * 4)
    certificate = lfo.solve(problem).certificate
    assert certificate.bound.kind == "numerical"
    assert certificate.gap < 1e-6


def test_rounding_is_subtracted(solved, monkeypatch):
    """With a coarser arithmetic assumed, the bound falls by what it then cannot exclude."""
    result = solved("paper, constrained")
    before = result.certificate.bound
    honest = unit_rounding
    substitute(monkeypatch, "certificate.unit_rounding", lambda lift: 1e4 * honest(lift))
    after = judge(result.problem, result.trajectory, result.multipliers).bound
    assert after.rounding > 1e3 * before.rounding
    assert after.value < before.value


def multipliers_of(problem, **fields):
    """Return normal multipliers that are zero but for some fields."""
    (T, n, m), given = (problem.horizon, problem.state_dim, problem.control_dim), {}
    given |= {"eta_C": 1.0, "eta": np.zeros((T, n)), "mu": np.zeros((T + 1, n)), "nu": np.zeros((T, m))}
    given |= {"rho_u": np.zeros(problem.control_stop.shape, complex), "stage": {}}
    given |= {"rho_x": np.zeros(problem.state_stop.shape, complex)}
    return lfo.results.Multipliers(**(given | fields))


def test_a_slope_that_rounding_hides_leaves_no_rigorous_bound():
    """J is the first component of x_0, which nothing bounds: its slope 1 is 1 + 2^120 - 2^120, rounded to 0."""
    large = 2.0**120
    cost = lfo.QuadraticCost(q=[-large, 0.0], p=[large, 1.0])
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[1.0, 0.0], [1.0, 0.0]], np.zeros((2, 1))), 1, cost)
    problem = replace(problem, control_set=lfo.Box(-1, 1))
    multipliers = multipliers_of(problem, eta=np.array([[-large, -1.0]]))
    bound = judge(problem, lfo.simulate(problem, np.zeros((1, 1)), np.zeros(2)), multipliers).bound
    assert bound.kind == "numerical"
    assert bound.value < -10.0  # the cost at its own box


@pytest.mark.parametrize(("wrong_by", "lower", "upper"), [(-1e-3, -1.0, 10.0), (1e-3, -10.0, 1.0)])
def test_the_bound_holds_for_all_slopes_that_rounding_may_hide(monkeypatch, wrong_by, lower, upper):
    """J = r u - x_1 and x_1 = u: with a rounding of 1e-3, r = 1 is not told from 1 + wrong_by."""
    substitute(monkeypatch, "certificate.unit_rounding", lambda problem: abs(wrong_by))
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.0]], [[1.0]]),
        1,
        lfo.QuadraticCost(r=[1.0], p=[-1.0]),
        control_set=lfo.Box(lower, upper),
        state_set=lfo.Box(lower, upper),
        initial_state=[0.0],
    )
    at_rest = lfo.simulate(problem, np.zeros((1, 1)))
    bound = judge(problem, at_rest, multipliers_of(problem, eta=np.ones((1, 1)))).bound
    assert bound.kind == "rigorous"
    assert bound.value <= min(wrong_by * lower, wrong_by * upper)


@pytest.mark.parametrize("kind", ["offset", "row"])
def test_the_bound_holds_for_all_data_that_rounding_may_hide(monkeypatch, kind):
    """D = -1 is the offset times eta, or the limit of a row times its multiplier: with a rounding of 1e-3, -1.001."""
    substitute(monkeypatch, "certificate.unit_rounding", lambda problem: 1e-3)
    rows = [lfo.StageRows(None, [[1.0]], [1.0], name="row")] if kind == "row" else ()
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.0]], [[0.0]], offset=[1.0 if kind == "offset" else 0.0]),
        1,
        lfo.QuadraticCost(),
        control_set=lfo.Box(0, 0),
        state_set=lfo.Box(0, 0),
        stage_rows=rows,
    )
    eta, stage = np.full((1, 1), 1.0 if kind == "offset" else 0.0), {"row": np.ones((1, 1))} if rows else {}
    at_rest = lfo.Trajectory(np.zeros((2, 1)), np.zeros((1, 1)))
    extremal = extremal_at(problem, at_rest, multipliers_of(problem, eta=eta, stage=stage))
    assert ray_bound(extremal, (np.ones(1), np.ones(1))).value <= -1.001


def test_the_rounding_of_rows_grows_with_their_terms():
    """A sum of k terms is wrong by up to k - 1 roundings of the sum of their absolute values."""
    T = 500
    total = lfo.spectrum.LinearConstraint(np.ones((T, 1, 1)), [1.0])
    plain = lfo.OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[1.0]]), T, lfo.QuadraticCost(R=1.0))
    assert unit_rounding(replace(plain, control_spectrum=total)) >= T * np.finfo(np.longdouble).eps


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_numerical_bound_covers_curved_components_everywhere(side):
    """J = x_0 - x_1 + u^2/2 - 100 side u: nothing holds x_0 = x_1, but u is best at 100, far from the trajectory."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[0.0]]), 1, lfo.QuadraticCost(q=[1.0], p=[-1.0], R=1.0, r=[-100.0 * side])
    )
    there, best = (lfo.simulate(problem, [[side * u]], [1.0]) for u in (1.0, 100.0))
    bound = judge(problem, there, multipliers_of(problem, eta=np.ones((1, 1)))).bound
    assert bound.kind == "numerical"
    assert -np.inf < bound.value <= problem.value(best.x, best.u)


@pytest.mark.parametrize("part", ["Q", "P"])
def test_a_cost_that_is_semidefinite_up_to_rounding_may_be_negative(part):
    square = np.ones((2, 2))
    for weight, never in ((square, True), (square + 2.0**-52 * (1 - np.eye(2)), False)):
        cost = lfo.QuadraticCost(**{part: weight})
        problem = lfo.OptimalControlProblem(lfo.LinearDynamics(np.eye(2), np.zeros((2, 1))), 1, cost)
        moved = lfo.simulate(problem, [[0.0]], [1.0, -1.0])
        assert (problem.value(moved.x, moved.u) >= 0) is never
        assert cost_is_never_negative(problem) is never


def test_the_box_of_near_optima_holds_all_of_them():
    """J = u^2/2 up to 1/50 has |u| <= 1/5; nothing bounds u."""
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[0.0]], [[1.0]]), 1, lfo.QuadraticCost(R=1.0))
    problem = problem.with_ends([0.0])
    extremal = extremal_at(problem, lfo.simulate(problem, [[0.0]]), multipliers_of(problem))
    lower, upper = (side[:, 1:] for side in optimum_box(extremal, 0.02).bounds)
    assert (lower[0, 0] <= -0.2, upper[0, 0] >= 0.2) == (True, True)
    assert upper[0, 0] < 1.0


def test_the_scale_of_the_cost_is_that_of_rounding_of_the_hessian():
    """(x_1 - x_2)^2 is 0 at x_1 = x_2 = 1e6; with one entry of Q rounded otherwise, it is not."""
    Q = np.array([[1.0, -1.0], [-1.0, 1.0]])
    problems = [
        lfo.OptimalControlProblem(
            lfo.LinearDynamics(np.eye(2), np.zeros((2, 1))), 1, lfo.QuadraticCost(Q=weight), initial_state=[1e6, 1e6]
        )
        for weight in (Q, Q + np.diag([2.0**-52, 0.0]))
    ]
    still = lfo.simulate(problems[0], [[0.0]])
    first, second = (problem.value(still.x, still.u) for problem in problems)
    certificate = judge(problems[0], still, multipliers_of(problems[0]))
    assert (first, second > 0) == (0.0, True)
    assert certificate.allowed_gap >= second


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_scale_of_the_cost_is_that_of_rounding_on_either_side_of_a_kink(side):
    """At a soft bound, the cost is zero and grows on one side only: S is at least what rounding costs there."""
    price = 0.5
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.0]], [[1.0]]), 1, lfo.QuadraticCost(), lfo.sets.Soft(lfo.Box(-1, 1), price)
    )
    problem = problem.with_ends([0.0])
    certificate = judge(problem, lfo.simulate(problem, [[side]]), multipliers_of(problem))
    assert certificate.cost == 0
    moved = lfo.simulate(problem, [[side * (1 + DATA_ROUNDING)]])
    assert certificate.allowed_gap >= problem.value(moved.x, moved.u) > 0


TIGHTER = {
    "state band": {"state_spectrum": lfo.stop_band(bins=[2], component=0)},
    "control band": {"control_spectrum": lfo.stop_band(bins=[1])},
    "offset": {"dynamics": lfo.LinearDynamics([[0.9]], [[1.0]], offset=[0.1])},
    "control bound": {"control_set": lfo.Box(-0.08, 0.08)},
    "joint row": {"stage_rows": lfo.StageRows([[0.0]], [[-1.0]], [0.08])},
}


@pytest.mark.parametrize("name", TIGHTER)
def test_the_worth_of_residuals_covers_what_a_constraint_costs(name):
    """The optimal cost is convex in right-hand sides: without a constraint, it falls by no more than the worth."""
    free = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.9]], [[1.0]]), 8, lfo.QuadraticCost(R=1.0), initial_state=[1.0], terminal_state=[0.0]
    )
    looser, tighter = lfo.solve(free), lfo.solve(replace(free, **TIGHTER[name]))
    certificate = judge(tighter.problem, looser.trajectory, tighter.multipliers)
    assert certificate.worth_of_residuals >= tighter.cost - looser.cost > 1e-4


def test_a_small_control_in_its_stop_band_fails():
    """Its size counts, not that of the larger control."""
    waves = np.cos(2 * np.pi * np.arange(8) / 8)[:, None] * [1.0, 1e-7]
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.0]], [[0.0, 0.0]]),
        8,
        lfo.QuadraticCost(R=1.0),
        initial_state=[0.0],
        control_spectrum=lfo.stop_band(bins=[1], component=1),
    )
    assert failures(judge(problem, lfo.simulate(problem, waves), multipliers_of(problem)), "C-vii")


def test_a_nonconvex_cost_has_no_bound_but_is_judged():
    """The smallest counterexample to "H(u_t) = max H": c_0 = -u^2, c_T = 2 x^2, x_1 = u (docs/errata.md)."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 1, lfo.QuadraticCost(R=-2.0, P=4.0), lfo.Box(-1, 1), initial_state=[0]
    )
    certificate = lfo.certify(problem, np.zeros((1, 1)))
    assert certificate.pmp == "satisfied"
    assert certificate.bound is None
    assert certificate.gap is None
    assert not certificate.globally_optimal
    assert not [one for one in certificate.conditions if "maximal" in one.name]


@pytest.mark.parametrize("bound", [1.0, 2.0, 3.0])
def test_an_infeasible_problem_has_a_verified_ray(bound):
    problem = lfo.library.pendulum(control_bound=bound)
    ray = solve_convex(problem, "clarabel").ray
    proof = prove_infeasible(problem, ray)
    assert proof.bound.value > 0
    assert proof.bound.kind == "rigorous"
    words = " ".join(str(one) for one in proof.conflict)
    assert "control bound on force [N]" in words
    assert "terminal state" in words
    wrong = changed(proof.multipliers, eta=-proof.multipliers.eta)
    assert prove_infeasible(problem, wrong) is None


@expensive
def test_a_stop_band_in_conflict_is_named():
    """A constant force must move the cart, but its stop band removes everything except bin 30."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]),
        100,
        lfo.QuadraticCost(R=1.0),
        control_set=lfo.Box(-1, 1),
        initial_state=[0.0],
        terminal_state=[10.0],
        control_spectrum=lfo.stop_band(bins=[0]),
    )
    with pytest.raises(lfo.errors.InfeasibleError, match="control stop band on u_0, bins 0"):
        lfo.solve(problem)


def test_the_optimum_of_a_feasible_problem_is_no_proof_of_infeasibility(solved):
    result = solved("paper, constrained")
    assert prove_infeasible(result.problem, result.multipliers) is None


@pytest.mark.parametrize("end", ["initial_state", "terminal_state"])
def test_fixed_ends_are_sizes_of_states(end):
    """A trajectory at rest misses its end by all of its size, whatever else it does."""
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[0.0]], [[1.0]]), 1, lfo.QuadraticCost(R=1.0))
    at_rest = lfo.Trajectory(np.zeros((2, 1)), np.ones((1, 1)))
    assert trajectory_sizes(replace(problem, **{end: [-50.0]}), at_rest)[0].tolist() == [50.0]


@pytest.mark.parametrize(("angle", "passed"), [(0.0, True), (1e-3, False)])
def test_a_multiplier_of_a_wrong_direction_leaves_a_slope(angle, passed):
    """At u = (1, 0) of the unit ball; the gap is of second order in the angle, 5e-7 at 1e-3, the slope of first."""
    plant, cost = lfo.LinearDynamics([[0.0]], [[0.0, 0.0]]), lfo.QuadraticCost(r=[-1.0, 0.0])
    problem = lfo.OptimalControlProblem(plant, 1, cost, lfo.sets.Ball(1.0))
    (term,) = problem.terms
    weights = np.array([[np.cos(angle), np.sin(angle)]])
    there = lfo.simulate(problem, [[1.0, 0.0]], [0.0])
    certificate = judge(problem, there, multipliers_of(problem, stage={term.name: weights}))
    (condition,) = [one for one in certificate.conditions if "subgradients" in one.name]
    assert condition.residual == pytest.approx(angle**2 / 2, rel=1e-3, abs=1e-15)
    assert ("Hamiltonian stationary in u" in {one.name for one in certificate.failed}) is not passed


@pytest.mark.parametrize(("weight", "passed"), [(1e-12, True), (1e-3, False)])
def test_a_multiplier_of_an_absent_bound_counts_with_the_size_of_its_component(weight, passed):
    """Rounding of a multiplier is none of its own, though the bound is infinitely far away."""
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[0.0]]), 1, lfo.QuadraticCost(Q=1.0))
    certificate = judge(
        problem, lfo.simulate(problem, [[0.0]], [1.0]), multipliers_of(problem, mu=np.array([[weight], [0.0]]))
    )
    (condition,) = [one for one in certificate.conditions if one.label == "N-x"]
    assert condition.passed is passed


def hardly_coupled(gain: float, **sets: object) -> lfo.OptimalControlProblem:
    """Return a problem whose second state changes the first one by a gain, and has no cost and no data."""
    dynamics = lfo.LinearDynamics([[0.9, gain], [0.0, 0.9]], np.eye(2))
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=np.diag([1.0, 1e-14]), P=np.diag([1.0, 0.0]))
    return lfo.OptimalControlProblem(dynamics, 10, cost, initial_state=[1.0, 0.0], **sets)


@pytest.mark.parametrize("gain", [1e-17, 1e-13, 1e-12, 1e-3])
@pytest.mark.parametrize(
    "sets",
    [
        {"state_set": lfo.Box([-10, -1], [10, 1])},
        {"stage_rows": lfo.StageRows(C=[[0.0, 1.0], [0.0, -1.0]], e=[1.0, 1.0])},
    ],
    ids=["box", "rows"],
)
def test_a_limit_says_itself_what_a_small_violation_is(gain, sets):
    """The second state has the size at which it changes the first: of that, 4 was nothing, where the limit is 1."""
    problem = hardly_coupled(gain, **sets)
    u = lfo.solve(problem).trajectory.u.copy()
    assert lfo.certify(problem, u).globally_optimal
    u[3:5, 1] += 5.0, -4.5
    certificate = lfo.certify(problem, u)
    assert not certificate.feasible
    assert certificate.violation > 0.5  # of the 5 that the state reaches


@pytest.mark.parametrize(("unit", "shift"), [(1.0, 0.0), (1e6, 0.0), (1e-6, 0.0), (1.0, 1e6)])
def test_a_violated_limit_is_violated_in_every_unit_and_wherever_zero_is(unit, shift):
    """Of the same violation, one choice of the unit of the state, or of its zero, was feasible and others were not."""
    scale, gains = np.array([1.0, unit]), np.array([[0.9, 1e-13], [0.0, 0.9]])
    A, at = gains * scale[:, None] / scale, shift * scale
    dynamics = lfo.LinearDynamics(A, np.diag(scale), at - A @ at)
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=np.diag([1.0, 1e-12]), x_ref=at)
    bounds = lfo.Box(np.array([-10.0, -1.0]) * scale + at, np.array([10.0, 1.0]) * scale + at)
    ends = {"initial_state": np.array([1.0, 0.0]) * scale + at}
    problem = lfo.OptimalControlProblem(dynamics, 6, cost, state_set=bounds, **ends)
    u = lfo.solve(problem).trajectory.u.copy()
    assert lfo.certify(problem, u).globally_optimal
    u[2:4, 1] += 4.0, -3.6
    assert not lfo.certify(problem, u).feasible


def test_gains_that_are_rounding_give_no_sizes():
    """A state acts on another by 1e-17, which is rounding beside 0.9: its jump from 0 to 5 violates the dynamics."""
    problem = hardly_coupled(1e-17)
    at = lfo.solve(problem).trajectory
    x = at.x.copy()
    x[4:, 1] += 5.0
    assert not lfo.certify(problem, lfo.Trajectory(x, at.u)).feasible


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_what_hardly_moves_other_states_is_small_at_a_bound_of_zero(unit):
    """A state without cost starts at 0, which does not say what is small there; the state that it moves does."""
    A, scale = np.array([[0.9, 0.5], [0.0, 0.5]]), np.array([1.0, unit])
    dynamics = lfo.LinearDynamics(A * scale[:, None] / scale, [[1.0], [0.0]])
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=1.0)
    problem = lfo.OptimalControlProblem(dynamics, 10, cost, initial_state=[1.0, 0.0])
    at = lfo.solve(problem).trajectory
    for noise, feasible in ((1e-12, True), (1e-3, False)):
        x = at.x.copy()
        x[:, 1] += noise * unit * 0.5 ** np.arange(11)
        assert lfo.certify(problem, lfo.Trajectory(x, at.u)).feasible is feasible
