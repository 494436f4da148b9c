"""Ends and references of 1e-15 to 0.1 in place of zero change no status, and the cost by no more than they allow.

A measured state and a reference that was computed are hardly ever zero, and a loop comes to its set point step by step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import lin_freq_ocp as lfo
from helpers.checks import pairs

APART = 1e-5  # of the costs of two answers, which are of order 1
STEEPEST = 30.0  # change of the cost by a change of all small numbers
METHODS = "quick", "quick", "structured", "convex"
NO_POINT = {"initial box", "initial ball", "free initial state", "periodic ends"}  # features without a given start
NEAREST_TO_REST = {  # the distance from which their optima near rest are found and proven
    "convex path constraint": 1e-13,
    "piecewise-smooth dynamics": 1e-13,
    "piecewise-affine dynamics": 1e-11,
    "part of the fundamental": np.inf,
}
KINKS = {"piecewise-smooth dynamics", "cost by formulas with a kink"}  # no multipliers are found for both, at rest
LEVELS = {"levels", "duty cycles"}  # they satisfy exact equations from rest alone, and reach balls of ends on the rim


@dataclass(frozen=True)
class Outcome:
    """The features, the small number, and status and cost at zero and at it."""

    seed: int
    names: tuple[str, ...]
    method: str
    small: float
    statuses: tuple[str, str]
    costs: tuple[float, float]

    @property
    def kind(self) -> str:
        """Return the method."""
        return self.method

    @property
    def passed(self) -> bool:
        """Whether both statuses are the same and both costs nearly."""
        apart = abs(self.costs[1] - self.costs[0]) if np.isfinite(self.costs).all() else 0.0
        return self.statuses[0] == self.statuses[1] and apart <= APART + STEEPEST * self.small


def with_small_numbers(problem: lfo.OptimalControlProblem, values: np.ndarray) -> lfo.OptimalControlProblem:
    """Return a problem of pairs with these values in place of zeros: of the speed at both ends, and of references.

    Where there is a fifth value, the position begins that far from its reference.
    """
    position = 0.6 + values[4] if len(values) > 4 else 1.5
    changes: dict[str, Any] = {"initial_state": lfo.sets.Point([position, values[0]])}
    if isinstance(problem.terminal_state, lfo.sets.Point):
        changes["terminal_state"] = lfo.sets.Point([0.2, values[1]])
    x_ref, u_ref = problem.quadratic.x_ref, problem.quadratic.u_ref
    references = {"x_ref": np.where(x_ref == 0, values[2], x_ref), "u_ref": np.where(u_ref == 0, values[3], u_ref)}
    tracking = problem.with_references(references)
    return replace(tracking, **changes)


def check(seed: int) -> Outcome:
    """Solve a random pair of features with zeros and with small numbers, far from the reference or at it."""
    rng, features = np.random.default_rng([seed, 47]), sorted(pairs.FEATURES.keys() - NO_POINT)
    while True:
        names = tuple(str(name) for name in rng.choice(features, 2, replace=False))
        exact = [name for name in names if name.startswith("stop band") or name in ("linked ends", "terminal ball")]
        stopped_levels = LEVELS & set(names) and exact
        if pairs.exclude_each_other(*names) or stopped_levels:
            continue
        try:
            problem = pairs.problem_of(*names)
        except (lfo.errors.ProblemError, lfo.errors.UnsupportedError):
            continue
        if problem.state_dim == 2 and isinstance(problem.initial_state, lfo.sets.Point):
            break
    small, wanted = float(10.0 ** rng.uniform(-15, -1)), rng.random() < 0.5
    near = max((NEAREST_TO_REST.get(name, 0.0) for name in names), default=0.0)
    count = 4 + int(wanted and small >= near and not set(names) >= KINKS)
    values = small * rng.choice([-1.0, 0.0, 1.0], count) * rng.uniform(0.1, 1, count)
    method = str(rng.choice(METHODS))
    statuses, costs = list[str](), list[float]()
    for numbers in (np.zeros(count), values):
        given = with_small_numbers(problem, numbers)
        try:
            result = lfo.solve(given, pairs.quick_method(given) if method == "quick" else method, throw=False)
        except (lfo.errors.ProblemError, lfo.errors.UnsupportedError) as error:
            statuses.append(type(error).__name__)
            costs.append(np.inf)
            continue
        statuses.append(str(result.status))
        costs.append(np.inf if result.cost is None else result.cost)
    return Outcome(seed, names, method, small, (statuses[0], statuses[1]), (costs[0], costs[1]))
