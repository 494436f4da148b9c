"""Every pair of features, and of a feature and a use, in a small problem (see tests/helpers/checks/pairs.py)."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from rich.console import Console

from helpers.checks.pairs import KNOWN, check, pairs
from helpers.combinations import PAGE, page, words_of_page
from verify.seeded import check_all

PROCESSES = 2


def verify(console: Console, save: Path | None, against: Path | None) -> bool:
    """Try all pairs, and return whether none is wrong and all are as on the page, ``against``; ``save`` writes one."""
    outcomes = check_all(check, pairs(), PROCESSES, "pairs")
    counts = Counter(one.verdict for one in outcomes)
    console.print(f"{len(outcomes)} pairs: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
    failed = [one for one in outcomes if (one.verdict == "wrong") != (one.pair in KNOWN)]
    if save is not None:
        save.write_text(page(outcomes), encoding="utf-8")
    said = words_of_page((save or against or PAGE).read_text(encoding="utf-8"))
    changed = [one for one in outcomes if said.get(one.pair) != " ".join(one.words.split())]
    for what, found in (("wrong", failed), ("not as on the page", changed)):
        for one in found:
            console.print(f"{what}: {', '.join(one.pair)}: {one.words}", soft_wrap=True, markup=False)
    return not failed and not changed
