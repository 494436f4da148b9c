"""IPOPT, by CasADi, on one smooth map: multiple shooting, its region, boxes, stop bands and a quadratic cost."""

from __future__ import annotations

import time
import warnings
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from lin_freq_ocp.formulas.nodes import Formula, evaluate
from lin_freq_ocp.formulas.operations import POWER, PRODUCT, QUOTIENT, SUM, VARIABLE
from lin_freq_ocp.problem.hybrid.forms import piecewise_smooth
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.program_rows import real_rows

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
    X, U, step = casadi.MX.sym("X", n, T + 1), casadi.MX.sym("U", m, T), map_of(casadi, problem)
    parts = [np.kron(real_rows(T, problem.control_stop[:, j]), np.eye(1, m, j)) for j in range(m)]
    rows = np.concatenate(parts)
    constraints = [casadi.vec(X[:, 1:] - step.map(T)(casadi.vertcat(X[:, :T], U)))]
    if len(rows):
        constraints.append(casadi.DM(rows) @ casadi.vec(U))
    equations, mode = casadi.vertcat(*constraints).numel(), piecewise_smooth(problem).modes[0]
    if mode.region:  # switching functions, which are at most zero
        y = casadi.SX.sym("y", n + m)
        region = casadi.Function("region", [y], [_expression(casadi, mode.region, y)])
        constraints.append(casadi.vec(region.map(T)(casadi.vertcat(X[:, :T], U))))
    lower = np.full(casadi.vertcat(*constraints).numel(), -np.inf)
    lower[:equations] = 0.0
    unknowns = casadi.vertcat(casadi.vec(X), casadi.vec(U))
    tubes = problem.state_tube, problem.control_tube
    bounds = {f"{side}bx": np.concatenate([getattr(tube, name).ravel() for tube in tubes])
              for side, name in (("l", "lower"), ("u", "upper"))}  # fmt: skip
    program = {"x": unknowns, "f": cost_of_signals(casadi, problem, X, U), "g": casadi.vertcat(*constraints)}
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
    return casadi.Function("f", [y], [_expression(casadi, piecewise_smooth(problem).modes[0].f, y)])


def cost_of_signals(casadi: Any, problem: OptimalControlProblem, X: Any, U: Any) -> Any:
    """Return the quadratic cost of columns X (n, T+1) and U (m, T)."""
    cost, n, T = problem.quadratic, problem.state_dim, problem.horizon
    references = np.broadcast_to(cost.x_ref, (T + 1, n)), np.broadcast_to(cost.u_ref, U.shape[::-1])
    hessians = np.broadcast_to(cost.stage_hessians(), (T, n + U.shape[0], n + U.shape[0]))
    y = casadi.vertcat(X[:, :T] - references[0][:T].T, U - references[1].T)
    end, total = X[:, T] - references[0][T], 0
    same = bool((hessians == hessians[0]).all())
    products = hessians[0] @ y if same else casadi.horzcat(*(hessians[t] @ y[:, t] for t in range(T)))
    total = 0.5 * casadi.sum1(casadi.sum2(y * products)) + 0.5 * end.T @ np.asarray(cost.P) @ end
    linear = np.hstack([np.broadcast_to(cost.q, (T, n)), np.broadcast_to(cost.r, U.shape[::-1])])
    return total + casadi.sum1(casadi.sum2(linear.T * y)) + casadi.dot(casadi.DM(cost.p), end)


def _expression(casadi: Any, formulas: tuple[Formula, ...], y: Any) -> Any:
    """Return formulas as an expression of a column y."""
    functions = {"arctan": "atan"}

    def rule(node: Formula, a: list[Any]) -> Any:
        if node.kind == VARIABLE:
            return y[int(node.data[0])]
        if node.kind == SUM:
            return sum((factor * one for factor, one in zip(node.data[:-1], a, strict=True)), casadi.SX(node.data[-1]))
        if node.kind in (PRODUCT, QUOTIENT):
            return a[0] * a[1] if node.kind == PRODUCT else a[0] / a[1]
        if node.kind == POWER:
            return a[0] ** int(node.data[0])
        return getattr(casadi, functions.get(node.kind, node.kind))(a[0])

    return casadi.vertcat(*evaluate(formulas, rule))
