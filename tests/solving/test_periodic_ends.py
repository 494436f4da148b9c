"""Periodic and linked ends, solved by every method, judged, and compared with CVXPY."""

from __future__ import annotations

import re
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive, seeds
from helpers.spectral_plants import certificate_of_claim
from lin_freq_ocp.api import raise_for
from lin_freq_ocp.certificate import prove_infeasible
from lin_freq_ocp.errors import InfeasibleError, ProblemError, UnsupportedError

T, METHODS = 12, ("auto", "convex", "structured")


def random_problem(seed: int) -> lfo.OptimalControlProblem:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 3))
    A /= np.abs(np.linalg.eigvals(A)).max() / rng.choice([0.7, 1.0, 1.2])
    dynamics = lfo.LinearDynamics(A, rng.normal(size=(3, 2)), offset=0.3 * rng.normal(size=(T, 3)))
    cost = lfo.QuadraticCost(Q=np.diag(rng.random(3)), R=1.0, P=np.eye(3), x_ref=rng.normal(size=(T + 1, 3)))
    given = lfo.Periodic(), lfo.sets.LinkedEnds(*rng.normal(size=(2, 2, 3)), rng.normal(size=2))
    start = lfo.Box([0.2, None, None], None) if seed % 3 == 0 else None
    ends = {"initial_state": start, "terminal_state": given[seed % 2]}
    return lfo.OptimalControlProblem(dynamics, T, cost, control_set=lfo.Box(-1, 1), **ends)


def independent_cost(problem: lfo.OptimalControlProblem) -> float:
    x, u = cp.Variable((T + 1, 3)), cp.Variable((T, 2))
    cost, dynamics, links = problem.quadratic, problem.linear, problem.terminal_state
    E_0, E_T, e = (
        (np.eye(3), -np.eye(3), np.zeros(3)) if isinstance(links, lfo.Periodic) else (links.E_0, links.E_T, links.e)
    )
    held = [cp.abs(u) <= 1, E_0 @ x[0] + E_T @ x[T] == e]
    held += [x[t + 1] == dynamics.A @ x[t] + dynamics.B @ u[t] + dynamics.offset[t] for t in range(T)]
    held += [x[0, 0] >= 0.2] if problem.initial_box.lower[0] == 0.2 else []
    total = cp.sum_squares(u) + cp.sum_squares(x[T] - cost.x_ref[T])
    total += sum(cp.quad_form(x[t] - cost.x_ref[t], cost.Q) for t in range(T))
    program = cp.Problem(cp.Minimize(total / 2), held)
    return float(program.solve(solver="CLARABEL"))


@pytest.mark.parametrize("seed", seeds(range(6)))
def test_every_method_finds_the_optimum_of_cvxpy(seed):
    problem = random_problem(seed)
    expected = independent_cost(problem)
    for method in METHODS:
        result = lfo.solve(problem, method=method)
        assert result.certificate.globally_optimal
        assert result.cost == pytest.approx(expected, rel=1e-7, abs=1e-7)


def double_integrator(**further: object) -> lfo.OptimalControlProblem:
    """A position that follows a square wave of one period, whose velocity costs nothing."""
    times, h = np.arange(41), 0.1
    reference = np.column_stack([np.sign(np.sin(2 * np.pi * (times + 0.5) / 40)), 0 * times])
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=0.01, x_ref=reference)
    dynamics = lfo.LinearDynamics([[1.0, h], [0.0, 1.0]], [[h * h / 2], [h]])
    given = {"cost": cost, "control_set": lfo.Box(-8, 8), "terminal_state": lfo.Periodic()} | further
    return lfo.OptimalControlProblem(dynamics, 40, **given)


def in_other_units(problem: lfo.OptimalControlProblem) -> lfo.OptimalControlProblem:
    x, u = np.array([1e6, 1e-3]), 1e-4
    dynamics, cost = problem.linear, problem.quadratic
    return replace(
        problem,
        dynamics=lfo.LinearDynamics(dynamics.A * x[:, None] / x, dynamics.B * x[:, None] / u),
        cost=lfo.QuadraticCost(Q=cost.Q / x / x[:, None], R=cost.R / u**2, x_ref=cost.x_ref * x),
        control_set=lfo.Box(-8 * u, 8 * u),
    )


@pytest.mark.parametrize("method", METHODS)
def test_verdicts_do_not_depend_on_units(method):
    problem = double_integrator()
    results = [lfo.solve(one, method=method) for one in (problem, in_other_units(problem))]
    assert all(result.certificate.globally_optimal for result in results)
    assert results[0].cost == pytest.approx(results[1].cost, rel=1e-9)


@pytest.mark.parametrize("change", [[1e-5, 0.0], [0.0, 1e-5]])
@pytest.mark.parametrize("units", [False, True])
def test_ends_that_differ_are_not_feasible(units, change):
    problem = in_other_units(double_integrator()) if units else double_integrator()
    result = lfo.solve(problem)
    x = result.trajectory.x.copy()
    x[-1] += np.array(change) * np.abs(x).max(0)
    certificate = lfo.certify(problem, lfo.Trajectory(x, result.trajectory.u), result.multipliers)
    assert not certificate.feasible
    assert "S-ends" in {condition.label for condition in certificate.failed}


def test_another_multiplier_of_the_ends_fails_at_transversality():
    problem = double_integrator()
    result = lfo.solve(problem)
    stage = {name: 1.001 * weights for name, weights in result.multipliers.stage.items()}
    certificate = lfo.certify(problem, result.trajectory, replace(result.multipliers, stage=stage))
    assert {condition.label for condition in certificate.failed} == {"C-iv"}


def test_the_multiplier_is_the_derivative_by_the_right_hand_side():
    def linked(e):
        return double_integrator(terminal_state=lfo.sets.LinkedEnds(-np.eye(2), np.eye(2), e))

    result, near = lfo.solve(linked([0.1, 0.2])), 1e-5
    slopes = [(lfo.solve(linked([0.1, 0.2] + near * one)).cost - result.cost) / near for one in np.eye(2)]
    assert -result.multipliers.stage["linked ends"][0] == pytest.approx(np.array(slopes), rel=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_a_contradiction_is_proven_and_explained(method):
    problem = double_integrator(
        control_set=lfo.Box(0.1, 8), state_set=lfo.Box(-100, 100)
    )  # the velocity grows at every step
    result = lfo.solve(problem, method=method, throw=False)
    with pytest.raises(InfeasibleError, match="periodic ends"):
        raise_for(result)
    proof = prove_infeasible(problem, result.ray)
    assert proof is not None
    assert proof.bound.kind == "rigorous"
    assert "periodic ends, t = 0, 40" in [str(one) for one in proof.conflict]
    less = replace(result.ray, stage={"periodic ends": -result.ray.stage["periodic ends"]})
    assert prove_infeasible(problem, less) is None


def test_a_rate_limit_an_output_band_and_the_export_keep_it():
    outputs = lfo.spectrum.OutputSpectrum(np.eye(2), np.zeros((2, 1)), lfo.low_pass(1.0))
    problem = lfo.rate_limited(double_integrator(output_spectrum=outputs), 8.0)
    result = lfo.solve(problem)
    assert result.certificate.globally_optimal
    assert result.trajectory.x[0, :2] == pytest.approx(result.trajectory.x[-1, :2])
    program = lfo.to_cvxpy(problem)
    program.solve(solver="CLARABEL")
    assert program.value == pytest.approx(result.cost, rel=1e-6)


CLOSED: dict[str, dict[str, object]] = {
    "bounds": {"control_set": lfo.Box(-1.5, 1.5)},
    "state bounds": {"state_set": lfo.Box([-0.5, None], [0.5, None])},
    "a bound on x_T": {"terminal_state": lfo.Periodic() & lfo.Box([0.3, None], None)},
    "a bound on x_0": {"initial_state": lfo.Box([0.3, None], None)},
    "a band": {"control_spectrum": lfo.low_pass(0.6)},
    "rows": {"stage_rows": lfo.StageRows([[1.0, 0.0]], [[0.1]], [0.4])},
}


@pytest.mark.parametrize("name", CLOSED)
def test_the_fourier_domain_method_closes_the_period(name):
    problem = double_integrator(**CLOSED[name])  # whose integrators have the eigenvalue of bin 0
    result = lfo.solve(problem, method="spectral")
    assert result.certificate.globally_optimal
    assert certificate_of_claim(problem).globally_optimal
    assert abs(result.certificate.gap) < 1e-12
    assert result.cost == pytest.approx(lfo.solve(problem, method="structured").cost, rel=1e-8)


@pytest.mark.parametrize("seed", seeds(range(0, 12, 2)))
def test_the_fourier_domain_method_agrees_on_random_problems(seed):
    given = random_problem(seed)
    problem = replace(given, cost=replace(given.quadratic, P=np.zeros((3, 3))))
    result = lfo.solve(problem, method="spectral")
    assert result.certificate.globally_optimal
    assert result.cost == pytest.approx(lfo.solve(problem, method="structured").cost, rel=1e-8)


@pytest.mark.parametrize(
    "change",
    [
        {"initial_state": [0.0, 0.0]},
        {"cost": lfo.QuadraticCost(R=1.0, P=1.0)},
        {"terminal_state": lfo.sets.LinkedEnds(-np.eye(2), np.eye(2))},
        {"state_set": lfo.sets.Soft(lfo.Box(-1, 1), 1.0)},
    ],
)
def test_the_fourier_domain_method_refuses_other_links(change):
    problem = double_integrator(**change)
    with pytest.raises(UnsupportedError, match="linked otherwise"):
        lfo.solve(problem, method="spectral")
    assert lfo.solve(problem).certificate.globally_optimal


def test_a_solver_of_a_period_takes_no_free_end():
    solver = lfo.SpectralSolver(double_integrator())
    with pytest.raises(ProblemError, match=r"terminal_state.*the ends are periodic"):
        solver.solve(terminal_state=lfo.sets.Everything())


# --- spectra of states -----------------------------------------------------------------------------------------------


def with_states(
    one: lfo.spectrum.FrequencyConstraint, horizon: int = 40, **further: object
) -> lfo.OptimalControlProblem:
    times, h = np.arange(horizon + 1), 0.1
    square = np.sign(np.sin(2 * np.pi * (times + 0.5) / horizon))
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=0.01, x_ref=np.column_stack([square, 0 * times]))
    dynamics = lfo.LinearDynamics([[1.0, h], [0.0, 1.0]], [[h * h / 2], [h]])
    given = {"control_set": lfo.Box(-8, 8), "state_spectrum": one} | further
    return lfo.OptimalControlProblem(dynamics, horizon, cost, terminal_state=lfo.Periodic(), **given)


SPECTRA = {
    "band": lfo.low_pass(1.0, component=0),
    "mask": lfo.MagnitudeBound(1.0, band=lfo.low_pass(0.4), component=0),
    "energy": lfo.spectrum.EnergyBound(2.0, band=lfo.low_pass(0.4), component=0),
    "every frequency": lfo.MagnitudeBound(1.0, band=lfo.low_pass(0.4), component=0, every_frequency=True),
}


@pytest.mark.parametrize("horizon", [40, 41])
@pytest.mark.parametrize("name", seeds(SPECTRA))
def test_spectra_of_states_are_those_of_outputs_with_t_samples(name, horizon):
    problem = with_states(SPECTRA[name], horizon)
    outputs = lfo.spectrum.OutputSpectrum(np.eye(2), np.zeros((2, 1)), SPECTRA[name])
    expected = lfo.solve(replace(problem, state_spectrum=None, output_spectrum=outputs)).cost
    methods = (*METHODS, *(["spectral"] if name == "band" else []))
    for result in (lfo.solve(problem, method=method) for method in methods):
        assert result.certificate.globally_optimal
        assert result.certificate.pmp == "satisfied"
        # between the points of the last round, peaks are up to 1e-9 above a mask
        assert result.cost == pytest.approx(expected, rel=1e-8 if name == "every frequency" else 1e-9)
    free = lfo.solve(replace(problem, state_spectrum=None)).cost
    assert expected > free * (1 + 1e-6)  # it is active


def test_a_state_band_of_a_period_agrees_with_cvxpy():
    for problem in (with_states(SPECTRA["band"], 41), lfo.rate_limited(with_states(SPECTRA["band"], 41), 8.0)):
        program = lfo.to_cvxpy(problem)
        program.solve(solver="CLARABEL")
        assert lfo.solve(problem).cost == pytest.approx(program.value, rel=1e-6)


@pytest.mark.parametrize("method", ["convex", "structured", "spectral"])
def test_what_is_wrong_with_a_state_band_of_a_period_fails_at_its_label(method):
    problem = with_states(SPECTRA["band"], 41)
    result = lfo.solve(problem, method=method)
    x, u = result.trajectory.x, result.trajectory.u
    wave = 1e-6 * np.linalg.norm(x[:, 0]) * np.cos(2 * np.pi * 15 * np.arange(42) / 41)
    moved = x + np.column_stack([wave, 0 * wave])
    certificate = lfo.certify(problem, lfo.Trajectory(moved, u), result.multipliers)
    assert "C-vi" in {condition.label for condition in certificate.failed}
    rho = result.multipliers.rho_x.copy()
    rho[np.argmax(np.abs(rho[:, 0])), 0] *= 1.1  # by 0.001, it would be worth less than a millionth of the cost
    certificate = lfo.certify(problem, result.trajectory, replace(result.multipliers, rho_x=rho))
    assert {condition.label for condition in certificate.failed} == {"C-iii", "C-iv"}
    with pytest.raises(ProblemError, match=r"rho_x.*shape"):
        lfo.certify(problem, result.trajectory, replace(result.multipliers, rho_x=np.zeros((22, 2))))


@expensive
def test_state_bands_of_a_period_in_other_units_and_that_contradict_bounds():
    result = lfo.solve(with_states(SPECTRA["band"], 41))
    scaled = in_other_units(with_states(SPECTRA["band"], 41))
    again = lfo.solve(
        replace(scaled, cost=replace(scaled.quadratic, Q=1e-9 * scaled.quadratic.Q, R=1e-9 * scaled.quadratic.R))
    )
    assert again.certificate.pmp == "satisfied"
    assert again.cost == pytest.approx(1e-9 * result.cost, rel=1e-9)
    lower = [[0.5 if t < 15 else None, None] for t in range(42)]
    bounds = lfo.Box(lower, [[-0.5 if 20 < t < 35 else None, None] for t in range(42)])
    only_constant = lfo.low_pass(0.01, component=0)
    for method in METHODS:
        problem = with_states(only_constant, 41, state_set=bounds)
        result = lfo.solve(problem, method=method, throw=False)
        assert (result.status, result.bound) == ("infeasible", "rigorous")  # without a bounded control
        proof = prove_infeasible(problem, result.ray)
        assert proof is not None
        assert "state stop band on x_0" in " ".join(map(str, proof.conflict))


def test_equations_over_all_times_of_a_period_have_t_matrices():
    mean = lfo.spectrum.LinearConstraint(np.tile([[1.0, 0.0]], (41, 1, 1)), [2.0])
    result = lfo.solve(with_states(mean, 41))
    assert result.certificate.pmp == "satisfied"
    assert result.trajectory.x[:-1, 0].sum() == pytest.approx(-2.0)
    with pytest.raises(ProblemError, match=r"\(42, 1, 2\).*\(41, 1, 2\)"):
        with_states(lfo.spectrum.LinearConstraint(np.tile([[1.0, 0.0]], (42, 1, 1)), [2.0]), 41)


@expensive
def test_a_period_with_a_state_band_is_written_and_reported(tmp_path, blank):
    lfo.io.write_problem(with_states(SPECTRA["band"], 41), tmp_path / "problem.toml")
    loaded = lfo.read_problem(tmp_path / "problem.toml")
    assert loaded.state_samples == 41
    compared = lfo.compare(loaded, filters=[])
    page = compared.save(tmp_path / "report")
    assert re.search(r"7\D+20 of x_0", page.read_text())
    lfo.solve(loaded).save(tmp_path / "solution.npz")
    saved = lfo.load(tmp_path / "solution.npz")
    assert lfo.certify(loaded, saved.trajectory, saved.multipliers).pmp == "satisfied"


# --- controls alone --------------------------------------------------------------------------------------------------

WITHOUT_A_START: dict[str, dict[str, object]] = {
    "periodic ends": {},
    "a band": {"control_spectrum": lfo.low_pass(0.6)},
    "linked ends": {"terminal_state": lfo.sets.LinkedEnds(np.eye(2), np.eye(2), [0.1, 0.2])},
    "a box of initial states": {"terminal_state": None, "initial_state": lfo.Box([-1, -2], [0.5, 2])},
}


@pytest.mark.parametrize("name", WITHOUT_A_START)
def test_controls_alone_get_the_initial_state_that_makes_them_cheapest(name):
    problem = double_integrator(**WITHOUT_A_START[name])
    result = lfo.solve(problem)
    certificate = lfo.certify(problem, result.trajectory.u)
    assert certificate.globally_optimal
    assert certificate.cost == pytest.approx(result.cost, rel=1e-9)
    worse = lfo.certify(problem, 0.9 * result.trajectory.u)
    assert worse.feasible
    assert worse.pmp == "violated"
    assert worse.cost > 1.001 * result.cost


def test_controls_that_leave_the_sets_are_judged_where_their_ends_meet():
    problem = double_integrator(state_set=lfo.Box([-0.5, None], [0.5, None]))
    certificate = lfo.certify(problem, 2 * lfo.solve(problem).trajectory.u)
    assert {condition.label for condition in certificate.failed if condition.on_feasibility} == {"S-x"}


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1.0, 1e3, 1e9])
def test_rest_at_the_edge_of_a_ball_is_proven_where_a_norm_is_zero_and_the_cost_is_not(unit):
    """No Newton step leads there; the repair of a point beside it moves x_0 into the ball.

    The cost is linear, at least (0.3 * 6 + 0.5) * 0.8.
    """
    cost = lfo.QuadraticCost(q=[0.3, -0.2], r=[0.1], p=[0.5, 0.1])
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0, 1.0], [0.0, 1.0]], [[0.5], [1.0]]),
        6,
        cost + lfo.costs.SmoothCost(stage="norm(x_1, 0.131*u_0)"),
        control_set=lfo.Box(-unit, unit),
        state_set=lfo.Box(-5 * unit, 5 * unit),
        initial_state=lfo.sets.Ball(0.2 * unit, [unit, 0.0]),
        terminal_state=lfo.Periodic(),
    )
    result = lfo.solve(problem)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(1.84 * unit, rel=1e-9)
