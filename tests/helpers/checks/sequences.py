# pyright: reportAttributeAccessIssue=false
"""Small random piecewise-affine problems: every method finds the optimum of all mode sequences, solved one by one.

Regions are cut by one or two lines, often not through the origin; maps jump there or not. Problems have stop bands,
fixed, boxed and free ends, linear costs, or no cost. The optimum is the least of all sequences by plain Clarabel, on
programs that share no code with the package.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import clarabel
import numpy as np
import scipy.sparse as sp

import lin_freq_ocp as lfo
from helpers.oracle import TOLERANCE, PlainProgram, plain_program
from lin_freq_ocp.transform.hybrid import piecewise_affine

MOST_SEQUENCES = 260  # solved in a second
AGREEMENT = 3e-6  # difference of two costs, relative to max(1, |J|): the gap that is asked, and the error of Clarabel
SMALL_UNIT = 1e-8  # of the cost
# For each mode the lines that bound its region, and its side: 1 for g'x + h'u <= c
PATTERNS = {
    "two": [[(0, 1)], [(0, -1)]],
    "three": [[(0, 1)], [(0, -1), (1, 1)], [(0, -1), (1, -1)]],
    "four": [[(0, first), (1, second)] for first in (1, -1) for second in (1, -1)],
    "parallel": [[(0, 1)], [(0, -1), (1, 1)], [(1, -1)]],
}


@dataclass(frozen=True)
class Outcome:
    """What became of one problem.

    Attributes
    ----------
    best : float
        The optimum by enumeration; inf if no sequence has a trajectory.
    wrong : tuple of str
        Answers that are missing, or that the optimum refutes.
    """

    seed: int
    best: float
    wrong: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.wrong


def check(seed: int) -> Outcome:
    """Solve a problem by several methods, from its optimum, and with a limit, and compare them with the enumeration."""
    problem = random_problem(seed)
    best, sequence = enumerated(problem)
    runs = [("auto", problem, {}), ("3 nodes", problem, {"node_limit": 3})]
    if sequence is not None:
        optimum = lfo.solve(problem.with_modes(sequence), throw=False)
        runs += [("start", problem, {"start": one}) for one in (optimum, sequence)]
    runs += [("enumerate", problem, {"method": "enumerate"})] * (seed % 4 == 0)
    runs += [("miqp", problem, {"method": "miqp"})] * (seed % 5 == 0)
    runs += [("small cost", random_problem(seed, SMALL_UNIT), {})] * (seed % 7 == 0)
    wrong = list[str]()
    for name, given, arguments in runs:
        result, unit = lfo.solve(given, throw=False, **arguments), SMALL_UNIT if name == "small cost" else 1.0
        wrong += [f"{name}: {what}" for what in _faults(result, best, unit, limited="node_limit" in arguments)]
    return Outcome(seed, best, tuple(wrong))


def _faults(result: lfo.results.Result, best: float, unit: float, limited: bool) -> Iterator[str]:
    """Yield what the optimum refutes in an answer to a problem whose cost is in this unit."""
    allowed = AGREEMENT * max(1.0, abs(best)) if np.isfinite(best) else 0.0
    proven = "optimal" if np.isfinite(best) else "infeasible"
    if result.status != proven and not (limited and result.status == "limit"):
        yield f"{result.status} ({result.message}), not {proven}"
    bound, cost = (None if one is None else one / unit for one in (result.lower_bound, result.cost))
    if bound is not None and bound > best + allowed:
        yield f"a bound of {bound:.10g} above {best:.10g}"
    if cost is None or not np.isfinite(best) or result.certificate is None:
        return
    if result.certificate.feasible and cost < best - allowed:
        yield f"a cost of {cost:.10g} below {best:.10g}"
    if (result.status == "optimal" or result.certificate.globally_optimal) and cost > best + allowed:
        yield f"a cost of {cost:.10g} called optimal, above {best:.10g}"


def enumerated(problem: lfo.OptimalControlProblem) -> tuple[float, tuple[int, ...] | None]:
    """Return the least cost of all mode sequences by plain Clarabel, and the sequence; inf and None without any."""
    T, n, modes = problem.horizon, problem.state_dim, range(len(piecewise_affine(problem).modes))
    programs = [plain_program(problem.with_modes([i] * T), np.inf) for i in modes]
    first, regions = programs[0], [len(mode.region.e) for mode in piecewise_affine(problem).modes]
    A, G = ([getattr(one, name).toarray() for one in programs] for name in ("A", "G"))
    common = len(G[0]) - T * regions[0]  # the bounds come first, then the regions; in A, the dynamics come first

    def rows(i: int, t: int) -> tuple[slice, slice]:
        return slice(t * n, (t + 1) * n), slice(common + t * regions[i], common + (t + 1) * regions[i])

    best, found = np.inf, None
    for sequence in product(modes, repeat=T):
        own = [(i, *rows(i, t)) for t, i in enumerate(sequence)]
        matrix = [A[i][of_map] for i, of_map, _ in own] + [A[0][T * n :], G[0][:common]]
        matrix += [G[i][at] for i, _, at in own]
        right = [programs[i].b[of_map] for i, of_map, _ in own] + [first.b[T * n :], first.h[:common]]
        right += [programs[i].h[at] for i, _, at in own]
        cost = _least_cost(first, np.vstack(matrix), np.concatenate(right))
        if cost < best:
            best, found = cost, sequence
    return best, found


def _least_cost(program: PlainProgram, matrix: np.ndarray, right: np.ndarray) -> float:
    """Return the least cost of a program with other rows, the equations first; inf unless Clarabel solves it."""
    settings, equations = clarabel.DefaultSettings(), len(program.b)
    settings.verbose, settings.max_threads = False, 1
    settings.tol_feas = settings.tol_gap_abs = settings.tol_gap_rel = TOLERANCE
    cones = [clarabel.ZeroConeT(equations), clarabel.NonnegativeConeT(len(right) - equations)]
    P = sp.csc_array(sp.triu(program.P))
    answer = clarabel.DefaultSolver(P, program.q, sp.csc_array(matrix), right, cones, settings).solve()
    return answer.obj_val + program.constant if str(answer.status) == "Solved" else np.inf


def random_problem(seed: int, unit: float = 1.0) -> lfo.OptimalControlProblem:
    """Return the problem of a seed, with the cost in this unit."""
    rng = np.random.default_rng([77, seed])
    n, m = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    kind = str(rng.choice(list(PATTERNS)))
    x_bound, u_bound = rng.uniform(1, 3, n), rng.uniform(0.5, 2, m)
    modes = _modes(rng, kind, n, m)
    horizon = int(rng.integers(3, 8))
    while len(modes) ** horizon > MOST_SEQUENCES:
        horizon -= 1
    cost = _cost(rng, n, m, unit)
    x_0 = rng.uniform(-1, 1, n) * x_bound * (rng.random() >= 0.15)
    end = _end(rng, x_bound)
    of_u = rng.random() < 0.4
    at = (int(rng.integers(horizon // 2 + 1)), int(rng.integers(m))) if of_u else (0, 0)
    of_x, free = rng.random() < 0.1, rng.random() < 0.1
    states = lfo.Box(-x_bound, x_bound)
    return lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes),
        horizon,
        cost,
        lfo.Box(-u_bound, u_bound),
        states,
        states if free else x_0,
        end,
        control_spectrum=lfo.stop_band(bins=[at[0]], component=at[1]) if of_u else None,
        state_spectrum=lfo.stop_band(bins=[(horizon + 1) // 2], component=0) if of_x else None,
    )


def _modes(rng: np.random.Generator, kind: str, n: int, m: int) -> list[lfo.AffineMode]:
    """Return modes whose regions are cut by lines; a continuous map changes by v (g'x + h'u - c) beyond a line."""

    def drawn() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        A = rng.standard_normal((n, n)) * rng.choice([0.5, 1.0, 1.2]) / np.sqrt(n)
        return A, rng.standard_normal((n, m)), rng.choice([0, 0.3]) * rng.standard_normal(n)

    of_u = rng.random() < 0.4
    g = rng.standard_normal((2, n)) * (rng.random((2, n)) < 0.8)
    h = rng.standard_normal((2, m)) * of_u * (rng.random((2, m)) < 0.5)
    g[~g.any(axis=1), 0] = 1.0
    c = rng.choice([0.0, 0.3, -0.5, 5.0], 2) * rng.choice([1, 1, 1])
    if kind == "parallel":
        g, h, c = np.eye(1, n).repeat(2, axis=0), 0 * h, np.sort(rng.uniform(-0.8, 0.8, 2))
    base, continuous = drawn(), rng.random() < 0.35
    maps = [drawn() for _ in PATTERNS[kind]]
    v = rng.standard_normal((2, n)) if continuous else np.zeros((2, n))
    modes = list[lfo.AffineMode]()
    for sides, own in zip(PATTERNS[kind], maps, strict=True):
        A, B, d = base if continuous else own
        for k, side in sides:
            if side < 0:
                A, B, d = A + np.outer(v[k], g[k]), B + np.outer(v[k], h[k]), d - v[k] * c[k]
        lines, signs = [k for k, _ in sides], np.array([side for _, side in sides])
        modes.append(lfo.AffineMode(A, B, d, signs[:, None] * g[lines], signs[:, None] * h[lines], signs * c[lines]))
    return modes


def _cost(rng: np.random.Generator, n: int, m: int, unit: float) -> lfo.QuadraticCost:
    Q, R = np.diag(rng.choice([0, 1.0, 0.2], n)), np.diag(rng.uniform(0.05, 1, m))
    P = np.diag(rng.choice([0, 5.0, 1.0], n))
    x_ref = rng.choice([0, 1.0]) * rng.standard_normal(n)
    some = unit * (rng.random() >= 0.15)
    q = rng.choice([0, 1.0]) * rng.standard_normal(n) * 0.3
    r = rng.choice([0, 0, 1.0]) * rng.standard_normal(m) * 0.3
    return lfo.QuadraticCost(Q=some * Q, R=some * R, P=some * P, q=unit * q, r=unit * r, x_ref=x_ref)


def _end(rng: np.random.Generator, x_bound: np.ndarray) -> lfo.Box | np.ndarray | None:
    """Return the origin, a box, or None for a free end."""
    share = rng.random()
    if share < 0.15:
        return 0 * x_bound
    if share >= 0.4:
        return None
    width, centre = rng.uniform(0.05, 0.5), rng.uniform(-0.5, 0.5, len(x_bound)) * x_bound
    return lfo.Box(np.maximum(centre - width, -x_bound), np.minimum(centre + width, x_bound))
