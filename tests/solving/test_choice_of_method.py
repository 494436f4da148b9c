"""Which method solves a problem, and what follows where one of them fails."""

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.proofs import assert_proven
from helpers.random.linear import random_linear
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp import SpectralSolver
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.methods import convex_candidates
from lin_freq_ocp.results import Status
from lin_freq_ocp.testing import reference_problem

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
        return replace(answer, status=Status.INFEASIBLE, trajectory=None, multipliers=None, ray=multipliers)

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

    @expensive
    @pytest.mark.parametrize(
        "lie",
        [
            without_prices,
            infeasible_with(None),
            infeasible_with(lambda honest: honest),
            infeasible_with(lambda honest: replace(honest, eta_C=0.0)),
        ],
        ids=["no prices", "no ray", "prices as a ray", "false ray"],
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
    def test_a_wrong_point_is_repaired_or_corrected(self, lie, monkeypatch):
        """Whatever is wrong: the trajectory, its multipliers, or its active rows."""
        monkeypatch.setattr(SpectralSolver, "solve", claiming(lie))
        result = lfo.solve(lfo.library.pendulum(), method="spectral")
        assert result.cost == pytest.approx(3199.18631986, rel=1e-9)
        assert_proven(result)

    def test_a_point_that_cannot_be_corrected_is_no_optimum(self, monkeypatch):
        """No certificate says more than its own multipliers do where repair and correction fail."""
        substitute(monkeypatch, "methods.repair_trajectory", lambda *given: None)
        substitute(monkeypatch, "methods.corrections", lambda *given: ())
        result = lfo.solve(lfo.library.pendulum(), method="spectral", throw=False)
        assert result.status == "locally_optimal"
        assert "no trajectory that satisfies every constraint is known to cost" in result.message

    @pytest.mark.parametrize("ray", [None, lambda honest: replace(honest, eta_C=0.0)])
    def test_a_false_ray_of_spectral_alone_is_not_believed(self, ray, monkeypatch):
        monkeypatch.setattr(SpectralSolver, "solve", claiming(infeasible_with(ray)))
        with pytest.raises(lfo.errors.InfeasibleError, match=r"without a proof .*its ray proves nothing") as caught:
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
                    lambda answer, stop=stop, by=interrupted: replace(stop(feasible_but_dearer(answer)), interrupted=by)
                ),
            )
            result = lfo.solve(lfo.library.pendulum(), throw=False)
            assert (result.status, result.method, result.interrupted) == ("limit", "spectral", interrupted)
            assert result.trajectory is not None
            monkeypatch.undo()

    @expensive
    @pytest.mark.parametrize(("limit", "left"), [(None, None), (60.0, 10.0), (40.0, 1e-3)])
    def test_both_methods_share_one_time_limit(self, limit, left, monkeypatch):
        """What the first has used the second has not; a thousandth of a second is always left, for its words."""
        given, clock = [], Clock()

        def slow(answer):
            clock.seconds += 50.0
            return ended_with("numerical_error")(without_prices(answer))

        def noting(problem, backend, options, programs):
            given.append(options.time_limit)
            return convex_candidates(problem, backend, options, programs)

        monkeypatch.setattr(SpectralSolver, "solve", claiming(slow))
        substitute(monkeypatch, "methods.convex_candidates", noting)
        with use_clock(clock):
            lfo.solve(lfo.library.pendulum(), time_limit=limit, throw=False)
        assert given == [left]


def test_a_feasible_point_refutes_rays():
    """A nilpotent plant ends where its offsets put it, up to four rounding errors: two methods believe their rays.

    Without any rounding, no trajectory ends where it shall, and the multipliers of the third prove that.
    """
    problem = random_linear(2148).problem
    rays = [lfo.solve(problem, method, throw=False) for method in ("spectral", "structured")]
    assert {(ray.status, ray.primal, ray.ray) for ray in rays} == {("numerical_error", True, None)}
    assert all("the controls nearest to zero satisfy all constraints" in ray.message for ray in rays)
    result = lfo.solve(problem, throw=False)
    assert (result.status, result.bound, result.method) == ("infeasible", "rigorous", "convex")
