"""Random seeds of the tests, and cases of long tables: a run takes a third of them, the next day's run another third.

The environment variable ``SEEDS_OF_TESTS`` chooses the third, 0, 1 or 2, or "all", as
``scripts/verify.py --part suite`` does. The first process sets it, so that all workers of a run take the same seeds,
also around midnight.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from datetime import date
from typing import TypeVar

import pytest

Seed = TypeVar("Seed")  # a number, or a tuple with one
VARIABLE = "SEEDS_OF_TESTS"
ALL = "all"
CHOICES = "0", "1", "2", ALL


today = date.today


def choose_seeds() -> None:
    """Choose the third of today, unless the environment has a choice."""
    chosen = os.environ.setdefault(VARIABLE, str(today().toordinal() % 3))
    if chosen not in CHOICES:
        raise pytest.UsageError(f"{VARIABLE}: got {chosen!r}; expected one of {', '.join(CHOICES)}")


def seeds(given: Iterable[Seed], always: Iterable[Seed] = ()) -> list[Seed]:
    """Return the given seeds, or cases, of this run and all of ``always``, for which an answer was once wrong.

    The thirds are no residues of 3: random problems often have the kind ``seed % 3``.
    """
    chosen = os.environ[VARIABLE]
    taken = [seed for i, seed in enumerate(given) if chosen in (ALL, str((i + i // 3) % 3))]
    return [*taken, *always]


def examples(most: int) -> int:
    """Return how many examples Hypothesis draws in this run: a third of the most, which it draws with all seeds."""
    return most if os.environ[VARIABLE] == ALL else max(1, most // 3)


def turn(third: int) -> pytest.MarkDecorator:
    """Run an expensive test in one run of three: cheaper tests of its file have the same subject every day."""
    return pytest.mark.skipif(f"os.environ['{VARIABLE}'] not in ('{third}', '{ALL}')", reason="another day's turn")


whole_sample = pytest.mark.skipif(f"os.environ['{VARIABLE}'] != '{ALL}'", reason=f"needs {VARIABLE}={ALL}")
"""For a long case of a test, or for one that says what the answers to all seeds have in common."""
