"""Costs by formulas, stated as costs or as an additional state: CUTEst's discrete-time control problems.

    OMP_NUM_THREADS=1 python scripts/benchmark.py formula_costs [--cases NAME ...] [--repeats N] [--limit S] [--write]

Processor seconds of ``lfo.solve(problem, "nonsmooth")``, all starts and the judge included, the least of N, with the
stage cost as a cost, and as the steps of an additional last state. Beside them: the cost, and its difference from the
published local optimum, relative; below zero, ours is lower. A solve ends after S seconds without an answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.nonlinear import timed
from benchmark.record import Record, build_parser
from helpers.formula_costs import PUBLISHED, with_state


def cell(problem: lfo.OptimalControlProblem, repeats: int, limit: float) -> tuple[str, float]:
    """Return the time of a solve in words, and its cost."""
    run = partial(lfo.solve, problem, "nonsmooth", time_limit=limit, throw=False)
    seconds, result = timed({"solve": run}, repeats)["solve"]
    satisfied = result.certificate is not None and result.certificate.pmp == "satisfied"
    return (f"{seconds:.3f}" if satisfied else f"{seconds:.3f} ({result.status})"), result.cost


def main(arguments: Sequence[str]) -> None:
    """Print the table."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--cases", nargs="*", default=list(PUBLISHED), choices=list(PUBLISHED))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--limit", type=float, default=20.0)
    options = parser.parse_args(arguments)
    table = Table("problem", title="processor seconds of a solve")
    for heading in ("as a cost", "as a state", "cost", "published, relative"):
        table.add_column(heading, justify="right")
    with Record(options.write) as record:
        for name in options.cases:
            build, published = PUBLISHED[name]
            problem = build()
            seconds, cost = cell(problem, options.repeats, options.limit)
            stated = problem.cost.formulas[1] is None
            as_state = cell(with_state(problem), options.repeats, options.limit)[0] if stated else "none"
            table.add_row(name, seconds, as_state, f"{cost:.10g}", f"{(cost - published) / abs(published):.1e}")
        record.show(table)
