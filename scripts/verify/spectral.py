"""Random LTI problems, Fourier-domain method against a sparse program (see tests/helpers/checks/spectral.py)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from helpers.checks.spectral import AGREEMENT, BOTH_SOLVED, GOOD, Outcome, Verdict, check
from helpers.random.lti import KINDS, kind_of
from verify.seeded import check_all

AGREEING = 0.99  # share of the problems solved by both that must agree


def summary(outcomes: Sequence[Outcome]) -> Table:
    """Return the outcomes of all problems."""
    counts = Counter(one.verdict for one in outcomes)
    both = [one for one in outcomes if one.verdict in BOTH_SOLVED]
    certificates = [one.certificate for one in outcomes if one.certified]
    rounds = [one.rounds for one in outcomes if one.rounds is not None]
    rigorous = sum(one.bound.kind == "rigorous" for one in certificates)
    table = Table("random LTI problems", "count", "", title="Fourier-domain method against Clarabel at 1e-11")
    table.add_row("problems", str(len(outcomes)))
    table.add_row("both solved it", str(len(both)))
    table.add_row("difference of the costs", "", _quantiles([one.difference for one in both], ".0e"))
    table.add_row("the same cost", str(counts[Verdict.AGREES]), f"within {AGREEMENT:g}: {agreeing(outcomes):.1%}")
    for verdict in Verdict:
        if verdict is not Verdict.AGREES and counts[verdict]:
            table.add_row(verdict, str(counts[verdict]), "" if verdict in GOOD else "must not be")
    table.add_row("solved here and certified", str(len(certificates)), f"{rigorous} by a rigorous bound")
    table.add_row("gap", "", _quantiles([abs(one.gap) for one in certificates], ".0e"))
    table.add_row("worst condition, relative", "", _quantiles([one.worst.relative for one in certificates], ".0e"))
    table.add_row("rounds", "", _quantiles(rounds, ".0f"))
    return table


def by_kind(outcomes: Sequence[Outcome]) -> Table:
    """Return counts and the largest difference for every kind of dynamics."""
    table = Table("kind", "problems", "solved", "agree", "infeasible", "difference", "failed")
    for kind in KINDS:
        some = [one for one in outcomes if kind_of(one.seed) == kind]
        both = [one for one in some if one.verdict in BOTH_SOLVED]
        same = sum(one.verdict is Verdict.AGREES for one in both)
        infeasible = sum(one.ours == "infeasible" for one in some)
        largest = f"{max((one.difference for one in both), default=0.0):.1e}"
        counts = len(some), len(both), same, infeasible, largest, sum(not one.passed for one in some)
        table.add_row(kind, *map(str, counts))
    return table


def agreeing(outcomes: Sequence[Outcome]) -> float:
    """Return the share of the problems solved by both that have the same cost; 1 if there are none."""
    same = [one.verdict is Verdict.AGREES for one in outcomes if one.verdict in BOTH_SOLVED]
    return sum(same) / len(same) if same else 1.0


def _quantiles(values: Sequence[float], form: str) -> str:
    if not len(values):
        return ""
    levels = {"median": 0.5, "90 %": 0.9, "95 %": 0.95, "max": 1.0}
    return ", ".join(f"{name} {np.quantile(values, level):{form}}" for name, level in levels.items())


def verify(console: Console, seeds: Sequence[int], processes: int) -> bool:
    """Check all seeds and print their outcomes; return whether every requirement is met."""
    outcomes = check_all(check, seeds, processes, "Fourier-domain method")
    console.print(summary(outcomes), by_kind(outcomes))
    for one in outcomes:
        if not one.passed or one.verdict not in (Verdict.AGREES, Verdict.RAY):
            console.print(str(one), soft_wrap=True, markup=False, highlight=False)
    enough = agreeing(outcomes) >= AGREEING
    if not enough:
        console.print(f"FAILED only {agreeing(outcomes):.1%} of the problems solved by both have the same cost")
    return enough and all(one.passed for one in outcomes)
