"""The share of the tests that a run takes: a twelfth of random seeds, of long tables and of expensive tests.

The next day's run takes another twelfth. The environment variable ``SEEDS_OF_TESTS`` chooses it, 0 to 11, or "all", as
``scripts/verify.py --part suite`` does. A run of named files takes all of them. The first process sets the variable, so
that all workers of a run take the same seeds, also around midnight.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from datetime import date
from typing import TypeVar
from zlib import crc32

import pytest

Seed = TypeVar("Seed")  # a number, or a tuple with one
VARIABLE = "SEEDS_OF_TESTS"
ALL = "all"
PARTS = 12


today = date.today


def choose_seeds(named: bool = False) -> None:
    """Choose the twelfth of today, or all where files are named, unless the environment has a choice."""
    chosen = os.environ.setdefault(VARIABLE, ALL if named else str(today().toordinal() % PARTS))
    if chosen not in {ALL, *map(str, range(PARTS))}:
        raise pytest.UsageError(f"{VARIABLE}: got {chosen!r}; expected a number from 0 to {PARTS - 1}, or {ALL}")


def seeds(given: Iterable[Seed], always: Iterable[Seed] = ()) -> list[Seed]:
    """Return the given seeds, or cases, of this run and all of ``always``, for which an answer was once wrong.

    A run takes at least one. The twelfths are no residues of 12: random problems often have the kind ``seed % 3``.
    """
    given, chosen = list(given), os.environ[VARIABLE]
    parts = min(PARTS, len(given))
    taken = [seed for i, seed in enumerate(given) if chosen == ALL or (i + i // parts) % parts == int(chosen) % parts]
    return [*taken, *always]


def examples(most: int) -> int:
    """Return how many examples Hypothesis draws in this run: a twelfth of the most, which it draws with all seeds."""
    return most if os.environ[VARIABLE] == ALL else max(1, most // PARTS)


expensive = pytest.mark.expensive
"""For a test of more than some tenths of a second: one run of twelve takes it, of its cases each on its own day."""


def has_its_turn(nodeid: str) -> bool:
    """Whether this run takes an expensive test: its name decides on which day."""
    return os.environ[VARIABLE] in (ALL, str(crc32(nodeid.encode()) % PARTS))


whole_sample = pytest.mark.skipif(f"os.environ['{VARIABLE}'] != '{ALL}'", reason=f"needs {VARIABLE}={ALL}")
"""For a long case of a test, or for one that says what the answers to all seeds have in common."""
