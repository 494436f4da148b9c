"""The command explore: the address it prints, the file it writes, and what it refuses."""

import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request

import pytest

from helpers.command_line import run
from helpers.patience import PATIENCE
from helpers.seeds import expensive


@expensive
def test_ctrl_c_ends_the_server_with_its_status():
    command = [sys.executable, "-m", "lin_freq_ocp", "explore", "double_integrator", "--no-browser"]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, **streams, text=True, start_new_session=True) as process:
        try:
            url = process.stdout.readline().strip()
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{20,}/", url)
            with urllib.request.urlopen(url, timeout=PATIENCE) as page:
                assert b"double_integrator" in page.read()
            os.kill(process.pid, signal.SIGINT)
            _, err = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert (process.returncode, err) == (130, "")


@expensive
def test_a_page_with_a_sweep_inside_is_written(tmp_path):
    path = tmp_path / "page.html"
    status, out, _ = run(
        "explore", "double_integrator", "--set", "horizon=20", "--set", "sampling_time=0.1", "--static", str(path)
    )
    assert status == 0
    assert re.fullmatch(rf"wrote {re.escape(str(path))} with [1-9][0-9]* solved points\n", out)
    page = path.read_text(encoding="utf-8")
    assert page.startswith("<!DOCTYPE html>")
    assert "connect-src 'none'" in page
    assert not re.search(r'(src|href)="(?!data:)', page)


@expensive
def test_a_problem_file_can_be_explored(tmp_path):
    path, page = tmp_path / "problem.toml", tmp_path / "page.html"
    assert run("init", str(path))[0] == 0
    settings = ("--set", "horizon=100", "--set", "dynamics.sampling_time=0.02")
    assert run("explore", str(path), *settings, "--static", str(page))[0] == 0
    assert '"key": "cutoff"' in page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("pendulums",), "pendulum"),
        (("missing.toml",), "missing.toml"),
        (("cart_between_walls",), "sweep --grid"),
        (("pendulum", "--port", "0"), "--port"),
        (("pendulum", "--port", "70000"), "--port"),
        (("pendulum", "--set", "horizons=3"), "horizons"),
        (("pendulum", "--static", "missing/page.html"), "--static"),
    ],
)
def test_bad_input_is_named(words, complaint):
    status, out, err = run("explore", *words)
    assert (status, out) == (2, "")
    assert complaint in err


def test_a_port_in_use_is_named():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        status, _, err = run("explore", "double_integrator", "--no-browser", "--port", port)
    assert status == 2
    assert port in err
