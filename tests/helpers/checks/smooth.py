"""Random smooth problems without bounds: where IPOPT has an answer there is one, and no saddle is called a minimum.

The Hessian of the Lagrangian and the Jacobian of all equations are CasADi's, dense, with multipliers of least squares:
eigenvalues of the first on the null space of the second decide what a point is, independently of the judge's recursion.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from importlib import import_module

import numpy as np
import scipy.linalg as la
from benchmark.ipopt import cost_of_signals, map_of, solved_by_ipopt

import lin_freq_ocp as lfo
from helpers.random.smooth import kind_of, random_problem
from lin_freq_ocp.methods.hybrid import LocalSearch

SADDLE = 1e-6  # eigenvalue below zero, relative to the largest, at which a point is no minimum
BETTER = 1e-6  # relative difference of costs


@dataclass(frozen=True)
class Outcome:
    """What became of one problem: our status and cost, those of IPOPT, and the least relative eigenvalue."""

    seed: int
    kind: str
    status: str
    cost: float
    claim: str
    claimed: float
    eigenvalue: float

    @property
    def verdict(self) -> str:
        """Return "right", or what is wrong."""
        solved = lfo.results.Status(self.status).solved
        if not solved:
            return "no answer" if self.claim == "Solve_Succeeded" else "right"
        if self.status == "locally_optimal" and self.eigenvalue < -SADDLE:
            return "a saddle is called a minimum"
        return "a minimum is called a saddle" if self.status == "extremal" and self.eigenvalue > SADDLE else "right"

    @property
    def worse(self) -> bool:
        """Whether IPOPT has a better optimum."""
        return self.claim == "Solve_Succeeded" and self.cost > self.claimed + BETTER * (abs(self.claimed) + BETTER)


def check(seed: int) -> Outcome:
    """Solve the problem of a seed by both, and look at the eigenvalues where our answer is."""
    problem = random_problem(seed)
    start = next(LocalSearch(problem).starts())[0]
    claim = solved_by_ipopt(problem, start)
    result = lfo.solve(problem, global_bound=False, throw=False)
    at = result.trajectory
    cost, eigenvalue = (np.inf, np.nan) if at is None else (result.cost, least_eigenvalue(problem, at))
    return Outcome(seed, kind_of(seed), str(result.status), float(cost), claim.status, claim.cost, eigenvalue)


def least_eigenvalue(problem: lfo.OptimalControlProblem, at: lfo.Trajectory) -> float:
    """Return the least eigenvalue of the dense projected Hessian of the Lagrangian, relative to the largest."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of the types that CasADi's binding makes
        casadi = import_module("casadi")
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    X, U = casadi.MX.sym("X", n, T + 1), casadi.MX.sym("U", m, T)
    y, ends = casadi.vertcat(casadi.vec(X), casadi.vec(U)), (problem.initial_box, problem.terminal_box)
    rows = [casadi.vec(X[:, 1:] - map_of(casadi, problem).map(T)(casadi.vertcat(X[:, :T], U)))]
    rows += [X[np.flatnonzero(box.fixed).tolist(), t] for box, t in zip(ends, (0, T), strict=True) if box.fixed.any()]
    equations, cost = casadi.vertcat(*rows), cost_of_signals(casadi, problem, X, U)
    multipliers = casadi.MX.sym("l", equations.numel())
    lagrangian = cost + casadi.dot(multipliers, equations)
    slopes = casadi.Function("slopes", [y], [casadi.gradient(cost, y), casadi.jacobian(equations, y)])
    hessian = casadi.Function("hessian", [y, multipliers], [casadi.hessian(lagrangian, y)[0]])
    point = np.concatenate([at.x.ravel(), at.u.ravel()])
    gradient, J = (np.array(part.full()) for part in slopes(point))
    fitted = la.lstsq(J.T, -gradient[:, 0])[0]
    Z = la.null_space(J)
    values = np.linalg.eigvalsh(Z.T @ np.array(hessian(point, fitted).full()) @ Z)
    return float(values[0] / max(np.abs(values).max(), 1e-300))
