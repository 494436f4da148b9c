"""Long checks: known optima by three solvers, and random problems solved twice and judged. About half an hour.

    python scripts/verify.py [--part NAME]... [--problems N] [--seed 0] [--processes 2]
    python scripts/verify.py --part answers|presented [--save FILE] [--against FILE]
    python scripts/verify.py --part pairs [--save docs/combinations.md]
    python scripts/verify.py --part layers [--save tests/derivatives/layers.npz]

One file for each part in verify/; all run if none is named. Exit status 1 if a check fails.

known        problems with known optimal costs, by Clarabel, PIQP and OSQP; bodies that turn in the least time
convex       random convex problems, against CVXPY on our program
linear       random linear problems of every shape, in units of 1e-9 to 1e9, against plain Clarabel
spectral     random time-invariant problems, by the Fourier-domain method and by the sparse program
structured   random problems of all kinds by every method for linear dynamics: costs and verdicts
explain      random infeasible problems are explained, and every statement is tried
rays         weak controls on unstable plants, compact problems and problems without a bound, shifted: never infeasible,
             never unbounded, always unbounded; costs of compact ones by exact rationals
alone        random problems and those of the library: certify() of a trajectory alone agrees with solve
mixed        random feasible problems of mixed features, against CVXPY on an independent model
flips        random continuous piecewise-affine problems: what the judge says of changing a mode is tried
units        the same problems in other units: verdicts, controls and costs must not change
translation  the same with states counted from 1e2 to 1e9 times their range away
modes        ten piecewise-affine problems by enumeration, branch and bound, SCIP and DAQP, and random ones of up to
             seven steps against all mode sequences, solved one by one by plain Clarabel
nonsmooth    Examples 2 and 3 of the paper from cold starts, a minute for every global bound, and SCIP on short ones
smooth       random smooth problems without bounds, against IPOPT, and eigenvalues of the dense projected Hessian
formulas     random problems with costs and time by formulas, against IPOPT and by differences of the cost
answers      linear problems by the sparse program and by the structured method, compared with each other, or with the
             answers of another state of the code (--save, --against)
presented    what users see of the same problems, JSON, texts of commands and steps of loops: nothing may change
             (--save, --against)
limits       time limits of 1 and 3 s on problems that take far longer
loop         closed loops with disturbances, and plans of ten plants against the sparse program
embedded     disturbed steps of ten generated controllers in C, against the sparse program
applied_spectrum  random controllers in C with windows of controls: sanitizers, hostile states, every window by a sum
frequencies  masks at every frequency, between bounds of an independent model, and proven maxima of signals
proofs       proofs of random problems beside exact optima, and with every number changed
pairs        every pair of features, and of a feature and a use, in a small problem: it works, or is refused with reason
triples      three features at random in a small problem: it works, or is refused with reason
formulas_together  random formulas of dynamics, costs and path constraints beside other features: feasibility and cost
             by NumPy, convex problems against CVXPY, others against solves from other starts
cancellation  costs and constraints by formulas that lose most digits of their values, against balls of 400 bits
cost_units    costs in units of 1e-9 to 1e9 and with constants of 1e6 times their variation: no status may change
small_ends    ends and references of 1e-15 to 0.1 in place of zero: no status may change, and nor the cost much
weights       weights of 1e4 to 1e10 on one component, time or control: nothing that balls refute is called optimal
names         hostile names through every writer: C is compiled, TOML and pages are parsed
jumps         states that jump to 1e30 and to no number, in loops and in generated C: controls keep hard limits exactly
uncontrollable  problems whose controls hardly move some states, by every method, against balls of 600 bits
robust       margins of random systems with loads, constant and varying in time, against all extreme points; for every
             thirty of them, a loop of 1000 steps under loads of the set, more than 0.6 of the largest that it bears
derivatives  random optima, their kinks and other units, against differences of exact optima
layers       gradients through layers of PyTorch and JAX, as far as these are installed, against those of derivatives
suite        the tests with all their random seeds

A run of the tests takes a twelfth of their seeded samples, of long tables of cases, and of expensive tests. N is by
default the number beside each part below; "frequencies" checks five times as many signals; "loop" and "embedded" count
steps.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module
from pathlib import Path

from rich.console import Console

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # for helpers, which the tests use, too

PARTS: dict[str, int | None] = {  # random problems of each part; None: a fixed list
    "known": None,
    "convex": 1000,
    "linear": 5000,
    "spectral": 900,
    "structured": 500,
    "explain": 50,
    "rays": 900,
    "alone": 300,
    "mixed": 200,
    "flips": 200,
    "units": 2000,
    "translation": 1000,
    "modes": 300,
    "nonsmooth": None,
    "smooth": 1000,
    "formulas": 300,
    "loop": 10_000,
    "embedded": 10_000,
    "applied_spectrum": 100,
    "frequencies": 200,
    "proofs": 100,
    "cancellation": 300,
    "cost_units": 300,
    "small_ends": 600,
    "weights": 300,
    "names": 300,
    "jumps": 300,
    "uncontrollable": 1000,
    "robust": 1000,
    "derivatives": 300,
    "layers": None,
    "pairs": None,
    "triples": 1000,
    "formulas_together": 300,
    "answers": None,
    "presented": None,
    "limits": None,
    "suite": None,
}
WIDTH = 132  # columns of the tables, also where they are written into a file


def main() -> int:
    """Run the checks and print the tables; return 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=PARTS, help="may be repeated; default: all")
    parser.add_argument("--problems", type=int, help="how many random problems of each part")
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--processes", type=int, default=2, help="for the parts of random problems")
    parser.add_argument("--save", type=Path, help="file (npz) for what the part answers found, or page of pairs")
    parser.add_argument("--against", type=Path, help="file of --save to compare it with")
    options = parser.parse_args()
    console, good = Console(width=WIDTH), True
    for part, count in PARTS.items():
        if options.part is None or part in options.part:
            verify = import_module(f"verify.{part}").verify
            seeds = None if count is None else range(options.seed, options.seed + (options.problems or count))
            if part in ("answers", "presented", "pairs", "layers"):
                good &= verify(console, options.save, options.against)
            else:
                good &= verify(console) if seeds is None else verify(console, seeds, options.processes)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
