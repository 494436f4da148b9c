"""Ctrl-C at any moment of the command line, sent to all its processes as a terminal does: 130, and not a word."""

import fcntl
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.patience import PATIENCE, wait_until
from helpers.seeds import expensive
from lin_freq_ocp.base import leave, leave_silently, let_commands_decide

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks at processes as Linux shows them")

ROOM = 1 << 20  # bytes of a pipe that nobody reads while workers start: import times fill the usual 65 kB
SWEEP = ("sweep", "pendulum", "--grid", "cutoff=0.5:3:400", "--workers", "2")


def children(process):
    return Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()


def interrupted(arguments, ready):
    """Send Ctrl-C as soon as something has happened; return exit status, stdout and stderr of our own words."""
    command = [sys.executable, "-X", "importtime", "-m", "lin_freq_ocp", *arguments]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **streams, text=True, start_new_session=True) as process:
        try:
            fcntl.fcntl(process.stderr, fcntl.F_SETPIPE_SZ, ROOM)
            ready(process)
            os.killpg(process.pid, signal.SIGINT)
            out, err = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    return process.returncode, out, [line for line in err.splitlines() if not line.startswith("import time:")]


def imported(module):
    """Return what waits until a process has imported a module."""

    def ready(process):
        for line in process.stderr:
            if line.rstrip().endswith(f" {module}"):
                return

    return ready


def working(process):
    """Wait until processes to work on have been asked for, which then import what they need."""
    imported("lin_freq_ocp.cli.app")(process)
    wait_until(lambda: len(children(process)) > 1)


@expensive
@pytest.mark.parametrize("module", ["inspect", "numpy", "lin_freq_ocp.base.arrays"])
def test_during_imports(module):
    assert interrupted(("solve", "pendulum"), imported(module)) == (130, "", [])


INTERRUPTED_TEXT = """
from lin_freq_ocp.cli import app

def status(arguments):
    try:
        exec("raise KeyboardInterrupt")
    except KeyboardInterrupt:
        return app.INTERRUPTED

app._run_command = status
app.main()
"""


def test_while_a_class_is_made_from_a_text(tmp_path):
    """As dataclasses do: Python then ends by the signal, unless it forgets it."""
    (tmp_path / "interrupted_text.py").write_text(INTERRUPTED_TEXT)
    command = [sys.executable, "-m", "interrupted_text"]
    assert subprocess.run(command, cwd=tmp_path, check=False, timeout=PATIENCE).returncode == 130


@expensive
def test_while_workers_start():
    status, _, words = interrupted(SWEEP, working)
    assert (status, words) == (130, [])


@pytest.mark.parametrize(
    ("arguments", "ours"),
    [
        (["/usr/bin/lin-freq-ocp", "solve"], True),
        (["-m", "solve"], True),
        (["my_script.py", "-m", "lin_freq_ocp"], False),
        (["/usr/bin/pytest", "lin-freq-ocp"], False),
        (["-c"], False),
        ([], False),
    ],
)
def test_scripts_that_import_the_package_keep_their_ctrl_c(monkeypatch, arguments, ours):
    monkeypatch.setattr(sys, "argv", arguments)
    monkeypatch.setattr(sys, "orig_argv", ["python", "-m", "lin_freq_ocp", "solve"])
    before = signal.getsignal(signal.SIGINT)
    try:
        leave_silently()
        assert (signal.getsignal(signal.SIGINT) is leave) == ours
        assert let_commands_decide() == ours
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_other_modules_keep_their_ctrl_c(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["-m"])
    monkeypatch.setattr(sys, "orig_argv", ["python", "-m", "my_module", "lin_freq_ocp"])
    leave_silently()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
