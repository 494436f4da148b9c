"""The page docs/combinations.md: what every pair of tests/helpers/checks/pairs.py came to, written and read back."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from helpers.checks.pairs import FEATURES, USES, Outcome, exclude_each_other

PAGE = Path(__file__).parents[2] / "docs" / "combinations.md"
WORKS, NO_PAIR = "✓", "·"
HEAD = """# What goes with what

Every feature of a problem was put together with every other one in a small problem, and with everything that one does
with a problem. ✓: it works, and where the problem is convex, CVXPY finds the same cost. A number: it is refused, with
the reason in the note of that number. ·: the two exclude each other, as two kinds of dynamics do.

`python scripts/verify.py --part pairs` tries all pairs, and with `--save docs/combinations.md` writes this page. The
problems are in `tests/helpers/checks/pairs.py`.

## Feature and feature

The columns have the numbers of the rows.

"""
USE = """
## Feature and use

"""
NOTES = """
## Notes

"""


def page(outcomes: Iterable[Outcome]) -> str:
    """Return the text of the page."""
    notes, cells = dict[str, int](), dict[tuple[str, str], str]()
    for one in outcomes:
        number = notes.setdefault(one.words, len(notes) + 1) if one.words else None
        cells[one.pair] = WORKS if number is None else str(number)
    names = list(FEATURES)
    columns = [str(i + 1) for i in range(len(names))]
    rows = [
        [
            f"{i + 1} {name}",
            *(NO_PAIR if exclude_each_other(other, name) else cells[other, name] for other in names[:i]),
        ]
        for i, name in enumerate(names)
    ]
    uses = [[name, *(cells[name, use] for use in USES)] for name in names]
    written = "".join(f"{number}. `{' '.join(words.split())}`\n" for words, number in notes.items())
    return HEAD + _table(["", *columns[:-1]], rows) + USE + _table(["", *USES], uses) + NOTES + written


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    filled = ([*row, *[""] * (len(head) - len(row))] for row in (head, ["---"] * len(head), *rows))
    return "".join(f"| {' | '.join(row)} |\n" for row in filled)


def words_of_page(text: str) -> Mapping[tuple[str, str], str]:
    """Return the reason of every pair on the page, an empty text for those that work."""
    notes = {number: words for number, words in re.findall(r"^(\d+)\. `(.*)`$", text, re.MULTILINE)}
    features, uses = (
        [[cell.strip() for cell in line.strip("|\n").split("|")] for line in part.splitlines() if line.startswith("|")]
        for part in text.split(USE)
    )
    names, found = [row[0].split(" ", 1)[1] for row in features[2:]], dict[tuple[str, str], str]()
    for name, row in zip(names, features[2:], strict=True):
        found |= {(other, name): cell for other, cell in zip(names, row[1:], strict=False)}
    for row in uses[2:]:
        found |= {(row[0], use): cell for use, cell in zip(uses[0][1:], row[1:], strict=True)}
    return {pair: notes.get(cell, "") for pair, cell in found.items() if cell not in ("", NO_PAIR)}
