"""Checks of many seeds in processes of one BLAS thread each, with their progress on a terminal, and their table."""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Protocol, TypeVar

from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

Found = TypeVar("Found")


class Checked(Protocol):
    """The outcome of a seed: its kind, what was said, and whether all of that is right."""

    @property
    def kind(self) -> str:
        """Return the group of problems that it is counted in."""
        ...

    @property
    def statuses(self) -> Sequence[str]:
        """Return what was said."""
        ...

    @property
    def passed(self) -> bool:
        """Whether all of that is right."""
        ...


CHUNK = 5
"""Seeds that a process takes at a time."""


def check_all(check: Callable[[int], Found], seeds: Sequence[int], processes: int, what: str) -> list[Found]:
    """Return the result of every seed, in their order."""
    terminal, spawn = Console(stderr=True), multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, spawn, initializer=threadpool_limits, initargs=(1,)) as pool:
        checked = pool.map(check, seeds, chunksize=CHUNK)
        if terminal.is_terminal:
            checked = track(checked, what, len(seeds), console=terminal, transient=True)
        return list(checked)


def trial(title: str, check: Callable[[int], Checked]) -> Callable[[Console, range, int], bool]:
    """Return the function ``verify`` of a part: it prints how often what was said of each kind, and what is false."""

    def verify(console: Console, seeds: range, processes: int) -> bool:
        outcomes = check_all(check, seeds, processes, title)
        table = Table("kind", "problems", "false", "said", title=title)
        for kind in dict.fromkeys(one.kind for one in outcomes):
            own = [one for one in outcomes if one.kind == kind]
            counts = Counter(status for one in own for status in one.statuses)
            said = ", ".join(f"{status} {count}" for status, count in counts.most_common())
            table.add_row(kind, str(len(own)), str(sum(not one.passed for one in own)), said)
        console.print(table)
        failed = [one for one in outcomes if not one.passed]
        for one in failed:
            console.print(one, markup=False)
        return not failed

    return verify
