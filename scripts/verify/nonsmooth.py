"""Examples 2 and 3 of the paper from cold starts: known optima, certificates and proven gaps.

The optimal costs were found by dynamic programming, enumeration with a local solver, and a global solver; those of
T = 20 by this project alone. SCIP, if installed, is asked for those of up to eight steps: its claims, and the answer
that starts from its point.
"""

from __future__ import annotations

from rich.console import Console
from rich.progress import track
from rich.table import Table

import lin_freq_ocp as lfo
from lin_freq_ocp.program.backends.base import Claim
from lin_freq_ocp.testing import PIECEWISE_SMOOTH

COST, CONDITION = 1e-7, 1e-8  # relative difference of costs, and the worst condition of the certificate
GAP, SECONDS = 1e-4, 60.0  # relative gap to prove, and the time for that together with the search
# Another gap: the frequency constraint of this problem has a duality gap
TOLERANCES = {"buck, T = 20, bins 7 to 10": 1e-3}
ROUNDING = 1e-9  # of the cost: a bound may be above the optimum by this, as the cost is that of a point
# SCIP is asked for problems of so many steps at most, and given so long for each
OPINION_HORIZON, OPINION_SECONDS = 8, 60.0
CLAIMED = 1e-5  # relative difference of a claimed cost, whose trajectory violates its rows by up to 1e-6


def verify(console: Console, bounds: bool = True) -> bool:
    """Solve all and print their outcomes; return whether all are right."""
    table, good = Table("problem", "optimal cost", title="piecewise-smooth dynamics from cold starts"), True
    for heading in ("error of cost", "worst condition", "joint", "printed", "found in", "proven gap", "in"):
        table.add_column(heading, justify="right")
    for name in track(list(PIECEWISE_SMOOTH), "solving", console=Console(stderr=True), transient=True):
        problem, optimum = _problem(name), PIECEWISE_SMOOTH[name][2]
        method, limit = ("auto", SECONDS) if bounds else ("nonsmooth", None)
        result = lfo.solve(problem, method, time_limit=limit, tolerance=TOLERANCES.get(name), throw=False)
        certificate = result.certificate
        if certificate is None or certificate.borders is None:
            table.add_row(name, f"{optimum:.12g}", result.status)
            good = False
            continue
        error, worst = abs(certificate.cost / optimum - 1), certificate.worst.relative
        good &= error <= COST and worst <= CONDITION and certificate.pmp == "satisfied" and certificate.borders.joint
        good &= not bounds or (result.gap is not None and -ROUNDING <= result.gap <= TOLERANCES.get(name, GAP))
        table.add_row(
            name,
            f"{optimum:.12g}",
            f"{error:.0e}",
            f"{worst:.0e}",
            "holds" if certificate.borders.joint else "fails",
            "holds" if certificate.borders.printed else "fails",
            f"{result.seconds['solve']:.1f} s",
            "" if result.gap is None else f"{result.gap:.1e}",
            f"{result.seconds['certify']:.1f} s" if bounds else "",
        )
    console.print(table)
    return second_opinion(console) and good


def second_opinion(console: Console) -> bool:
    """Print the claims of SCIP about the short problems; return whether none contradicts the known optima."""
    try:
        from verify.minlp import polished, solve_minlp
    except ImportError as error:
        console.print(f"SCIP is not asked: {error}")
        return True
    table, good = Table("problem", "optimal cost", title="SCIP's second opinion, by its own word, and polished"), True
    for heading in ("claimed cost", "claimed bound", "ended", "seconds", "error of the polished cost"):
        table.add_column(heading, justify="right")
    short = [name for name in PIECEWISE_SMOOTH if _problem(name).horizon <= OPINION_HORIZON]
    for name in track(short, "asking SCIP", console=Console(stderr=True), transient=True):
        problem, optimum = _problem(name), PIECEWISE_SMOOTH[name][2]
        claim = solve_minlp(problem, time_limit=OPINION_SECONDS)
        size, local = abs(optimum), polished(problem, claim)
        good &= claim.bound is None or claim.bound <= optimum + CLAIMED * size
        error = None if local is None or not local.feasible else (local.cost - optimum) / size
        if claim.status is Claim.SOLVED:
            good &= claim.cost is not None and abs(claim.cost - optimum) <= CLAIMED * size
            good &= error is not None and abs(error) <= COST
        table.add_row(
            name,
            f"{optimum:.10g}",
            "" if claim.cost is None else f"{claim.cost:.10g}",
            "" if claim.bound is None else f"{claim.bound:.10g}",
            claim.message,
            f"{sum(claim.seconds.values()):.1f}",
            "" if error is None else f"{error:.0e}",
        )
    console.print(table)
    return good


def _problem(name: str) -> lfo.OptimalControlProblem:
    system, arguments, _ = PIECEWISE_SMOOTH[name]
    return lfo.library.by_name(system)(**arguments)
