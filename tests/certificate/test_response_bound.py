"""The judge of frequency responses: every condition broken once, units, and a bound that holds for any multipliers."""

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp import Trajectory
from lin_freq_ocp.certificate import extremal_at, farkas_bound, judge
from lin_freq_ocp.transform import BinCurvature, bin_curvature

T = 16
LIMIT = 1.15  # of the output: some of its largest values reach it
MODES = ["periodic", "zero-padded"]


def wave_problem(mode, x_unit=1.0, u_unit=1.0, cost_unit=1.0):
    """Return least power with a bound on both signals, in units of the output, the control and the cost."""
    N = T if mode == "periodic" else 2 * T
    w = 2 * np.pi * np.arange(N // 2 + 1) / N
    offset = 0.5 * np.fft.rfft(np.random.default_rng(3).standard_normal((N, 1)), axis=0)
    G = x_unit / u_unit / (1.2 - 0.9 * np.exp(-1j * w))
    S = [[cost_unit / x_unit / u_unit]]
    return lfo.OptimalControlProblem(
        lfo.FrequencyResponse(G, 0.1, x_unit * offset, mode=mode),
        T,
        lfo.QuadraticCost(S=S, q=[0.1 * cost_unit / x_unit]),
        control_set=lfo.Box(-0.3 * u_unit, 0.3 * u_unit),
        state_set=lfo.Box(-LIMIT * x_unit, LIMIT * x_unit),
        control_spectrum=lfo.low_pass(cutoff=2.0),
    )


@pytest.fixture(scope="module", params=MODES)
def solved(request):
    result = lfo.solve(wave_problem(request.param))
    assert result.certificate.globally_optimal
    assert result.certificate.pmp == "satisfied"
    assert np.abs(result.multipliers.mu).max() > 1e-3
    assert np.abs(result.multipliers.nu).max() > 1e-3
    return result


def failed(problem, trajectory, multipliers):
    return {(one.label, one.name) for one in judge(problem, trajectory, multipliers).failed}


@pytest.mark.parametrize("time", [1, 7, T])
def test_an_output_that_is_not_of_the_response_fails(solved, time):
    x = solved.trajectory.x.copy()
    x[time] += 4e-6 * np.abs(x).max()
    found = failed(solved.problem, Trajectory(x, solved.trajectory.u), solved.multipliers)
    assert ("C-iii", "state equation") in found


def test_the_first_output_fails(solved):
    x = solved.trajectory.x.copy()
    x[0] += 4e-6 * np.abs(x).max()
    found = failed(solved.problem, Trajectory(x, solved.trajectory.u), solved.multipliers)
    assert {label for label, _ in found} == {"S-ends"}


def test_a_response_that_is_broken_fails(solved):
    G = solved.problem.dynamics.G * (1 + 1e-5)
    problem = replace(solved.problem, dynamics=replace(solved.problem.dynamics, G=G))
    found = failed(problem, solved.trajectory, solved.multipliers)
    assert ("C-iii", "state equation") in found


@pytest.mark.parametrize("time", [0, 6])
def test_a_multiplier_of_the_response_that_is_moved_fails(solved, time):
    eta = solved.multipliers.eta.copy()
    eta[time] += 1e-5 * np.abs(eta).max()
    found = failed(solved.problem, solved.trajectory, replace(solved.multipliers, eta=eta))
    assert ("C-iii", "adjoint equation") in found
    assert ("C-v", "Hamiltonian stationary in u") in found


def test_the_last_multiplier_and_that_of_the_ends_are_checked(solved):
    eta = solved.multipliers.eta.copy()
    eta[-1] += 1e-5 * np.abs(eta).max()
    found = failed(solved.problem, solved.trajectory, replace(solved.multipliers, eta=eta))
    assert ("C-iv", "transversality at T") in found
    stage = {name: one + 1e-5 * np.abs(eta).max() for name, one in solved.multipliers.stage.items()}
    found = failed(solved.problem, solved.trajectory, replace(solved.multipliers, stage=stage))
    assert ("C-iv", "transversality at 0") in found


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("x_unit", "u_unit", "cost_unit"), [(1e6, 1, 1), (1, 1e-6, 1), (1, 1, 1e-9), (1e3, 1e-3, 1e9)])
def test_the_verdict_does_not_depend_on_units(mode, x_unit, u_unit, cost_unit):
    plain, other = lfo.solve(wave_problem(mode)), lfo.solve(wave_problem(mode, x_unit, u_unit, cost_unit))
    assert other.certificate.globally_optimal
    assert other.certificate.pmp == "satisfied"
    assert other.cost / cost_unit == pytest.approx(plain.cost, rel=1e-8)


def test_the_bound_holds_for_any_multipliers(solved):
    rng = np.random.default_rng(0)
    given = solved.multipliers
    for size in (1e-6, 1e-2, 1.0):
        nu = given.nu + size * rng.standard_normal(given.nu.shape)
        mu = given.mu + size * rng.standard_normal(given.mu.shape)
        eta = given.eta + size * rng.standard_normal(given.eta.shape)
        certificate = judge(solved.problem, solved.trajectory, replace(given, eta=eta, mu=mu, nu=nu))
        assert certificate.bound.kind == "rigorous"
        assert certificate.lower_bound <= solved.cost + 1e-12


def test_the_bound_holds_from_other_trajectories(solved):
    rng = np.random.default_rng(1)
    for size in (1e-8, 1e-3, 1.0):
        x = solved.trajectory.x + size * rng.standard_normal(solved.trajectory.x.shape)
        u = solved.trajectory.u + size * rng.standard_normal(solved.trajectory.u.shape)
        assert judge(solved.problem, Trajectory(x, u), solved.multipliers).lower_bound <= solved.cost + 1e-12


def test_atoms_far_from_the_peak_of_a_soft_mask_prove_nothing():
    """Their values have no excess, the trajectory has: what its cost has beyond them is no part of the bound."""
    free = replace(wave_problem("periodic"), state_set=None, control_set=lfo.Box(-2, 2), control_spectrum=None)
    free = replace(free, cost=lfo.QuadraticCost(Q=1.0, R=0.1, x_ref=1.0))
    mask = lfo.MagnitudeBound(1.0, band=lfo.low_pass(0.6), every_frequency=True, penalty=0.1)
    problem, name = replace(free, control_spectrum=mask), "mask on u_0"
    worse, best = lfo.solve(free), lfo.solve(problem)
    stage = {**worse.multipliers.stage, name: np.zeros((1, 2))}
    given = replace(worse.multipliers, stage=stage, frequencies={name: np.array([np.pi])})
    certificate = judge(problem, worse.trajectory, given)
    assert certificate.cost > best.cost + 0.05
    assert certificate.lower_bound <= best.cost
    assert not certificate.globally_optimal


@expensive
def test_what_bands_remove_is_no_part_of_the_bound():
    """Bin 3, where the cost is not convex, is stopped; controls that have it, and a multiplier that hides it."""
    G = np.ones(9)
    G[3] = -4.0
    power = lfo.QuadraticCost(S=[[1.0]], q=[0.2])
    stop = lfo.stop_band(bins=[3])
    problem = lfo.OptimalControlProblem(lfo.FrequencyResponse(G), T, power, lfo.Box(-1, 1), control_spectrum=stop)
    best = lfo.solve(problem)
    u = best.trajectory.u + 0.3 * np.cos(2 * np.pi * 3 * np.arange(T) / T)[:, None]
    there = Trajectory(problem.dynamics.response(T).states(u), u)
    bounds = []
    for size in np.linspace(-10, 10, 41):
        rho = best.multipliers.rho_u.copy()
        rho[3] += size * 0.3
        bounds.append(judge(problem, there, replace(best.multipliers, rho_u=rho)).lower_bound)
    assert max(bounds) <= best.cost


def test_convexity_is_judged_by_the_judge(monkeypatch):
    """A search that takes a cost for convex where it is not: its stationary point is not called optimal."""
    convex = lfo.OptimalControlProblem(lfo.FrequencyResponse(np.ones(9)), T, lfo.QuadraticCost(S=[[1.0]]))
    other = replace(convex, dynamics=lfo.FrequencyResponse(-np.ones(9)), control_set=lfo.Box(-1, 1))
    result, at_rest = lfo.solve(convex), lfo.simulate(convex, np.zeros((T, 1)))
    assert judge(convex, at_rest, result.multipliers).globally_optimal
    monkeypatch.setattr(BinCurvature, "failing", np.zeros(0, dtype=int))
    assert judge(other, at_rest, result.multipliers).pmp == "satisfied"
    assert not judge(other, at_rest, result.multipliers).globally_optimal


def test_power_is_not_bounded_by_zero():
    certificate = lfo.solve(replace(wave_problem("periodic"), cost=lfo.QuadraticCost(S=[[1.0]]))).certificate
    assert certificate.globally_optimal
    assert certificate.lower_bound < -0.1


def test_without_bounds_the_curvature_of_all_bins_bounds_the_cost():
    problem = replace(wave_problem("periodic"), control_set=None, state_set=None)
    certificate = lfo.solve(problem).certificate
    assert certificate.bound.kind == "rigorous"
    assert certificate.globally_optimal


def test_a_cost_that_is_convex_at_each_time_is_bounded():
    """Zero-padded, the states' part is left out of the curvature of bins, which is then below zero at some."""
    G = np.fft.rfft(np.random.default_rng(0).standard_normal(10))
    cost = lfo.QuadraticCost(Q=2.0, S=[[1.3]], R=1.0, x_ref=1.0)
    problem = lfo.OptimalControlProblem(lfo.FrequencyResponse(G, mode="zero-padded"), 5, cost, lfo.Box(-1, 1))
    assert bin_curvature(problem, problem.dynamics.response(5)).smallest.min() < -0.1
    assert lfo.solve(problem).certificate.globally_optimal


def test_a_cost_that_is_not_convex_has_no_bound():
    problem = wave_problem("periodic")
    problem = replace(problem, dynamics=replace(problem.dynamics, G=-problem.dynamics.G))
    trajectory = lfo.simulate(problem, np.zeros((T, 1)))
    certificate = lfo.certify(problem, trajectory)
    assert certificate.bound is None


@pytest.mark.parametrize("mode", MODES)
def test_what_no_control_can_do_is_proven(mode):
    problem = replace(wave_problem(mode), state_set=lfo.Box(-0.5, 0.5))
    result = lfo.solve(problem, throw=False)
    assert str(result.status) == "infeasible"
    assert any("x_0" in one.block for one in result.conflict)


def zero_multipliers(problem):
    x, u = np.zeros((problem.horizon + 1, 1)), np.zeros((problem.horizon, 1))
    stops = np.zeros(problem.control_stop.shape, complex), np.zeros(problem.state_stop.shape, complex)
    return lfo.results.Multipliers(1.0, u, x, u, *stops, {})


def test_the_bound_holds_for_all_slopes_in_both_ends_of_a_period_that_rounding_may_hide(monkeypatch):
    """x_0 = x_2 = u_0 and the slopes of both ends cancel: with a rounding of 1e-3, all four terms may be wrong."""
    unit, reach = 1e-3, 1e-4
    substitute(monkeypatch, "certificate.unit_rounding", lambda problem: unit)

    def problem(wrong_by):
        q, x_ref = (1.0 - wrong_by) * np.array([1.0, 0.0, 1.0]), (1.0 + wrong_by) * np.array([[1.0], [0.0], [1.0]])
        cost = lfo.QuadraticCost(Q=1.0, P=1.0, q=q[:2, None], p=q[2:], x_ref=x_ref)
        return lfo.OptimalControlProblem(
            lfo.FrequencyResponse(np.ones(2)), 2, cost, [lfo.Box(-reach, reach), lfo.Box(0.0, 0.0)]
        )

    rounded, exact = problem(0.0), problem(unit)
    certificate = judge(rounded, lfo.simulate(rounded, np.zeros((2, 1))), zero_multipliers(rounded))
    assert certificate.bound.kind == "rigorous"
    moved = [lfo.simulate(exact, [[u], [0.0]]) for u in (0.0, reach)]
    costs = [exact.value(one.x, one.u) for one in moved]
    assert certificate.cost - certificate.lower_bound >= costs[0] - costs[1] > 0


def test_the_bound_holds_from_states_that_are_not_of_the_response():
    """J = x u - x^2/2 - u is u^2/2 - u where x = u: other states must not raise its least value, -1/2 a step."""
    cost = lfo.QuadraticCost(Q=-1.0, S=[[1.0]], r=[-1.0])
    problem = lfo.OptimalControlProblem(lfo.FrequencyResponse(np.ones(3)), 4, cost, lfo.Box(1 - 1e-5, 1 + 1e-5))
    for change in (-1e-2, 1e-2):
        there = Trajectory(np.full((5, 1), 1.0 + change), np.ones((4, 1)))
        bound = judge(problem, there, zero_multipliers(problem)).bound
        assert bound.kind == "rigorous"
        assert bound.value <= -2.0


@pytest.mark.parametrize("change", [-1e-2, 1e-2])
def test_slopes_at_states_that_are_not_of_the_response_do_not_hide_those_of_the_cost(change):
    """J = u^2 - x^2/2 + change u: where x = u its slope at 0 is the change, at x = change it is 0."""
    cost, reach = lfo.QuadraticCost(Q=-1.0, R=2.0, r=[change]), 1e-3
    problem = lfo.OptimalControlProblem(lfo.FrequencyResponse(np.ones(3)), 4, cost, lfo.Box(-reach, reach))
    bound = judge(problem, Trajectory(np.full((5, 1), change), np.zeros((4, 1))), zero_multipliers(problem)).bound
    best = lfo.simulate(problem, np.full((4, 1), -np.sign(change) * reach))
    assert bound.kind == "rigorous"
    assert bound.value <= problem.value(best.x, best.u)


def test_the_bound_holds_for_all_responses_that_rounding_may_hide(monkeypatch):
    """J = x_0 - u_0 and x_0 = u_0: with a rounding of 1e-3, both costs and the response may be wrong."""
    unit, reach = 1e-3, 1.0
    substitute(monkeypatch, "certificate.unit_rounding", lambda problem: unit)

    def problem(wrong_by):
        q, r = (1 - wrong_by) * np.eye(2, 1), -(1 + wrong_by) * np.eye(2, 1)
        boxes = [lfo.Box(-reach, reach), lfo.Box(0.0, 0.0)]
        return lfo.OptimalControlProblem(
            lfo.FrequencyResponse((1 - wrong_by) * np.ones(2)), 2, lfo.QuadraticCost(q=q, r=r), boxes
        )

    rounded, exact = problem(0.0), problem(unit)
    bound = judge(rounded, lfo.simulate(rounded, np.zeros((2, 1))), zero_multipliers(rounded)).bound
    best = lfo.simulate(exact, [[reach], [0.0]])
    assert bound.value <= exact.value(best.x, best.u) < 0


def test_the_bound_holds_for_all_limits_that_rounding_may_hide(monkeypatch):
    """D = -1 is the upper bound of x_0 times its multiplier: with a rounding of 1e-3, it may be -1.001."""
    substitute(monkeypatch, "certificate.unit_rounding", lambda problem: 1e-3)
    still = lfo.Box(0.0, 0.0)
    problem = lfo.OptimalControlProblem(
        lfo.FrequencyResponse(np.ones(2)), 2, lfo.QuadraticCost(), still, state_set=lfo.Box(None, 1.0)
    )
    multipliers = replace(zero_multipliers(problem), mu=np.eye(3, 1))
    extremal = extremal_at(problem, lfo.simulate(problem, np.zeros((2, 1))), multipliers)
    assert farkas_bound(extremal, (np.ones(1), np.ones(1))).value <= -1.001


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_multipliers_of_absent_bounds_are_left_out(side):
    cost = lfo.QuadraticCost(Q=1.0, r=[0.1])
    problem = lfo.OptimalControlProblem(lfo.FrequencyResponse(np.ones(2)), 2, cost, lfo.Box(-1.0, 1.0))
    at_rest, none = lfo.simulate(problem, np.zeros((2, 1))), zero_multipliers(problem)
    bound = judge(problem, at_rest, replace(none, mu=np.full((3, 1), side))).bound
    assert bound.value == judge(problem, at_rest, none).bound.value


@pytest.mark.parametrize("mode", MODES)
def test_controls_in_a_ball_are_bounded(mode):
    """A linear cost has a bound, and a contradiction a proof, though no box limits the controls."""
    inside = replace(wave_problem(mode), control_set=lfo.sets.Ball(0.3), cost=lfo.QuadraticCost(q=[0.2], r=[-0.1]))
    found = lfo.solve(inside)
    box = lfo.solve(replace(inside, control_set=lfo.Box(-0.3, 0.3)))
    assert found.status == "optimal"
    assert found.cost == pytest.approx(box.cost, abs=1e-8)
    beyond = lfo.StageRows(None, [[1.0]], [-0.31], name="beyond")
    proof = lfo.solve(replace(inside, stage_rows=beyond), throw=False)
    assert (proof.status, proof.bound) == ("infeasible", "rigorous")
