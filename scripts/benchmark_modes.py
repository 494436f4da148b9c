"""Time the search over modes beside a mixed-integer solver, and what each relaxation leaves open at the root.

Usage: python scripts/benchmark_modes.py [--limit SECONDS] [--relaxations] [--long]

The contender is SCIP on the monolithic big-M problem as a careful user of CVXPY would write it. Each is asked for a
relative gap of 1e-6; what we print as ours includes the judge's check of the whole tree. ``--relaxations`` prints root
gaps and nodes of our search with each relaxation instead; ``--long`` adds the horizons of 30.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable

import cvxpy as cp
import numpy as np
from rich.console import Console
from rich.table import Table

import lin_freq_ocp as lfo
from lin_freq_ocp.interchange.environment import environment
from lin_freq_ocp.methods.modes.branch_and_bound import BranchAndBound
from lin_freq_ocp.methods.modes.node import relaxed
from lin_freq_ocp.methods.modes.search import SearchLimits
from lin_freq_ocp.transcription.mode_relaxation import RELAXATIONS, ModeRelaxation

GAP = 1e-6

CASES: dict[str, Callable[[], lfo.OptimalControlProblem]] = {
    "pendulum with wall, T = 20": lambda: lfo.library.pendulum_with_wall(horizon=20, control_spectrum="freq"),
    "rotation, T = 20": lambda: rotation(20),
    "buck, two modes, T = 15": lambda: lfo.library.buck_affine(horizon=15, control_spectrum="freq"),
    "buck, two modes, T = 20": lambda: lfo.library.buck_affine(horizon=20, control_spectrum="freq"),
}

LONG: dict[str, Callable[[], lfo.OptimalControlProblem]] = {
    "pendulum with wall, T = 30": lambda: lfo.library.pendulum_with_wall(horizon=30, control_spectrum="freq"),
    "rotation, T = 30": lambda: rotation(30),
    "buck, two modes, T = 30": lambda: lfo.library.buck_affine(horizon=30, control_spectrum="freq"),
}


def rotation(horizon: int) -> lfo.OptimalControlProblem:
    """Return the switched rotation from (-6, 7)."""
    return lfo.library.switched_rotation(horizon=horizon, initial_state=(-6, 7), control_spectrum="freq")


def scip_through_cvxpy(problem: lfo.OptimalControlProblem, limit: float) -> tuple[float, float, str]:
    """Return seconds, cost and status of SCIP on the big-M problem; M from the state and control bounds."""
    started = time.perf_counter()
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    arrays, cost = problem.piecewise.arrays(T), problem.quadratic
    modes = arrays.h.shape[1]
    x, u = cp.Variable((T + 1, n)), cp.Variable((T, m))
    delta = cp.Variable((T, modes), boolean=True)
    tube, controls = problem.state_tube, problem.control_tube
    boxes = problem.state_boxes
    constraints = [x >= boxes.lower, x <= boxes.upper, u >= controls.lower, u <= controls.upper]
    constraints += [x[0] == tube.lower[0], cp.sum(delta, axis=1) == 1]
    for t in range(T):
        low = np.concatenate([boxes.lower[t], controls.lower[t]])
        high = np.concatenate([boxes.upper[t], controls.upper[t]])
        for i in range(modes):
            A, B, d, G, H, h = (part[t, i] for part in vars(arrays).values())
            rows = np.hstack([G, H])
            real = np.isfinite(h)
            M = np.maximum(rows * low, rows * high).sum(axis=1)[real] - h[real]
            constraints.append(G[real] @ x[t] + H[real] @ u[t] <= h[real] + M * (1 - delta[t, i]))
            maps = np.hstack([A, B])
            least = np.minimum(maps * low, maps * high).sum(axis=1) + d
            most = np.maximum(maps * low, maps * high).sum(axis=1) + d
            miss = x[t + 1] - A @ x[t] - B @ u[t] - d
            constraints.append(miss <= (boxes.upper[t + 1] - least) * (1 - delta[t, i]))
            constraints.append(-miss <= (most - boxes.lower[t + 1]) * (1 - delta[t, i]))
    k = np.flatnonzero(problem.control_stop.any(axis=1))
    angle = 2 * np.pi * np.outer(k, np.arange(T)) / T
    constraints += [np.cos(angle) @ u == 0, np.sin(angle[2 * k < T]) @ u == 0]
    Q, R, P = (np.diagonal(part) for part in (cost.Q, cost.R, cost.P))
    objective = 0.5 * cp.sum(cp.multiply(np.tile(Q, (T, 1)), cp.square(x[:-1] - cost.x_ref)))
    objective += 0.5 * cp.sum(cp.multiply(np.tile(R, (T, 1)), cp.square(u - cost.u_ref)))
    objective += 0.5 * cp.sum(cp.multiply(P, cp.square(x[-1] - cost.x_ref)))
    program = cp.Problem(cp.Minimize(objective), constraints)
    options = {"limits/gap": GAP, "limits/time": limit}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            program.solve(solver=cp.SCIP, scip_params=options)
        except cp.SolverError as error:
            return time.perf_counter() - started, np.nan, str(error)
    value = np.nan if program.value is None else float(program.value)
    return time.perf_counter() - started, value, str(program.status)


def compare(cases: dict[str, Callable[[], lfo.OptimalControlProblem]], limit: float) -> Table:
    """Return the table of times, ours and SCIP's."""
    table = Table("problem", "ours", "cost", "proven gap", "nodes", "SCIP", "its cost", "its status", "SCIP / ours")
    for name, build in cases.items():
        problem = build()
        started = time.perf_counter()
        result = lfo.solve(problem, time_limit=limit, throw=False)
        ours = time.perf_counter() - started
        theirs, cost, status = scip_through_cvxpy(problem, limit)
        nodes = str(len(result.tree.nodes)) if result.tree else "-"
        gap = "-" if result.gap is None else f"{result.gap:.1e}"
        row = [f"{ours:.2f} s" + ("" if result.status == "optimal" else f" ({result.status})")]
        row += [f"{result.cost:.7g}", gap, nodes, f"{theirs:.2f} s", f"{cost:.7g}", status, f"{theirs / ours:.2g}"]
        table.add_row(name, *row)
    return table


def relaxations(cases: dict[str, Callable[[], lfo.OptimalControlProblem]], limit: float) -> Table:
    """Return root gaps in per cent, with and without what the reach excludes, and nodes of each relaxation."""
    table = Table("problem", *(f"{kind}: root gap, nodes" for kind in RELAXATIONS))
    for name, build in cases.items():
        problem, cells = build(), list[str]()
        best = lfo.solve(problem, time_limit=limit, throw=False).cost
        for kind in RELAXATIONS:
            relaxation = ModeRelaxation(problem, kind)
            everything = np.ones((problem.horizon, len(problem.piecewise.modes)), dtype=bool)
            root = relaxed(relaxation, relaxation.reach.from_start(everything))
            outcome = BranchAndBound(problem, SearchLimits(GAP, limit), relaxation=kind).run()
            nodes = f"{len(outcome.tree.nodes)}" + (" (stopped)" if outcome.words else "")
            cells.append(f"{100 * (best - root.bound) / best:.3g} %, {nodes}")
        table.add_row(name, *cells)
    return table


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--limit", type=float, default=60.0, help="seconds for each solve")
    parser.add_argument("--relaxations", action="store_true", help="root gaps and nodes instead of times")
    parser.add_argument("--long", action="store_true", help="also horizons of 30")
    given = parser.parse_args()
    cases = {**CASES, **(LONG if given.long else {})}
    console = Console(width=160)
    console.print(environment("scip"))
    console.print((relaxations if given.relaxations else compare)(cases, given.limit))


if __name__ == "__main__":
    main()
