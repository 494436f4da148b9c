"""Nearly uncontrollable problems have one optimal cost, whichever method finds it.

Controls move some components of the state by 1e-3 to 1e-9 of its size only, and the end of the horizon is fixed. The
optimum is computed in balls of 600 bits: the conditions of an active set, whose multipliers and slacks are above zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from flint import arb, arb_mat, ctx

import lin_freq_ocp as lfo

METHODS = ("auto", "structured", "convex")
BITS = 600
CHANGES = 40  # of the active set, at most
AGREEMENT = 1e-6  # of costs, relative
REACH = 1e-9  # of the end by controls of the size of their bounds; below, rounding of the data hides the move


@dataclass(frozen=True)
class Outcome:
    """The exact optimal cost of a problem, and the status and the cost by each method."""

    seed: int
    exact: float | None
    statuses: dict[str, str]
    costs: dict[str, float]
    outside: float  # of the bounds on controls

    @property
    def wrong(self) -> dict[str, float]:
        """Return the costs that are called optimal and are not."""
        proven = {method: self.costs[method] for method, status in self.statuses.items() if status == "optimal"}
        reference = self.exact if self.exact is not None else next(iter(proven.values()), 0.0)
        return {name: cost for name, cost in proven.items() if abs(cost - reference) > AGREEMENT * abs(reference)}

    @property
    def passed(self) -> bool:
        """Whether every optimal cost is right, and every control within its bounds exactly."""
        return not self.wrong and self.outside == 0.0


def random_problem(seed: int) -> lfo.OptimalControlProblem:
    """Return a problem with a fixed end, at least REACH away from others that controls within their bounds reach."""
    rng = np.random.default_rng([seed, 31])
    while True:
        problem = _draw(rng)
        dynamics, tube = problem.dynamics, problem.control_tube
        size = np.where(np.isfinite(tube.upper), tube.upper, 1.0)[0]
        responses = [dynamics.B * size]
        for _ in range(problem.horizon - 1):
            responses.append(dynamics.A @ responses[-1])
        moves = np.linalg.svd(np.hstack(responses)[problem.terminal_box.fixed], compute_uv=False)
        if moves[-1] > REACH:
            return problem


def _draw(rng: np.random.Generator) -> lfo.OptimalControlProblem:
    n, m, T = int(rng.integers(2, 5)), int(rng.integers(1, 4)), int(rng.integers(6, 21))
    A = np.diag(rng.choice([1.0, -1.0, 0.5, 0.9, 1.05], n))
    A += np.triu(10.0 ** rng.uniform(-7, 0, (n, n)) * rng.choice([-1.0, 0.0, 1.0], (n, n)), 1)
    B = rng.normal(size=(n, m)) * 10.0 ** rng.uniform(-7, 0, (n, 1))
    if rng.random() < 0.5:  # the weak directions are combinations of all components
        turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
        A, B = turn @ A @ turn.T, turn @ B
    limit, start, fixed = 10.0 ** rng.uniform(-1, 1, m), rng.normal(size=n), rng.random(n) < 0.8
    fixed[rng.integers(n)] = True
    Q = np.diag(rng.uniform(0, 1, n)) if rng.random() < 0.3 else np.zeros((n, n))
    cost = lfo.QuadraticCost(Q=Q, R=np.diag(rng.uniform(0.5, 2, m)))
    bounds = lfo.Box(-limit, limit) if rng.random() < 0.7 else None
    problem = lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), T, cost, bounds, initial_state=start)
    end = lfo.simulate(problem, rng.uniform(-0.8, 0.8, (T, m)) * limit).x[-1]
    terminal = lfo.Box(np.where(fixed, end, -np.inf), np.where(fixed, end, np.inf))
    return replace(problem, terminal_state=terminal)


def check(seed: int) -> Outcome:
    """Solve a random problem by every method, and in balls."""
    problem, statuses, costs, outside, near = random_problem(seed), {}, {}, 0.0, None
    tube = problem.control_tube
    for method in METHODS:
        result = lfo.solve(problem, method, throw=False)
        statuses[method], costs[method] = str(result.status), result.cost
        if result.trajectory is not None:
            outside = max(outside, float(tube.violation(result.control).max()))
            near = result.control if near is None or result.status == "optimal" else near
    exact = None if near is None else optimal_cost(problem, near)
    return Outcome(seed, None if exact is None else float(exact), statuses, costs, outside)


def optimal_cost(problem: lfo.OptimalControlProblem, near: np.ndarray) -> arb | None:
    """Return the optimal cost as a ball, from controls near the optimal ones; None if no active set is proven."""
    before, ctx.prec = ctx.prec, BITS
    try:
        return _optimum(_condensed(problem), problem.control_tube, near)
    finally:
        ctx.prec = before


def _condensed(problem):
    """Return H, g, c of the cost 1/2 u'H u + g'u + c, and E, e of the rows E u = e on the fixed end."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    A, B = arb_mat(problem.dynamics.A.tolist()), arb_mat(problem.dynamics.B.tolist())
    Q, R = np.broadcast_to(problem.quadratic.Q, (n, n)), np.broadcast_to(problem.quadratic.R, (m, m))
    free, forced = arb_mat([[value] for value in problem.initial_box.lower.tolist()]), arb_mat(n, T * m)
    H, g, c = arb_mat(T * m, T * m), arb_mat(T * m, 1), arb(0)
    weights = arb_mat(Q.tolist())
    for t in range(T):
        if Q.any():
            H += forced.transpose() * weights * forced
            g += forced.transpose() * weights * free
            c += (free.transpose() * weights * free)[0, 0] / 2
        forced, free = A * forced, A * free
        for j in range(m):
            for i in range(n):
                forced[i, t * m + j] = B[i, j]
            H[t * m + j, t * m + j] += arb(float(R[j, j]))
    rows = np.flatnonzero(problem.terminal_box.fixed).tolist()
    E = arb_mat([[forced[i, k] for k in range(T * m)] for i in rows])
    e = arb_mat([[arb(float(problem.terminal_box.lower[i])) - free[i, 0]] for i in rows])
    return H, g, c, E, e


def _optimum(condensed, tube, near) -> arb | None:
    H, g, c, E, e = condensed
    count, rows = H.nrows(), E.nrows()
    lower, upper = tube.lower.ravel(), tube.upper.ravel()
    u = near.ravel()
    held = {k: float(side[k]) for side in (lower, upper) for k in range(count) if u[k] == side[k]}
    for _ in range(CHANGES):
        free = [k for k in range(count) if k not in held]
        size = len(free) + rows
        K, right = arb_mat(size, size), arb_mat(size, 1)
        for a, k in enumerate(free):
            for b, other in enumerate(free):
                K[a, b] = H[k, other]
            for i in range(rows):
                K[a, len(free) + i] = K[len(free) + i, a] = E[i, k]
            right[a, 0] = -g[k, 0] - sum((H[k, j] * value for j, value in held.items()), arb(0))
        for i in range(rows):
            right[len(free) + i, 0] = e[i, 0] - sum((E[i, j] * value for j, value in held.items()), arb(0))
        try:
            solution = K.solve(right)
        except ZeroDivisionError:
            return None
        found = arb_mat(count, 1)
        for a, k in enumerate(free):
            found[k, 0] = solution[a, 0]
        for k, value in held.items():
            found[k, 0] = value
        slope = H * found + g
        for i in range(rows):
            for k in range(count):
                slope[k, 0] += E[i, k] * solution[len(free) + i, 0]
        missed = {
            k: float(side[k])
            for side, sign in ((lower, -1), (upper, 1))
            for k in free
            if sign * found[k, 0] > sign * side[k]
        }
        wrong = [k for k, value in held.items() if (slope[k, 0] if value == upper[k] else -slope[k, 0]) > 0]
        if not missed and not wrong:
            inside = all(found[k, 0] > lower[k] and found[k, 0] < upper[k] for k in free)
            signs = all((slope[k, 0] if value == upper[k] else -slope[k, 0]) < 0 for k, value in held.items())
            return (
                (found.transpose() * H * found)[0, 0] / 2 + (g.transpose() * found)[0, 0] + c
                if inside and signs
                else None
            )
        held = {k: value for k, value in held.items() if k not in wrong} | missed
    return None
