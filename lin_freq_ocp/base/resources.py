"""Limits on memory and threads of a solve: a share of the memory, and one BLAS thread.

Arrays that are too large are refused before they are allocated. Products of small matrices lose more time by sharing
them among threads than they gain.
"""

from __future__ import annotations

import os
import threading
from contextlib import ContextDecorator, suppress
from functools import cached_property
from importlib import import_module
from pathlib import Path

import numpy as np
from threadpoolctl import LibController, ThreadpoolController

from lin_freq_ocp.base.errors import UnsupportedError

MEMORY_SHARE = 0.5  # of the memory for one solve: estimates are good to a factor of two, and other programs need some
GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")  # of a container on Linux
GIB = 2.0**30
ALWAYS_THERE = 2.0**24  # bytes that every machine has: nothing is asked of it
NUMBERS_PER_SIGNAL = 16  # per component and time, of a problem and a trajectory with multipliers


def memory_limit() -> float:
    """Return the bytes that one solve may use: a share of the memory of the machine or of its container."""
    available = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 2 * GIB
    with suppress(OSError, ValueError):  # "max" where there is no limit
        available = min(available, float(GROUP_LIMIT.read_text()))
    return MEMORY_SHARE * available


def require_memory(subject: str, size: float, advice: str) -> None:
    """Raise UnsupportedError if a size in bytes exceeds ``memory_limit``; ``subject`` is that of the message."""
    limit = np.inf if size < ALWAYS_THERE else memory_limit()
    if size > limit:
        raise UnsupportedError(
            f"memory: {subject} would take about {size / GIB:.3g} GiB; {limit / GIB:.3g} GiB may be used, "
            f"{MEMORY_SHARE:.0%} of the machine's. {advice}"
        )


def require_horizon(horizon: int, state_dim: int, control_dim: int) -> None:
    """Raise UnsupportedError unless the signals of a problem fit into memory."""
    size = 8.0 * NUMBERS_PER_SIGNAL * horizon * (state_dim + control_dim)
    require_memory(
        f"signals and bounds of horizon = {horizon}, {state_dim} states and {control_dim} controls",
        size,
        "Choose a shorter horizon or a longer sampling time.",
    )


class _OneBlasThread(ContextDecorator):
    """A context, also a decorator: linear algebra uses one thread while any thread of this process is in it.

    The last thread that leaves restores the numbers that the first one found.
    """

    def __init__(self):
        self._lock, self._users = threading.Lock(), 0

    @cached_property
    def _libraries(self) -> list[LibController]:
        import_module("scipy.linalg")  # it loads SciPy's library; NumPy has one of its own
        return ThreadpoolController().select(user_api="blas").lib_controllers

    def __enter__(self) -> None:
        with self._lock:
            if self._users == 0:  # ``limit`` of threadpoolctl describes each library before and after: 20 us
                self._found = [(library, library.num_threads) for library in self._libraries]
                for library, _ in self._found:
                    library.set_num_threads(1)
            self._users += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._users -= 1
            if self._users == 0:
                for library, threads in self._found:
                    library.set_num_threads(threads)


one_blas_thread = _OneBlasThread()
