"""Ctrl-C during a solver's compiled code: noted at once, acted on between its iterations, nothing lost."""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def interrupts_noted() -> Generator[threading.Event]:
    """Set the event, instead of raising KeyboardInterrupt, when Ctrl-C arrives; only the main thread receives it."""
    noted = threading.Event()
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is None:
        yield noted
        return
    before = signal.signal(signal.SIGINT, lambda number, frame: noted.set())
    try:
        yield noted
    finally:
        signal.signal(signal.SIGINT, before)
