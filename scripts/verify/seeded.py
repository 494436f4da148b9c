"""Checks of many seeds in processes of one BLAS thread each, with their progress on a terminal."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

from rich.console import Console
from rich.progress import track
from threadpoolctl import threadpool_limits

Found = TypeVar("Found")

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
