"""Certificates of trajectories from elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks import pairs
from helpers.checks.alone import any_problem
from helpers.seeds import expensive
from lin_freq_ocp.certificate import Condition


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


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_overflow_proves_nothing():
    """inf <= 1e-6 * inf: x_{t+1} = 2 x_t + u_t fails at every time here, by more than a float can say."""
    assert not Condition("C-iii", "state equation", np.inf, np.inf, 1e-6).passed
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics([[2.0]], [[1.0]]), 4, lfo.QuadraticCost())
    trajectory = lfo.Trajectory(1e308 * np.array([[1.0], [-1.0], [1.0], [-1.0], [1.0]]), np.full((4, 1), 1e308))
    zero = lfo.results.Multipliers(
        1.0, np.zeros((4, 1)), np.zeros((5, 1)), np.zeros((4, 1)), np.zeros((3, 1)), np.zeros((3, 1))
    )
    certificate = lfo.certify(problem, trajectory, zero)
    assert certificate.pmp == "violated"
    assert not certificate.feasible


def test_multipliers_of_an_answer_without_a_proof_are_those_of_the_trajectory_too():
    """By one method, this problem is optimal; by the other, no more than locally, without a rigorous bound."""
    problem = any_problem(10)
    result = lfo.solve(problem, "structured")
    assert lfo.certify(problem, result.trajectory).pmp == "satisfied"


@expensive
@pytest.mark.parametrize(
    "features", [("path constraint",), ("path constraint", "joint rows"), ("path constraint", "low pass")]
)
@pytest.mark.parametrize("away", [1e-15, 1e-14, 1e-13, 1e-12, 1e-10, 1e-8])
def test_controls_alone_of_an_answer_near_its_set_point_are_right_and_others_wrong(features, away):
    """Doubles near 0.6 are 1e-16 apart: the states are rounded by up to a tenth of themselves, the controls are not."""
    problem = replace(pairs.problem_of(*features), initial_state=lfo.sets.Point([0.6 + away, 0.0]))
    result = lfo.solve(problem, pairs.quick_method(problem), throw=False)
    assert lfo.certify(problem, result).pmp == "satisfied"
    assert lfo.certify(problem, result.trajectory.u).pmp == "satisfied"
    if away >= 1e-10:  # else 0.1 % of the states is about their rounding
        assert {lfo.certify(problem, part * result.trajectory.u).pmp for part in (0.999, 1.001)} == {"violated"}


def test_multipliers_of_another_kind_are_refused_with_the_field():
    result = lfo.solve(lfo.library.pendulum())
    with pytest.raises(
        lfo.errors.ProblemError, match=r"multipliers: got 'x'; expected Multipliers.*result.multipliers"
    ):
        lfo.certify(result.problem, result.trajectory, multipliers="x")
