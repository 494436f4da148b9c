"""Costs and constraints whose formulas lose most digits of their values, against balls of more than 50 digits.

x+ = a x + b u with costs f(s_t) + r/2 u_t^2, s a combination of the states: f is small, and its terms are of order one.
The exact cost of any trajectory is above the optimum, so no lower bound may be above it: that of the answer, and that
of Newton's method from there, in balls. A path constraint that known controls satisfy is never infeasible.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from flint import arb

import lin_freq_ocp as lfo
from helpers.checks.outcome import Outcome
from helpers.exact.reduced import FormulaTrial, ReducedCost, series_of

STEPS = 12  # of Newton's method
ROUNDING = 64 * float(np.finfo(float).eps)  # of a cost in double precision, relative to the terms of its formulas
OPTIMAL = 1e-6  # part of the cost by which an optimal one may be above another, beyond what its rounding allows
BOUND, REACH = 0.5, 0.9  # of controls and of states
SECONDS = 1.0  # of the search for a bound
KINDS = ("cost", "path constraint")

FORMULAS = {
    "1 - cos(s)": True,  # whether it is convex where |s| <= 1
    "log(cosh(s))": True,
    "exp(s) - 1 - s": True,
    "sqrt(1 + s**2) - 1": True,
    "cosh(s) - 1": True,
    "s - log(1 + s)": True,
    "(1 + s)**4 - 1 - 4*s": True,
    "cos(s) - 1 + s**2": True,
    "1/(1 + s) - 1 + s": True,
    "exp(s) + exp(-s) - 2": True,
    "s*tanh(s)": False,
    "s - sin(s) + s**2/2": False,
    "exp(-s**2) - 1 + 2*s**2": False,
    "log(1 + s**2)": False,
    "(1 + s)*(1 - s) - cos(s)": False,
}


class Trial(FormulaTrial):
    """The numbers of a problem whose formula cancels."""

    def __init__(self, seed: int):
        rng = np.random.default_rng([seed, 43])
        self.n, self.T = int(rng.integers(1, 3)), int(rng.integers(1, 5))
        self.A = np.triu(rng.uniform(-0.5, 0.5, (self.n, self.n)), 1) + np.diag(rng.choice([0.5, 0.9, 1.0], self.n))
        self.B = rng.choice([-1.0, 1.0, 0.5], (self.n, 1))
        self.c = np.ones(self.n) if rng.random() < 0.5 else rng.uniform(0.3, 1.0, self.n)
        self.start = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-9, -1) * rng.uniform(0.3, 1.0, self.n)
        self.price = float(rng.choice([1.0, 0.1, 1e-3]))
        self.formula = str(rng.choice(list(FORMULAS)))
        self.margin = float(10.0 ** rng.uniform(-12, -3))  # of the limit of a path constraint

    def problem(self, *rows: lfo.sets.PathConstraint) -> lfo.OptimalControlProblem:
        """Return the problem; with path constraints, it has no cost by formulas."""
        cost = lfo.QuadraticCost(R=self.price)
        return self.problem_of(cost if rows else cost + self.formula_cost, BOUND, REACH, stage_rows=rows)


def improve_controls(cost: ReducedCost, u: list[Any]) -> list[Any]:
    """Return controls that Newton's method leads to, within the bounds."""
    for _ in range(STEPS):
        slopes, hessian = cost.derivatives(u)
        step = hessian.solve(slopes)
        u = [min(max((value - step[k, 0]).mid(), arb(-BOUND)), arb(BOUND)) for k, value in enumerate(u)]
    return u


def check(seed: int) -> Outcome:
    """Solve a random problem, and compare what is said with balls."""
    return (_check_cost, _check_constraint)[seed % 2](seed)


def _check_cost(seed: int) -> Outcome:
    trial, wrong = Trial(seed), list[str]()
    result = lfo.solve(trial.problem(), throw=False, time_limit=SECONDS)
    if result.trajectory is None or result.cost is None:
        return Outcome(seed, KINDS[0], (str(result.status),), (f"no answer: {result.message}",))
    exact, own = trial.reduced(), [arb(value) for value in result.control[:, 0].tolist()]
    cost, best = exact.value(own), exact.value(improve_controls(exact, own))
    best = best if best < cost else cost
    allowed = ROUNDING * trial.T
    if not abs(cost - result.cost) <= allowed:
        wrong.append(f"the cost {result.cost!r} is {float(cost)!r}")
    if result.lower_bound is not None and result.bound == "rigorous" and result.lower_bound > best:
        wrong.append(f"the bound {result.lower_bound!r} is above {float(best)!r}")
    if result.status == "optimal" and not cost - best <= OPTIMAL * abs(best) + allowed:
        wrong.append(f"optimal at {float(cost)!r}, above {float(best)!r}")
    return Outcome(seed, KINDS[0], (str(result.status),), tuple(wrong))


def _check_constraint(seed: int) -> Outcome:
    trial, rng, wrong = Trial(seed), np.random.default_rng([seed, 44]), list[str]()
    size = float(np.abs(trial.start).max())
    u = (size * rng.uniform(-1, 1, trial.T)).tolist()
    constrained = trial.reduced(trial.terms[0]._replace(times=range(trial.T + 1)))
    largest = max(series_of(trial.formula, s)[0] for s in constrained.combinations(u))
    limit = float(largest + abs(largest) * trial.margin)
    limit = limit if limit >= largest else float(np.nextafter(limit, np.inf))
    row = lfo.sets.PathConstraint(trial.formula, upper=limit, let=trial.let)
    result = lfo.solve(trial.problem(row), throw=False, time_limit=SECONDS)
    if result.status in ("infeasible", "infeasible_claimed"):
        wrong.append(f"{result.status}, but {u} keeps {limit!r}: {result.message}")
    return Outcome(seed, KINDS[1], (str(result.status),), tuple(wrong))
