"""Measure the semismooth Newton method near known optima: how often it comes back, in how many steps, and how fast.

    python scripts/benchmark.py newton [--starts 200] [--seed 0] [--figure docs/newton.png] [--write]

Every start is an optimum of Examples 2 and 3 of the paper with normal noise on all states and controls, of the given
size relative to theirs, cut at the bounds; multipliers are those of least squares. It *converged* if |Phi| <= 1e-9, and
*returned* if the cost is that of the optimum, too: other points satisfy the conditions as well. About twenty minutes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.record import Record, build_parser
from helpers.checks.newton import PROBLEMS, run

LEVELS = (1e-3, 1e-2, 2e-2)  # noise, relative to the largest value of each state and control


def rates(starts: int, seed: int) -> Table:
    """Return success rates and numbers of steps, one row for each problem and noise level."""
    table = Table("problem", title=f"semismooth Newton method, {starts} starts each")
    for heading in ("noise", "converged", "returned", "steps, median", "most"):
        table.add_column(heading, justify="right")
    for name, build in track(PROBLEMS.items(), "starting", console=Console(stderr=True), transient=True):
        problem = build()
        result = lfo.solve(problem, throw=False)
        for level in LEVELS:
            runs = [run(problem, result, level, seed + i) for i in range(starts)]
            steps = [len(found.residuals) - 1 for found, _ in runs if found.converged] or [0]
            shares = [sum(found.converged for found, _ in runs), sum(returned for _, returned in runs)]
            table.add_row(
                name,
                f"{level:g}",
                *(f"{100 * share / starts:.1f} %" for share in shares),
                f"{np.median(steps):g}",
                str(max(steps)),
            )
            name = ""
    return table


def drawn(path: Path, seed: int) -> None:
    """Draw |Phi| against steps of one run for each problem."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4.4), layout="constrained")
    for name, build in PROBLEMS.items():
        problem = build()
        result = lfo.solve(problem, throw=False)
        found, _ = run(problem, result, LEVELS[2], seed)
        axes.semilogy(range(len(found.residuals)), np.maximum(found.residuals, 1e-17), "o-", label=name)
    axes.set(xlabel="step", ylabel="|Φ|, equations of order 1", title="Digits double with every step near the end")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=150)


def main(arguments: Sequence[str]) -> None:
    """Run the cases of the options."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--starts", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", type=Path, help="also draw the residuals of one run for each problem")
    options = parser.parse_args(arguments)
    with Record(options.write) as record:
        record.show(rates(options.starts, options.seed))
    if options.figure:
        drawn(options.figure, options.seed)
