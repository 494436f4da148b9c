"""The structured interior point against the sparse program for Clarabel, which it replaces: ratios of times in one run.

    OMP_NUM_THREADS=1 python scripts/benchmark.py structured [--cases NAME ...] [--horizons T ...] [--repeats N]
                                                             [--plain] [--alone] [--layers] [--write]

Every time is that of ``lfo.solve``, judge included, in this process, the least of N; runs alternate. Beside it: the gap
that the judge proves, and the difference of both costs. --plain: the loops by NumPy and LAPACK as well; --alone:
without the sparse program; --layers: what each speed layer is worth instead (structured_layers.py). The peak of memory
is this process's, so it says most with one case and horizon.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable, Sequence

from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.record import Record, build_parser
from benchmark.structured_cases import CASES
from benchmark.structured_layers import table_of
from lin_freq_ocp.methods.structured import solver
from lin_freq_ocp.methods.structured.kkt import recursions

Solve = Callable[[], lfo.results.Result]


def timed(solves: dict[str, Solve], repeats: int) -> dict[str, tuple[float, lfo.results.Result]]:
    """Return the least time of each solve, and its result; a solve of more than 10 s runs once."""
    best: dict[str, tuple[float, lfo.results.Result]] = {}
    for _ in range(repeats):
        for name, solve in solves.items():
            if name in best and best[name][0] > 10:
                continue
            start = time.perf_counter()
            result = solve()
            seconds = time.perf_counter() - start
            best[name] = min(best.get(name, (seconds, result)), (seconds, result), key=lambda one: one[0])
    return best


def by_arrays(problem: lfo.OptimalControlProblem) -> lfo.results.Result:
    """Solve without compiled loops."""
    own = solver.loops
    solver.loops = lambda compiled: recursions.loops(False)
    try:
        return lfo.solve(problem, method="structured", throw=False)
    finally:
        solver.loops = own


def row(table: Table, name: str, horizon: int, best: dict[str, tuple[float, lfo.results.Result]]) -> None:
    """Add the figures of one problem."""
    seconds, result = best["structured"]
    cells = [name, str(horizon), f"{seconds:.3g}", str(result.status)]
    cells.append("" if result.gap is None else f"{abs(result.gap):.0e}")
    for other in ("convex", "plain"):
        if other not in best:
            cells += ["", ""]
            continue
        theirs, answer = best[other]
        ratio = theirs / seconds
        cells.append(f"{theirs:.3g} ({ratio:.2g}x)")
        differ = result.cost is not None and answer.cost is not None
        cells.append(f"{abs(answer.cost - result.cost) / abs(result.cost):.0e}" if differ else str(answer.status))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    table.add_row(*cells, f"{memory:.2f}")


def main(arguments: Sequence[str]) -> None:
    """Run the cases that were asked for."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--horizons", nargs="+", type=int)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--alone", action="store_true")
    parser.add_argument("--layers", action="store_true")
    given = parser.parse_args(arguments)
    recursions.loops()  # compiled before the first clock starts
    with Record(given.write) as record:
        record.show(table_of(given.repeats) if given.layers else compared(given))


def compared(given: argparse.Namespace) -> Table:
    """Return the figures of the cases that were asked for."""
    columns = ["case", "T", "structured [s]", "status", "gap", "convex [s]", "cost", "plain [s]", "cost", "peak [GB]"]
    table = Table(*columns, title="structured interior point: least of all runs, one thread")
    for name in given.cases:
        case = CASES[name]
        for horizon in given.horizons or case.horizons:
            problem = case.problem(horizon)
            solves: dict[str, Solve] = {"structured": lambda p=problem: lfo.solve(p, "structured", throw=False)}
            if horizon in case.compared and not given.alone:
                solves["convex"] = lambda p=problem: lfo.solve(p, "convex", throw=False)
            if given.plain:
                solves["plain"] = lambda p=problem: by_arrays(p)
            row(table, name, horizon, timed(solves, given.repeats))
    return table
