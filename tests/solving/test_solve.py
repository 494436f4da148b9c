"""Answers: known optima, every way a solve can end, multipliers as sensitivities, units."""

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.proofs import assert_proven
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.program import Block, Claim, Solution, scaled_program, solve
from lin_freq_ocp.testing import INSTANCES, PENDULUM, STATED, reference_problem

METHODS = pytest.mark.parametrize("method", ["auto", "convex"])
"""The default, which is "spectral" wherever that applies, and the sparse program."""


@pytest.mark.parametrize(
    "how", [{"method": "spectral"}, {"backend": "clarabel"}, {"backend": "qpsolvers:piqp"}], ids=str
)
@pytest.mark.parametrize("name", seeds(PENDULUM))
def test_pendulum(name, how):
    keywords, optimum = PENDULUM[name]
    result = lfo.solve(lfo.library.pendulum(**keywords), **how)
    assert result.cost == pytest.approx(optimum, rel=1e-7)
    assert_proven(result)


@pytest.mark.parametrize("name", seeds(PENDULUM))
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
@pytest.mark.parametrize("name", seeds(STATED))
def test_reference_problems(name, method):
    result = lfo.solve(reference_problem(name), method=method)
    assert result.cost == pytest.approx(INSTANCES[name]["optimal_value"], rel=1e-7)
    assert_proven(result)


def test_the_reference_problem_with_a_mask():
    result = lfo.solve(reference_problem("dint200_soft"))
    assert result.cost == pytest.approx(INSTANCES["dint200_soft"]["optimal_value"], rel=1e-6)
    assert_proven(result)


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
    @expensive
    @pytest.mark.parametrize(("method", "solver"), [("auto", "spectral"), ("convex", "convex, clarabel")])
    def test_infeasible(self, method, solver):
        with pytest.raises(lfo.errors.InfeasibleError, match=r"control bound on force \[N\]") as caught:
            lfo.solve(lfo.library.pendulum(horizon=60, control_bound=1.0), method=method)
        result = caught.value.result
        assert result.solver == solver
        assert result.status == "infeasible"
        assert result.cost is None
        assert result.dual
        assert not result.primal

    @pytest.mark.parametrize("backend", ["osqp", "qpsolvers:piqp", "qpsolvers:highs"])
    def test_infeasible_whichever_backend_met_it(self, backend):
        result = lfo.solve(lfo.library.pendulum(horizon=60, control_bound=1.0), backend=backend, throw=False)
        assert (result.status, result.backend) == ("infeasible", backend)
        assert result.conflict

    def test_unbounded(self):
        integrator = lfo.LinearDynamics([[1.0]], [[1.0]])
        problem = lfo.OptimalControlProblem(integrator, 10, lfo.QuadraticCost(r=[1.0]), initial_state=[0.0])
        with pytest.raises(lfo.errors.UnboundedError, match="no lower bound"):
            lfo.solve(problem)

    @expensive
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
        with use_clock(Clock(1.0)), pytest.raises(lfo.errors.LimitError) as caught:
            lfo.solve(lfo.library.pendulum(horizon=480), method=method, time_limit=3.0)
        assert caught.value.result.trajectory is not None
        assert not caught.value.result.certificate.globally_optimal

    @expensive
    def test_a_solver_that_lies_is_not_believed(self, monkeypatch):
        def liar(program, tolerance, time_limit):
            honest = solve(program, tolerance, time_limit)
            return Solution(Claim.SOLVED, 1e3 + honest.z[::-1], 1e3 + honest.y[::-1], "Solved")

        substitute(monkeypatch, "program.backend", lambda name: liar)
        with pytest.raises(lfo.errors.NumericalError, match="residuals are too large"):
            lfo.solve(lfo.library.pendulum(horizon=60), method="convex")

    def test_a_false_ray_is_not_believed(self, monkeypatch):
        def liar(program, tolerance, time_limit):
            return Solution(Claim.INFEASIBLE, None, np.ones(len(program.lower)), "PrimalInfeasible")

        substitute(monkeypatch, "program.backend", lambda name: liar)
        with pytest.raises(lfo.errors.InfeasibleError, match=r"without a proof .*its ray proves nothing") as caught:
            lfo.solve(lfo.library.pendulum(horizon=60), method="convex")
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


@pytest.mark.parametrize("factor", seeds([1e-6, 1e-3, 1e3, 1e6]))
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


@pytest.mark.parametrize(("k", "component"), seeds([(97, 0), (97, 1), (110, 0), (110, 1), (120, 0)]))
def test_the_price_of_a_bin(k, component, solved):
    """d J*/d uhat_k = -rho_u[k]: moving the real (0) or imaginary (1) part of one bin, its conjugate with it."""
    problem, step = solved("paper, constrained").problem, 1e-3
    stopped = np.flatnonzero(problem.control_stop[:, 0])
    row = 2 * int(np.searchsorted(stopped, k)) + component
    single = 2 * k == problem.horizon
    unit = np.sqrt((1 if single else 2) / problem.horizon)

    def cost(move):
        linear, scaling, program = scaled_program(problem)
        shift = np.zeros(len(program.lower))
        shift[program.rows[Block.CONTROL_SPECTRUM].start + row] = unit * move
        shift *= scaling.rows
        moved = replace(program, lower=program.lower + shift, upper=program.upper + shift)
        trajectory = linear.trajectory(scaling.primal(solve(moved, 1e-12, None).z))
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
