"""Answers: known optima, every way a solve can end, the choice of method, multipliers as sensitivities, units."""

import time
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.backends import clarabel_
from lin_freq_ocp.backends.base import Claim, Solution
from lin_freq_ocp.methods.convex import sparse_program as convex
from lin_freq_ocp.methods.spectral import SpectralSolver
from lin_freq_ocp.testing.reference import INSTANCES, PENDULUM, STATED, reference_problem
from lin_freq_ocp.transcription.program import Block

METHODS = pytest.mark.parametrize("method", ["auto", "convex"])
"""The default, which is "spectral" wherever that applies, and the sparse program."""


@pytest.mark.parametrize(
    "how", [{"method": "spectral"}, {"backend": "clarabel"}, {"backend": "qpsolvers:piqp"}], ids=str
)
@pytest.mark.parametrize("name", PENDULUM)
def test_pendulum(name, how):
    keywords, optimum = PENDULUM[name]
    result = lfo.solve(lfo.library.pendulum(**keywords), **how)
    assert result.cost == pytest.approx(optimum, rel=1e-7)
    assert_proven(result)


@pytest.mark.parametrize("name", PENDULUM)
def test_pendulum_by_osqp(name):
    keywords, optimum = PENDULUM[name]
    assert lfo.solve(lfo.library.pendulum(**keywords), backend="osqp").cost == pytest.approx(optimum, rel=1e-5)


@METHODS
@pytest.mark.parametrize(("cutoff", "optimum"), [(0.8 * np.pi, 3611.455894278), (None, 3204.426641194)])
def test_physical_pendulum(cutoff, optimum, method):
    result = lfo.solve(lfo.library.pendulum(parameters="physical", cutoff=cutoff), method=method)
    assert result.cost == pytest.approx(optimum, rel=1e-7)
    assert_proven(result)


@METHODS
@pytest.mark.parametrize("name", STATED)
def test_reference_problems(name, method):
    result = lfo.solve(reference_problem(name), method=method)
    assert result.cost == pytest.approx(INSTANCES[name]["optimal_value"], rel=1e-7)
    assert_proven(result)


def test_the_reference_problem_with_a_mask():
    result = lfo.solve(reference_problem("dint200_soft"))
    assert result.cost == pytest.approx(INSTANCES["dint200_soft"]["optimal_value"], rel=1e-6)
    assert_proven(result)


def assert_proven(result):
    assert result.status == "optimal"
    assert result.primal
    assert result.dual
    certificate = result.certificate
    assert certificate.pmp == "satisfied"
    assert certificate.normal
    assert certificate.worst.relative < 1e-6
    assert certificate.gap < 1e-6
    bound = certificate.bound
    outside = -np.minimum(bound.stage_gaps, 0).sum()  # a point a rounding error outside its set can gain on it
    infeasibility = abs(bound.dynamics_term) + abs(bound.frequency_term) + outside
    assert certificate.lower_bound <= result.cost + infeasibility


@METHODS
@pytest.mark.parametrize("gain", [1e-9, 1e9])
def test_the_unit_of_an_unbounded_control_does_not_matter(gain, method):
    """x_10 = 1 by ten equal controls of 0.1/gain, however large or small that is."""
    integrator = lfo.LinearDynamics([[1.0]], [[gain]])
    cost = lfo.QuadraticCost(R=gain**2)
    problem = lfo.OptimalControlProblem(integrator, 10, cost, initial_state=[0.0], terminal_state=[1.0])
    result = lfo.solve(problem, method=method)
    assert result.control * gain == pytest.approx(np.full((10, 1), 0.1))
    assert result.cost == pytest.approx(0.05)
    assert result.certificate.pmp == "satisfied"


def test_without_any_cost_every_feasible_trajectory_is_extremal():
    double = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0], [0.1]])
    ends = {"initial_state": [0, 0], "terminal_state": [1, 0]}
    result = lfo.solve(lfo.OptimalControlProblem(double, 20, lfo.QuadraticCost(), lfo.Box(-3, 3), **ends))
    assert_proven(result)
    assert result.cost == 0


class TestEndings:
    @pytest.mark.parametrize(("method", "solver"), [("auto", "spectral"), ("convex", "convex, clarabel")])
    def test_infeasible(self, method, solver):
        with pytest.raises(lfo.errors.InfeasibleError, match=r"control bound on force \[N\]") as caught:
            lfo.solve(lfo.library.pendulum(control_bound=1.0), method=method)
        result = caught.value.result
        assert result.solver == solver
        assert result.status == "infeasible"
        assert result.cost is None
        assert result.dual
        assert not result.primal

    @pytest.mark.parametrize("backend", ["osqp", "qpsolvers:piqp", "qpsolvers:highs"])
    def test_infeasible_whichever_backend_met_it(self, backend):
        result = lfo.solve(lfo.library.pendulum(control_bound=1.0), backend=backend, throw=False)
        assert (result.status, result.backend) == ("infeasible", backend)
        assert result.conflict

    def test_unbounded(self):
        integrator = lfo.LinearDynamics([[1.0]], [[1.0]])
        problem = lfo.OptimalControlProblem(integrator, 10, lfo.QuadraticCost(r=[1.0]), initial_state=[0.0])
        with pytest.raises(lfo.errors.UnboundedError, match="no lower bound"):
            lfo.solve(problem)

    def test_infeasible_comes_before_unbounded(self):
        """The second state falls for ever, but the first cannot reach its end."""
        two = lfo.LinearDynamics(np.eye(2), np.eye(2))
        sets = {"control_set": lfo.Box([-1, None], [1, None]), "initial_state": [0, 0]}
        cost = lfo.QuadraticCost(r=[0.0, 1.0])
        with pytest.raises(lfo.errors.UnboundedError):
            lfo.solve(lfo.OptimalControlProblem(two, 5, cost, **sets))
        with pytest.raises(lfo.errors.InfeasibleError):
            lfo.solve(lfo.OptimalControlProblem(two, 5, cost, **sets, terminal_state=lfo.Box([9, None], [9, None])))

    @METHODS
    def test_limit_keeps_the_best_point(self, method):
        with pytest.raises(lfo.errors.LimitError) as caught:
            lfo.solve(lfo.library.pendulum(horizon=480), method=method, time_limit=1e-3)
        assert caught.value.result.trajectory is not None
        assert not caught.value.result.certificate.globally_optimal

    def test_a_solver_that_lies_is_not_believed(self, monkeypatch):
        def liar(program, tolerance, time_limit):
            honest = clarabel_.solve(program, tolerance, time_limit)
            return Solution(Claim.SOLVED, 1e3 + honest.z[::-1], 1e3 + honest.y[::-1], "Solved")

        monkeypatch.setattr(convex, "backend", lambda name: liar)
        with pytest.raises(lfo.errors.NumericalError, match="residuals are too large"):
            lfo.solve(lfo.library.pendulum(), method="convex")

    def test_a_false_ray_is_not_believed(self, monkeypatch):
        def liar(program, tolerance, time_limit):
            return Solution(Claim.INFEASIBLE, None, np.ones(len(program.lower)), "PrimalInfeasible")

        monkeypatch.setattr(convex, "backend", lambda name: liar)
        with pytest.raises(lfo.errors.InfeasibleError, match=r"not proven .*its ray proves nothing") as caught:
            lfo.solve(lfo.library.pendulum(), method="convex")
        assert not caught.value.proven

    @pytest.mark.parametrize("method", ["auto", "spectral", "convex"])
    def test_nonconvex_cost_is_refused_with_its_eigenvalue(self, method):
        problem = replace(lfo.library.pendulum(), cost=lfo.QuadraticCost(R=-2.0))
        with pytest.raises(lfo.errors.UnsupportedError, match="eigenvalue -2"):
            lfo.solve(problem, method=method)

    @pytest.mark.parametrize("bad", [{"method": "magic"}, {"backend": "magic"}, {"time_limit": 0}, {"tolerance": -1}])
    def test_bad_options(self, bad):
        with pytest.raises(lfo.errors.UnsupportedError, match=next(iter(bad))):
            lfo.solve(lfo.library.pendulum(), **bad)


DOUBLE = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0], [0.1]])
ENDS = {"initial_state": [0, 0], "terminal_state": [1, 0]}


def outside_the_spectral_class():
    """Return problems that the Fourier-domain method cannot take, each with the reason."""
    rising = np.linspace(1, 2, 20)[:, None, None]
    bounded = lfo.OptimalControlProblem(DOUBLE, 20, lfo.QuadraticCost(R=1.0), lfo.Box(-3, 3), **ENDS)
    limit = lfo.StageRows(rising * [[0, 1]], None, [2.0])
    linear = lfo.QuadraticCost(q=[1.0, 0.0], r=[0.1])
    return {
        "A over time": (reference_problem("ltv200"), "A or B depends on time"),
        "Q over time": (replace(bounded, cost=lfo.QuadraticCost(Q=rising * np.eye(2), R=1.0)), "Q, R or S depends on"),
        "rows over time": (replace(bounded, stage_rows=limit), "C or D of a stage row depends on time"),
        "a linear cost": (replace(bounded, cost=linear), "neither Q nor R"),
        "no cost": (replace(bounded, cost=lfo.QuadraticCost()), "neither Q nor R"),
    }


def claiming(change):
    """Return SpectralSolver.solve with its honest answer changed."""
    honest = SpectralSolver.solve

    def solve(self, *given, **named):
        return change(honest(self, *given, **named))

    return solve


def off_the_dynamics(answer):
    return replace(answer, trajectory=lfo.Trajectory(answer.trajectory.x * (1 + 1e-3), answer.trajectory.u))


def with_other_prices(answer):
    return replace(answer, multipliers=replace(answer.multipliers, eta=answer.multipliers.eta * 1.01))


def feasible_but_dearer(answer):
    other = replace(answer.problem, cost=lfo.QuadraticCost(Q=100.0, R=2.0))
    return replace(answer, trajectory=lfo.solve(other, method="convex").trajectory)


def without_prices(answer):
    return replace(answer, multipliers=None)


def infeasible_with(ray):
    def change(answer):
        multipliers = None if ray is None else ray(answer.multipliers)
        return replace(answer, status="infeasible", trajectory=None, multipliers=None, ray=multipliers)

    return change


def ended_with(status):
    return lambda answer: replace(answer, status=status, message="gave up")


class TestChoiceOfMethod:
    def test_the_default_is_spectral_and_names_no_backend(self):
        result = lfo.solve(lfo.library.pendulum())
        assert (result.method, result.backend, result.solver) == ("spectral", None, "spectral")
        assert_proven(result)

    @pytest.mark.parametrize("backend", ["clarabel", "osqp"])
    def test_a_named_backend_is_used(self, backend):
        result = lfo.solve(lfo.library.pendulum(), backend=backend)
        assert (result.method, result.backend, result.solver) == ("convex", backend, f"convex, {backend}")

    def test_spectral_refuses_a_named_backend(self):
        with pytest.raises(lfo.errors.UnsupportedError, match="backend: got 'clarabel' for the method 'spectral'"):
            lfo.solve(lfo.library.pendulum(), method="spectral", backend="clarabel")

    @pytest.mark.parametrize("case", outside_the_spectral_class())
    def test_spectral_refuses_with_the_reason_and_auto_takes_the_sparse_program(self, case):
        problem, reason = outside_the_spectral_class()[case]
        with pytest.raises(lfo.errors.UnsupportedError, match=f"method 'spectral': {reason}.*Use method 'convex'"):
            lfo.solve(problem, method="spectral")
        result = lfo.solve(problem)
        assert (result.method, result.backend) == ("convex", "clarabel")
        assert_proven(result)

    @pytest.mark.parametrize(
        "lie",
        [
            off_the_dynamics,
            with_other_prices,
            feasible_but_dearer,
            without_prices,
            infeasible_with(None),
            infeasible_with(lambda honest: honest),
            infeasible_with(lambda honest: replace(honest, eta_C=0.0)),
        ],
        ids=[
            "off the dynamics",
            "other prices",
            "feasible but dearer",
            "no prices",
            "no ray",
            "prices as a ray",
            "false ray",
        ],
    )
    def test_what_spectral_cannot_prove_is_left_to_the_sparse_program(self, lie, monkeypatch):
        monkeypatch.setattr(SpectralSolver, "solve", claiming(lie))
        result = lfo.solve(lfo.library.pendulum())
        assert (result.method, result.backend) == ("convex", "clarabel")
        assert result.cost == pytest.approx(3199.18631986, rel=1e-7)
        assert_proven(result)

    @pytest.mark.parametrize("status", ["numerical_error", "unbounded", "limit"])
    def test_a_point_that_is_proven_is_optimal_whatever_its_solver_says(self, status, monkeypatch):
        monkeypatch.setattr(SpectralSolver, "solve", claiming(ended_with(status)))
        result = lfo.solve(lfo.library.pendulum())
        assert (result.status, result.method) == ("optimal", "spectral")
        assert_proven(result)

    @pytest.mark.parametrize("lie", [off_the_dynamics, with_other_prices, feasible_but_dearer])
    def test_spectral_alone_keeps_its_answer_and_the_judge_says_what_it_is(self, lie, monkeypatch):
        monkeypatch.setattr(SpectralSolver, "solve", claiming(lie))
        result = lfo.solve(lfo.library.pendulum(), method="spectral", throw=False)
        assert result.method == "spectral"
        assert result.certificate.pmp == "violated"

    @pytest.mark.parametrize("ray", [None, lambda honest: replace(honest, eta_C=0.0)])
    def test_a_false_ray_of_spectral_alone_is_not_believed(self, ray, monkeypatch):
        monkeypatch.setattr(SpectralSolver, "solve", claiming(infeasible_with(ray)))
        with pytest.raises(lfo.errors.InfeasibleError, match=r"not proven .*its ray proves nothing") as caught:
            lfo.solve(lfo.library.pendulum(), method="spectral")
        assert not caught.value.proven
        result = caught.value.result
        assert result.status == "infeasible_claimed"
        assert (result.method, result.ray, result.conflict, result.dual) == ("spectral", None, None, False)

    def test_a_limit_is_an_answer(self, monkeypatch):
        """The time is over, or Ctrl-C was pressed: another method would only take longer."""
        for interrupted in (False, True):
            stop = ended_with("limit")
            monkeypatch.setattr(
                SpectralSolver,
                "solve",
                claiming(
                    lambda answer, stop=stop, by=interrupted: replace(stop(off_the_dynamics(answer)), interrupted=by)
                ),
            )
            result = lfo.solve(lfo.library.pendulum(), throw=False)
            assert (result.status, result.method, result.interrupted) == ("limit", "spectral", interrupted)
            assert result.trajectory is not None
            monkeypatch.undo()

    @pytest.mark.parametrize(("limit", "least", "most"), [(None, None, None), (60.0, 30.0, 59.95), (0.01, 0.0, 0.01)])
    def test_both_methods_share_one_time_limit(self, limit, least, most, monkeypatch):
        """What the first has used the second has not; a thousandth of a second is always left, for its words."""
        given = []

        def slow(answer):
            time.sleep(0.05)
            return ended_with("numerical_error")(off_the_dynamics(answer))

        def noting(problem, backend, tolerance, time_limit):
            given.append(time_limit)
            return convex.convex_candidates(problem, backend, tolerance, time_limit)

        monkeypatch.setattr(SpectralSolver, "solve", claiming(slow))
        monkeypatch.setattr(import_module("lin_freq_ocp.solving.linear"), "convex_candidates", noting)
        lfo.solve(lfo.library.pendulum(), time_limit=limit, throw=False)
        assert len(given) == 1
        assert given[0] is None if limit is None else least < given[0] < most


class TestShapesOfProblems:
    @METHODS
    def test_free_end_and_boxed_ends(self, method):
        ends = lfo.Box([-0.15, None, -0.1, None], [-0.14, None, 0.1, None])
        pendulum = replace(lfo.library.pendulum(), initial_state=ends, terminal_state=None)
        result = lfo.solve(replace(pendulum, cost=lfo.QuadraticCost(Q=1.0, R=2.0, P=3.0)), method=method)
        assert_proven(result)
        assert np.all(ends.violation(result.trajectory.x[0]) < 1e-8)

    @METHODS
    def test_one_step(self, method):
        """Minimise u^2 + x_1^2 with x_1 = 2 + u: u = -1."""
        problem = lfo.OptimalControlProblem(
            lfo.LinearDynamics([[1.0]], [[1.0]]), 1, lfo.QuadraticCost(R=2.0, P=2.0), initial_state=[2.0]
        )
        result = lfo.solve(problem, method=method)
        assert result.control == pytest.approx(np.array([[-1.0]]))
        assert result.cost == pytest.approx(2.0)
        assert_proven(result)

    @METHODS
    def test_everything_removed_leaves_the_drift(self, method):
        with pytest.warns(lfo.errors.BandWarning, match="removes every bin"):
            problem = lfo.OptimalControlProblem(
                lfo.LinearDynamics([[0.5]], [[1.0]]),
                8,
                lfo.QuadraticCost(Q=2.0, R=1.0),
                initial_state=[1.0],
                control_spectrum=lfo.spectrum.band_pass(0.5, 0.6),
            )
        result = lfo.solve(problem, method=method)
        assert np.abs(result.control).max() < 1e-9
        assert result.cost == pytest.approx(sum(0.25**t for t in range(8)))
        assert_proven(result)

    @METHODS
    def test_time_varying_bounds_and_references(self, method):
        T = 40
        reference = np.sin(np.arange(T + 1) / 6)[:, None]
        problem = lfo.OptimalControlProblem(
            lfo.LinearDynamics([[1.0]], [[0.4]], offset=0.01 * np.ones((T, 1))),
            T,
            lfo.QuadraticCost(Q=1.0, R=1e-3, P=1.0, x_ref=reference),
            control_set=[lfo.Box(-1, 0.2 if t < 10 else 1.0) for t in range(T)],
            initial_state=[0.0],
            control_spectrum=lfo.low_pass(2.0),
        )
        result = lfo.solve(problem, method=method)
        assert_proven(result)
        assert result.control[:10].max() <= 0.2 + 1e-9


@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1e3, 1e6])
def test_the_unit_of_cost_does_not_matter(factor):
    problem = replace(lfo.library.pendulum(), cost=lfo.QuadraticCost(R=2.0 * factor))
    for how in ({"method": "spectral"}, {"backend": "clarabel"}, {"backend": "osqp"}):
        result = lfo.solve(problem, **how)
        assert result.cost / factor == pytest.approx(3199.18631986, rel=1e-6)
        assert result.certificate.pmp == "satisfied"


def test_mixed_units_do_not_matter():
    """Kilometres, microradians, mm/s and rad/h; force in millinewtons."""
    pendulum = lfo.library.pendulum()
    unit, force = np.array([1e-3, 1e6, 1e3, 3600.0]), 1e3
    A, B = pendulum.dynamics.A, pendulum.dynamics.B
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(unit[:, None] * A / unit, unit[:, None] * B / force, sampling_time=0.01),
        240,
        lfo.QuadraticCost(R=2.0 / force**2),
        control_set=lfo.Box(-5 * force, 5 * force),
        state_set=lfo.Box(unit * pendulum.state_set.lower, unit * pendulum.state_set.upper),
        initial_state=unit * pendulum.initial_state.lower,
        terminal_state=unit * pendulum.terminal_state.lower,
        control_spectrum=lfo.low_pass(0.8 * np.pi),
    )
    for how in ({"method": "spectral"}, {"backend": "clarabel"}, {"backend": "osqp"}):
        result = lfo.solve(problem, **how)
        assert result.cost == pytest.approx(3199.18631986, rel=1e-6)
        assert result.certificate.pmp == "satisfied"


@pytest.mark.parametrize(("k", "component"), [(97, 0), (97, 1), (110, 0), (110, 1), (120, 0)])
def test_the_price_of_a_bin(k, component, solved):
    """d J*/d uhat_k = -rho_u[k]: moving the real (0) or imaginary (1) part of one bin, its conjugate with it."""
    problem, step = solved("paper, constrained").problem, 1e-3
    stopped = np.flatnonzero(problem.control_stop[:, 0])
    row = 2 * int(np.searchsorted(stopped, k)) + component
    single = 2 * k == problem.horizon
    unit = np.sqrt((1 if single else 2) / problem.horizon)

    def cost(move):
        transcription, scaling, program = convex.scaled_program(problem)
        shift = np.zeros(len(program.lower))
        shift[program.rows[Block.CONTROL_SPECTRUM].start + row] = unit * move
        shift *= scaling.rows
        moved = replace(program, lower=program.lower + shift, upper=program.upper + shift)
        trajectory = transcription.trajectory(scaling.primal(clarabel_.solve(moved, 1e-12, None).z))
        assert np.fft.rfft(trajectory.u[:, 0])[k] == pytest.approx(move * (1j if component else 1), abs=1e-9)
        return problem.cost.value(trajectory.x, trajectory.u)

    price = -solved("paper, constrained").multipliers.rho_u[k, 0]
    slope = (cost(step) - cost(-step)) / (2 * step)
    assert slope == pytest.approx(price.imag if component else price.real, rel=1e-4, abs=1e-4)


def test_sensitivity_to_the_initial_state(solved):
    """d J*/d x_0 = mu_0 with the sign of the Lagrangian: L contains <mu_0, x_0 - xbar>, so it is -mu_0."""
    result, step = solved("paper, constrained"), 1e-6
    for i in range(4):
        costs = []
        for sign in (1, -1):
            start = result.problem.initial_state.lower.copy()
            start[i] += sign * step
            costs.append(lfo.solve(replace(result.problem, initial_state=start), tolerance=1e-12).cost)
        assert (costs[0] - costs[1]) / (2 * step) == pytest.approx(-result.multipliers.mu[0, i], rel=1e-3)


class TestCertify:
    def test_somebody_elses_solution(self, solved):
        result = solved("velocity bound")
        certificate = lfo.certify(result.problem, result.trajectory)
        assert certificate.pmp == "satisfied"
        assert certificate.globally_optimal

    def test_a_control_alone(self, solved):
        result = solved("paper, constrained")
        certificate = lfo.certify(result.problem, result.control)
        assert certificate.globally_optimal

    def test_a_feasible_point_that_is_not_optimal(self, solved):
        """The optimum of another cost is feasible here, and violates only what says optimal."""
        result = solved("paper, constrained")
        other = lfo.solve(replace(result.problem, cost=lfo.QuadraticCost(Q=100.0, R=2.0)))
        certificate = lfo.certify(result.problem, other.trajectory)
        assert certificate.pmp == "violated"
        assert certificate.feasible
        assert not certificate.globally_optimal
        assert certificate.lower_bound <= result.cost

    def test_a_wrong_shape(self, solved):
        result = solved("paper, constrained")
        with pytest.raises(lfo.errors.ProblemError, match=r"trajectory: got x \(240, 4\)"):
            lfo.certify(result.problem, lfo.Trajectory(result.trajectory.x[1:], result.control[1:]))


def test_a_result_in_eight_lines(solved):
    default = solved("paper, constrained")
    for result, solver in (
        (default, "method    spectral"),
        (lfo.solve(default.problem, method="convex"), "method    convex, clarabel"),
    ):
        lines = str(result).splitlines()
        assert len(lines) <= 9
        assert solver in lines
        for word in ("optimal", "3199.186", "rigorous", "satisfied, normal"):
            assert word in "\n".join(lines)


def test_results_in_one_line(solved):
    result = solved("paper, constrained")
    line = repr(result)
    assert line.startswith("Result(optimal by spectral, cost 3199.186")
    assert f"gap {result.gap:.2e}" in line
    assert repr(result.certificate).startswith("Certificate(globally optimal, theorem satisfied, cost 3199.186")
    assert str(result.certificate) in str(result)
    assert repr(result.problem) == f"OptimalControlProblem({result.problem})"
    wrong = lfo.certify(result.problem, lfo.Trajectory(result.trajectory.x + 1, result.control))
    assert repr(wrong).startswith("Certificate(not feasible, theorem violated, cost")
    for one in (result, result.certificate, result.problem, wrong):
        assert len(repr(one)) < 200
        assert "\n" not in repr(one)


def test_results_cannot_be_changed(solved):
    result = solved("paper, constrained")
    for array in (result.trajectory.x, result.control, result.multipliers.eta, result.multipliers.rho_u):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
