"""A command that is killed without a word leaves no processes behind."""

import subprocess
import sys
from contextlib import suppress

import psutil
import pytest

from helpers.patience import wait_until
from helpers.seeds import expensive

SWEEP = ("sweep", "double_integrator", "--grid", "horizon=60:400:300", "--workers", "2")


@pytest.mark.skipif(sys.platform == "win32", reason="children are counted as forkserver starts them")
@expensive
def test_workers_of_a_killed_sweep_end():
    command = [sys.executable, "-m", "lin_freq_ocp", *SWEEP]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            sweep = psutil.Process(process.pid)
            wait_until(lambda: process.poll() is not None or len(sweep.children(recursive=True)) == 4)
            workers = sweep.children(recursive=True)  # two that solve, and two that serve them
        finally:
            process.kill()
    assert len(workers) == 4
    try:
        wait_until(lambda: all(map(ended, workers)))
    finally:
        for left in workers:
            with suppress(psutil.NoSuchProcess):
                left.kill()


def ended(process):
    """Whether a process has ended, be it known to its new parent or not."""
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
