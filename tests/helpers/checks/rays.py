"""Problems whose feasibility, or whose bound, is known by construction; none of this is asked of a solver.

unstable     controls too weak for an unstable plant without hard constraints on its states: every control is feasible
compact      a free initial state, a fixed terminal one and bounded controls: all states are continuous functions of the
             controls if A is invertible, so that an optimum exists; exact rationals say whether it is, and its cost
unbounded    a free initial state with a linear cost, with states counted from zero, 1e3 and 1e6
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

import lin_freq_ocp as lfo
from helpers.checks.outcome import Outcome
from helpers.random.unbounded import random_unbounded
from lin_freq_ocp.transform import translated_by

KINDS = "unstable", "compact", "unbounded"
METHODS = "auto", "structured", "convex"
SHIFTS = 0.0, 1e3, 1e6
CLOSE = 1e-6  # relative error of a cost, or of a bound, in the sum of its terms
Rows = list[list[Fraction]]


def check(seed: int) -> Outcome:
    """Solve one problem, of the kind that the seed says."""
    kind = KINDS[seed % len(KINDS)]
    statuses, wrong = {"unstable": unstable, "compact": compact, "unbounded": unbounded}[kind](seed)
    return Outcome(seed, kind, tuple(statuses), tuple(wrong))


def weak_problem(seed: int) -> lfo.OptimalControlProblem:
    """Return an unstable plant with a weak control, over 10 to 400 steps."""
    rng = np.random.default_rng(seed)
    n, T, soft = int(rng.integers(1, 4)), int(10 * 40 ** rng.random()), rng.random() < 0.5
    A = rng.standard_normal((n, n))
    A *= rng.uniform(1.02, 1.6) / np.abs(np.linalg.eigvals(A)).max()
    cost = lfo.QuadraticCost(Q=np.eye(n), R=rng.uniform(0.1, 2.0), P=np.eye(n))
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, rng.standard_normal((n, 1))),
        T,
        cost,
        control_set=lfo.Box(-1, 1),
        state_set=lfo.sets.Soft(lfo.Box(-np.ones(n), np.ones(n)), 10.0) if soft else None,
        initial_state=rng.uniform(1, 10, n),
    )


def unstable(seed: int) -> tuple[list[str], list[str]]:
    """Solve a problem that every control satisfies, by one method."""
    problem = weak_problem(seed)
    method = METHODS[seed // len(KINDS) % len(METHODS)]
    result = lfo.solve(problem, method, throw=False)
    feasible = [lfo.simulate(problem, np.full((problem.horizon, 1), u)) for u in (-1.0, 0.0, 1.0)]
    least = min(problem.value(one.x, one.u) for one in feasible)
    wrong = [f"{method}: {result.status}"] if result.status.startswith("infeasible") else []
    if result.status == "optimal" and result.lower_bound > (1 + CLOSE) * least:
        wrong.append(f"{method}: a bound of {result.lower_bound} above a cost of {least}")
    return [result.status], wrong


def compact_problem(seed: int) -> lfo.OptimalControlProblem:
    """Return a problem with linear costs, bounded controls, a fixed end and a free start."""
    rng = np.random.default_rng(seed)
    n, T = int(rng.integers(1, 5)), int(rng.integers(10, 40))
    A = rng.standard_normal((n, n)).round(2)
    A = (A * rng.uniform(0.3, 1.0) / np.abs(np.linalg.eigvals(A)).max()).round(2)
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, rng.standard_normal((n, 1)).round(2)),
        T,
        lfo.QuadraticCost(q=rng.standard_normal(n).round(2)),
        lfo.Box(-0.5, 0.5),
        terminal_state=rng.standard_normal(n).round(2),
    )


def compact(seed: int) -> tuple[list[str], list[str]]:
    """Solve a compact problem by two methods, and compare what is proven with the exact optimum."""
    problem = compact_problem(seed)
    exact = exact_cost(problem)
    if exact is None:
        return [], []
    wrong, statuses = list[str](), list[str]()
    for method in METHODS[:2]:
        result = lfo.solve(problem, method, throw=False)
        statuses.append(result.status)
        if result.status in ("unbounded", "infeasible"):  # what is claimed is no proof: x_0 may be 1e30
            wrong.append(f"{method}: {result.status}, the cost is {float(exact)}")
        if result.bound == "rigorous" and result.lower_bound is not None:
            above = Fraction(result.lower_bound) - exact
            if above > CLOSE * Fraction(result.certificate.cost_scale):
                wrong.append(f"{method}: a bound of {result.lower_bound} above the cost {float(exact)}")
    return statuses, wrong


def exact_cost(problem: lfo.OptimalControlProblem) -> Fraction | None:
    """Return the optimal cost of a compact problem with linear costs of states; None if A is singular.

    Backwards from x_T, the cost is linear in the controls: each is at a bound. u_t costs -p_t'B, where p_t is the sum
    of (A^-T)^(t+1-s) q over s <= t.
    """
    A, B, _ = problem.linear.at(0)
    transposed = [[Fraction(value) for value in row] for row in A.T]
    q, b = ([Fraction(value) for value in part] for part in (problem.quadratic.q.ravel(), B[:, 0]))
    bound = Fraction(problem.control_tube.upper.max())
    price, cost = [Fraction(0)] * len(q), Fraction(0)
    for _ in range(problem.horizon):
        solved = _solve(transposed, [one + other for one, other in zip(price, q, strict=True)])
        if solved is None:
            return None
        price = solved
        cost -= bound * abs(sum(one * other for one, other in zip(price, b, strict=True)))
    end = [Fraction(value) for value in problem.terminal_box.lower]
    return cost + sum(one * other for one, other in zip(price, end, strict=True))


def _solve(matrix: Rows, right: list[Fraction]) -> list[Fraction] | None:
    """Return the solution of linear equations by elimination; None if the matrix is singular."""
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for i in range(len(rows)):
        pivot = next((k for k in range(i, len(rows)) if rows[k][i]), None)
        if pivot is None:
            return None
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in range(len(rows)):
            if k != i:
                rows[k] = [value - rows[k][i] * other for value, other in zip(rows[k], rows[i], strict=True)]
    return [row[-1] for row in rows]


def unbounded(seed: int) -> tuple[list[str], list[str]]:
    """Solve a problem without a lower bound, wherever zero is."""
    problem, _ = random_unbounded(seed)
    shifts = (np.full(problem.state_dim, -shift) for shift in SHIFTS)
    found = [lfo.solve(translated_by(problem, shift).problem, throw=False).status for shift in shifts]
    return [*found], [f"{status} from {s:g}" for s, status in zip(SHIFTS, found, strict=True) if status != "unbounded"]
