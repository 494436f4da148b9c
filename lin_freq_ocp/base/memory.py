"""How much memory may be used: large arrays are refused before they are allocated."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import numpy as np

from lin_freq_ocp.base.errors import UnsupportedError

SHARE = 0.5  # of the memory for one solve: estimates are good to a factor of two, and other programs need some
GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")  # of a container on Linux
GIB = 2.0**30
ALWAYS_THERE = 2.0**24  # bytes that every machine has: nothing is asked of it
NUMBERS_PER_SIGNAL = 16  # per component and time, of a problem and a trajectory with multipliers


def memory_limit() -> float:
    """Return the bytes that one solve may take: a share of the machine's memory, or of what its container may use."""
    available = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 2 * GIB
    with suppress(OSError, ValueError):  # "max" where there is no limit
        available = min(available, float(GROUP_LIMIT.read_text()))
    return SHARE * available


def require_memory(what: str, size: float, advice: str) -> None:
    """Raise UnsupportedError if ``what`` (the subject of the message) needs more than one solve may take, in bytes."""
    limit = np.inf if size < ALWAYS_THERE else memory_limit()
    if size > limit:
        raise UnsupportedError(
            f"memory: {what} would take about {size / GIB:.3g} GiB; {limit / GIB:.3g} GiB may be used, "
            f"{SHARE:.0%} of what there is. {advice}"
        )


def require_horizon(horizon: int, state_dim: int, control_dim: int) -> None:
    """Raise UnsupportedError unless the signals of a problem fit into memory."""
    size = 8.0 * NUMBERS_PER_SIGNAL * horizon * (state_dim + control_dim)
    require_memory(
        f"signals and bounds of horizon = {horizon}, {state_dim} states and {control_dim} controls",
        size,
        "Choose a shorter horizon or a longer sampling time.",
    )
