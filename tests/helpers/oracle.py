"""The optimal cost of linear problems by plain Clarabel, on a quadratic program that shares no code with the package.

The program is written from a problem of boxes, stop bands and joint rows, in good units, with scipy.sparse alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import clarabel
import numpy as np
import scipy.sparse as sp
from scipy.optimize import lsq_linear

import lin_freq_ocp as lfo
from lin_freq_ocp.base import Array, Indices

TOLERANCE = 1e-10  # asked of Clarabel
AGREEMENT = 1e-6  # difference of the two costs, relative to the sum of the absolute terms
NONE = 1e6  # bounds from here on stand for infinity, and are left out if the answer is far within them
NOISE = 1e-9  # difference of two costs, in good units, that Clarabel's tolerance can make
ACTIVE = 1e-7  # distance from a limit, in good units, at which it may carry a multiplier
NEAR = 1e4  # an answer below this is far within bounds of NONE


@dataclass(frozen=True)
class PlainProgram:
    """min 1/2 z'P z + q'z + constant with A z = b, G z <= h, in z = (x_0 .. x_T, u_0 .. u_{T-1})."""

    P: sp.csc_array
    q: Array
    constant: float
    A: sp.csc_array
    b: Array
    G: sp.csc_array
    h: Array

    def cost(self, z: Array) -> float:
        """Return the cost of a point."""
        return float(0.5 * z @ (self.P @ z) + self.q @ z + self.constant)


def plain_program(problem: lfo.OptimalControlProblem, none: float) -> PlainProgram:
    """Return the quadratic program of a problem with boxes, stop bands and joint rows, and bounds below ``none``."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    states, variables = (T + 1) * n, (T + 1) * n + T * m
    equations, limits = _Rows(variables), _Rows(variables)
    P, gradient, constant = np.zeros((variables, variables)), np.zeros(variables), 0.0
    cost = problem.quadratic
    shapes = {"Q": (n, n), "R": (m, m), "S": (n, m), "q": (n,), "r": (m,)}
    per_time = [np.broadcast_to(getattr(cost, field), (T, *shape)) for field, shape in shapes.items()]
    x_ref, u_ref = np.broadcast_to(cost.x_ref, (T + 1, n)), np.broadcast_to(cost.u_ref, (T, m))
    for t in range(T + 1):
        here = np.arange(t * n, t * n + n)
        if t == T:
            H, linear, at, reference = cost.P, cost.p, here, x_ref[T]
        else:
            now = states + np.arange(t * m, t * m + m)
            A, B, d = problem.linear.at(t)
            for i in range(n):
                equations.add(np.concatenate([[here[i] + n], here, now]), np.concatenate([[1.0], -A[i], -B[i]]), d[i])
            Q, R, S, q, r = (field[t] for field in per_time)
            H, linear = np.block([[Q, S], [S.T, R]]), np.concatenate([q, r])
            at, reference = np.concatenate([here, now]), np.concatenate([x_ref[t], u_ref[t]])
        P[np.ix_(at, at)] += H
        gradient[at] += linear - H @ reference
        constant += 0.5 * float(reference @ H @ reference)
    _add_bounds(problem, equations, limits, none)
    _add_bands(problem, equations)
    for family in problem.stage_rows:
        for t in range(T):
            C, D = (np.broadcast_to(part, (T, *part.shape[-2:]))[t] for part in (family.C, family.D))
            e = np.broadcast_to(family.e, (T, family.rows))[t]
            at = np.concatenate([np.arange(t * n, t * n + n), states + np.arange(t * m, t * m + m)])
            for i in np.flatnonzero(e < none):
                limits.add(at, np.concatenate([C[i], D[i]]), e[i])
    return PlainProgram(sp.csc_array(P), gradient, constant, *equations.matrix(), *limits.matrix())


class _Rows:
    """Rows of a sparse matrix, one after the other, with their right-hand sides."""

    def __init__(self, columns: int):
        self._columns, self._entries, self._right = columns, list[tuple[Indices, Array]](), list[float]()

    def add(self, at: Indices | int, values: Array | float, right: float) -> None:
        self._entries.append((np.atleast_1d(at), np.atleast_1d(values)))
        self._right.append(float(right))

    def matrix(self) -> tuple[sp.csc_array, Array]:
        at, values = (np.concatenate([np.zeros(0), *(one[k] for one in self._entries)]) for k in (0, 1))
        row = np.repeat(np.arange(len(self._right)), [len(one[0]) for one in self._entries])
        shape = len(self._right), self._columns
        return sp.csc_array((values, (row, at.astype(int))), shape=shape), np.array(self._right)


def _add_bounds(problem: lfo.OptimalControlProblem, equations: _Rows, limits: _Rows, none: float) -> None:
    """Add the bounds of all states and controls; an interval of no width is an equation."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    x = [
        _bounds(problem.state_set, T + 1, n),
        *(_bounds(end, 1, n) for end in (problem.initial_state, problem.terminal_state)),
    ]
    lower, upper = x[0]
    for t, (low, high) in zip((0, T), x[1:], strict=True):
        lower[t], upper[t] = np.maximum(lower[t], low[0]), np.minimum(upper[t], high[0])
    u = _bounds(problem.control_set, T, m)
    lower, upper = (np.concatenate([a.ravel(), b.ravel()]) for a, b in zip((lower, upper), u, strict=True))
    for i in range(len(lower)):
        if lower[i] == upper[i]:
            equations.add(i, 1.0, lower[i])
            continue
        if upper[i] < none:
            limits.add(i, 1.0, upper[i])
        if lower[i] > -none:
            limits.add(i, -1.0, -lower[i])


def _bounds(box: object, times: int, count: int) -> tuple[Array, Array]:
    if box is None:
        return np.full((times, count), -np.inf), np.full((times, count), np.inf)
    assert isinstance(box, lfo.Box)
    return np.broadcast_to(box.lower, (times, count)).copy(), np.broadcast_to(box.upper, (times, count)).copy()


def _add_bands(problem: lfo.OptimalControlProblem, equations: _Rows) -> None:
    """Add real and imaginary part of every stopped bin."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    for stop, length, count, first in (
        (problem.state_stop, problem.state_samples, n, 0),
        (problem.control_stop, T, m, (T + 1) * n),
    ):
        for k, j in np.argwhere(stop):
            turns = 2 * np.pi * k * np.arange(length) / length
            at = first + np.arange(length) * count + j
            equations.add(at, np.cos(turns), 0.0)
            if 0 < 2 * k < length:
                equations.add(at, np.sin(turns), 0.0)


def fitted(program: PlainProgram, z: Array) -> tuple[Array, float]:
    """Return the multipliers of equations and limits that fit a point best, and the first-order error of its cost."""
    slack = program.h - program.G @ z
    active = slack <= ACTIVE * (1 + np.abs(program.h))
    held = np.concatenate([np.ones(len(program.b), dtype=bool), active])
    columns = sp.csc_array(sp.vstack([program.A, program.G]))[held].T.toarray()
    gradient = program.P @ z + program.q
    least = np.where(np.arange(columns.shape[1]) < len(program.b), -np.inf, 0.0)
    norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    y = np.zeros(len(held))
    if columns.size:
        y[held] = lsq_linear(columns / norms, -gradient, (least, np.inf), tol=1e-15).x / norms
    slope = gradient + columns @ y[held]
    missed = np.concatenate([program.A @ z - program.b, slack])
    beyond = np.abs(np.minimum(slack, 0.0)).sum()
    return y, float(np.abs(y) @ np.abs(missed) + np.abs(slope) @ np.abs(z) + beyond)


@dataclass(frozen=True)
class Reference:
    """Clarabel's answer, in good units: its status, or "unsure" where its "Solved" point has a larger error.

    ``y`` are the duals of equations and limits (>= 0); ``error`` is the first-order error of the cost: residuals times
    multipliers, and complementarity.
    """

    status: str
    program: PlainProgram
    z: Array
    y: Array
    cost: float
    error: float


def worth(program: PlainProgram, y: Array, z: Array) -> float:
    """Return the first-order decrease of the cost by the violations of a point, with multipliers y."""
    missed = np.concatenate([np.abs(program.A @ z - program.b), np.maximum(program.G @ z - program.h, 0.0)])
    return float(np.abs(y) @ missed)


def solved_plainly(problem: lfo.OptimalControlProblem) -> Reference:
    """Return plain Clarabel's answer; bounds that stand for infinity are first left out."""
    reference = _clarabel(problem, plain_program(problem, NONE))
    if reference.status == "Solved" and np.abs(reference.z).max() < NEAR:
        return reference
    return _clarabel(problem, plain_program(problem, np.inf))


def recedes(problem: lfo.OptimalControlProblem, program: PlainProgram) -> bool:
    """Whether Clarabel finds a direction along which all constraints stay satisfied and the cost falls for ever."""
    box, zeros = sp.eye_array(len(program.q)), np.zeros
    directions = PlainProgram(
        sp.csc_array(program.P.shape),
        program.q,
        0.0,
        sp.csc_array(sp.vstack([program.A, program.P])),
        zeros(len(program.b) + len(program.q)),
        sp.csc_array(sp.vstack([program.G, box, -box])),
        np.concatenate([zeros(len(program.h)), np.ones(2 * len(program.q))]),
    )
    return _clarabel(problem, directions).cost < -AGREEMENT * float(np.abs(program.q).max(initial=0.0))


def moves_by_rounding(problem: lfo.OptimalControlProblem, reference: Reference) -> bool:
    """Whether some state moves so little, far from zero, that double precision loses ``AGREEMENT`` of its motion."""
    x, _ = _signals(problem, reference.z)
    motion = np.ptp(x, axis=0)
    return bool((AGREEMENT * motion < np.finfo(float).eps * np.abs(x).max(axis=0))[motion > 0].any())


def _clarabel(problem: lfo.OptimalControlProblem, program: PlainProgram) -> Reference:
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = TOLERANCE
    A, b = sp.csc_array(sp.vstack([program.A, program.G])), np.concatenate([program.b, program.h])
    cones = [clarabel.ZeroConeT(len(program.b)), clarabel.NonnegativeConeT(len(program.h))]
    answer = clarabel.DefaultSolver(sp.csc_array(sp.triu(program.P)), program.q, A, b, cones, settings).solve()
    z, y, status = np.array(answer.x), np.array(answer.z), str(answer.status)
    slack = b - A @ z
    error = float((np.abs(y) * np.abs(slack)).sum() + (np.abs(z) * np.abs(program.P @ z + program.q + A.T @ y)).sum())
    if status == "Solved" and error > max(AGREEMENT * cost_scale(problem, *_signals(problem, z)), NOISE):
        status = "unsure"
    return Reference(status, program, z, y, program.cost(z), error)


def _signals(problem: lfo.OptimalControlProblem, z: Array) -> tuple[Array, Array]:
    x, u = np.split(z, [(problem.horizon + 1) * problem.state_dim])
    return x.reshape(-1, problem.state_dim), u.reshape(-1, problem.control_dim)


def cost_scale(problem: lfo.OptimalControlProblem, x: Array, u: Array) -> float:
    """Return the sum of the absolute terms of the cost."""
    a, b = (np.abs(part) for part in problem.quadratic.deviations(x, u))
    absolute = problem.quadratic.magnitudes
    no_linear = lfo.QuadraticCost(Q=absolute.Q, R=absolute.R, S=absolute.S, P=absolute.P)
    T, n = len(u), x.shape[1]
    quadratic = no_linear.at_dimensions(n, u.shape[1], T).value(a, b)
    return quadratic + lfo.QuadraticCost(q=absolute.q, r=absolute.r, p=absolute.p).at_dimensions(
        n, u.shape[1], T
    ).value(np.abs(x), np.abs(u))
