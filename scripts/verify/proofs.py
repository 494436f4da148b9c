"""Proofs: every mutation of each kind, and a hundred random problems (see tests/helpers/checks/proofs.py)."""

from __future__ import annotations

import multiprocessing
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from helpers.checks.proofs import KINDS, Truth, check_random, truth_of, wrong_of
from helpers.mutations import of_index
from verify.seeded import check_all

NARROW = 1e-9  # relative width of an interval
LINES = 4
"""Lines of a proof whose mutations a process takes at a time."""


def mutate(lines: list[str], truth: Truth, first_hash: str, index: int) -> tuple[int, list[str]]:
    """Check every mutation of a line; return their number and the errors."""
    with tempfile.TemporaryDirectory() as folder:
        found = of_index(lines, index)
        wrong = [(one, wrong_of(one, truth, first_hash, Path(folder))) for one in found]
    return len(found), [f"{one}: {words}" for one, words in wrong if words]


def mutated_kinds(console: Console, processes: int) -> bool:
    """Check all mutations of all kinds, and print how many there are; return whether nothing is wrong."""
    table, good = Table("proof", "lines", "mutations", "failed", title="mutations of proofs"), True
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context) as pool, tempfile.TemporaryDirectory() as folder:
        for kind, make in KINDS.items():
            proof = make()
            truth, first_hash = truth_of(kind, proof, Path(folder))
            lines = proof.splitlines(keepends=True)
            found = list(pool.map(partial(mutate, lines, truth, first_hash), range(len(lines)), chunksize=LINES))
            wrong = [words for _, some in found for words in some]
            table.add_row(kind, f"{len(lines)}", f"{sum(count for count, _ in found)}", f"{len(wrong)}")
            good &= not wrong
            for words in wrong:
                console.print(f"FAILED {kind}, {words}", markup=False)
    console.print(table)
    return good


def verify(console: Console, seeds: range, processes: int) -> bool:
    """Check all mutations, and the random problems of these seeds; return whether nothing is wrong."""
    good = mutated_kinds(console, processes)
    outcomes = check_all(check_random, seeds, processes, "proving")
    columns = "problems", "exact", "interval", "within 1e-9", "widest", "failed"
    table = Table("dynamics", *columns, title="proofs of random problems")
    for kind in [*sorted({one.kind for one in outcomes}), "all"]:
        some = [one for one in outcomes if kind in (one.kind, "all")]
        widths = [one.width for one in some if np.isfinite(one.width)]
        counts = len(some), sum(one.exact for one in some), len(widths), sum(width <= NARROW for width in widths)
        failed = sum(not one.passed for one in some)
        table.add_row(kind, *map(str, counts), f"{max(widths, default=0.0):.1e}", f"{failed}")
    console.print(table)
    for one in outcomes:
        if not one.passed:
            console.print(f"FAILED seed {one.seed}, {one.kind}: {one.wrong}", markup=False)
        elif one.width > NARROW and one.kind != "kinks":
            console.print(f"wide: seed {one.seed}, {one.kind}: {one.last}", markup=False)
    return good and all(one.passed for one in outcomes)
