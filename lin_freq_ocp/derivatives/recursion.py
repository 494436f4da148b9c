"""K of many problems of one plant with bounds on controls: one Riccati recursion over an axis of problems.

The controls at a bound are held; the others are those of a regulator. With p_{t+1} = A p_t + B v_t + d_t, a solve
minimises 1/2 z'H z - <of_z, z> over z = (p, v); the multipliers of its rows are q.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Mask, split_signals, stack_signals, with_fields
from lin_freq_ocp.derivatives.data import ByDatum, Values, Variables, slopes
from lin_freq_ocp.derivatives.derivatives import UNSETTLED, WEAK, SolutionDerivatives
from lin_freq_ocp.derivatives.exact_point import FORWARD, SAFETY
from lin_freq_ocp.methods.candidate import zero_multipliers
from lin_freq_ocp.problem.ocp import OptimalControlProblem

SEEN_CONTROL = 1e-9  # of a solution: the part of a control at a kink that is rounding
PER_PROBLEM = ("initial_state", "x_ref", "u_ref")  # the data that problems have of their own
AT_BOUND = 1e-9  # part of the size of a control within which it is at its bound, before the exact point is known


@dataclass(frozen=True, eq=False)
class Solved:
    """A solution for all problems: p (N, T+1, n), v (N, T, m), q (N, T, n), and multipliers of p_0 and of held v."""

    p: Array
    v: Array
    q: Array
    of_start: Array
    of_bounds: Array


class Regulators:
    """The factors of all problems, whose ``free`` controls (N, T, m) are at no bound."""

    def __init__(self, problem: OptimalControlProblem, free: Mask):
        cost, self.A, self.B = problem.quadratic, problem.linear.A, problem.linear.B
        self.cost, self.free = cost, free.astype(np.float64)
        (N, T, m), n = free.shape, len(self.A)
        self.gains, self.inverses, self.mixed = np.empty((T, N, m, n)), np.empty((T, N, m, m)), np.empty((T, N, n, m))
        self.V = np.empty((T + 1, N, n, n))
        self.V[T] = cost.P
        for t in range(T - 1, -1, -1):
            f, V = self.free[:, t], self.V[t + 1]
            BV = self.B.T @ V
            M = (cost.R + BV @ self.B) * (f[:, :, None] * f[:, None, :]) + np.eye(m) * (1 - f)[:, :, None]
            self.inverses[t] = np.linalg.inv(M) * (f[:, :, None] * f[:, None, :])
            self.mixed[t] = cost.S + np.swapaxes(BV @ self.A, 1, 2)
            self.gains[t] = self.inverses[t] @ np.swapaxes(self.mixed[t], 1, 2)
            V = cost.Q + self.A.T @ V @ self.A - self.mixed[t] @ self.gains[t]
            self.V[t] = 0.5 * (V + np.swapaxes(V, 1, 2))

    def solve(self, of_z: Array, d: Array) -> Solved:
        """Return the solution with p_0 = 0 for slopes of_z (N, T+1, n+m), and offsets d (N, T, n)."""
        (N, T, m), n = self.free.shape, d.shape[2]
        of_x, of_u = split_signals(of_z, n)
        steps, g = np.empty((T, N, m)), -of_x[:, T]
        for t in range(T - 1, -1, -1):
            h = g + (self.V[t + 1] @ d[:, t, :, None])[:, :, 0]
            steps[t] = (self.inverses[t] @ (h @ self.B - of_u[:, t])[:, :, None])[:, :, 0]
            g = h @ self.A - of_x[:, t] - (self.mixed[t] @ steps[t][:, :, None])[:, :, 0]
        p, v, q = np.zeros((N, T + 1, n)), np.empty((N, T, m)), np.empty((N, T, n))
        for t in range(T):
            v[:, t] = -(self.gains[t] @ p[:, t, :, None])[:, :, 0] - steps[t]
            p[:, t + 1] = p[:, t] @ self.A.T + v[:, t] @ self.B.T + d[:, t]
        slope, of_bounds = split_signals(of_z - self.cost.bend(stack_signals(p, v)), n)
        q[:, T - 1] = slope[:, T]
        for t in range(T - 1, 0, -1):
            q[:, t - 1] = slope[:, t] + q[:, t] @ self.A
        return Solved(p, v, q, slope[:, 0] + q[:, 0] @ self.A, (of_bounds + q @ self.B) * (1 - self.free))


@dataclass(frozen=True, eq=False)
class Gradients(ByDatum):
    """The derivatives of weighted sums of the optima of many problems by every datum, under its name.

    Initial states and references have a derivative for each problem, on the first axis; what the problems share has the
    sum over all.

    Attributes
    ----------
    exists : (N,)
        Whether each has a derivative.
    reasons : tuple of str
        Why not; empty if it has one.

    Examples
    --------
    >>> solutions = lfo.solve_many(lfo.library.double_integrator(), [[0, 0], [0.1, 0]])
    >>> solutions.vjp(u=[[[1.0]] * 200] * 2)["initial_state"].shape
    (2, 2)
    """

    slopes: Values
    exists: Mask
    reasons: tuple[str, ...]

    def __repr__(self) -> str:
        return f"Gradients(exists {int(self.exists.sum())} of {len(self.exists)}, by {', '.join(self)})"


def takes_many(problem: OptimalControlProblem) -> bool:
    """Whether ``many_gradients`` takes a problem: constant matrices, bounds on controls alone, a free end."""
    cost, tube = problem.quadratic, problem.state_tube
    if problem.mode_names or problem.response is not None or problem.terms or problem.cost.has_formulas:
        return False
    constant = all(part.ndim == 2 for part in (problem.linear.A, problem.linear.B, cost.Q, cost.R, cost.S))
    free = not np.isfinite(tube.lower[1:]).any() and not np.isfinite(tube.upper[1:]).any()
    bands = problem.control_stop.any() or problem.state_stop.any()
    vectors = cost.q.ndim == cost.r.ndim == problem.linear.offset.ndim == 1
    return constant and vectors and free and not bands and bool(problem.initial_box.fixed.all())


def many_gradients(
    problem: OptimalControlProblem, x: Array, u: Array, references: tuple[Array, Array], weights: tuple[Array, Array]
) -> tuple[Values, tuple[str, ...]]:
    """Return the derivatives of <weights, optima> of problems that differ in initial states and references.

    x (N, T+1, n) and u (N, T, m) are answers; references and weights have these shapes. The derivatives have an axis of
    problems in front; there is a reason for each problem that has none, else an empty text.
    """
    cost, tube, linear_slopes = problem.quadratic, problem.control_tube, problem.quadratic.linear_slopes(u.shape[1])
    size = np.maximum(np.abs(u).max((1, 2), keepdims=True), np.finfo(np.float64).tiny)
    held = (tube.upper - u <= AT_BOUND * size) | (u - tube.lower <= AT_BOUND * size)
    u = np.where(held, np.clip(u, tube.lower, tube.upper), u)
    upper = tube.upper - u <= u - tube.lower
    u = np.where(held, np.where(upper, tube.upper, tube.lower), u)
    regulators = Regulators(problem, ~held)
    last = eta = nu = of_z = np.zeros(())
    for _ in range(2):  # the exact point, and its last correction
        a, b = x - references[0], u - references[1]
        of_z = -cost.bend(stack_signals(a, b)) - (0.0 if linear_slopes is None else linear_slopes)
        step = regulators.solve(of_z, problem.linear.successors(x, u) - x[:, 1:])
        x, u = x + step.p, u + step.v
        last, eta, nu = np.abs(step.v).max((1, 2), keepdims=True), step.q, step.of_bounds
    a, b = x - references[0], u - references[1]
    room, price = np.where(upper, tube.upper - u, u - tube.lower), np.where(upper, nu, -nu)
    error = np.maximum(FORWARD * size, SAFETY * last)
    steepest = np.abs(split_signals(of_z, problem.state_dim)[1]).max((1, 2), keepdims=True)
    of_prices = np.maximum(FORWARD, SAFETY * last / size) * steepest
    moving = ~tube.fixed  # with equal bounds, either sign of a price is right
    weak = moving & np.where(held, price <= of_prices, room <= error)
    wrong = (moving & np.where(held, price < -of_prices, room < -error)).any((1, 2))
    if (weak & held).any():
        regulators = Regulators(problem, ~held | weak)
    way = regulators.solve(stack_signals(*weights), np.zeros_like(eta))
    sizes = np.maximum(np.abs(way.p).max((1, 2)), np.abs(way.v).max((1, 2)))
    seen = (np.abs(np.where(weak, way.v, 0.0)) > SEEN_CONTROL * sizes[:, None, None]).any((1, 2))
    reasons = np.where(wrong, UNSETTLED, np.where(seen, WEAK, ""))
    none, mu, of_bounds = zero_multipliers(problem, 1.0), 0 * x, np.where(weak, 0.0, way.of_bounds)
    mu[:, 0] = way.of_start
    rho_u, rho_x = (np.broadcast_to(part, (len(x), *part.shape)) for part in (none.rho_u, none.rho_x))
    at = with_fields(none, eta=eta, mu=0 * x, nu=nu, rho_u=rho_u, rho_x=rho_x)
    along = with_fields(at, eta=way.q, mu=mu, nu=of_bounds)
    found = slopes(problem, Variables(x, u, a, b, at), Variables(way.p, way.v, way.p, way.v, along))
    return {name: -part for name, part in found.items()}, tuple(reasons.tolist())


def gradients_of(
    problem: OptimalControlProblem,
    references: Sequence[Mapping[str, ArrayLike]],
    answers: tuple[Array, Array],
    weights: tuple[Array, Array],
    derivatives_of: Callable[[int], SolutionDerivatives],
) -> Gradients:
    """Return the derivatives of weighted sums of many optima (N, T+1, n), (N, T, m): at once, or one by one.

    ``references`` are those of each problem that differ from the given ones.
    """
    cost, (x, u) = problem.quadratic, answers
    if takes_many(problem):
        x_ref, u_ref = np.empty(x.shape), np.empty(u.shape)
        x_ref[:], u_ref[:] = cost.x_ref, cost.u_ref
        for i, own in enumerate(references):
            x_ref[i], u_ref[i] = own.get("x_ref", x_ref[i]), own.get("u_ref", u_ref[i])
        parts, reasons = many_gradients(problem, x, u, (x_ref, u_ref), weights)
    else:
        each = [derivatives_of(i).vjp(x=weights[0][i], u=weights[1][i]) for i in range(len(x))]
        parts = {name: np.stack([one[name] for one in each]) for name in each[0]}
        reasons = tuple(one.reason for one in each)
    found = {name: part if name in PER_PROBLEM else part.sum(axis=0) for name, part in parts.items()}
    return Gradients(found, np.array([not reason for reason in reasons]), reasons)
