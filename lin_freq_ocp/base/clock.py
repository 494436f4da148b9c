"""The clock: whatever measures time, or stops when its time is over, reads it here, so that a test can set another."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager

LEAST_SECONDS = 1e-3  # given to a solver when the time is over: it makes a step, and ends with its limit

_read: Callable[[], float] = time.perf_counter
_read_processor: Callable[[], float] = time.process_time


def now() -> float:
    """Return the seconds that the clock shows; only differences mean something."""
    return _read()


def seconds_left(end: float) -> float | None:
    """Return the seconds from now to the end, which is a reading of ``now``; LEAST_SECONDS at least, None for inf."""
    return None if end == math.inf else max(end - now(), LEAST_SECONDS)


def processor_now() -> float:
    """Return the seconds for which processors have worked for this process; on a busy machine they pass more slowly."""
    return _read_processor()


@contextmanager
def use_clock(read: Callable[[], float], processor: Callable[[], float] | None = None) -> Generator[None]:
    """Read the seconds from this function instead, in all threads of this process; other processes keep their clock.

    Processor seconds are read from ``processor``, by default from the same function.
    """
    global _read, _read_processor
    before, _read, _read_processor = (_read, _read_processor), read, processor or read
    try:
        yield
    finally:
        _read, _read_processor = before
