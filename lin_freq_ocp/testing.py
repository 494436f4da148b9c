"""Problems with known optimal costs to test your own solver, and a check of your own terms.

``conformance_cases()`` yields the problems, and ``check(case, solver)`` measures the answer of a solver to one of them.
``check_terms(problem)`` lists the faults of costs, sets, rows and frequency constraints that you have written.

Examples
--------
>>> from lin_freq_ocp.testing import check, conformance_cases
>>> def my_solver(problem):  # OptimalControlProblem -> Trajectory, or None if infeasible
...     return lfo.solve(problem, throw=False).trajectory
>>> reports = [check(case, my_solver) for case in conformance_cases("linear")]
>>> [report.message for report in reports if not report.passed]
[]
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp

import lin_freq_ocp as lfo
from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.terms.penalty import Penalty
from lin_freq_ocp.problem.terms.term import Term, TermKind
from lin_freq_ocp.program.backends.base import Claim, backend
from lin_freq_ocp.program.program import Program
from lin_freq_ocp.transform.limits import constraints, numbers
from lin_freq_ocp.transform.reformulations import RATE_LIMIT

__all__ = ["Case", "Report", "check", "check_terms", "conformance_cases"]
DOOR = ["INSTANCES", "PENDULUM", "PIECEWISE_AFFINE", "STATED", "reference_problem"]  # for the tests of the package

Kind = Literal["linear", "piecewise affine", "piecewise smooth"]
Solver = Callable[[lfo.OptimalControlProblem], lfo.Trajectory | None]  # None: infeasible, or no answer
TOLERANCE = 1e-6  # relative error of a cost


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
    """The judgement of a solver's answer to a case.

    Attributes
    ----------
    name : str
        Of the case.
    cost : float or None
        Of the trajectory that the solver returned.
    passed : bool
    message : str
        The fault, if there is one.
    """

    name: str
    cost: float | None
    passed: bool
    message: str = ""


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
    >>> case = next(conformance_cases("linear"))
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


# Problems with known costs: linear ones in full, others as arguments of the library; the file says more
_REFERENCE: dict[str, Any] = json.loads(Path(__file__).with_name("reference.json").read_text())
INSTANCES = {str(data["name"]): data for data in _REFERENCE["instances"]}
STATED = [name for name in INSTANCES if not INSTANCES[name]["soft_u"]]  # by boxes and stop bands, without a mask
MASKED = 1e-6  # relative error of the known cost of the problem with a mask, dint200_soft
PENDULUM: dict[str, tuple[dict[str, object], float]] = _REFERENCE["pendulum"]  # keyword arguments, optimal cost
PRINTED = 1e-7  # relative error of the costs of problems with modes, by their digits
PIECEWISE_AFFINE: dict[str, tuple[str, dict[str, object], float | None]] = _REFERENCE["piecewise affine"]
PIECEWISE_SMOOTH: dict[str, tuple[str, dict[str, object], float]] = _REFERENCE["piecewise smooth"]


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


def reference_problem(name: str, **changes: Any) -> lfo.OptimalControlProblem:
    """Return the problem of an instance; ``changes`` replace entries of its data."""
    data = INSTANCES[name] | changes
    T = data["T"]
    bounds = lfo.Box([-bound for bound in data["xmax"]], data["xmax"])
    last = bounds if data["xT"] is None else lfo.sets.Everything()
    A, B = data["A"], data["B"]
    if name == "ltv200":  # the time-varying instance
        t = np.arange(T)
        A, B = np.zeros((T, 2, 2)), np.zeros((T, 2, 1))
        A[:, 0, 0] = 1
        A[:, 0, 1] = 0.02 + 0.005 * np.sin(2 * np.pi * t / 200)
        A[:, 1, 0] = -0.02 * np.cos(2 * np.pi * t / 100)
        A[:, 1, 1] = 1 - 0.002 * t / 200
        B[:, 1, 0] = 0.02 * (1 + 0.3 * np.sin(2 * np.pi * t / 50))
    return lfo.OptimalControlProblem(
        dynamics=lfo.LinearDynamics(A, B),
        horizon=T,
        cost=lfo.QuadraticCost(Q=data["Q"], R=data["R"], P=data["PT"]),
        control_set=lfo.Box(data["ulo"], data["uhi"]),
        state_set=[lfo.sets.Everything(), *[bounds] * (T - 1), last],
        initial_state=data["x0"],
        terminal_state=data["xT"],
        control_spectrum=[
            *(lfo.stop_band(bins=bins, component=j) for j, bins in enumerate(data["stop_u"]) if bins),
            *(lfo.MagnitudeBound(mask["c"], bins=mask["k"], component=int(j)) for j, mask in data["soft_u"].items()),
        ],
        name=name,
    )


SIZES = (0.1, 1.0, 10.0)  # of random signals, in units of the optimal ones: inside and outside of limits
STEP = 1e-6  # of differences, relative to the values
ROUNDING = 1e-9  # error of sums, relative to their terms
ACCURACY = 1e-4  # error of differences and of solvers, relative to the compared values
Point = tuple[Array, Array]  # x (T+1, n) and u (T, m)


def check_terms(problem: lfo.OptimalControlProblem, seed: int = 0) -> list[str]:
    """Return the faults of the terms of a problem, in words; an empty list if they keep their protocols.

    Of every term h(L(x, u)) the check compares rows and adjoint of L with its values, slopes of h with differences, the
    conic form with the cost, the Fenchel-Young gap with the gain of other points, and all with the problem
    ``rate_limited``. A relaxed limit must not be violated more, and its numbers at their own values change nothing. The
    optimum must be proven.

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
    best, faults = (result.trajectory.x, result.trajectory.u), dict.fromkeys(unproven)
    for size in SIZES:
        x, u = (size * np.abs(part).max() * rng.standard_normal(part.shape) for part in best)
        for t, value in problem.fixed_ends.items():
            x[t] = value
        for term in problem.terms:
            for fault in (*_map_faults(term, (x, u), rng), *_penalty_faults(term, (x, u), best, rng)):
                faults[f"{term.name}: {fault}"] = None
        faults |= dict.fromkeys((*_rate_limit_faults(problem, x, u), *_limit_faults(problem, x, u)))
    return list(faults)


def _map_faults(term: Term, point: Point, rng: np.random.Generator) -> Iterator[str]:
    (x, u), weights = point, rng.standard_normal(term.shape)
    v, offset = term.map.values(x, u), term.map.values(np.zeros_like(x), np.zeros_like(u))
    error = ROUNDING * (term.map.sizes(x, u) + np.abs(offset))
    L, c = term.map.rows(len(u), x.shape[1], u.shape[1])
    if (np.abs((L @ np.concatenate([x.ravel(), u.ravel()]) + c).reshape(v.shape) - v) > error).any():
        yield "rows of the map differ from its values"
    of_x, of_u = term.map.pull_back(weights, (x.shape, u.shape))
    if abs((weights * (v - offset)).sum() - (of_x * x).sum() - (of_u * u).sum()) > (np.abs(weights) * error).sum():
        yield "pull_back is not the adjoint of values"


def _penalty_faults(term: Term, sample: Point, best: Point, rng: np.random.Generator) -> Iterator[str]:
    penalty, v, w, sizes = term.penalty, term.map.values(*sample), term.map.values(*best), term.map.sizes(*best)
    change, weights = np.abs(v).max() * rng.standard_normal(v.shape), rng.standard_normal(v.shape)
    for name, function, slope in (
        ("slope", lambda at: penalty.cost(at).sum(keepdims=True), np.array([penalty.slope(v, change, 0.0)])),
        ("excess_slope", penalty.excess, penalty.excess_slope(v, change, 0.0)),
    ):
        limited = np.isfinite(function(v))
        backward, value, near, forward = (function(v + step * change)[limited] for step in (-1.0, 0.0, STEP, 1.0))
        rise = (near - value) / STEP
        if (np.abs(slope[limited] - rise) > ACCURACY * (np.abs(forward - backward) + np.abs(rise)).sum()).any():
            yield f"{name} is not that of differences"
    expected = np.inf if penalty.violation(v).any() else penalty.cost(v).sum()
    if not np.isclose(_conic_value(penalty, v), expected, rtol=ACCURACY, atol=ACCURACY * penalty.unbounded(change)[1]):
        yield "the conic form has another value than the cost"
    for eta_C in (0.0, 1.0):
        # At fixed multipliers no point, w among them, gains more than the Fenchel-Young gap
        point, multipliers = w if np.isinf(expected) else v, penalty.subgradient(weights, eta_C)
        gain = eta_C * (penalty.cost(point) - penalty.cost(w)).sum() + (multipliers * (w - point)).sum()
        scale = eta_C * (penalty.cost(point) + penalty.cost(w)).sum()
        scale += (np.abs(multipliers) * (sizes + np.abs(point))).sum()
        gap = penalty.gap(point, multipliers, eta_C)
        if min(gap.min(), gap.sum() - gain) < -ACCURACY * scale:
            yield "the gap is less than what another point gains"


def _conic_value(penalty: Penalty, v: Array) -> float:
    """Return the least price of slacks with which values fit into the conic form; inf if they fit with none."""
    form = penalty.conic(*v.shape)
    values, last = np.append(v.ravel(), 0.0)[form.entries], np.eye(len(form.prices) + 1)[-1]
    # One more variable, with a square and no row: the program is not empty where the form has no slacks
    A = sp.csc_array(sp.hstack([form.slacks, sp.csc_array((len(values), 1))]))
    prices, lower, upper = np.append(form.prices, 0.0), form.lower - values, form.upper - values
    program = Program(sp.csc_array(sp.diags_array(last)), prices, A, lower, upper, cones=form.cones)
    solution = backend("clarabel")(program, ROUNDING, None)
    return float(prices @ solution.z) if solution.claim is Claim.SOLVED and solution.z is not None else np.inf


def _rate_limit_faults(problem: lfo.OptimalControlProblem, x: Array, u: Array) -> Iterator[str]:
    """Yield the kinds of terms whose cost or violation changes where rate limits append states to the problem."""
    limited, augmented = lfo.rate_limited(problem, 1.0), np.hstack([x, np.vstack([0 * u[:1], u])])
    for kind in dict.fromkeys(term.kind for term in problem.terms):
        totals = [
            np.sum([[term.cost(states, u).sum(), term.violation(states, u).sum()] for term in terms], axis=0)
            for terms, states in ((_of_kind(problem, kind), x), (_of_kind(limited, kind), augmented))
        ]
        if not np.allclose(*totals, rtol=ROUNDING, atol=0.0):
            yield f"{kind}: it is another one in rate_limited"


def _limit_faults(problem: lfo.OptimalControlProblem, x: Array, u: Array) -> Iterator[str]:
    """Yield the limits that are violated more after they are relaxed, and the numbers that are not those they say."""
    before = _total_violation(problem, x, u)
    for limit in constraints(problem):
        relaxed = limit.relaxed(problem, 1.0 if limit.whole else limit.size)
        if _total_violation(relaxed, x, u) > (1 + ROUNDING) * before:
            yield f"{limit.name}: it is violated more after it is relaxed"
    for number in numbers(problem).values():
        same = replace(problem, **{number.field: number.put(getattr(problem, number.field), number.value)})
        if not np.isclose(_total_violation(same, x, u), before, rtol=ROUNDING, atol=0.0):
            yield f"{number.key}: it is another one at its own value"


def _total_violation(problem: lfo.OptimalControlProblem, x: Array, u: Array) -> float:
    bounds = problem.state_tube.violation(x).sum() + problem.control_tube.violation(u).sum()
    return float(bounds + sum(term.violation(x, u).sum() for term in problem.terms))


def _of_kind(problem: lfo.OptimalControlProblem, kind: TermKind) -> list[Term]:
    implied = {id(term) for term in problem.terms if term.kind.is_link and term.source is None}  # by the dynamics
    return [term for term in problem.terms if term.kind == kind and term.name != RATE_LIMIT and id(term) not in implied]
