"""The clock: whatever measures time, or stops when its time is over, reads it here, so that a test can set another."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager

_read: Callable[[], float] = time.perf_counter


def now() -> float:
    """Return the seconds that the clock shows; only differences mean something."""
    return _read()


@contextmanager
def use_clock(read: Callable[[], float]) -> Generator[None]:
    """Read the seconds from this function instead, in all threads of this process; other processes keep their clock."""
    global _read
    before, _read = _read, read
    try:
        yield
    finally:
        _read = before
