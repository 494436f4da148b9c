"""How long a test waits for a thread or a process: longer than any load delays them, so that only a hang ends it."""

import time
from collections.abc import Callable
from typing import TypeVar

PATIENCE = 600.0  # seconds

Value = TypeVar("Value")


def wait_until(condition: Callable[[], Value]) -> Value:
    """Wait until a condition holds, and return its value; AssertionError after ``PATIENCE``."""
    end = time.monotonic() + PATIENCE
    while not (value := condition()):
        assert time.monotonic() < end, f"waited for {PATIENCE:g} s"
        time.sleep(0.01)
    return value
