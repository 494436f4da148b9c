"""Small programs, with primal and dual known by hand, and how a backend is asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.methods import SOLVED_TOLERANCE
from lin_freq_ocp.program import Claim, Program, Solution, backend

OWN = ["clarabel", "osqp"]
INF = np.inf


def program(P: Any, q: Any, A: Any, lower: Any, upper: Any) -> Program:
    q = np.array(q, dtype=float)
    return Program(
        P=sp.csc_array(np.array(P, dtype=float).reshape(len(q), len(q))),
        q=q,
        A=sp.csc_array(np.array(A, dtype=float).reshape(-1, len(q))),
        lower=np.array(lower, dtype=float),
        upper=np.array(upper, dtype=float),
    )


@dataclass(frozen=True)
class Case:
    """A program with its only primal answer, and its only dual one or None where there are many."""

    program: Program
    z: list[float]
    y: list[float] | None


SOLVABLE = {
    # one variable: min 1/2 z^2 - z, whose free minimum is z = 1, so that y = 1 - z at whatever holds it back
    "upper": Case(program(1, [-1], [1], [-INF], [0.3]), [0.3], [0.7]),
    "lower": Case(program(1, [-1], [1], [1.5], [INF]), [1.5], [-0.5]),
    "equation below": Case(program(1, [-1], [1], [0.3], [0.3]), [0.3], [0.7]),
    "equation above": Case(program(1, [-1], [1], [1.5], [1.5]), [1.5], [-0.5]),
    "two sides, upper": Case(program(1, [-1], [1], [-0.5], [0.3]), [0.3], [0.7]),
    "two sides, lower": Case(program(1, [-1], [1], [1.5], [4.0]), [1.5], [-0.5]),
    "two sides, neither": Case(program(1, [-1], [1], [-5], [7]), [1], [0]),
    "a row without bounds": Case(program(1, [-1], [[1], [1]], [-INF, -INF], [INF, 0.3]), [0.3], [0, 0.7]),
    "negative coefficient": Case(program(1, [-1], [-2], [-0.6], [INF]), [0.3], [-0.35]),  # 0.3 - 1 - 2 y = 0
    "negative coefficient, upper": Case(program(1, [-1], [-2], [-INF], [-3]), [1.5], [0.25]),
    "no rows": Case(program(1, [-1], [], [], []), [1], []),
    # min 1/2 |z|^2 on z_0 + z_1 + z_2 = 3 and z_0 - z_1 = 1: z = a (1,1,1) + b (1,-1,0)
    "equations only": Case(
        program(np.eye(3), [0, 0, 0], [[1, 1, 1], [1, -1, 0]], [3, 1], [3, 1]), [1.5, 0.5, 1], [-1, -0.5]
    ),
    # [[2, 1], [1, 2]] z = -q - A'y with z_0 = 1 held from above: 1 + 2 z_1 = 0, y = 4 - 2 - z_1
    "off-diagonal Hessian": Case(
        program([[2, 1], [1, 2]], [-4, 0], [[1, 0], [0, 1]], [-INF, -9], [1, INF]), [1, -0.5], [2.5, 0]
    ),
    "equation, bounds on both sides": Case(
        # min 1/2 |z|^2, sum z = 3, z_0 <= 0.5, z_2 >= 1.5: z_1 = 1, y_eq = -1, y_0 = 1 - 0.5, y_2 = 1 - 1.5
        program(np.eye(3), [0, 0, 0], [[1, 1, 1], [1, 0, 0], [0, 0, 1]], [3, -INF, 1.5], [3, 0.5, INF]),
        [0.5, 1, 1.5],
        [-1, 0.5, -0.5],
    ),
    "semidefinite Hessian": Case(  # z_1 has no curvature: its bound holds it, 0 + 1 + y = 0
        program(np.diag([1.0, 0.0]), [-1, 1], [0, 1], [-2], [INF]), [1, -2], [-1]
    ),
    "linear programme": Case(  # max z_0 + 2 z_1 on the simplex
        program(np.zeros((2, 2)), [-1, -2], [[1, 1], [1, 0], [0, 1]], [-INF, 0, 0], [1, INF, INF]), [0, 1], [2, -1, 0]
    ),
    "linear programme, equation": Case(
        program(np.zeros((2, 2)), [3, 1], [[1, 1], [1, 0], [0, 1]], [1, 0, 0], [1, 0.4, 0.7]), [0.3, 0.7], [-3, 0, 2]
    ),
    "the same equation twice": Case(program(np.eye(2), [-2, 0], [[1, 1], [2, 2]], [1, 2], [1, 2]), [1.5, -0.5], None),
    "the same bound twice": Case(program(1, [-1], [[1], [2]], [-INF, -INF], [0.3, 0.6]), [0.3], None),
    "bounds that leave one point": Case(  # z_0 >= 0, z_1 >= 0, z_0 + z_1 <= 0: no interior at all
        program(np.eye(2), [-1, -2], [[1, 0], [0, 1], [1, 1]], [0, 0, -INF], [INF, INF, 0]), [0, 0], None
    ),
    "large and small numbers": Case(  # min 1/2 1e4 z^2 - 1e2 z, 1e-2 z <= 5e-5: z = 5e-3, 50 - 100 + 1e-2 y = 0
        program(1e4, [-1e2], [1e-2], [-INF], [5e-5]), [5e-3], [5e3]
    ),
}
INFEASIBLE = {
    "bounds": program(1, [0], [[1], [1]], [1, -INF], [INF, 0]),
    "equations": program(np.eye(2), [0, 0], [[1, 1], [1, 1]], [1, 2], [1, 2]),
    "equation outside bounds": program(
        np.eye(2), [1, -1], [[1, 1], [1, 0], [0, 1]], [3, -1, -1], [3, 1, 1]
    ),  # 1 + 1 < 3
}
UNBOUNDED = {
    "linear": program(0, [-1], [1], [0], [INF]),
    "without curvature": program(np.diag([1.0, 0.0]), [0, -1], [[1, 0], [0, 1]], [0, 0], [1, INF]),
    "along an equation": program(np.zeros((2, 2)), [-1, 0], [[1, -1], [0, 1]], [0, -3], [0, INF]),
}


def ask(name: str, asked: Program, tolerance: float = 1e-9, time_limit: float | None = None) -> Solution:
    return backend(name)(asked, tolerance, time_limit)


def is_accepted(asked: Program, solution: Solution) -> bool:
    """Whether methods.convex would call this an optimum."""
    if solution.claim not in (Claim.SOLVED, Claim.FAILED) or solution.z is None or solution.y is None:
        return False
    with np.errstate(invalid="ignore", over="ignore"):
        return asked.residuals(solution.z, solution.y).worst <= SOLVED_TOLERANCE


def long_program(size: int) -> Program:
    """Return a program of many dense rows, which takes every solver some time."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(2 * size, size))
    root = rng.normal(size=(size, size)) / np.sqrt(size)
    return program(root @ root.T, rng.normal(size=size), A, np.full(2 * size, -1.0), np.full(2 * size, 1.0))
