"""Ctrl-C, where an exception would do harm: while modules are imported, and during a solver's compiled code.

While the command line imports, it ends the process at once, with its status and without a traceback. During compiled
code it is noted at once and acted on between iterations, so that nothing is lost.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import PurePath
from types import FrameType

INTERRUPTED = 130  # exit status after Ctrl-C, as of shells


def leave(number: int, frame: FrameType | None) -> None:
    """Leave now: nothing is open, and KeyboardInterrupt in the midst of an import becomes other errors on its way."""
    os._exit(INTERRUPTED)


def leave_silently() -> None:
    """Let Ctrl-C end this process silently, if it is the command line and Ctrl-C is not ignored."""
    main = threading.current_thread() is threading.main_thread()
    if main and _is_command_line() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, leave)


def let_commands_decide() -> bool:
    """Let Ctrl-C raise KeyboardInterrupt again, which the commands know what to do with; return whether it did not."""
    silent = signal.getsignal(signal.SIGINT) is leave
    if silent:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return silent


def _is_command_line() -> bool:
    """Whether this process was started as ``lin-freq-ocp`` or ``python -m lin_freq_ocp``."""
    program = sys.argv[0] if sys.argv else ""
    if program == "-m":  # a package is imported before Python knows the path of what it is to run
        given = sys.orig_argv
        return "lin_freq_ocp" in (given[given.index("-m") + 1 :] if "-m" in given else [])[:1]
    return PurePath(program).stem == "lin-freq-ocp"


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
