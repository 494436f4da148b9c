"""Whether costs, sets, rows and frequency constraints of one's own keep their protocols, at random trajectories."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

import lin_freq_ocp as lfo
from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.reformulations import RATE_LIMIT
from lin_freq_ocp.problem.terms.penalty import Penalty
from lin_freq_ocp.problem.terms.term import Term, TermKind
from lin_freq_ocp.program.backends.base import Claim, backend
from lin_freq_ocp.program.program import Program

SIZES = (0.1, 1.0, 10.0)  # of random signals, in units of the optimal ones: some within limits, some beyond
STEP = 1e-6  # of differences, relative to the values
ROUNDING = 1e-9  # error of sums, relative to their terms
ACCURACY = 1e-4  # error of differences and of solvers, relative to what is compared
Point = tuple[Array, Array]  # x (T+1, n) and u (T, m)


def check_terms(problem: lfo.OptimalControlProblem, seed: int = 0) -> list[str]:
    """Return what is wrong with the terms of a problem, in words; nothing if they keep their protocols.

    Of every term h(L(x, u)) rows and adjoint of L are compared with its values, slopes of h with differences, its conic
    form with its cost, the Fenchel-Young gap with what other points gain, and all of them with those of the problem
    ``rate_limited``. The optimum must be proven.

    Parameters
    ----------
    problem : OptimalControlProblem
        With linear dynamics, a solution, and the terms in question.
    seed : int
        Of the random trajectories.

    Returns
    -------
    list of str

    Examples
    --------
    >>> check_terms(lfo.library.quadcopter(horizon=20))
    []
    """
    rng, result = np.random.default_rng(seed), lfo.solve(problem, throw=False)
    unproven = [] if result.status == "optimal" else [f"the optimum is not proven: {result.status}, {result.message}"]
    if result.trajectory is None or not result.primal:
        return unproven
    best, found = (result.trajectory.x, result.trajectory.u), dict.fromkeys(unproven)
    for size in SIZES:
        x, u = (size * np.abs(part).max() * rng.standard_normal(part.shape) for part in best)
        for t, value in problem.fixed_ends.items():
            x[t] = value
        for term in problem.terms:
            faults = (*_map_faults(term, (x, u), rng), *_penalty_faults(term, (x, u), best, rng))
            found |= {f"{term.name}: {fault}": None for fault in faults}
        found |= dict.fromkeys(_lost(problem, x, u))
    return list(found)


def _map_faults(term: Term, point: Point, rng: np.random.Generator) -> Iterator[str]:
    (x, u), weights = point, rng.standard_normal(term.shape)
    v, none = term.map.values(x, u), term.map.values(np.zeros_like(x), np.zeros_like(u))
    error = ROUNDING * (term.map.sizes(x, u) + np.abs(none))
    L, c = term.map.rows(len(u), x.shape[1], u.shape[1])
    if (np.abs((L @ np.concatenate([x.ravel(), u.ravel()]) + c).reshape(v.shape) - v) > error).any():
        yield "rows of the map differ from its values"
    of_x, of_u = term.map.pull_back(weights, (x.shape, u.shape))
    if abs((weights * (v - none)).sum() - (of_x * x).sum() - (of_u * u).sum()) > (np.abs(weights) * error).sum():
        yield "pull_back is not the adjoint of values"


def _penalty_faults(term: Term, point: Point, best: Point, rng: np.random.Generator) -> Iterator[str]:
    penalty, v, w, sizes = term.penalty, term.map.values(*point), term.map.values(*best), term.map.sizes(*best)
    change, weights = np.abs(v).max() * rng.standard_normal(v.shape), rng.standard_normal(v.shape)
    for name, function, slope in (
        ("slope", lambda at: penalty.cost(at).sum(keepdims=True), np.array([penalty.slope(v, change, 0.0)])),
        ("excess_slope", penalty.excess, penalty.excess_slope(v, change, 0.0)),
    ):
        limited = np.isfinite(function(v))
        before, at, after, beyond = (function(v + step * change)[limited] for step in (-1.0, 0.0, STEP, 1.0))
        rise = (after - at) / STEP
        if (np.abs(slope[limited] - rise) > ACCURACY * (np.abs(beyond - before) + np.abs(rise)).sum()).any():
            yield f"{name} is not that of differences"
    expected = np.inf if penalty.violation(v).any() else penalty.cost(v).sum()
    if not np.isclose(_conic_value(penalty, v), expected, rtol=ACCURACY, atol=ACCURACY * penalty.unbounded(change)[1]):
        yield "the conic form has another value than the cost"
    for eta_C in (0.0, 1.0):
        at, fitting = w if np.isinf(expected) else v, penalty.subgradient(weights, eta_C)
        gained = eta_C * (penalty.cost(at) - penalty.cost(w)).sum() + (fitting * (w - at)).sum()
        terms = eta_C * (penalty.cost(at) + penalty.cost(w)).sum() + (np.abs(fitting) * (sizes + np.abs(at))).sum()
        gap = penalty.gap(at, fitting, eta_C)
        if min(gap.min(), gap.sum() - gained) < -ACCURACY * terms:
            yield "the gap is less than what another point gains"


def _conic_value(penalty: Penalty, v: Array) -> float:
    """Return the least price of slacks with which values fit into the conic form; inf if they fit with none."""
    form = penalty.conic(*v.shape)
    at, idle = np.append(v.ravel(), 0.0)[form.entries], np.eye(len(form.prices) + 1)[-1]
    A = sp.csc_array(sp.hstack([form.slacks, sp.csc_array((len(at), 1))]))  # the last variable is idle
    prices, lower, upper = np.append(form.prices, 0.0), form.lower - at, form.upper - at
    program = Program(sp.csc_array(sp.diags_array(idle)), prices, 0.0, A, lower, upper, {}, form.cones)
    found = backend("clarabel")(program, ROUNDING, None)
    return float(prices @ found.z) if found.claim is Claim.SOLVED and found.z is not None else np.inf


def _lost(problem: lfo.OptimalControlProblem, x: Array, u: Array) -> Iterator[str]:
    """Yield the kinds of terms that cost another amount, or are violated by another amount, in further states."""
    limited, wide = lfo.rate_limited(problem, 1.0), np.hstack([x, np.vstack([0 * u[:1], u])])
    for kind in dict.fromkeys(term.kind for term in problem.terms):
        totals = [
            np.sum([[term.cost(at, u).sum(), term.violation(at, u).sum()] for term in given], axis=0)
            for given, at in ((_of_kind(problem, kind), x), (_of_kind(limited, kind), wide))
        ]
        if not np.allclose(*totals, rtol=ROUNDING, atol=0.0):
            yield f"{kind}: it is another one in rate_limited"


def _of_kind(problem: lfo.OptimalControlProblem, kind: TermKind) -> list[Term]:
    return [term for term in problem.terms if term.kind == kind and term.name != RATE_LIMIT]
