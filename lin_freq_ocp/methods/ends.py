"""Ends outside the sets of their times: a proof of infeasibility that needs no solver."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.problem.maps import StageMap
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.penalties import Below
from lin_freq_ocp.problem.sets import NO_BOUND
from lin_freq_ocp.problem.trajectory import Multipliers


def contradiction_at_ends(problem: OptimalControlProblem) -> Multipliers | None:
    """Return a Farkas ray of one hard row on x_0 or x_T that no point of that end satisfies; None if there is none."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    for t, end in zip((0, T), problem.ends, strict=True):
        finite = np.isfinite(end.lower) | np.isfinite(end.upper)
        for term in problem.terms:
            row_map, penalty = term.map, term.penalty
            at_end = isinstance(row_map, StageMap) and row_map.D is None and isinstance(penalty, Below) and term.hard
            if not (finite.any() and at_end and t in row_map.times):
                continue
            k = int(np.flatnonzero(row_map.times == t)[0])
            C, c = (one if one.ndim == rank else one[k] for one, rank in ((row_map.C, 2), (row_map.constant, 1)))
            limit = np.broadcast_to(penalty.limit, term.shape)[k]
            nearest = np.where(C > 0, end.lower, end.upper)
            least = np.where(C == 0, 0.0, C * np.clip(nearest, -NO_BOUND, NO_BOUND)).sum(1) + c
            row = int(np.argmax(least - limit))
            if least[row] <= limit[row]:
                continue
            weights = {one.name: np.zeros(one.shape) for one in problem.terms}
            weights[term.name][k, row] = 1.0
            mu = np.zeros((T + 1, n))
            mu[t] = -C[row]
            bins = (np.zeros(stop.shape, complex) for stop in (problem.control_stop, problem.state_stop))
            return Multipliers(0.0, np.zeros((T, n)), mu, np.zeros((T, m)), *bins, weights)
    return None
