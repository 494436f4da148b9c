"""A line for each problem and horizon of the benchmark: our time, and how many times longer the others take."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from benchmark_cases import FAMILIES, RESOLVED
from benchmark_contenders import CONTENDERS
from benchmark_measures import Row
from rich.table import Table

OTHERS = [name for name in CONTENDERS if name != "ours"]


def summary(rows: Sequence[Row]) -> Table:
    """Return the table; in brackets is who ended without the answer, and a dash is who was not run."""
    table = Table("problem", title="median CPU time of ours, and how many times longer the others take")
    for heading in ("T", "ours", *OTHERS, "gap, ours", "bounds, ours"):
        table.add_column(heading, justify="right")
    last = ""
    for (family, horizon), some in groupby(rows, lambda row: (row.family, row.horizon)):
        found = {row.contender: row for row in some}
        ours = found["ours"]
        proofs = ("" if value is None else f"{value:.0e}" for value in (ours.gap, ours.bounds))
        cells = (ratio(found.get(name)) for name in OTHERS)
        words, last = ("" if family == last else described(family)), family
        table.add_row(words, f"{horizon}", duration(ours.seconds), *cells, *proofs)
    return table


def described(family: str) -> str:
    """Return what a family is."""
    solved = RESOLVED.get(family, family)
    return FAMILIES[solved].words + ("" if solved == family else "; again and again from new initial states")


def ratio(row: Row | None) -> str:
    """Return how many times longer than ours, in brackets where there is no answer."""
    if row is None or row.ratio is None:
        return "-"
    said = f"{row.ratio:.0f} x" if row.ratio >= 10 else f"{row.ratio:.1f} x"
    return said if row.status == "optimal" else f"({said})"


def duration(seconds: float | None) -> str:
    """Return seconds with three digits, in ms below one second."""
    if seconds is None:
        return ""
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"
