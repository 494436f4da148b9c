"""A convex function and a cost of a user's own, defined here and nowhere in the package."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.sparse as sp

import lin_freq_ocp as lfo
from lin_freq_ocp.problem import ConicForm, NonsmoothCost, Penalty, StageMap, Term, TermKind
from lin_freq_ocp.testing import check_terms


@dataclass(frozen=True, eq=False)
class WeightedMax(Penalty):
    """h(v) = price * max(0, scale_1 v_1, scale_2 v_2, ...), group by group."""

    scale: np.ndarray
    price: float

    @property
    def weights(self):
        return np.asarray(self.price)

    def excess(self, v):
        return (self.scale * v).max(1, keepdims=True)

    def excess_slope(self, v, change, near):
        scaled = self.scale * v
        largest = scaled >= scaled.max(1, keepdims=True) - near
        return np.where(largest, self.scale * change, -np.inf).max(1, keepdims=True)

    def recession(self, change):
        return self.excess(change)

    def subgradient(self, multipliers, eta_C):
        fitting = np.maximum(multipliers, 0.0)  # of price times the hull of 0 and scale_i e_i
        total, most = (fitting / self.scale).sum(1, keepdims=True), eta_C * self.price
        return fitting * np.where(total > most, most / np.where(total > 0, total, 1.0), 1.0)

    def gap(self, v, multipliers, eta_C):
        return (eta_C * self.cost(v) - (multipliers * v).sum(1))[:, None]

    def least_slacks(self, v):
        return np.maximum(self.excess(v), 0.0).ravel()

    def conic(self, groups, dim):
        """Return v_i - s / scale_i <= 0 and s >= 0, a slack for each group."""
        entries, identity = np.arange(groups * dim), sp.eye_array(groups)
        columns = sp.kron(identity, -1 / self.scale[:, None])
        return ConicForm(
            np.append(entries, np.full(groups, -1)),
            np.append(np.full(groups * dim, -np.inf), np.zeros(groups)),
            np.append(np.zeros(groups * dim), np.full(groups, np.inf)),
            sp.csr_array(sp.vstack([columns, identity])),
            np.full(groups, self.price),
            entries.reshape(groups, dim),
        )


class WorstThrust(NonsmoothCost):
    """price * sum_t max(0, scale_j u_t,j): one-sided, as of thrusters."""

    label = "worst thrust"

    def __init__(self, scale, price: float):
        self.penalty = WeightedMax(np.asarray(scale, dtype=float), price)

    def own_terms(self, n, m, horizon, field, name):
        thrust = StageMap(np.arange(horizon), None, np.eye(m), np.zeros(m))
        return [Term(name, TermKind.STAGE_COST, thrust, self.penalty)]

    def describe(self):
        return "the largest weighted thrust"

    def augmented(self, n, k):
        return self


COST = WorstThrust([1.0, 2.0], 0.05)


def problem(*costs) -> lfo.OptimalControlProblem:
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0, 1]], [[0, 0], [0.1, -0.2]])
    cost = sum(costs, lfo.QuadraticCost(Q=np.diag([1.0, 0.1]), R=0.01))
    sets = {"control_set": lfo.Box(-1, 2), "initial_state": [-1.0, 0.2]}
    return lfo.OptimalControlProblem(dynamics, 40, cost, **sets)


def test_it_is_solved_and_certified():
    result, without = lfo.solve(problem(COST)), lfo.solve(problem())
    assert result.certificate.globally_optimal
    x, u = result.trajectory.x, result.trajectory.u
    thrust = 0.05 * np.maximum((u * [1.0, 2.0]).max(1), 0.0).sum()
    assert result.cost == pytest.approx(problem().value(x, u) + thrust, rel=1e-9)
    assert without.cost + 1e-3 < result.cost
    assert not lfo.certify(problem(COST), without.trajectory).globally_optimal


def test_it_is_exported():
    program = lfo.to_cvxpy(problem(COST))
    program.solve(solver="CLARABEL")
    assert program.value == pytest.approx(lfo.solve(problem(COST)).cost, rel=1e-6)


def test_it_stands_beside_other_costs_and_describes_itself():
    both = problem(COST, lfo.costs.L1Cost(x=0.1), COST)
    assert [term.name for term in both.terms] == ["worst thrust", "L1 cost of states", "worst thrust 2"]
    assert "the largest weighted thrust" in both._repr_html_()
    assert lfo.solve(both).certificate.globally_optimal
    assert lfo.solve(lfo.rate_limited(problem(COST), 0.5)).certificate.globally_optimal


def test_it_keeps_the_protocols():
    assert check_terms(problem(COST)) == []
