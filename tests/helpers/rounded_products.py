"""Random problems whose Hessians are products c c' in floating point, and their optimal costs in rational numbers."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

import lin_freq_ocp as lfo

KINDS = ("along the null space", "at its reference", "beside the null space")


def rounded_product(seed: int) -> tuple[lfo.OptimalControlProblem, str]:
    """Return a problem, and where it starts: in the first two kinds, J* is zero but for rounding.

    It starts 1 to 1e7 away from zero. Its controls have a cost of their own, and change every state, or none.
    """
    rng = np.random.default_rng(seed)
    n, T = int(rng.integers(2, 5)), int(rng.integers(2, 6))
    c = rng.choice([-0.7, -0.3, 0.1, 0.3, 0.9], n)
    Q = np.outer(c, c) * 10.0 ** rng.integers(-3, 4)
    x = rng.standard_normal(n)
    x = 10.0 ** rng.choice([0, 2, 5, 7]) * (x - c * (c @ x) / (c @ c))
    kind = KINDS[int(rng.integers(0, 3))]
    reference = x if kind == KINDS[1] else np.zeros(n)
    start = x + c * rng.uniform(-1, 1) if kind == KINDS[2] else x
    B = rng.standard_normal((n, 1)) * rng.integers(0, 2)
    cost = lfo.QuadraticCost(Q=Q, R=1.0, P=Q * rng.integers(0, 2), x_ref=reference)
    A = np.eye(n) if rng.random() < 0.6 else 0.9 * np.eye(n)
    return lfo.OptimalControlProblem(lfo.LinearDynamics(A, B), T, cost, initial_state=start), kind


def exact_optimum(problem: lfo.OptimalControlProblem) -> Fraction | None:
    """Return J* of a problem with a fixed start and one control without bounds, as its numbers stand; None: -inf."""
    T, cost, A, B = problem.horizon, problem.quadratic, problem.linear.A, problem.linear.B
    ref = np.broadcast_to(cost.x_ref, (T + 1, problem.state_dim))
    exact = np.vectorize(Fraction, otypes=[object])
    A, b, Q, P, R = exact(A), exact(B)[:, 0], exact(cost.Q), exact(cost.P), Fraction(float(cost.R[0, 0]))
    columns = np.full((problem.state_dim, T + 1), Fraction(0))  # of x_t in (u, 1)
    columns[:, T] = exact(problem.initial_box.lower)
    form = np.full((T + 1, T + 1), Fraction(0))  # J = 1/2 (u, 1)'form (u, 1)
    for t in range(T + 1):
        moved = columns.copy()
        moved[:, T] -= exact(ref[t])
        form = form + moved.T.dot(P if t == T else Q).dot(moved)
        if t < T:
            form[t, t] += R
            columns = A.dot(columns)
            columns[:, t] += b
    form = (form + form.T) / 2
    for k in range(T):  # eliminate the controls
        if form[k, k] <= 0:
            return None
        form = form - np.outer(form[:, k], form[k]) / form[k, k]
    return form[T, T] / 2
