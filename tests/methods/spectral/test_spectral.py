"""The Fourier-domain method on known problems: accuracy, multipliers, limits, units, one thread."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from helpers.spectral_plants import TIGHT, T, problem_of, residuals, wave
from lin_freq_ocp.methods.spectral import Data, Exchange, Structure, WorkingSet, verified_ray
from lin_freq_ocp.problem import time_signal
from lin_freq_ocp.testing import INSTANCES, PENDULUM, STATED, reference_problem

LTI = [name for name in STATED if name != "ltv200"]
LONG = {  # pendulum: horizon, sampling time; and the gap that the certificate must prove
    "open loop grows by 3e46": (240, 0.1, 1e-8),
    "T = 1000": (1000, 0.0024, 1e-8),
    "T = 5000, fine": (5000, 0.00048, 2e-8),
    "T = 10 000": (10_000, 0.01, 1e-8),
}


def adjoint_residual(problem: lfo.OptimalControlProblem, answer: Any) -> float:
    """Return the worst residual of adjoint equation, transversality and stationarity, relative to max |eta|."""
    one, (x, u), T = answer.multipliers, (answer.trajectory.x, answer.trajectory.u), problem.horizon
    in_x, in_u = problem.cost.gradient(x, u)
    in_x, in_u = in_x + one.mu + time_signal(one.rho_x, T + 1), in_u + one.nu + time_signal(one.rho_u, T)
    for term in problem.terms:
        on_x, on_u = term.map.pull_back(one.stage[term.name], (x.shape, u.shape))
        in_x += on_x
        in_u += on_u
    adjoint = in_x.copy()
    adjoint[:-1] -= one.eta @ problem.dynamics.A
    adjoint[1:] += one.eta
    through_u = (in_u - one.eta @ problem.dynamics.B) / max(1.0, np.abs(problem.dynamics.B).max())
    return max(np.abs(adjoint).max(), np.abs(through_u).max()) / np.abs(one.eta).max()


def relative_violation(problem: lfo.OptimalControlProblem, trajectory: lfo.Trajectory) -> float:
    """Return the worst violation of a bound, relative to the largest bound of its component."""
    worst = 0.0
    for tube, signal in ((problem.state_tube, trajectory.x), (problem.control_tube, trajectory.u)):
        bounds = np.abs(np.stack([tube.lower, tube.upper]))
        largest = np.where(np.isfinite(bounds), bounds, 0.0).max((0, 1))
        worst = max(worst, (tube.violation(signal) / np.where(largest > 0, largest, 1.0)).max())
    return worst


def assert_accurate(
    problem: lfo.OptimalControlProblem, answer: lfo.solvers.SpectralSolution, gap: float = 1e-8
) -> float:
    """Check the figures that the method promises; return the cost."""
    assert answer.status == "optimal", answer.message
    measured = residuals(problem, answer.trajectory)
    assert relative_violation(problem, answer.trajectory) <= 1e-9
    assert measured["dynamics"] <= 1e-12
    assert measured["control bands"] <= 1e-12
    assert adjoint_residual(problem, answer) <= 1e-12
    certificate = lfo.certify(problem, answer.trajectory, answer.multipliers)
    assert certificate.pmp == "satisfied"
    assert certificate.normal
    assert -1e-12 < certificate.gap <= gap
    return certificate.cost


@pytest.mark.parametrize("name", LTI)
def test_known_problems_are_solved_to_nine_digits(name):
    problem = reference_problem(name)
    cost = assert_accurate(problem, lfo.SpectralSolver(problem).solve())
    assert cost == pytest.approx(INSTANCES[name]["optimal_value"], rel=1e-9)


@pytest.mark.parametrize("name", PENDULUM)
def test_the_pendulum_is_solved_to_all_known_digits(name):
    arguments, known = PENDULUM[name]
    problem = lfo.library.pendulum(**arguments)
    cost = assert_accurate(problem, lfo.SpectralSolver(problem).solve())
    assert cost == pytest.approx(known, rel=1e-11)


@expensive
@pytest.mark.parametrize("name", LONG)
def test_long_and_unstable_pendulums_are_proven_optimal(name):
    horizon, sampling_time, gap = LONG[name]
    problem = lfo.library.pendulum(horizon=horizon, sampling_time=sampling_time)
    answer = lfo.SpectralSolver(problem).solve()
    assert_accurate(problem, answer, gap)
    assert np.abs(answer.trajectory.u).max() > 0.9 * 5 or sampling_time == 0.1


@expensive
@pytest.mark.parametrize("name", ["double_integrator", "two_mass_spring", "flexible_satellite"])
def test_library_problems_agree_with_the_sparse_program(name):
    problem = lfo.library.by_name(name)()
    cost = assert_accurate(problem, lfo.SpectralSolver(problem).solve())
    assert cost == pytest.approx(lfo.solve(problem, method="convex", tolerance=1e-11).cost, rel=1e-8)


UNIQUE: dict[str, dict[str, Any]] = {
    "control bounds and bands": {"control_set": TIGHT},
    "joint rows": {"stage_rows": lfo.StageRows([[1.0, 0, 0.5], [0, -1.0, 0]], [[1.0, 0], [0, 1.0]], [1.0, 0.62])},
    "state bounds and bands": {
        "state_set": lfo.Box([-0.45, -0.51, -0.25], 1.1),
        "state_spectrum": lfo.stop_band(bins=[7], component=2),
        "terminal_state": None,
        "cost": lfo.QuadraticCost(Q=0.3, R=1.0, P=1.0, p=[0.5, 0, 0], x_ref=wave(T + 1, 3, 0.5, 7)),
    },
}


@pytest.fixture(scope="module", params=UNIQUE)
def pair(request):
    problem = problem_of(**UNIQUE[request.param])
    return lfo.solve(problem, method="spectral"), lfo.solve(problem, method="convex", tolerance=1e-12)


def fields_of(multipliers: lfo.results.Multipliers) -> dict[str, np.ndarray]:
    fields = {name: getattr(multipliers, name) for name in ("eta", "mu", "nu", "rho_u", "rho_x")}
    return fields | {f"stage {name}": rows for name, rows in multipliers.stage.items()}


def test_multipliers_are_those_of_the_sparse_program(pair):
    ours, theirs = pair
    size = np.abs(ours.multipliers.eta).max()
    expected = fields_of(theirs.multipliers)
    for name, value in fields_of(ours.multipliers).items():
        np.testing.assert_allclose(value, expected[name], atol=1e-6 * size, err_msg=name)
    np.testing.assert_allclose(ours.trajectory.u, theirs.trajectory.u, atol=1e-6)
    assert np.abs(ours.multipliers.rho_u).max() > 1e-3 * size


def test_every_multiplier_counts(pair):
    """Its sign changed, or left out, and the certificate is lost."""
    result, _ = pair
    fields = fields_of(result.multipliers)
    for name, value in fields.items():
        if np.abs(value).max() == 0:
            continue
        for factor in (-1.0, 0.0, 1.01):
            spoilt = fields | {name: factor * value}
            stage = {key[6:]: rows for key, rows in spoilt.items() if key.startswith("stage ")}
            plain = {key: rows for key, rows in spoilt.items() if not key.startswith("stage ")}
            judged = lfo.certify(result.problem, result.trajectory, lfo.results.Multipliers(1.0, **plain, stage=stage))
            assert judged.pmp == "violated", (name, factor)
    on_rows = [fields["nu"], fields["mu"][1:-1], *(rows for name, rows in fields.items() if name.startswith("stage "))]
    assert max(np.abs(rows).max() for rows in on_rows) > 1e-2


def test_an_answer_of_another_problem_is_not_certified():
    result = lfo.solve(problem_of(), method="spectral")
    tighter = problem_of(control_set=TIGHT)
    assert lfo.certify(tighter, result.trajectory, result.multipliers).pmp == "violated"


def test_the_solution_says_which_rows_are_active():
    problem = problem_of(control_set=TIGHT, state_set=lfo.Box([-1.15, -0.6, -0.4], 1.1))
    solution = lfo.SpectralSolver(problem).solve()
    t, f, sign = solution.active.t, solution.active.f, solution.active.sign
    y = np.hstack([solution.trajectory.x[t], solution.trajectory.u[np.minimum(t, T - 1)]])[np.arange(len(t)), f]
    lower = np.hstack([problem.state_tube.lower[:-1], problem.control_tube.lower])[t, f]
    upper = np.hstack([problem.state_tube.upper[:-1], problem.control_tube.upper])[t, f]
    np.testing.assert_allclose(y, np.where(sign > 0, upper, lower), atol=1e-12)
    assert {0, 1} & set(f)
    assert {3, 4} & set(f)
    assert 1 <= solution.rounds <= 10
    assert solution.problem is problem
    assert solution.seconds["setup"] > 0
    assert solution.seconds["solve"] > 0


@pytest.fixture(scope="module")
def stopped():
    """The pendulum, which needs several rounds, stopped after one."""
    problem = lfo.library.pendulum()
    return problem, lfo.solve(problem, method="spectral", time_limit=1e-9, throw=False)


def test_a_time_limit_leaves_a_point_that_obeys_the_equations(stopped):
    problem, result = stopped
    assert (result.status, result.message, result.interrupted) == ("limit", "time limit", False)
    measured = residuals(problem, result.trajectory)
    assert measured["dynamics"] < 1e-12
    assert measured["control bands"] < 1e-12
    np.testing.assert_allclose(result.trajectory.x[[0, -1]], problem.state_tube.lower[[0, -1]], atol=1e-12)
    assert not result.primal


def test_a_time_limit_leaves_a_valid_lower_bound(stopped):
    _, result = stopped
    optimum = PENDULUM["paper, constrained"][1]
    assert 0 < result.lower_bound < optimum * (1 + 1e-12)


def test_a_time_limit_leaves_a_point_that_misses_bounds(stopped):
    problem, _ = stopped
    solution = lfo.SpectralSolver(problem).solve(time_limit=1e-9)
    assert relative_violation(problem, solution.trajectory) > 1e-3
    assert (solution.status, solution.rounds) == ("limit", 1)


def test_with_a_time_limit_an_error_is_raised(stopped):
    with pytest.raises(lfo.errors.LimitError, match="time limit"):
        lfo.solve(stopped[0], method="spectral", time_limit=1e-9)


def test_a_loose_tolerance_ends_earlier():
    single = lfo.SpectralSolver(lfo.library.double_integrator())
    loose, tight = single.solve(tolerance=1e-3), single.solve()
    assert loose.rounds < tight.rounds
    assert 1e-6 < relative_violation(single.problem, loose.trajectory) < 1e-3
    assert relative_violation(single.problem, tight.trajectory) < 1e-9


def in_other_units(
    problem: lfo.OptimalControlProblem, x: np.ndarray, u: np.ndarray, cost: float
) -> lfo.OptimalControlProblem:
    """Return the problem in which states are x, controls u and costs ``cost`` times as large."""
    A, B, offset = problem.dynamics.A, problem.dynamics.B, problem.dynamics.offset
    one = problem.cost

    def box(tube: lfo.Box, units: np.ndarray) -> lfo.Box:
        return lfo.Box(tube.lower * units, tube.upper * units)

    return replace(
        problem,
        dynamics=lfo.LinearDynamics(A / x * x[:, None], B / u * x[:, None], offset * x),
        cost=lfo.QuadraticCost(
            Q=cost * one.Q / x / x[:, None],
            R=cost * one.R / u / u[:, None],
            S=cost * one.S / u / x[:, None],
            P=cost * one.P / x / x[:, None],
            q=cost * one.q / x,
            r=cost * one.r / u,
            p=cost * one.p / x,
            x_ref=one.x_ref * x,
            u_ref=one.u_ref * u,
        ),
        control_set=box(problem.control_tube, u),
        state_set=box(problem.state_tube, x),
        initial_state=None,
        terminal_state=None,
        stage_rows=[lfo.StageRows(rows.C / x, rows.D / u, rows.e, rows.name) for rows in problem.stage_rows],
    )


SOFT: dict[str, dict[str, Any]] = {
    "free start": {
        "initial_state": None,
        "cost": lfo.QuadraticCost(R=1.0, P=2.0, q=0.1 * wave(T, 3)),
        "state_set": lfo.Box(-2.0, 2.0),
    },
    "integrators": {
        "dynamics": lfo.LinearDynamics(np.eye(3) + 0.1 * np.eye(3, k=1), np.eye(3)[:, 1:], wave(T, 3, 0.01))
    },
}
UNITS: dict[str, tuple[Any, Any, float]] = {
    "one for all": ([1e3, 1e3, 1e3], [1e-4, 1e-4], 1e5),
    "one of each kind": ([1e3, 1.0, 1e-5], [1e4, 1e-3], 1e-7),
}


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("name", [*UNIQUE, *SOFT])
def test_units_do_not_matter(name, units):
    x, u, cost = (np.array(part) for part in UNITS[units])
    problem = problem_of(**(UNIQUE | SOFT)[name])
    plain = lfo.SpectralSolver(problem).solve()
    other = lfo.SpectralSolver(in_other_units(problem, x, u, float(cost))).solve()
    assert plain.status == other.status == "optimal"
    np.testing.assert_allclose(other.trajectory.x / x, plain.trajectory.x, atol=1e-7)
    np.testing.assert_allclose(other.trajectory.u / u, plain.trajectory.u, atol=1e-8)
    np.testing.assert_allclose(other.multipliers.eta * x / cost, plain.multipliers.eta, atol=1e-8)
    np.testing.assert_allclose(other.multipliers.rho_u * u / cost, plain.multipliers.rho_u, atol=1e-8)
    value = other.problem.cost.value(other.trajectory.x, other.trajectory.u)
    assert value / cost == pytest.approx(problem.cost.value(plain.trajectory.x, plain.trajectory.u), abs=2e-9)


@pytest.mark.parametrize("size", [1e2, 1e5, 1e9])
@pytest.mark.parametrize("start", [[1.0], lfo.Box(0.5, 1.0)], ids=["fixed", "boxed"])
def test_bounds_that_are_never_reached_do_not_matter(start, size):
    """Whoever writes 1e9 for "no bound" gets the same answer, or is told that it is not one."""
    dynamics, cost = lfo.LinearDynamics([[0.9]], [[1.0]]), lfo.QuadraticCost(R=1.0, q=[1.0])
    problem = lfo.OptimalControlProblem(dynamics, 20, cost, initial_state=start)
    unbounded = lfo.solve(problem, method="spectral").cost
    result = lfo.solve(replace(problem, control_set=lfo.Box(-size, size)), method="spectral", throw=False)
    assert result.status == "numerical_error" or result.cost == pytest.approx(unbounded, rel=1e-8)


def blas_threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_linear_algebra_runs_on_one_thread(monkeypatch):
    seen: dict[str, set[int]] = {}
    run, prepare = Exchange.run, Structure.__init__

    def noting(name: str, function: Any) -> Any:
        def noted(*args: Any, **kwargs: Any) -> Any:
            seen[name] = blas_threads()
            return function(*args, **kwargs)

        return noted

    monkeypatch.setattr(Exchange, "run", noting("solve", run))
    monkeypatch.setattr(Structure, "__init__", noting("setup", prepare))
    with threadpool_limits(2, user_api="blas"):
        outside = blas_threads()
        if outside == {1}:
            pytest.skip("this BLAS has one thread only")
        lfo.SpectralSolver(problem_of()).solve()
        assert blas_threads() == outside
    assert seen == {"setup": {1}, "solve": {1}}


def test_two_solves_give_the_same_bits():
    first, second = (lfo.SpectralSolver(lfo.library.pendulum()).solve() for _ in range(2))
    np.testing.assert_array_equal(first.trajectory.u, second.trajectory.u)
    np.testing.assert_array_equal(first.multipliers.eta, second.multipliers.eta)


def test_a_bound_that_a_free_end_can_move_away_from_is_no_ray():
    """Alone, x_T <= -1 contradicts x_T = 0; the free end has a slope there, and so no proof follows."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.5]], [[1.0]]),
        8,
        lfo.QuadraticCost(R=1.0),
        initial_state=[0.0],
        terminal_state=lfo.Box(-3, -1),
    )
    solver = lfo.SpectralSolver(problem)
    data = Data(Structure(solver.lti), solver.lti)
    working = WorkingSet(data.structure.kkt, solver.lti)
    working.add(np.array([8]), np.array([0]), np.ones(1))
    row = working.weighted(np.ones(1))
    assert (row.slacks(np.zeros((2, 8)), np.zeros(1)) < 0).all()
    assert verified_ray(data, row, np.zeros(len(data.e))) is None


def test_a_solver_takes_problems_of_the_same_structure():
    problem = lfo.library.double_integrator()
    solver = lfo.SpectralSolver(problem)
    other = replace(problem, cost=replace(problem.cost, r=[0.3]), initial_state=[0.1, 0.0], control_set=lfo.Box(-4, 4))
    found, known = solver.solve_similar(other), lfo.SpectralSolver(other).solve()
    assert found.problem is other
    np.testing.assert_allclose(found.trajectory.u, known.trajectory.u, atol=1e-9)
    assert solver.solve_similar(problem).status == "optimal"
    with pytest.raises(lfo.errors.ProblemError, match="terminal_state: got other fixed components than in the problem"):
        solver.solve_similar(replace(problem, terminal_state=None))
