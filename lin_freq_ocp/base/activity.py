"""What a long call does, in the last line of a terminal or below the cell of a notebook, and nowhere else.

The line has the levels of the call, ``comparing gantry; with the constraint; method structured``, and the seconds since
it began. It appears after a while, and is gone when the call ends.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from contextvars import copy_context
from html import escape
from importlib import import_module
from io import TextIOWrapper
from multiprocessing import parent_process
from shutil import get_terminal_size
from threading import Event, Lock, Thread, get_ident
from typing import ParamSpec

from lin_freq_ocp.base.clock import now

# Before the line appears, in a notebook and on a terminal, between its changes, and between those of its seconds.
FIRST_SECONDS, TERMINAL_SECONDS, BETWEEN_SECONDS, TICK_SECONDS = 0.5, 1.0, 0.2, 1.0

Reported = ParamSpec("Reported")


class ActivityLine:
    """The line of a call, whose thread alone changes its levels; ``write`` replaces it by a text, or by nothing."""

    def __init__(self, write: Callable[[str], None], first: float):
        self.owner, self.levels, self._write, self._begun = _caller(), list[str](), write, now()
        self._next, self._shown, self._lock, self._ended = self._begun + first, False, Lock(), Event()
        Thread(target=copy_context().run, args=(self._count_seconds,), daemon=True).start()  # of the same notebook cell

    def show(self) -> None:
        """Show the levels, unless the line has just changed."""
        with self._lock:
            if self.levels and now() >= self._next and not self._ended.is_set():
                self._next, self._shown = now() + BETWEEN_SECONDS, True
                self._write(f"{'; '.join(self.levels)} ({now() - self._begun:.0f} s)")

    def _count_seconds(self) -> None:
        while not self._ended.wait(TICK_SECONDS):
            self.show()

    def close(self) -> None:
        """Empty the line."""
        self._ended.set()
        with self._lock:
            if self._shown:
                self._write("")


_line: ActivityLine | None = None


@contextmanager
def activity(what: str) -> Generator[None]:
    """Show what a call does while it lasts, also as a decorator; in another such call, as a further level."""
    global _line
    line = activity_line() if _line is None else None
    _line = _line or line
    try:
        with activity_step(what):
            yield
    finally:
        if line is not None:
            _line = None
            line.close()


@contextmanager
def activity_step(what: str) -> Generator[None]:
    """Add a level to the line of the call, if it has one: for what is too quick to open a line."""
    line = _line
    if line is None or line.owner != _caller():
        yield
        return
    line.levels.append(what)
    line.show()
    try:
        yield
    finally:
        line.levels.pop()


def tell(text: str) -> None:
    """Replace the last level of the line of the call, if it has one."""
    if _line is not None and _line.owner == _caller():
        _line.levels[-1] = text
        _line.show()


@contextmanager
def report_progress(
    progress: Callable[Reported, None] | None, what: str, words: Callable[Reported, str]
) -> Generator[Callable[Reported, None] | None]:
    """Yield the given function that reports progress; without one, a function that tells its words where a line can."""
    if progress is not None:
        yield progress
        return

    def report(*args: Reported.args, **kwargs: Reported.kwargs) -> None:
        tell(words(*args, **kwargs))

    with activity(what):
        yield report if _line is not None else None


def activity_line() -> ActivityLine | None:
    """Return the line of a Jupyter kernel, else that of a terminal; None elsewhere, and in a worker of a pool.

    A library that has replaced sys.stderr, as the bars of Rich do, has a line of its own.
    """
    if parent_process() is not None:
        return None
    ipython = sys.modules.get("IPython")
    if ipython is not None and hasattr(ipython.get_ipython(), "kernel"):
        return ActivityLine(NotebookOutput(), FIRST_SECONDS)
    terminal = isinstance(sys.stderr, TextIOWrapper) and sys.stderr.isatty()
    return ActivityLine(write_on_terminal, TERMINAL_SECONDS) if terminal else None


def _caller() -> tuple[int, int]:
    """Return the process, which a fork changes, and the thread."""
    return os.getpid(), get_ident()


def write_on_terminal(text: str) -> None:
    """Replace the last line of the terminal."""
    width = get_terminal_size().columns - 1
    print(f"\r{text[:width]:{width}}", end="" if text else "\r", file=sys.stderr, flush=True)


class NotebookOutput:
    """A function that replaces a line below the running cell."""

    def __init__(self):
        self._update: Callable[..., object] | None = None

    def __call__(self, text: str) -> None:
        """Replace the line."""
        bundle = {"text/plain": text, "text/html": f"<progress></progress> {escape(text)}"} if text else {}
        if self._update is None:
            self._update = import_module("IPython.display").display(bundle, raw=True, display_id=True).update
        else:
            self._update(bundle, raw=True)
