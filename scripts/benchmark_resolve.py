"""Re-solving: one problem from many new initial states, one after the other."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from benchmark_cases import FAMILIES, RESOLVED, moved
from benchmark_contenders import RESOLVERS, Answer
from benchmark_measures import Row, measured, timed

NONZERO = 1e-9  # A multiplier above this fraction of the largest belongs to an active bound
WORST = ("error", "gap", "dynamics", "stop_band", "bounds", "adjoint", "iterations")


def resolve_rows(family: str, horizon: int, count: int, limit: float) -> tuple[list[Row], str]:
    """Return a row per contender over ``count`` initial states, and what is said below the table.

    Setting up for the first problem, and solving it once, is not timed. Times are medians over the initial states that
    the contender found a trajectory for; every other figure is the worst of them.
    """
    print(f"{family}, T = {horizon}, {count} initial states", file=sys.stderr)
    problem = FAMILIES[RESOLVED[family]].problem(horizon)
    contenders = {name: prepare(problem) for name, prepare in RESOLVERS.items()}
    rows: dict[str, list[Row]] = {name: [] for name in RESOLVERS}
    gaps, active = list[float](), list[np.ndarray]()
    for one in moved(problem, count):
        runs = {name: timed(contender, one, limit) for name, contender in contenders.items()}
        some, best = measured(family, one, runs)
        for row in some:
            rows[row.contender].append(row)
        if best is not None:
            gaps.append(best.gap)
        if runs["ours"].answer.status == "optimal":
            active.append(active_set(runs["ours"].answer))
    merged = [together(some) for some in rows.values()]
    ours = next(row.seconds for row in merged if row.contender == "ours")
    changed = [not np.array_equal(*pair) for pair in pairwise(active)]
    note = f"T = {horizon}: {count} initial states"
    if changed:
        note += f", the active set is another than the one before in {np.mean(changed):.0%}"
    if gaps:
        note += f"; optimal costs proven to {max(gaps):.0e} or better"
    if ours is not None:
        merged = [row if row.seconds is None else replace(row, ratio=row.seconds / ours) for row in merged]
    return merged, note


def together(rows: Sequence[Row]) -> Row:
    """Return one row for the same contender's rows of many initial states."""
    solved = [row for row in rows if row.status == "optimal"]
    first, others = rows[0], [row for row in rows if row.status != "optimal"]
    endings = sorted({row.status for row in others})
    remark = "; ".join(f"{sum(row.status == ending for row in others)} {ending}" for ending in endings)
    if not solved:
        return Row(first.family, first.horizon, first.contender, "failed", remark=remark)
    times = np.array([row.seconds for row in solved])
    columns = {name: [value for row in solved if (value := getattr(row, name)) is not None] for name in WORST}
    worst = {name: max(values, key=abs, default=None) for name, values in columns.items()}
    return Row(
        first.family,
        first.horizon,
        first.contender,
        "optimal",
        runs=len(solved),
        seconds=float(np.median(times)),
        fastest=float(times.min()),
        slowest=float(times.max()),
        remark=remark,
        **worst,
    )


def active_set(answer: Answer) -> np.ndarray:
    """Return where the multipliers of states (ends apart) and controls are not zero, flat."""
    parts = [np.abs(answer.multipliers.mu[1:-1]), np.abs(answer.multipliers.nu)]
    return np.concatenate([(part > NONZERO * part.max()).ravel() for part in parts])
