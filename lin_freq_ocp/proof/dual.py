"""The section DUAL of a proof for one mode: multipliers, and a point z_t of every stage.

The checker requires lambda in the domain of the conjugates without any tolerance: multipliers that a price limits are
made smaller by a few roundings, and multipliers of a cone are moved into the dual cone. mu_t is kept if z_t can be put
on its bound.

The checker defines eta_{t-1} = A_t' eta_t - s_t, with s_t = D_x c_t(z_t) + the multipliers of terms and removed bins
pulled back to x_t + mu_t, and eta_T = 0. If the dynamics are unstable, the recursion enlarges the last digit of mu_T
without limit. With mu_T + d, eta is affine in d. The d that brings eta_0 and eta_{T-1} nearest to the given ones keeps
all others near, too: eta_0 fixes the parts that grow backwards, and eta_{T-1} the parts that decay. It needs as many
digits as the recursion loses.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import singledispatch

import numpy as np
from flint import arb, arb_mat

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.terms.penalties import HalfSpaces, StandardCone
from lin_freq_ocp.problem.terms.penalty import Penalty
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.proof.statement import Text, exact, line, multiplier_lines, rows, stack_signals

Balls = list[arb]

SHRINK = 1 - 2.0**-48  # of multipliers that a price limits: their norm is rounded in the last few bits
ON_BOUND = 1e-6  # distance from a bound, relative to the component's size, up to which a curved component is on it

# Bits beyond those that errors grow by: of a double, with some for the size of the terms and their number
EXTRA_BITS = 96

DRIFT = 1e-6  # of the adjoint by the recursion, relative to its size, above which the file gives the adjoint itself


@dataclass(frozen=True, eq=False)
class Dual:
    """Multipliers with mu_T as the file states it, and whether the file gives the adjoint at every time."""

    problem: OptimalControlProblem
    point: DualPoint
    end: Text  # mu_T
    adjoint: bool

    def lines(self) -> Iterator[str]:
        """Yield the section NODES, with one node, and the section DUAL."""
        problem, point, n = self.problem, self.point, self.problem.state_dim
        yield line(section="nodes", reach=False)
        yield line(node=0, parent=None, t=0, modes=[0])
        yield line(section="dual", node=0, cost=int(point.normal))
        yield from signal_lines(0, point.state_signal[: problem.state_samples])
        yield from signal_lines(n, point.control_signal)
        yield from multiplier_lines(problem.terms, point.weights)
        yield line(t=problem.horizon, z=point.x[-1], mu=self.end)
        stages = rows(np.hstack([point.x[:-1], point.u])[::-1])
        for t, z in zip(range(problem.horizon - 1, -1, -1), stages, strict=True):
            of_bounds = {"mu": point.mu[t]} if t and point.mu[t].any() else {}
            adjoint = {"eta": point.eta[t - 1]} if t and self.adjoint else {}
            yield line(t=t, z=z, **of_bounds, **adjoint)


def dual_of(problem: OptimalControlProblem, at: Trajectory, multipliers: Multipliers) -> Dual:
    """Return the dual of multipliers, in the precision of balls; terms have their final frequencies."""
    point = dual_point(problem, at, multipliers)
    free = np.flatnonzero(problem.state_tube.fixed[-1])
    moved, eta = steer_adjoint(problem.linear.A, exact_slopes(problem, point), point.eta, free)
    end = [point.mu[-1, i].hex() for i in range(problem.state_dim)]
    for i, change in zip(free.tolist(), moved, strict=True):
        mantissa, exponent = (change + float(point.mu[-1, i])).mid().man_exp()
        end[i] = exact(int(mantissa), int(exponent))
    drift = np.abs(eta - point.eta).max(axis=0) > DRIFT * np.abs(point.eta).max(axis=0)
    # The file can give the adjoint itself where a slope in any state costs something finite, by bounds or curvature
    bounded = np.isfinite(problem.state_tube.lower) & np.isfinite(problem.state_tube.upper)
    costs = bounded | (point.normal & curvatures(problem, 1.0)[1])
    return Dual(problem, point, Text(json.dumps(end)), bool(drift.any() and costs.all()))


def curvatures(problem: OptimalControlProblem, eta_C: float) -> tuple[Mask, Mask]:
    """Return which components the cost curves: (x, u) of each stage, (1 or T, n + m), and x, (T+1, n)."""
    curved = eta_C * problem.quadratic.stage_hessians.diagonal(axis1=1, axis2=2) > 0
    in_x = np.broadcast_to(curved[:, : problem.state_dim], (problem.horizon, problem.state_dim))
    return curved, np.vstack([in_x, eta_C * np.diagonal(problem.quadratic.P) > 0])


@dataclass(frozen=True, eq=False)
class DualPoint:
    """z_t, mu_t and the multipliers of terms by their index, which may differ from those of the solver."""

    x: Array  # z_t, (T+1, n)
    u: Array  # (T, m)
    mu: Array  # (T+1, n)
    eta: Array  # (T, n)
    normal: bool  # whether the cost counts
    state_signal: Array  # of removed bins, (T+1, n)
    control_signal: Array  # (T, m)
    weights: list[Array]  # of each term, (groups, dim)


def dual_point(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> DualPoint:
    """Return the multipliers and points of a proof; the terms of the problem have their final frequencies."""
    n = problem.state_dim
    curved, in_x = curvatures(problem, multipliers.eta_C)
    x, mu = project_on_bounds(problem.state_tube, trajectory.x, multipliers.mu, in_x)
    u, _ = project_on_bounds(problem.control_tube, trajectory.u, multipliers.nu, curved[:, n:])
    weights = domain_multipliers(problem.terms, multipliers)
    signals = problem.in_time(multipliers.rho_x), time_signal(multipliers.rho_u, problem.horizon)
    return DualPoint(x, u, mu, multipliers.eta, multipliers.eta_C > 0, *signals, weights)


def project_on_bounds(tube: Box, signal: Array, normals: Array, curved: Mask) -> tuple[Array, Array]:
    """Return a signal on its bounds where normals say so, and the normals that remain, both (times, size).

    A component without curvature may be moved to any bound at no loss.
    """
    size = np.abs(signal).max(axis=0, initial=0.0)
    projected, remaining = tube.project(signal), np.where(tube.fixed, normals, 0.0)
    for bound, pressed in ((tube.upper, normals > 0), (tube.lower, normals < 0)):
        finite = np.where(np.isfinite(bound), bound, signal)
        here = pressed & np.isfinite(bound) & (~curved | (np.abs(finite - signal) <= ON_BOUND * size))
        projected, remaining = np.where(here, finite, projected), np.where(here, normals, remaining)
    return projected, remaining


def domain_multipliers(terms: Sequence[Term], multipliers: Multipliers) -> list[Array]:
    """Return the nearest multipliers of each term, (groups, dim), inside the domain of the conjugate of eta_C h."""
    return [
        shrink(
            term.penalty,
            term.penalty.subgradient(multipliers.stage.get(term.name, np.zeros(term.shape)), multipliers.eta_C),
        )
        for term in terms
    ]


@singledispatch
def shrink(penalty: Penalty, weights: Array) -> Array:
    """Return multipliers that stay in the domain of the conjugate whichever way their norms are rounded."""
    return np.where(np.isfinite(penalty.weights), SHRINK, 1.0) * weights


@shrink.register
def _shrink_half_spaces(penalty: HalfSpaces, weights: Array) -> Array:
    return weights


@shrink.register
def _shrink_cone(penalty: StandardCone, weights: Array) -> Array:
    return np.column_stack([weights[:, 0], SHRINK * weights[:, 1:]])


def exact_slopes(problem: OptimalControlProblem, point: DualPoint) -> list[Balls]:
    """Return s_0 .. s_T, the sums of the cost's gradient at z_t, the pulled-back multipliers and mu_t, in balls."""
    n, count = problem.state_dim, (problem.horizon + 1) * problem.state_dim
    slopes = [[arb(value) for value in row] for row in point.mu.tolist()]
    if point.normal:
        _add_cost(slopes, problem, point)
    if point.state_signal.any():
        _add_signal(slopes, point.state_signal)
    for term, weights in zip(problem.terms, point.weights, strict=True):
        if term.map.dense_size[0]:
            pulled, _ = term.map.pull_back(weights, (point.x.shape, point.u.shape))
            _add_signal(slopes, pulled)
        elif weights.any():  # sparse rows pull back the sums of multipliers times coefficients of states
            matrix, _ = term.map.rows(problem.horizon, n, problem.control_dim)
            used = np.flatnonzero(weights)
            sparse = matrix[used].tocoo()
            of_x = sparse.col < count
            multipliers = weights.ravel()[used][sparse.row[of_x]].tolist()
            entries = zip(sparse.col[of_x].tolist(), sparse.data[of_x].tolist(), multipliers, strict=True)
            for column, value, weight in entries:
                slopes[column // n][column % n] += arb(value) * weight
    return slopes


def _add_cost(slopes: list[Balls], problem: OptimalControlProblem, point: DualPoint) -> None:
    """Add the gradient in x of the quadratic cost at z_t."""
    cost, n, T = problem.quadratic, problem.state_dim, problem.horizon
    hessians, linear = (
        cost.stage_hessians[:, :n],
        np.broadcast_to(stack_signals(cost.q, cost.r, T), (T, n + point.u.shape[1])),
    )
    if hessians.any() or linear[:, :n].any():
        points = np.hstack([point.x[:-1], point.u])
        centers = np.broadcast_to(stack_signals(cost.x_ref, cost.u_ref, T), points.shape)
        once = arb_mat(hessians[0].tolist()) if len(hessians) == 1 else None
        for t, slope in enumerate(slopes[:-1]):
            hessian = arb_mat(hessians[t].tolist()) if once is None else once
            _add_gradient(slope, hessian, points[t], centers[t], linear[t])
    x_ref = cost.x_ref[-1] if cost.x_ref.ndim == 2 else cost.x_ref
    _add_gradient(slopes[-1], arb_mat(cost.P.tolist()), point.x[-1], x_ref, cost.p)


def _add_gradient(slope: Balls, hessian: arb_mat, point: Array, center: Array, linear: Array) -> None:
    """Add the first entries of hessian (point - center) + linear."""
    moved = arb_mat([[arb(a) - b] for a, b in zip(point.tolist(), center.tolist(), strict=True)])
    bent = (hessian * moved).entries()
    for i, value in enumerate(bent):
        slope[i] += value + float(linear[i])


def _add_signal(slopes: list[Balls], signal: Array) -> None:
    for slope, row in zip(slopes, signal.tolist(), strict=True):
        for i, value in enumerate(row):
            slope[i] += value


def run_adjoint(A: Array, slopes: Sequence[Balls], begin: arb_mat) -> tuple[arb_mat, Array]:
    """Run eta_{t-1} = A_t' eta_t - s_t for t = T-1 .. 1 from eta_{T-1}, columns (n, k); s_t acts on the first one.

    A is (n, n) or (T, n, n), and slopes are s_0 .. s_T. Return eta_0, (n, k), and of its first column all eta_t as
    floats, (T, n).
    """
    T, n = len(slopes) - 1, begin.nrows()
    turned = A.T if A.ndim == 2 else np.swapaxes(A, 1, 2)
    constant = arb_mat(turned.tolist()) if A.ndim == 2 else None
    eta, path = begin, np.empty((T, n))
    path[T - 1] = [float(eta[i, 0]) for i in range(n)]
    for t in range(T - 1, 0, -1):
        eta = (arb_mat(turned[t].tolist()) if constant is None else constant) * eta
        for i, slope in enumerate(slopes[t]):
            eta[i, 0] -= slope
        path[t - 1] = [float(eta[i, 0]) for i in range(n)]
    return eta, path


def steer_adjoint(A: Array, slopes: Sequence[Balls], eta: Array, free: Indices) -> tuple[Balls, Array]:
    """Return d, (free,), as exact numbers, and the adjoint with mu_T + d as floats, (T, n)."""
    n, last = eta.shape[1], slopes[-1]
    begin = arb_mat(n, 1 + len(free))
    for i in range(n):
        begin[i, 0] = -last[i]
    for k, i in enumerate(free.tolist()):
        begin[i, 1 + k] = -1
    sizes = np.abs(eta).max(axis=0)
    weights = [arb(1.0 / size) if size > 0 else arb(1) for size in sizes.tolist()]
    first, _ = run_adjoint(A, slopes, begin)
    rows = [
        (weight, [part[i, j] for j in range(1 + len(free))], float(goal[i]))
        for part, goal in ((first, eta[0]), (begin, eta[-1]))
        for i, weight in enumerate(weights)
    ]
    system = arb_mat([[weight * entry for entry in row[1:]] for weight, row, _ in rows])
    misses = arb_mat([[weight * (goal - row[0])] for weight, row, goal in rows])
    least_squares = (system.transpose() * system).solve(system.transpose() * misses)
    changes = [least_squares[k, 0].mid() for k in range(len(free))]
    steered = arb_mat([[-value] for value in last])
    for d, i in zip(changes, free.tolist(), strict=True):
        steered[i, 0] -= d
    return changes, run_adjoint(A, slopes, steered)[1]


def precision(A: Array, horizon: int) -> int:
    """Return the bits of a proof.

    Radii of balls grow as products of |A_t|. The linear system of the equations at the end squares both, once more than
    the recursion through its solution.
    """
    bits = 2 * growth(A, horizon) + 2 * growth(np.abs(A), horizon)
    return EXTRA_BITS + int(np.ceil(bits)) + 4 * int(np.log2(horizon + 1))


def growth(A: Array, horizon: int) -> float:
    """Return the base-2 logarithm of the largest norm of A_t ... A_s over the horizon, at least zero, or a bound on it.

    A is (n, n) or (T, n, n). Logarithms are added up, as the product itself may overflow.
    """
    logarithm, least, largest, steps = 0.0, 0.0, 0.0, 1
    product = np.array(A) if A.ndim == 2 else np.array(A[0])
    while steps <= horizon and (size := float(np.linalg.norm(product))):
        logarithm, product = logarithm + np.log2(size), product / size
        if A.ndim == 2:  # the power of ``steps``, squared next
            largest = max(largest, logarithm * min(horizon / steps, 2.0))
            product, logarithm, steps = product @ product, 2 * logarithm, 2 * steps
        else:  # the product from time 0 on; its largest rise counts
            least = min(least, logarithm)
            largest = max(largest, logarithm - least)
            product, steps = A[min(steps, len(A) - 1)] @ product, steps + 1
    return largest


def signal_lines(first: int, signals: Array) -> Iterator[str]:
    """Yield the multipliers of removed bins of the components of (x, u) from ``first`` on."""
    for i in np.flatnonzero(signals.any(axis=0)).tolist():
        yield line(signal=first + i, values=signals[:, i])
