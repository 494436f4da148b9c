"""Time of mode searches, compared with a mixed-integer solver on one big-M program. About 5 minutes.

    python scripts/benchmark.py modes [--case buck-15] [--contender big-M+daqp] [--limit-s 60] [--gap 1e-6] [--long]
                                      [--write]
    python scripts/benchmark.py modes --relaxations | --nodes | --layers
    python scripts/benchmark.py modes --list

All contenders run in one process with one thread, one after the other, with the same relative gap and time limit.
Ratios are of seconds of the process. Writing the problem down for the solver is timed with the solve; constructing the
OptimalControlProblem is not. Every sequence found is solved again as a convex program, and that is the cost shown:
*claimed* is how far the contender's own figure for it was off. *bound* is the contender's, relative to the best cost of
all: a bound above it, or a cost above it from who calls its answer optimal, is marked WRONG. Bounds of mixed-integer
solvers are claims; that of branch and bound is computed by the judge from the multipliers of every leaf.

``--nodes`` prints what a node of our search takes, everything in it, and its parts; ``--layers`` what the search takes
without each of the means that make it fast. Both are in seconds of the process, as other loads disturb the clock.

``--relaxations`` prints what each relaxation of our search leaves open at the root, in per cent of the cost, and how
many nodes the search has with it; ``--long`` adds horizons of 30.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np
from rich.table import Table
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from benchmark.nodes import layers, nodes
from benchmark.record import Record, build_parser, duration
from benchmark.relaxations import RELAXATIONS
from helpers.checks.claimed import resolved
from lin_freq_ocp.methods.hybrid.search.branch_and_bound import TreeSearch
from lin_freq_ocp.methods.hybrid.search.common import SearchLimits, solve_relaxation
from lin_freq_ocp.methods.hybrid.search.mixed import SolverClaim, solve_miqp
from lin_freq_ocp.methods.hybrid.search.path_native import path_library
from lin_freq_ocp.program.backends.base import Claim
from lin_freq_ocp.program.program_rows import real_rows
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine

GAP, LIMIT = 1e-6, 60.0
# Costs and bounds that differ by this many gaps are still right: a solver's gap is not met to the last digit
ALLOWED = 3.0


def _case(name: str, horizon: int) -> Callable[[], lfo.OptimalControlProblem]:
    given = {"initial_state": (-6, 7)} if name == "switched_rotation" else {}
    return lambda: lfo.library.by_name(name)(horizon=horizon, terminal_cost=True, control_spectrum="freq", **given)


SYSTEMS = {"pendulum": "pendulum_with_wall", "rotation": "switched_rotation", "buck": "buck_affine"}
# All with a terminal cost and the bins max(2, ceil(T/3)) .. T//2 of the control removed.
CASES = {
    f"{short}-{horizon}": _case(SYSTEMS[short], horizon)
    for short, horizon in (("pendulum", 20), ("rotation", 20), ("buck", 15), ("buck", 20))
}
LONG = {f"{short}-30": _case(name, 30) for short, name in SYSTEMS.items()}


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer of a contender; its cost is computed again from the sequence.

    Attributes
    ----------
    status : str
        By its own word.
    sequence : (T,) or None
    claimed, bound : float or None
        Its figures for the cost of that sequence, and for a lower bound on all.
    """

    status: str
    sequence: np.ndarray | None = None
    claimed: float | None = None
    bound: float | None = None


Contender = Callable[[lfo.OptimalControlProblem, float, float], Answer]  # (problem, seconds, relative gap) -> Answer


def cvxpy_scip(problem: lfo.OptimalControlProblem, limit: float, gap: float) -> Answer:
    """Write the problem in CVXPY as a careful user would, and hand it to SCIP."""
    model, delta = cvxpy_model(problem)
    parameters = {"limits/time": limit, "limits/gap": gap}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a limit that was reached is "inaccurate" to CVXPY
        try:
            model.solve(solver=cp.SCIP, scip_params=parameters)
        except cp.SolverError as error:
            return Answer(f"failed: {error}")
    if delta.value is None:
        return Answer(model.status)
    scip = model.solver_stats.extra_stats["model"]
    names = {"gaplimit": "optimal", "timelimit": "limit"}
    offset = float(model.value) - float(scip.getObjVal())  # what CVXPY keeps to itself, and SCIP's own tolerance
    status = names.get(scip.getStatus(), scip.getStatus())
    return Answer(status, np.argmax(delta.value, axis=1), float(model.value), float(scip.getDualbound()) + offset)


def cvxpy_model(problem: lfo.OptimalControlProblem) -> tuple[cp.Problem, cp.Variable]:
    """Return the big-M program in CVXPY and its binaries (T, modes), M by row from the stated bounds.

    Of time-invariant problems with boxes, a fixed initial state, stop bands on controls, and costs without linear
    terms.
    """
    T, n, m, cost = problem.horizon, problem.state_dim, problem.control_dim, problem.quadratic
    modes, states, controls = problem.dynamics.modes, problem.state_boxes, problem.control_tube
    x = cp.Variable((T + 1, n), bounds=[np.array(states.lower), np.array(states.upper)])
    u = cp.Variable((T, m), bounds=[np.array(controls.lower), np.array(controls.upper)])
    delta = cp.Variable((T, len(modes)), boolean=True)
    rows = [x[0] == problem.initial_box.lower, cp.sum(delta, axis=1) == 1]
    low, high = np.append(states.lower[0], controls.lower[0]), np.append(states.upper[0], controls.upper[0])
    for i, mode in enumerate(modes):
        off = 1 - delta[:, [i]]
        map_row = np.hstack([mode.linear.A, mode.linear.B])
        least, most = _range(map_row, low, high)
        region = mode.region.at_dimensions(n, m, T, "dynamics")
        offset, limit = np.tile(mode.linear.offset, (T, 1)), np.tile(region.e, (T, 1))
        step = x[1:] - x[:-1] @ mode.linear.A.T - u @ mode.linear.B.T - offset
        rows += [
            step <= off @ np.maximum(high[:n] - least - mode.linear.offset, 0)[None],
            step >= -off @ np.maximum(most + mode.linear.offset - low[:n], 0)[None],
        ]
        G, H = region.C, region.D
        excess = np.maximum(_range(np.hstack([G, H]), low, high)[1] - region.e, 0)
        rows.append(x[:-1] @ G.T + u @ H.T - limit <= off @ excess[None])
    for j in np.flatnonzero(problem.control_stop.any(axis=0)):
        rows.append(real_rows(T, problem.control_stop[:, j]) @ u[:, j] == 0)
    roots = [np.linalg.cholesky(part / 2).T for part in (cost.Q, cost.R)]
    a, b = x - np.tile(cost.x_ref, (T + 1, 1)), u - np.tile(cost.u_ref, (T, 1))
    objective = cp.sum_squares(a[:-1] @ roots[0].T) + cp.sum_squares(b @ roots[1].T)
    objective += 0.5 * cp.quad_form(a[T], cost.P)
    return cp.Problem(cp.Minimize(objective), rows), delta


def _range(rows: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and largest value of rows over a box."""
    ends = rows * low, rows * high
    return np.minimum(*ends).sum(axis=1), np.maximum(*ends).sum(axis=1)


def monolithic(backend: str) -> Contender:
    """Return a contender that hands our big-M program, tightened by the reach, to a mixed-integer solver."""

    def solve(problem: lfo.OptimalControlProblem, limit: float, gap: float) -> Answer:
        outcome = solve_miqp(problem, backend, limit, gap)
        status = "optimal" if outcome.status is Claim.SOLVED else outcome.status.value
        return Answer(status, outcome.sequence, outcome.cost, outcome.bound)

    return solve


def ours(method: str) -> Contender:
    """Return a contender that is a method of lfo.solve."""

    def solve(problem: lfo.OptimalControlProblem, limit: float, gap: float) -> Answer:
        result = lfo.solve(problem, method=method, time_limit=limit, tolerance=gap, throw=False)
        return Answer(result.status, result.sequence, result.cost, result.lower_bound)

    return solve


# The first is what the others' times are divided by. A new method is one line here.
CONTENDERS: dict[str, Contender] = {
    "branch_and_bound": ours("branch_and_bound"),
    "cvxpy+scip": cvxpy_scip,
    "big-M+scip": monolithic("scip"),
    "big-M+daqp": monolithic("daqp"),
}


@dataclass(frozen=True)
class Row:
    """One contender on one case; costs relative to the best of all.

    Attributes
    ----------
    seconds : float
    busy : float
        Seconds of the process, which other loads disturb less.
    cost : float or None
        Of its sequence, solved again.
    claimed : float or None
        Relative difference of its own figure from that.
    bound : float or None
    status, words : str
    """

    case: str
    contender: str
    seconds: float
    busy: float
    cost: float | None
    claimed: float | None
    bound: float | None
    status: str
    words: str = ""


def row_of(case: str, name: str, problem: lfo.OptimalControlProblem, limit: float, gap: float) -> Row:
    """Run one contender."""
    started, busy = time.perf_counter(), time.process_time()
    answer = CONTENDERS[name](problem, limit, gap)
    seconds, busy = time.perf_counter() - started, time.process_time() - busy
    if answer.sequence is None:
        return Row(case, name, seconds, busy, None, None, answer.bound, answer.status)
    outcome = SolverClaim(Claim.SOLVED, np.asarray(answer.sequence, dtype=np.intp), None, answer.claimed, None, "")
    again = resolved(problem, outcome)
    if again.cost is None:
        return Row(case, name, seconds, busy, None, None, answer.bound, answer.status, again.message)
    claimed = None if answer.claimed is None else (answer.claimed - again.cost) / max(1.0, abs(again.cost))
    return Row(case, name, seconds, busy, again.cost, claimed, answer.bound, answer.status)


def judged(rows: list[Row], gap: float) -> list[Row]:
    """Return the rows of one case, and their errors in words."""
    costs = [row.cost for row in rows if row.cost is not None]
    if not costs:
        return rows
    best = min(costs)
    allowed = ALLOWED * gap * max(1.0, abs(best))
    marked: list[Row] = []
    for row in rows:
        words = [row.words] if row.words else []
        if row.status == "optimal" and (row.cost is None or row.cost > best + allowed):
            words.append("WRONG: not optimal")
        if row.bound is not None and row.bound > best + allowed:
            words.append("WRONG: bound above the best cost")
        marked.append(replace(row, words="; ".join(words)))
    return marked


def table_of(case: str, rows: list[Row]) -> Table:
    """Return the rows of one case."""
    first = rows[0].busy
    best = min((row.cost for row in rows if row.cost is not None), default=None)
    table = Table(title=case)
    for heading in (
        "",
        "time",
        "of the process",
        f"x {rows[0].contender}",
        "cost",
        "claimed",
        "bound",
        "gap",
        "status",
        "remark",
    ):
        table.add_column(heading, justify="left" if heading in ("", "status", "remark") else "right")
    for row in rows:
        figures = (f"{row.cost:.8f}" if row.cost is not None else "",)
        figures += (f"{row.claimed:+.0e}" if row.claimed is not None else "",)
        figures += (f"{row.bound:.8f}" if row.bound is not None else "",)
        gap = None if best is None or row.cost is None or row.bound is None else (row.cost - row.bound) / abs(best)
        figures += (f"{gap:.1e}" if gap is not None else "",)
        ratio = f"{row.busy / first:.3g}"
        table.add_row(row.contender, duration(row.seconds), duration(row.busy), ratio, *figures, row.status, row.words)
    return table


def relaxations(cases: Mapping[str, Callable[[], lfo.OptimalControlProblem]], limit: float, gap: float) -> Table:
    """Return root gaps after exclusion by the reach, and the nodes of our search, for each relaxation."""
    table = Table("case", *(f"{kind}: root gap, nodes" for kind in RELAXATIONS))
    for name, build in cases.items():
        problem, cells = build(), list[str]()
        best = lfo.solve(problem, time_limit=limit, throw=False).cost
        for kind in RELAXATIONS.values():
            relaxation = kind(problem)
            everything = np.ones((problem.horizon, len(piecewise_affine(problem).modes)), dtype=bool)
            reach = relaxation.reach.from_start(everything)
            outcome = TreeSearch(problem, SearchLimits(gap, limit), relaxation=relaxation).run()
            nodes = f"{len(outcome.tree.nodes)}" + (" (stopped)" if outcome.message else "")
            root = None if reach is None or best is None else solve_relaxation(relaxation, reach).bound
            cells.append("" if root is None else f"{100 * (best - root) / abs(best):.3g} %, {nodes}")
        table.add_row(name, *cells)
    return table


def read_options(arguments: Sequence[str]) -> argparse.Namespace:
    """Return the options."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--case", action="append", choices=[*CASES, *LONG], help="repeatable; default: horizons to 20")
    parser.add_argument("--contender", action="append", choices=list(CONTENDERS), help="repeatable; default: all")
    parser.add_argument("--limit-s", type=float, default=LIMIT, metavar="SECONDS")
    parser.add_argument("--gap", type=float, default=GAP)
    parser.add_argument("--long", action="store_true", help="also horizons of 30")
    parser.add_argument("--relaxations", action="store_true", help="root gaps and nodes instead of times")
    parser.add_argument("--nodes", action="store_true", help="what a node takes")
    parser.add_argument("--layers", action="store_true", help="our search without each of its means")
    parser.add_argument("--list", action="store_true", help="print cases and contenders, and stop")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str]) -> None:
    """Run the cases of the options, and print their tables."""
    options = read_options(arguments)
    names = options.contender or list(CONTENDERS)
    if options.list:
        print("cases:", *CASES, "\n--long:", *LONG, "\ncontenders:", *CONTENDERS)
        return
    known = CASES | LONG
    cases = {name: known[name] for name in options.case or (known if options.long else CASES)}
    path_library()  # compiled, if it is the first time
    with Record(options.write) as record, threadpool_limits(1):
        if options.relaxations:
            record.show(relaxations(cases, options.limit_s, options.gap))
        if options.nodes:
            both = {f"{short}-{T}": _case(name, T) for short, name in SYSTEMS.items() for T in (20, 40)}
            record.show(nodes(both))
        if options.layers:
            record.show(layers(cases, options.limit_s, options.gap))
        if options.relaxations or options.nodes or options.layers:
            return
        small = lfo.library.switched_rotation(horizon=3, initial_state=(-6, 7), terminal_cost=True)
        for name in names:  # loads every library before anything is measured
            CONTENDERS[name](small, options.limit_s, options.gap)
        for case, build in cases.items():
            rows = [row_of(case, name, build(), options.limit_s, options.gap) for name in names]
            record.show(table_of(case, judged(rows, options.gap)))
