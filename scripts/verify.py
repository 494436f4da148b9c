"""Long checks: known optima by three solvers, and random problems solved twice and judged. About half an hour.

    python scripts/verify.py [--part known|convex|linear|spectral|structured|explain|mixed|flips|modes|nonsmooth|
                                     units|translation|limits|loop|frequencies|proofs]...
                             [--problems N] [--seed 0] [--processes 2]

First, the problems whose optimal values are known are solved by Clarabel, PIQP and OSQP: relative errors of the cost,
and of Clarabel's answer the worst condition of the certificate and the gap.

Then random problems: every one is solved by lin_freq_ocp and by CVXPY on a program written by `to_cvxpy`, and the two
costs are compared: a difference is explained only where CVXPY's point is less feasible than ours, by residuals that are
worth the difference. Every optimum must satisfy every condition of the maximum principle and be proven by its gap,
unless the bound is numerical, and every infeasible problem by a verified ray.

Then random linear problems of every shape, in units of 1e-9 to 1e9, against plain Clarabel (verify_linear.py).

Then random time-invariant problems by the Fourier-domain method and by the sparse program (verify_spectral.py).

Then random problems of all kinds by every method for linear dynamics: costs and verdicts (verify_structured.py).

Then random infeasible problems are explained, and everything that is said is tried (verify_explain.py).

Then random feasible problems of mixed features, against CVXPY on an independent model (verify_mixed.py).

Then random continuous piecewise-affine problems: what the judge says of changing a mode is tried (verify_flips.py).

Then the same problems in other units (verify_units.py), and with their states counted from 1e2 to 1e9 times their range
away (verify_translation.py): verdicts, controls and costs must not change.

Last, ten piecewise-affine problems by enumeration, branch and bound, SCIP and DAQP, and random ones of up to seven
steps against all mode sequences, solved one by one by plain Clarabel (verify_modes.py), and Examples 2 and 3 of the
paper from cold starts, with a minute for every global bound, and SCIP on the short ones (verify_nonsmooth.py). And time
limits of 1 and 3 s on problems that take far longer (verify_limits.py), and closed loops with disturbances
(verify_loop.py), masks at every frequency (verify_frequencies.py), and proofs: of random problems beside exact optima,
and with every number changed (verify_proofs.py).

Seeded samples run with the tests. All parts run if none is named; N is 1000 for "convex", 5000 for "linear", 900
for "spectral", 500 for "structured", 300 for "modes", 50 for "explain", 200 for "mixed", "flips" and
"frequencies", which checks five times as many signals; "loop" counts steps, 10 000; 100 for "proofs".
Exit status 1 if a check fails.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # for helpers.checks, which the tests run, too

import verify_explain
import verify_flips
import verify_frequencies
import verify_limits
import verify_linear
import verify_loop
import verify_mixed
import verify_modes
import verify_nonsmooth
import verify_proofs
import verify_spectral
import verify_structured
import verify_translation
import verify_units
from rich.console import Console
from rich.table import Table
from seeded import check_all

import lin_freq_ocp as lfo
from helpers.checks.convex import Outcome, check
from lin_freq_ocp.testing import INSTANCES, PENDULUM, STATED, reference_problem

# How many random problems each part solves unless told otherwise
PROBLEMS = {
    **{"convex": 1000, "linear": 5000, "spectral": 900, "structured": 500},
    **{
        "explain": 50,
        "mixed": 200,
        "flips": 200,
        "units": 2000,
        "translation": 1000,
        "modes": 300,
        "loop": 10_000,
        "frequencies": 200,
        "proofs": 100,
    },
}
WIDTH = 132  # columns of the tables, also where they are written into a file
PARTS = ["known", *PROBLEMS, "nonsmooth", "limits"]
# Relative error of the cost that each solver must keep on the pendulum, and Clarabel on all known problems
PROMISED = {"clarabel": 1e-7, "qpsolvers:piqp": 1e-7, "osqp": 1e-5}
MASKED = 1e-6  # relative error of the cost of the reference problem with a mask, which is known to no more


def summary(outcomes: list[Outcome]) -> Table:
    """Return a table by kind of dynamics."""
    table = Table(
        "dynamics", "problems", "optimal", "infeasible", "other", "rigorous", "extremal", title="random linear problems"
    )
    for column in ("cost difference", "gap", "worst condition", "failed"):
        table.add_column(column, justify="right")
    for kind in [*sorted({one.kind for one in outcomes}), "all"]:
        some = [one for one in outcomes if kind in (one.kind, "all")]
        optimal = [one for one in some if "optimal" in one.status]
        infeasible = sum(one.status == "infeasible" for one in some)
        largest = [
            max((value for one in optimal if (value := getattr(one, field)) is not None), default=0.0)
            for field in ("difference", "gap", "worst")
        ]
        table.add_row(
            kind,
            *(str(count) for count in (len(some), len(optimal), infeasible, len(some) - len(optimal) - infeasible)),
            str(sum(one.bound == "rigorous" for one in optimal)),
            str(sum(one.extremal for one in optimal)),
            *(f"{value:.1e}" for value in largest),
            str(sum(not one.passed for one in some)),
        )
    return table


def known_problems() -> dict[str, tuple[lfo.OptimalControlProblem, float]]:
    """Return the problems with known optimal values: the pendulum's, and those of the tests' reference data."""
    known = {name: (lfo.library.pendulum(**keywords), cost) for name, (keywords, cost) in PENDULUM.items()}
    known["physical, constrained"] = lfo.library.pendulum(parameters="physical"), 3611.455894278
    known["physical, classical"] = lfo.library.pendulum(parameters="physical", cutoff=None), 3204.426641194
    return known | {name: (reference_problem(name), INSTANCES[name]["optimal_value"]) for name in INSTANCES}


def known_optima() -> tuple[Table, bool]:
    """Return a table of relative errors on known problems, and whether all are within what is promised."""
    table, good = Table("problem", "optimal cost", title="known optima: relative error of the cost"), True
    for column in (*PROMISED, "worst condition", "gap"):
        table.add_column(column, justify="right")
    for name, (problem, optimum) in known_problems().items():
        cells = []
        for backend, promise in PROMISED.items():
            if backend != "clarabel" and name not in STATED and name in INSTANCES:
                cells.append("no cones")
                continue
            promise = promise if name in STATED or name not in INSTANCES else MASKED
            result = lfo.solve(problem, backend=backend, throw=False)
            if result.status != "optimal" or result.cost is None:
                cells.append(result.status)
                good &= name not in PENDULUM
                continue
            error = abs(result.cost / optimum - 1)
            good &= error <= promise or (backend != "clarabel" and name not in PENDULUM)
            cells.append(f"{error:.1e}")
        certificate = lfo.solve(problem).certificate
        assert certificate is not None
        good &= certificate.pmp == "satisfied" and certificate.globally_optimal
        table.add_row(name, f"{optimum:.12g}", *cells, f"{certificate.worst.relative:.1e}", f"{certificate.gap:.1e}")
    return table, good


def random_convex(console: Console, seeds: range, processes: int) -> bool:
    """Check the random problems of these seeds and print what became of them; return whether all are as they must."""
    outcomes = check_all(check, seeds, processes, "solving")
    console.print(summary(outcomes))
    for one in outcomes:
        if one.explained or not one.passed:
            console.print(one)
    return all(one.passed for one in outcomes)


def main() -> int:
    """Run the checks and print the tables; return 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=PARTS, help="may be repeated; default: all")
    parser.add_argument("--problems", type=int, help="how many random problems of each part")
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--processes", type=int, default=2, help="for the parts of random problems")
    options = parser.parse_args()
    parts, console, good = options.part or PARTS, Console(width=WIDTH), True
    seeds = {part: range(options.seed, options.seed + (options.problems or count)) for part, count in PROBLEMS.items()}
    if "known" in parts:
        table, good = known_optima()
        console.print(table)
    if "convex" in parts:
        good &= random_convex(console, seeds["convex"], options.processes)
    if "linear" in parts:
        good &= verify_linear.verify(console, seeds["linear"], options.processes)
    if "spectral" in parts:
        good &= verify_spectral.verify(console, seeds["spectral"], options.processes)
    if "structured" in parts:
        good &= verify_structured.verify(console, seeds["structured"], options.processes)
    if "explain" in parts:
        good &= verify_explain.verify(console, seeds["explain"], options.processes)
    if "mixed" in parts:
        good &= verify_mixed.verify(console, seeds["mixed"], options.processes)
    if "flips" in parts:
        good &= verify_flips.verify(console, seeds["flips"], options.processes)
    if "units" in parts:
        good &= verify_units.verify(console, seeds["units"], options.processes)
    if "translation" in parts:
        good &= verify_translation.verify(console, seeds["translation"], options.processes)
    if "modes" in parts:
        good &= verify_modes.verify(console, seeds["modes"], options.processes)
    if "nonsmooth" in parts:
        good &= verify_nonsmooth.verify(console)
    if "loop" in parts:
        good &= verify_loop.verify(console, seeds["loop"], options.processes)
    if "frequencies" in parts:
        good &= verify_frequencies.verify(console, seeds["frequencies"], options.processes)
    if "proofs" in parts:
        good &= verify_proofs.verify(console, seeds["proofs"], options.processes)
    if "limits" in parts:
        good &= verify_limits.verify(console)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
