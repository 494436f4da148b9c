"""Problems with known optimal costs, and the judgement of what a solver answers to them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

import lin_freq_ocp as lfo
from lin_freq_ocp.testing import random_convex, random_kinks, random_linear, random_lti
from lin_freq_ocp.testing.random_infeasible import random_infeasible
from lin_freq_ocp.testing.reference import (
    INSTANCES,
    PENDULUM,
    PIECEWISE_AFFINE,
    PIECEWISE_SMOOTH,
    STATED,
    reference_problem,
)

Kind = Literal["linear", "piecewise affine", "piecewise smooth"]
Solver = Callable[[lfo.OptimalControlProblem], lfo.Trajectory | None]  # None: infeasible, or no answer
TOLERANCE = 1e-6  # relative error of a cost
MASKED = 1e-6  # relative error of the known cost of the problem with a mask
PRINTED = 1e-7  # relative error of the known costs of piecewise-affine problems


def _mixed(seed: int) -> lfo.OptimalControlProblem:
    from lin_freq_ocp.testing import random_mixed  # needs CVXPY, slow to import

    return random_mixed.problem_of(random_mixed.random_model(seed))


FAMILIES: dict[str, Callable[[int], lfo.OptimalControlProblem]] = {
    "convex": lambda seed: random_convex.random_problem(seed)[1],
    "lti": random_lti.random_lti,
    "linear": lambda seed: random_linear.random_linear(seed).problem,
    "mixed": _mixed,
    "kinks": lambda seed: random_kinks.random_problem(seed)[1],
    "infeasible": lambda seed: random_infeasible(seed)[1],
}


@dataclass(frozen=True, eq=False)
class Case:
    """A problem and its optimal cost.

    Attributes
    ----------
    name : str
    problem : OptimalControlProblem
    cost : float or None
        inf: infeasible; None: not known, and only feasibility is judged.
    accuracy : float
        Relative error of the known cost.
    """

    name: str
    problem: lfo.OptimalControlProblem
    cost: float | None
    accuracy: float = 1e-9


@dataclass(frozen=True)
class Report:
    """What a solver's answer is worth.

    Attributes
    ----------
    name : str
        Of the case.
    cost : float or None
        Of the trajectory that was answered.
    passed : bool
    message : str
        What is wrong, if anything.
    """

    name: str
    cost: float | None
    passed: bool
    message: str = ""


def conformance_cases(kind: Kind | None = None) -> Iterator[Case]:
    """Yield problems with known optimal costs.

    Parameters
    ----------
    kind : {"linear", "piecewise affine", "piecewise smooth"}, optional
        Of the dynamics; default: all.

    Yields
    ------
    Case

    Examples
    --------
    >>> len(list(conformance_cases("linear"))) > 10
    True
    """
    if kind in (None, "linear"):
        for name in INSTANCES:
            accuracy = 1e-9 if name in STATED else MASKED
            yield Case(name, reference_problem(name), INSTANCES[name]["optimal_value"], accuracy)
        for name, (keywords, cost) in PENDULUM.items():
            yield Case(f"pendulum, {name}", lfo.library.PROBLEMS["pendulum"](**keywords), cost)
        yield Case("pendulum, too weak", lfo.library.pendulum(control_bound=0.01), np.inf)
    for table, of_kind in ((PIECEWISE_AFFINE, "piecewise affine"), (PIECEWISE_SMOOTH, "piecewise smooth")):
        if kind in (None, of_kind):
            for name, (system, keywords, cost) in table.items():
                yield Case(name, lfo.library.by_name(system)(**keywords), cost, PRINTED)


def random_case(family: str, seed: int) -> Case:
    """Return a random problem with the cost that this package proves, None where it proves nothing.

    Parameters
    ----------
    family : {"convex", "lti", "linear", "mixed", "kinks", "infeasible"}
        See the modules of ``lin_freq_ocp.testing``.
    seed : int

    Returns
    -------
    Case

    Examples
    --------
    >>> random_case("convex", 0).cost > 0
    True
    """
    problem = FAMILIES[family](seed)
    result = lfo.solve(problem, throw=False)
    cost = {"infeasible": np.inf, "optimal": result.cost}.get(str(result.status))
    return Case(f"{family} {seed}", problem, cost, TOLERANCE)


def check(case: Case, solver: Solver, tolerance: float = TOLERANCE) -> Report:
    """Ask a solver, measure its trajectory with ``certify``, and compare the cost with the known optimum.

    Parameters
    ----------
    case : Case
    solver : callable
        OptimalControlProblem -> Trajectory, or None for an infeasible problem.
    tolerance : float
        Relative error of the cost that is allowed.

    Returns
    -------
    Report

    Examples
    --------
    >>> case = random_case("convex", 0)
    >>> check(case, lambda problem: lfo.solve(problem).trajectory).passed
    True
    """
    trajectory = solver(case.problem)
    if trajectory is None:
        return Report(case.name, None, case.cost == np.inf, "" if case.cost == np.inf else "no trajectory")
    certificate = lfo.certify(case.problem, trajectory)
    cost = certificate.cost
    if not certificate.feasible:
        return Report(case.name, cost, False, f"not feasible: {certificate.worst.name}")
    if case.cost is None:
        return Report(case.name, cost, True)
    error = (cost - case.cost) / max(1.0, abs(case.cost)) if np.isfinite(case.cost) else -np.inf
    message = "" if abs(error) <= max(tolerance, case.accuracy) else f"relative error of the cost {error:.1e}"
    return Report(case.name, cost, not message, message)
