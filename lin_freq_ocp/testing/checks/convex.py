"""A random convex problem, solved here and by CVXPY on a program written by ``to_cvxpy``, and judged."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import cvxpy as cp

import lin_freq_ocp as lfo
from lin_freq_ocp.testing.random_convex import random_problem

COST_AGREEMENT = 1e-6
"""Relative difference of two costs from solvers that stop at 1e-8 or better."""


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
    difference = None
    if status == "optimal":
        difference = abs(result.cost - float(str(oracle.value))) / max(1.0, abs(result.cost))
    extremal = certificate.pmp == "satisfied"
    numerical = certificate.bound is not None and certificate.bound.kind == "numerical"
    proven = extremal and (certificate.globally_optimal or (numerical and result.status == "locally_optimal"))
    agrees = difference is None or difference <= COST_AGREEMENT
    bound = None if certificate.bound is None else certificate.bound.kind
    worst = certificate.worst.relative
    return Outcome(
        seed, kind, result.status, status, difference, certificate.gap, worst, bound, extremal, proven and agrees
    )
