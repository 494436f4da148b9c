"""The judge: it accepts optima, and each of its conditions rejects the error that it is there for."""

from dataclasses import replace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

import lin_freq_ocp as lfo
from lin_freq_ocp.base.arrays import first_largest
from lin_freq_ocp.certificate import bound as bound_module
from lin_freq_ocp.certificate.bound import box_minimum, diagonal_curvature
from lin_freq_ocp.certificate.rays import prove_infeasible
from lin_freq_ocp.certificate.verdict import judge
from lin_freq_ocp.methods.convex.sparse_program import solve_convex
from lin_freq_ocp.problem.costs.quadratic import RISES, is_semidefinite
from lin_freq_ocp.program import linear_program
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
        "C-i", "C-ii", "C-iii", "C-iv", "C-v", "C-vi", "C-vii", "S-x", "S-u", "N-x", "N-u",
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
        certificate = self.judge(result, moved(result.trajectory, u={(t, 0): 1e-3}))
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

    def test_rows_shifted_by_one_bin(self, solved, name, monkeypatch):
        problem = solved(name).problem
        honest = linear_program.stop_band_rows

        def shifted(block, stop, *others):
            for rows in honest(block, np.roll(stop, -1, axis=0), *others):
                yield replace(rows, targets=np.full(len(rows.targets), -1))

        monkeypatch.setattr(linear_program, "stop_band_rows", shifted)
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


matrices = st.integers(0, 2**32 - 1).map(np.random.default_rng)


@settings(derandomize=True, max_examples=60, deadline=None)
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


@settings(derandomize=True, max_examples=100, deadline=None)
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


def test_bound_is_called_numerical_where_no_set_bounds_the_states():
    problem = lfo.library.pendulum(sampling_time=0.1, state_bounds=(None,) * 4)
    certificate = lfo.solve(problem).certificate
    assert certificate.bound.kind == "numerical"
    assert certificate.gap < 1e-6


def test_rounding_is_subtracted(solved, monkeypatch):
    """With a coarser arithmetic assumed, the bound falls by what it then cannot exclude."""
    result = solved("paper, constrained")
    before = result.certificate.bound
    honest = bound_module.unit_rounding
    monkeypatch.setattr(bound_module, "unit_rounding", lambda lift: 1e4 * honest(lift))
    after = judge(result.problem, result.trajectory, result.multipliers).bound
    assert after.rounding > 1e3 * before.rounding
    assert after.value < before.value


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
