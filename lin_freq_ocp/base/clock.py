"""The clock of all time limits and measured times, which a test can replace."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager

LEAST_SECONDS = 1e-3  # time limit of a solver that starts when no time is left: it makes one step and stops

_read: Callable[[], float] = time.perf_counter
_read_processor: Callable[[], float] = time.process_time


def now() -> float:
    """Return the seconds of the clock; only differences have a meaning."""
    return _read()


def seconds_left(end: float) -> float | None:
    """Return the seconds from now to the end, which is a reading of ``now``; LEAST_SECONDS at least, None for inf."""
    return None if end == math.inf else max(end - now(), LEAST_SECONDS)


def seconds_since(date: float) -> float:
    """Return the seconds from a date of the file system, which a test does not replace, to now."""
    return time.time() - date


def processor_now() -> float:
    """Return the seconds of processor time of this process."""
    return _read_processor()


@contextmanager
def use_clock(read: Callable[[], float], processor: Callable[[], float] | None = None) -> Generator[None]:
    """Replace the clock by a function, in all threads of this process; other processes keep their clock.

    Processor seconds are read from ``processor``, by default from the same function.
    """
    global _read, _read_processor
    before, _read, _read_processor = (_read, _read_processor), read, processor or read
    try:
        yield
    finally:
        _read, _read_processor = before
