"""A random convex problem, solved here and by CVXPY on a program written by ``to_cvxpy``, and judged."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import cvxpy as cp
import numpy as np

import lin_freq_ocp as lfo
from helpers.checks.spectral import EXPLAINING, cost_errors
from helpers.random.convex import random_problem

COST_AGREEMENT = 1e-6  # relative difference of two costs from solvers that stop at 1e-8 or better


@dataclass(frozen=True)
class Outcome:
    """What became of one random problem."""

    seed: int
    kind: str
    status: str
    oracle: str
    difference: float | None
    gap: float | None
    worst: float | None
    bound: str | None
    extremal: bool
    passed: bool
    explained: bool = False


def check(seed: int) -> Outcome:
    """Solve one random problem twice, and judge."""
    kind, problem = random_problem(seed)
    result = lfo.solve(problem, throw=False)
    oracle = lfo.to_cvxpy(problem)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # CVXPY's own "solution may be inaccurate": its status says so
        try:
            oracle.solve(solver="CLARABEL")
        except cp.SolverError as error:
            status = f"failed ({type(error).__name__})"
        else:
            status = str(oracle.status)
    if result.status == "infeasible":
        return Outcome(seed, kind, result.status, status, None, None, None, None, False, status != "optimal")
    certificate = result.certificate
    if certificate is None or result.cost is None:
        return Outcome(seed, kind, result.status, status, None, None, None, None, False, False)
    difference, agrees, explained = None, True, False
    if status == "optimal":
        difference = abs(result.cost - float(str(oracle.value))) / max(1.0, abs(result.cost))
        agrees = difference <= COST_AGREEMENT
        explained = not agrees and oracle_is_infeasible(problem, result, oracle)
    extremal = certificate.pmp == "satisfied"
    numerical = certificate.bound is not None and certificate.bound.kind == "numerical"
    proven = extremal and (certificate.globally_optimal or (numerical and result.status == "locally_optimal"))
    bound = None if certificate.bound is None else certificate.bound.kind
    worst, passed = certificate.worst.relative, proven and (agrees or explained)
    return Outcome(
        seed, kind, result.status, status, difference, certificate.gap, worst, bound, extremal, passed, explained
    )


def oracle_is_infeasible(problem: lfo.OptimalControlProblem, result: lfo.results.Result, oracle: cp.Problem) -> bool:
    """Whether CVXPY's cost is below ours because its point violates constraints: residuals times our multipliers.

    Of our own trajectory the same products must be worth less than the difference.
    """
    multipliers, ours = result.multipliers, result.trajectory
    assert multipliers is not None
    assert ours is not None
    values = {variable.name(): np.asarray(variable.value) for variable in oracle.variables()}
    theirs = lfo.Trajectory(values["x"], values["u"])

    def worth(at: lfo.Trajectory, other: lfo.Trajectory) -> float:
        errors = cost_errors(problem, at, multipliers, other)
        return sum(value for what, value in errors.items() if what != "duality gap")

    difference = problem.value(ours.x, ours.u) - problem.value(theirs.x, theirs.u)
    return worth(ours, theirs) < difference <= worth(theirs, ours) / EXPLAINING
