"""Clocks for ``lin_freq_ocp.base.clock.use_clock``, by which a limit is over when a test says so."""

from __future__ import annotations

import threading


class Clock:
    """A clock that every look at it puts forward by so many seconds; it stands still by default."""

    def __init__(self, per_look: float = 0.0):
        self.per_look, self.seconds, self._lock = per_look, 0.0, threading.Lock()

    def __call__(self) -> float:
        with self._lock:  # threads look at it, too
            self.seconds += self.per_look
            return self.seconds
