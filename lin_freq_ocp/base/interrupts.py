"""Ctrl-C while modules are imported, and during a solver's compiled code, where an exception would do harm.

While the command line imports, Ctrl-C ends the process at once, with its exit status and without a traceback. During
compiled code it sets an event, which the solver reads between iterations: no result is lost.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED = 130  # exit status after Ctrl-C, as of shells


def leave(number: int, frame: FrameType | None) -> None:
    """End the process: no file is open, and KeyboardInterrupt within an import would become another error."""
    os._exit(INTERRUPTED)


def leave_silently() -> None:
    """Let Ctrl-C end this process silently, if it is the command line and Ctrl-C is not ignored.

    The command line is ``lin-freq-ocp`` or ``python -m lin_freq_ocp``.
    """
    program = sys.argv[0] if sys.argv else ""
    command = os.path.splitext(os.path.basename(program))[0] == "lin-freq-ocp"  # pathlib is slow to import
    if program == "-m":  # a package is imported before Python knows the path of the module that it will run
        arguments = sys.orig_argv
        command = "lin_freq_ocp" in (arguments[arguments.index("-m") + 1 :] if "-m" in arguments else [])[:1]
    main = threading.current_thread() is threading.main_thread()
    if main and command and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, leave)


def let_commands_decide() -> bool:
    """Let Ctrl-C raise KeyboardInterrupt again, which the commands handle; return whether it ended the process."""
    silent = signal.getsignal(signal.SIGINT) is leave
    if silent:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return silent


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
