"""A map of a user's own, on two times at once, by the structured method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.sparse as sp

import lin_freq_ocp as lfo
from helpers.linear_kinds import COST, PLANT, T
from lin_freq_ocp.methods import SolveOptions
from lin_freq_ocp.methods.structured import solve_structured
from lin_freq_ocp.problem import MatrixMap, NonsmoothCost, NormBall, Term, TermKind


@dataclass(frozen=True, eq=False)
class Changes(MatrixMap):
    """v_t = size (u_{t+1} - u_t)."""

    steps: int
    size: np.ndarray
    sign: float = -1.0

    @property
    def shape(self):
        return self.steps - 1, len(self.size)

    @property
    def positions(self):
        return np.arange(self.steps - 1)

    @property
    def additions(self):
        return 2.0

    def values(self, x, u):
        return self.size * (u[1:] + self.sign * u[:-1])

    def pull_back(self, weights, shapes):
        of_x, of_u = (np.zeros(shape) for shape in shapes)
        of_u[1:] += self.size * weights
        of_u[:-1] += self.sign * self.size * weights
        return of_x, of_u

    def rows(self, horizon, n, m):
        later = sp.eye_array(horizon - 1, horizon, k=1) + self.sign * sp.eye_array(horizon - 1, horizon)
        of_u = sp.kron(later, np.diag(self.size))
        return sp.csr_array(sp.hstack([sp.csr_array((of_u.shape[0], (horizon + 1) * n)), of_u])), np.zeros(
            of_u.shape[0]
        )

    def magnitudes(self):
        return Changes(self.steps, np.abs(self.size), 1.0)


class Variation(NonsmoothCost):
    """The total variation of the controls, or the sum of the norms of their changes."""

    label = "variation"

    def __init__(self, order: float):
        self.order = order

    def own_terms(self, n, m, horizon, field, name):
        norm = NormBall(self.order, np.zeros(()), np.ones(()))
        return [Term(name, TermKind.STAGE_COST, Changes(horizon, np.array([0.1, 0.05])), norm)]

    def describe(self):
        return "the variation of the controls"

    def augmented(self, n, k):
        return self


@pytest.mark.parametrize("order", [1, 2, np.inf])
def test_it_is_solved_and_certified(order):
    problem = lfo.OptimalControlProblem(
        PLANT, T, COST + Variation(order), initial_state=[1.0, -0.5], control_set=lfo.Box(-0.5, 0.5)
    )
    (found,) = solve_structured(problem, SolveOptions(compiled=False))
    assert found.status == "optimal"
    assert found.trajectory is not None
    assert lfo.certify(problem, found.trajectory, found.multipliers).globally_optimal
    known = lfo.solve(problem, method="convex").cost
    assert problem.value(found.trajectory.x, found.trajectory.u) == pytest.approx(known, rel=1e-8)
    changes = np.abs(np.diff(found.trajectory.u, axis=0))
    assert (changes < 1e-6).any()  # some controls stay the same
    assert (changes > 1e-3).any()
