"""Long checks: known optima by three solvers, and random problems solved twice and judged. About half an hour.

    python scripts/verify.py [--part known|convex|linear|spectral|explain|mixed|flips|modes|nonsmooth|units|limits]...
                             [--problems N] [--seed 0] [--processes 2]

First, the problems whose optimal values are known are solved by Clarabel, PIQP and OSQP: relative errors of the cost,
and of Clarabel's answer the worst condition of the certificate and the gap.

Then random problems: every one is solved by lin_freq_ocp and by CVXPY on a program written by `to_cvxpy`, and the two
costs are compared: a difference is explained only where CVXPY's point is less feasible than ours, by residuals that are
worth the difference. Every optimum must satisfy every condition of the maximum principle and be proven by its gap,
unless the bound is numerical, and every infeasible problem by a verified ray.

Then random linear problems of every shape, in units of 1e-9 to 1e9, against plain Clarabel (verify_linear.py).

Then random time-invariant problems by the Fourier-domain method and by the sparse program (verify_spectral.py).

Then random infeasible problems are explained, and everything that is said is tried (verify_explain.py).

Then random feasible problems of mixed features, against CVXPY on an independent model (verify_mixed.py).

Then random continuous piecewise-affine problems: what the judge says of changing a mode is tried (verify_flips.py).

Last, ten piecewise-affine problems by enumeration, branch and bound, SCIP and DAQP (verify_modes.py), and Examples 2
and 3 of the paper from cold starts, with a minute for every global bound, and SCIP on the short ones
(verify_nonsmooth.py). And time limits of 1 and 3 s on problems that take far longer (verify_limits.py).

Seeded samples run with the tests. All parts run if none is named; N is 1000 for "convex", 5000 for "linear", 900
for "spectral", 50 for "explain", 200 for "mixed" and 200 for "flips".
Exit status 1 if a check fails.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

import cvxpy as cp
import numpy as np
import verify_explain
import verify_flips
import verify_limits
import verify_linear
import verify_mixed
import verify_modes
import verify_nonsmooth
import verify_spectral
import verify_units
from rich.console import Console
from rich.progress import track
from rich.table import Table

import lin_freq_ocp as lfo

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from reference import INSTANCES, PENDULUM, STATED, reference_problem

PROBLEMS = {"convex": 1000, "linear": 5000, "spectral": 900, "explain": 50, "mixed": 200, "flips": 200, "units": 2000}
"""How many random problems each part solves unless told otherwise."""

WIDTH = 132
"""Columns of the tables, also where they are written into a file."""

PARTS = ["known", *PROBLEMS, "modes", "nonsmooth", "limits"]

PROMISED = {"clarabel": 1e-7, "qpsolvers:piqp": 1e-7, "osqp": 1e-5}
"""Relative error of the cost that each solver must keep on the pendulum, and Clarabel on all known problems."""

MASKED = 1e-6
"""Relative error of the cost of the reference problem with a mask, which is known to no more."""

COST_AGREEMENT = 1e-6
"""Relative difference of two costs from solvers that stop at 1e-8 or better."""


@dataclass(frozen=True)
class Outcome:
    """What became of one random problem."""

    seed: int
    kind: str
    status: str
    oracle: str
    difference: float | None
    gap: float | None
    worst: float | None
    bound: str | None
    extremal: bool
    passed: bool
    explained: bool = False


def random_problem(seed: int) -> tuple[str, lfo.OptimalControlProblem]:
    """Return the kind of dynamics and a problem around a random trajectory; one end in six may be out of reach."""
    rng = np.random.default_rng(seed)
    n, m, T = rng.integers(1, 6), rng.integers(1, 4), rng.integers(5, 120)
    kind, dynamics = random_dynamics(rng, n, m, T)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", lfo.BandWarning)
        bands = random_bands(rng, m)
        state_band = (
            [lfo.stop_band(bins=[int(rng.integers(1, 3))], component=0)] if rng.random() < 0.2 and T > 30 else None
        )
        free = lfo.OptimalControlProblem(dynamics, T, lfo.QuadraticCost(), control_spectrum=bands)
        u = rng.standard_normal((T, m)) + rng.standard_normal(m)
        u = np.fft.irfft(np.where(free.control_stop, 0, np.fft.rfft(u, axis=0)), n=T, axis=0)
        x = lfo.simulate(free, u, rng.standard_normal(n)).x
        reachable = rng.random() > 1 / 6
        end = x[-1] if reachable else x[-1] + 3 * rng.standard_normal(n) * np.abs(x).max(0)
        problem = lfo.OptimalControlProblem(
            dynamics=dynamics,
            horizon=T,
            cost=random_cost(rng, n, m, T),
            control_set=box_around(rng, u),
            state_set=[lfo.Everything(), *[box_around(rng, x)] * (T - 1), lfo.Everything()],
            initial_state=x[0],
            terminal_state=end if rng.random() < 0.6 else None,
            control_spectrum=bands,
            state_spectrum=state_band,
            name=f"random {seed}",
        )
    return kind, problem


def random_dynamics(rng: np.random.Generator, n: int, m: int, T: int) -> tuple[str, lfo.LinearDynamics]:
    """Return stable, marginal, unstable or time-varying dynamics with an offset."""
    kind = str(rng.choice(["stable", "marginal", "unstable", "time-varying"]))
    A = rng.standard_normal((n, n))
    radius = {"stable": 0.9, "marginal": 1.0, "unstable": 1.05, "time-varying": 0.98}[kind]
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    B = rng.standard_normal((n, m))
    if kind == "time-varying":
        swing = 1 + 0.1 * np.sin(np.arange(T) * rng.uniform(0.1, 1))
        A, B = A * np.minimum(swing, 1.0)[:, None, None], B * swing[:, None, None]
    return kind, lfo.LinearDynamics(A, B, offset=0.1 * rng.standard_normal(n), sampling_time=0.1)


def random_bands(rng: np.random.Generator, m: int) -> list[object]:
    """Return one band per control, or none for some."""
    makers = [
        lambda j: lfo.low_pass(rng.uniform(0.5, 3.0), component=j),
        lambda j: lfo.high_pass(rng.uniform(0.0, 0.5), component=j),
        lambda j: lfo.notch(rng.uniform(0.5, 2.5), rng.uniform(0.1, 0.6), component=j),
        lambda j: lfo.band_pass(0.0, rng.uniform(1.0, 3.0), component=j),
    ]
    return [makers[rng.integers(len(makers))](j) for j in range(m) if rng.random() < 0.8]


def random_cost(rng: np.random.Generator, n: int, m: int, T: int) -> lfo.QuadraticCost:
    """Return a convex cost with cross terms, linear terms and references, of any size."""
    factor = rng.standard_normal((n + m, n + m)) * (rng.random() < 0.7)
    M = 10.0 ** rng.uniform(-4, 4) * (factor @ factor.T + np.diag([0.0] * n + [0.5] * m))
    P = rng.standard_normal((n, n))
    return lfo.QuadraticCost(
        Q=(M[:n, :n] + M[:n, :n].T) / 2,
        R=(M[n:, n:] + M[n:, n:].T) / 2,
        S=M[:n, n:],
        q=M.max() * 0.1 * rng.standard_normal(n) if rng.random() < 0.3 else 0.0,
        P=M.max() * (P @ P.T + (P @ P.T).T) / 2,
        x_ref=rng.standard_normal((T + 1, n)) if rng.random() < 0.5 else 0.0,
    )


def box_around(rng: np.random.Generator, signal: np.ndarray) -> lfo.Box:
    """Return bounds that the signal just meets, some of them absent."""
    lower, upper = signal.min(0), signal.max(0)
    margin = 1e-3 * (upper - lower) + 1e-6
    return lfo.Box(
        np.where(rng.random(len(lower)) < 0.7, lower - margin, -np.inf),
        np.where(rng.random(len(lower)) < 0.7, upper + margin, np.inf),
    )


def check(seed: int) -> Outcome:
    """Solve one random problem twice, and judge."""
    kind, problem = random_problem(seed)
    result = lfo.solve(problem, throw=False)
    oracle = lfo.to_cvxpy(problem)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # CVXPY's own "solution may be inaccurate": its status says so
        try:
            oracle.solve(solver="CLARABEL")
        except cp.SolverError as error:
            status = f"failed ({type(error).__name__})"
        else:
            status = str(oracle.status)
    if result.status == "infeasible":
        return Outcome(seed, kind, result.status, status, None, None, None, None, False, status != "optimal")
    certificate = result.certificate
    if certificate is None or result.cost is None:
        return Outcome(seed, kind, result.status, status, None, None, None, None, False, False)
    difference, agrees, explained = None, True, False
    if status == "optimal":
        difference = abs(result.cost - float(oracle.value)) / max(1.0, abs(result.cost))
        agrees = difference <= COST_AGREEMENT
        explained = not agrees and oracle_is_infeasible(problem, result, oracle)
    extremal = certificate.pmp == "satisfied"
    numerical = certificate.bound is not None and certificate.bound.kind == "numerical"
    proven = extremal and (certificate.globally_optimal or (numerical and result.status == "locally_optimal"))
    bound = None if certificate.bound is None else certificate.bound.kind
    worst, passed = certificate.worst.relative, proven and (agrees or explained)
    return Outcome(
        seed, kind, result.status, status, difference, certificate.gap, worst, bound, extremal, passed, explained
    )


def oracle_is_infeasible(problem: lfo.OptimalControlProblem, result: lfo.Result, oracle: cp.Problem) -> bool:
    """Whether CVXPY's cost is below ours because its point violates constraints: residuals times our multipliers.

    Of our own trajectory the same products must be worth less than the difference.
    """
    values = {variable.name(): variable.value for variable in oracle.variables()}
    theirs, ours = lfo.Trajectory(values["x"], values["u"]), result.trajectory
    difference = result.cost - problem.cost.value(theirs.x, theirs.u)
    worth = [
        sum(value for what, value in verify_spectral.cost_errors(problem, at, result.multipliers, other).items()
            if what != "duality gap")
        for at, other in ((theirs, ours), (ours, theirs))
    ]  # fmt: skip
    return worth[1] < difference <= worth[0] / verify_spectral.EXPLAINING


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


def random_convex(console: Console, seeds: range) -> bool:
    """Check the random problems of these seeds and print what became of them; return whether all are as they must."""
    outcomes = [check(seed) for seed in track(seeds, "solving", console=Console(stderr=True), transient=True)]
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
    parser.add_argument("--processes", type=int, default=2, help="of the parts 'linear', 'spectral' and 'units'")
    options = parser.parse_args()
    parts, console, good = options.part or PARTS, Console(width=WIDTH), True
    seeds = {part: range(options.seed, options.seed + (options.problems or count)) for part, count in PROBLEMS.items()}
    if "known" in parts:
        table, good = known_optima()
        console.print(table)
    if "convex" in parts:
        good &= random_convex(console, seeds["convex"])
    if "linear" in parts:
        good &= verify_linear.verify(console, seeds["linear"], options.processes)
    if "spectral" in parts:
        good &= verify_spectral.verify(console, seeds["spectral"], options.processes)
    if "explain" in parts:
        good &= verify_explain.verify(console, seeds["explain"])
    if "mixed" in parts:
        good &= verify_mixed.verify(console, seeds["mixed"])
    if "flips" in parts:
        good &= verify_flips.verify(console, seeds["flips"])
    if "units" in parts:
        good &= verify_units.verify(console, seeds["units"], options.processes)
    if "modes" in parts:
        good &= verify_modes.verify(console)
    if "nonsmooth" in parts:
        good &= verify_nonsmooth.verify(console)
    if "limits" in parts:
        good &= verify_limits.verify(console)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
