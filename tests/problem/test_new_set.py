"""A convex set of a user's own, defined here and nowhere in the package: solved, certified, exported, extended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import turn
from lin_freq_ocp.problem import HARD, ConvexSet, HalfSpaces, Part, StandardCone
from lin_freq_ocp.testing import check_terms


@dataclass(frozen=True, eq=False)
class RoundedSimplex(ConvexSet):
    """{v >= 0 : sum v <= total, |W v| <= sum v + 0.1}: bounds, a half-space and an ellipsoidal cone."""

    W: np.ndarray
    total: float

    @property
    def dimension(self) -> int:
        return self.W.shape[1]

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(self.dimension), np.full(self.dimension, np.inf)

    def parts(self, dimension: int) -> tuple[Part, ...]:
        ones = np.ones((1, dimension))
        simplex = Part(ones, np.zeros(1), HalfSpaces(np.array([self.total]), HARD))
        cone = Part(np.vstack([ones, self.W]), np.append(0.1, np.zeros(len(self.W))), StandardCone())
        return simplex, cone

    def describe(self, names, signal) -> str:
        return f"{signal} in a rounded simplex"


SET = RoundedSimplex(np.array([[1.5, 0.2], [0.0, 1.2]]), 0.5)
ROUND = RoundedSimplex(np.eye(2), 9.0)


def problem(horizon=40, **further) -> lfo.OptimalControlProblem:
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0, 1]], [[0, 0], [0.1, -0.1]])
    cost = lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), R=0.01)
    return lfo.OptimalControlProblem(dynamics, horizon, cost, **({"initial_state": [-1.0, 0.0]} | further))


def test_it_is_solved_and_certified():
    result = lfo.solve(problem(control_set=SET))
    assert result.certificate.globally_optimal
    assert result.cost > lfo.solve(problem(control_set=lfo.Box(0, None))).cost + 1e-3
    assert SET.contains(result.trajectory.u, 1e-7).all()
    assert lfo.certify(problem(control_set=SET), result.trajectory).globally_optimal


def test_it_is_exported_and_combined():
    result = lfo.solve(problem(control_set=SET & lfo.Box(None, 0.3)))
    program = lfo.to_cvxpy(problem(control_set=SET & lfo.Box(None, 0.3)))
    program.solve(solver="CLARABEL")
    assert program.value == pytest.approx(result.cost, rel=1e-6)


def test_it_may_hold_at_some_times_and_describes_itself():
    given = problem(control_set=[SET if t % 2 else lfo.Box(0, 1) for t in range(40)])
    assert lfo.solve(given).certificate.globally_optimal
    assert "a rounded simplex" in problem(control_set=SET)._repr_html_()


def test_it_is_kept_where_states_are_added():
    slow = lfo.rate_limited(problem(control_set=lfo.Box(-1, 1), state_set=ROUND, initial_state=[2.0, 1.0]), 0.5)
    assert slow.state_dim == 4
    result = lfo.solve(slow)
    assert result.certificate.globally_optimal
    assert ROUND.contains(result.trajectory.x[:, :2], 1e-7).all()


def test_it_keeps_the_protocols():
    assert check_terms(problem(control_set=SET)) == []
    assert check_terms(problem(state_set=ROUND, initial_state=[2.0, 1.0])) == []


@turn(2)
def test_it_is_relaxed_where_a_conflict_is_explained():
    impossible = problem(12, control_set=SET & lfo.Box(None, 50.0), terminal_state=[10.0, 0.0])
    assert lfo.solve(impossible, throw=False).status == "infeasible"
    assert "control set" in str(lfo.explain(impossible))
