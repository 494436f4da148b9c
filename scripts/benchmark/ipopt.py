"""IPOPT, by CasADi, on one smooth map: multiple shooting, its region, path constraints, boxes, stop bands, and costs.

Costs are quadratic or by formulas without kinks.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from lin_freq_ocp.formulas.nodes import Formula, evaluate, kinks
from lin_freq_ocp.formulas.operations import POWER, PRODUCT, QUOTIENT, SUM, TABLE, TIME, VARIABLE
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.program_rows import real_rows
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth

TOLERANCE = 1e-9  # of IPOPT, relative


class Claim(NamedTuple):
    """The answer of IPOPT; seconds exclude the construction of the program."""

    trajectory: Trajectory
    cost: float
    status: str
    steps: int
    seconds: float


def solved_by_ipopt(problem: OptimalControlProblem, start: Trajectory, most_steps: int = 500) -> Claim:
    """Solve from a trajectory; the problem has no other constraints, terms and costs than those above."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of the types that CasADi's binding makes
        casadi = import_module("casadi")
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    one, X, U = casadi.SX.sym("y", n + m), casadi.MX.sym("X", n, T + 1), casadi.MX.sym("U", m, T)
    mode = piecewise_smooth(problem).modes[0]
    formulas = *mode.f, *mode.cost, *mode.region, *(h for rows in problem.path_constraints for h in rows.formulas)
    tables = list(dict.fromkeys(kinks(formulas, TIME, TABLE)))
    w = casadi.SX.sym("w", len(tables))
    data = np.array([node.data[:T] or range(T) for node in tables], dtype=float)
    of_time = dict(zip(tables, casadi.vertsplit(w) if len(tables) else [], strict=True))
    arguments = casadi.vertcat(X[:, :T], U), data.reshape(len(tables), T)

    def along(formulas: Sequence[Formula]) -> Any:
        function = casadi.Function("f", [one, w], [_expression(casadi, formulas, one, of_time)])
        return function.map(T)(*arguments)

    parts = [np.kron(real_rows(T, problem.control_stop[:, j]), np.eye(1, m, j)) for j in range(m)]
    rows = np.concatenate(parts)
    constraints = [casadi.vec(X[:, 1:] - along(mode.f))]
    if len(rows):
        constraints.append(casadi.DM(rows) @ casadi.vec(U))
    equations = casadi.vertcat(*constraints).numel()
    if mode.region:  # switching functions, which are at most zero
        constraints.append(casadi.vec(along(mode.region)))
    for rows in problem.path_constraints:
        limits = rows.limits()
        constraints.append(casadi.vec(along(rows.formulas) - limits[:T].T))
        if len(limits) > T:
            end = casadi.Function("h", [one, w], [_expression(casadi, rows.formulas, one, of_time)])
            last = [T if node.kind == TIME else node.data[-1] for node in tables]
            constraints.append(end(casadi.vertcat(X[:, T], np.zeros(m)), np.array(last, dtype=float)) - limits[T])
    lower = np.full(casadi.vertcat(*constraints).numel(), -np.inf)
    lower[:equations] = 0.0
    unknowns = casadi.vertcat(casadi.vec(X), casadi.vec(U))
    tubes = problem.state_tube, problem.control_tube
    bounds = {f"{side}bx": np.concatenate([getattr(tube, name).ravel() for tube in tubes])
              for side, name in (("l", "lower"), ("u", "upper"))}  # fmt: skip
    cost = cost_of_signals(casadi, problem, X, U)
    if mode.cost:
        cost += casadi.sum2(along(mode.cost))
    for formula in problem.cost.formulas[1:]:
        if formula is not None:
            last = casadi.Function("c", [one], [_expression(casadi, [formula], one, {})])
            cost += last(casadi.vertcat(X[:, T], np.zeros(m)))
    program = {"x": unknowns, "f": cost, "g": casadi.vertcat(*constraints)}
    quiet = {"ipopt.print_level": 0, "print_time": False, "ipopt.sb": "yes"}
    solver = casadi.nlpsol("s", "ipopt", program, {**quiet, "ipopt.tol": TOLERANCE, "ipopt.max_iter": most_steps})
    begun = time.process_time()
    found = solver(x0=np.concatenate([start.x.ravel(), start.u.ravel()]), lbg=lower, ubg=0, **bounds)
    seconds, values = time.process_time() - begun, np.array(found["x"]).ravel()
    x, u = np.split(values, [(T + 1) * n])
    stats = solver.stats()
    trajectory = Trajectory(x.reshape(T + 1, n), u.reshape(T, m))
    return Claim(trajectory, float(found["f"]), str(stats["return_status"]), int(stats["iter_count"]), seconds)


def map_of(casadi: Any, problem: OptimalControlProblem) -> Any:
    """Return the map of a problem as a function of a column (x, u)."""
    y = casadi.SX.sym("y", problem.state_dim + problem.control_dim)
    return casadi.Function("f", [y], [_expression(casadi, piecewise_smooth(problem).modes[0].f, y, {})])


def cost_of_signals(casadi: Any, problem: OptimalControlProblem, X: Any, U: Any) -> Any:
    """Return the quadratic cost of columns X (n, T+1) and U (m, T)."""
    cost, n, T = problem.quadratic, problem.state_dim, problem.horizon
    references = np.broadcast_to(cost.x_ref, (T + 1, n)), np.broadcast_to(cost.u_ref, U.shape[::-1])
    hessians = np.broadcast_to(cost.stage_hessians, (T, n + U.shape[0], n + U.shape[0]))
    y = casadi.vertcat(X[:, :T] - references[0][:T].T, U - references[1].T)
    end, total = X[:, T] - references[0][T], 0
    same = bool((hessians == hessians[0]).all())
    products = hessians[0] @ y if same else casadi.horzcat(*(hessians[t] @ y[:, t] for t in range(T)))
    total = 0.5 * casadi.sum1(casadi.sum2(y * products)) + 0.5 * end.T @ np.asarray(cost.P) @ end
    linear = np.hstack([np.broadcast_to(cost.q, (T, n)), np.broadcast_to(cost.r, U.shape[::-1])])
    return total + casadi.sum1(casadi.sum2(linear.T * y)) + casadi.dot(casadi.DM(cost.p), end)


def _expression(casadi: Any, formulas: Sequence[Formula], y: Any, of_time: Mapping[Formula, Any]) -> Any:
    """Return formulas as an expression of a column y and of symbols for what depends on time."""
    functions = {"arctan": "atan"}

    def rule(node: Formula, a: list[Any]) -> Any:
        if node.kind == VARIABLE:
            return y[int(node.data[0])]
        if node in of_time:
            return of_time[node]
        if node.kind == SUM:
            return sum((factor * one for factor, one in zip(node.data[:-1], a, strict=True)), casadi.SX(node.data[-1]))
        if node.kind in (PRODUCT, QUOTIENT):
            return a[0] * a[1] if node.kind == PRODUCT else a[0] / a[1]
        if node.kind == POWER:
            return a[0] ** int(node.data[0])
        return getattr(casadi, functions.get(node.kind, node.kind))(a[0])

    return casadi.vertcat(*evaluate(formulas, rule))
