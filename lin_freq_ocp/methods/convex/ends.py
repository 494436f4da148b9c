"""Ends outside the sets of their times: a proof of infeasibility that needs no solver."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lin_freq_ocp.base.arrays import NO_BOUND, Array
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers


def contradiction_at_ends(problem: OptimalControlProblem) -> Multipliers | None:
    """Return a Farkas ray of one hard row on x_0 or x_T that no point of that end satisfies, or None."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    for t, end in zip((0, T), problem.ends, strict=True):
        for name, k, C, limit in _rows_at(problem, t):
            nearest = np.clip(np.where(C > 0, end.lower, end.upper), -NO_BOUND, NO_BOUND)
            excess = np.where(C == 0, 0.0, C * nearest).sum(1) - limit
            row = int(np.argmax(excess))
            if excess[row] <= 0:
                continue
            weights = {term.name: np.zeros(term.shape) for term in problem.terms}
            weights[name][k, row] = 1.0
            mu = np.zeros((T + 1, n))
            mu[t] = -C[row]
            rho_u, rho_x = (np.zeros(stop.shape, dtype=complex) for stop in (problem.control_stop, problem.state_stop))
            return Multipliers(0.0, np.zeros((T, n)), mu, np.zeros((T, m)), rho_u, rho_x, weights)
    return None


def _rows_at(problem: OptimalControlProblem, t: int) -> Iterator[tuple[str, int, Array, Array]]:
    """Yield every term of hard rows C x_t <= limit: its name, the index of t in it, C and limit."""
    for term in problem.terms:
        rows = term.polyhedron(problem.state_dim, problem.control_dim)
        if rows is None or t not in rows.times or len(term.map.control_times):
            continue
        k = int(np.flatnonzero(rows.times == t)[0])
        yield term.name, k, rows.matrix(k)[:, : problem.state_dim], rows.e[k]
