"""A command that is killed without a word leaves no processes behind."""

import subprocess
import sys
import time

import psutil
import pytest

PATIENCE = 120  # seconds, after which something hangs
SWEEP = ("sweep", "double_integrator", "--grid", "horizon=60:400:300", "--workers", "2")


@pytest.mark.skipif(sys.platform == "win32", reason="children are counted as forkserver starts them")
def test_workers_of_a_killed_sweep_end():
    command = [sys.executable, "-m", "lin_freq_ocp", *SWEEP]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            sweep, workers, end = psutil.Process(process.pid), [], time.monotonic() + PATIENCE
            while len(workers) < 4 and process.poll() is None and time.monotonic() < end:  # with two that serve them
                time.sleep(0.01)
                workers = sweep.children(recursive=True)
        finally:
            process.kill()
    assert len(workers) == 4
    while (alive := [worker for worker in workers if not ended(worker)]) and time.monotonic() < end:
        time.sleep(0.01)
    for left in alive:
        left.kill()
    assert not alive


def ended(process):
    """Whether a process has ended, be it known to its new parent or not."""
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
