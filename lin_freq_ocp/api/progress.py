"""The progress of a long call in a Jupyter notebook: a line below the cell, which is gone when the call ends.

It is shown by IPython, which every notebook has; where there is no notebook, nothing is imported and nothing shown.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from html import escape
from importlib import import_module
from multiprocessing import parent_process
from typing import ParamSpec, Protocol

from lin_freq_ocp.base.clock import now

FIRST_SECONDS, BETWEEN_SECONDS = 0.5, 0.2  # before the line is shown, and from one change to the next

Given = ParamSpec("Given")
Bundle = dict[str, str]  # the same content in several media types


class Handle(Protocol):
    """What changes a displayed line."""

    def update(self, bundle: Bundle, *, raw: bool) -> object:
        """Show something else in its place."""


class Line:
    """A line below the cell that runs: quick calls never show it, and it is emptied in the end."""

    def __init__(self):
        self._next, self._handle = now() + FIRST_SECONDS, None

    def show(self, text: str) -> None:
        """Show a text, unless the last was shown just now."""
        if now() < self._next:
            return
        self._next = now() + BETWEEN_SECONDS
        bundle = {"text/plain": text, "text/html": f"<progress></progress> {escape(text)}"}
        if self._handle is None:
            self._handle: Handle | None = import_module("IPython.display").display(bundle, raw=True, display_id=True)
        else:
            self._handle.update(bundle, raw=True)

    def clear(self) -> None:
        """Leave nothing of it."""
        if self._handle is not None:
            self._handle.update({}, raw=True)


@contextmanager
def reporting(
    given: Callable[Given, None] | None, words: Callable[Given, str]
) -> Generator[Callable[Given, None] | None]:
    """Yield a given report of progress; without one, in a notebook, what shows its words, else None."""
    if given is not None or not in_notebook():
        yield given
        return
    line = Line()

    def report(*args: Given.args, **kwargs: Given.kwargs) -> None:
        line.show(words(*args, **kwargs))

    try:
        yield report
    finally:
        line.clear()


def in_notebook() -> bool:
    """Whether a Jupyter kernel runs this: IPython in a terminal has none, and a worker of a pool is not the kernel."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel") and parent_process() is None


def counted(done: int, count: int) -> str:
    """Return how many are solved of how many."""
    return f"{done} of {count} solved"
