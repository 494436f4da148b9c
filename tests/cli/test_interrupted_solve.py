"""Ctrl-C during a solve: the best point is kept, and the handler is given back."""

from __future__ import annotations

import os
import signal
import subprocess
import threading

import psutil
import pytest

import lin_freq_ocp as lfo
from helpers.command_json import SOLVE, require, require_words
from helpers.command_line import COMMAND, parsed, run
from helpers.patience import PATIENCE, wait_until
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp.methods.spectral import deadline, recover
from lin_freq_ocp.program import Claim, Solution, solve

# --- interrupted ----------------------------------------------------------------------------------------------------


def test_ctrl_c_while_nothing_is_known_yet(monkeypatch):
    def interrupted(*given, **named):
        raise KeyboardInterrupt

    substitute(monkeypatch, "solve", interrupted)
    status, out, err = run("solve", "pendulum", "--json")
    assert (status, out, err.strip()) == (130, "", "")


@expensive
@pytest.mark.parametrize("passes", [0, 1])
def test_ctrl_c_keeps_the_best_point(monkeypatch, passes):
    """A program may be solved twice, in natural and then in revised units: the interrupt may come in either."""
    finished = []
    substitute(monkeypatch, "methods.ACCURATE_ANSWER", -1.0)
    substitute(monkeypatch, "program.revised_scaling", lambda linear, scaling, z: scaling)

    def impatient(program, tolerance, time_limit):
        answer = solve(program, tolerance, time_limit)
        finished.append(answer)
        return answer if len(finished) <= passes else Solution(Claim.INTERRUPTED, answer.z, answer.y, "interrupted")

    substitute(monkeypatch, "program.backend", lambda name: impatient)
    status, out, _ = run("solve", "pendulum", "--method", "convex", "--json")
    summary = parsed(out)
    require(summary, SOLVE)
    require_words(summary)
    assert len(finished) == passes + 1
    assert summary["cost"] == pytest.approx(3199.186, rel=1e-3)
    assert status == 130


@expensive
@pytest.mark.skipif(threading.current_thread() is not threading.main_thread(), reason="Ctrl-C is the main thread's")
@pytest.mark.parametrize("method", ["auto", "spectral"])
def test_ctrl_c_acts_between_the_rounds_of_the_spectral_method(monkeypatch, method):
    """Each round's point is kept, with the bound that it proves; no other method begins after it."""
    optimum, last, bounds = 3199.18631986, lfo.SpectralSolver(lfo.library.pendulum()).solve().rounds, []
    for rounds in range(1, last):
        asked = press_ctrl_c(monkeypatch, rounds)
        status, out, err = run("solve", "pendulum", "--method", method, "--json")
        summary = parsed(out)
        require(summary, SOLVE)
        require_words(summary)
        assert (status, err, len(asked)) == (130, "", rounds + 1)  # the round that stops, and who says why
        assert (summary["status"], summary["message"], summary["method"]) == ("limit", "interrupted", "spectral")
        assert summary["cost"] is not None
        if rounds == 1:  # its point is the first one, which knows of no bound yet
            assert summary["cost"] < optimum
            assert (summary["primal"], summary["certificate"]["global"]) == (False, False)
        bounds.append(summary["lower_bound"])
    assert 0 < min(bounds) <= max(bounds) < optimum


@pytest.mark.skipif(threading.current_thread() is not threading.main_thread(), reason="Ctrl-C is the main thread's")
@pytest.mark.parametrize("method", ["auto", "spectral"])
def test_ctrl_c_after_the_last_round_is_not_lost(monkeypatch, method):
    """The answer is complete, and said to be; who waits for the exit status is told of Ctrl-C all the same."""

    def pressing(*found):
        signal.raise_signal(signal.SIGINT)
        return recover(*found)

    substitute(monkeypatch, "methods.spectral.recover", pressing)
    status, out, _ = run("solve", "pendulum", "--method", method, "--json")
    assert (status, parsed(out)["status"]) == (130, "optimal")


def press_ctrl_c(monkeypatch, rounds):
    """Send SIGINT in that round of the next spectral solve; return a list that grows with the rounds."""
    asked = []

    def pressing(seconds, interrupted):
        stop = deadline(seconds, interrupted)

        def pressed():
            asked.append(stop())
            if len(asked) == rounds:
                signal.raise_signal(signal.SIGINT)
            return stop()

        return pressed

    substitute(monkeypatch, "methods.spectral.deadline", pressing)
    return asked


@pytest.mark.skipif(threading.current_thread() is not threading.main_thread(), reason="Ctrl-C is the main thread's")
def test_after_a_spectral_solve_ctrl_c_is_itself_again(monkeypatch):
    before = signal.getsignal(signal.SIGINT)
    press_ctrl_c(monkeypatch, 1)
    assert run("solve", "pendulum", "--json")[0] == 130
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.skipif(threading.current_thread() is not threading.main_thread(), reason="Ctrl-C is the main thread's")
def test_an_interrupted_point_is_saved(monkeypatch, tmp_path):
    press_ctrl_c(monkeypatch, 1)
    path = str(tmp_path / "early.npz")
    status, out, err = run("solve", "pendulum", "--save", path, "--json")
    assert (status, err) == (130, "")
    monkeypatch.undo()
    solution, summary = lfo.load(path), parsed(out)
    cost = lfo.library.pendulum().cost.value(solution.trajectory.x, solution.trajectory.u)
    assert cost == pytest.approx(summary["cost"], rel=1e-14)
    status, out, err = run("certify", "pendulum", path, "--json")
    assert (status, parsed(out)["lower_bound"]) == (3, summary["lower_bound"])


# --- as real processes ----------------------------------------------------------------------------------------------


def work_on(process, seconds):
    """Wait until a process that is running has spent so many seconds of a processor from now on."""
    worked = psutil.Process(process.pid)
    end = worked.cpu_times().user + seconds
    wait_until(lambda: process.poll() is not None or worked.cpu_times().user >= end)
    assert process.poll() is None


@expensive
@pytest.mark.skipif(os.name == "nt", reason="no SIGINT for one process")
@pytest.mark.parametrize(("backend", "horizon"), [("clarabel", 2000), ("osqp", 1000)])
def test_ctrl_c_in_the_middle_of_a_long_solve(backend, horizon, tmp_path):
    """The high pass removes nothing and so makes a warning, which tells us that the solve is about to begin."""
    slow = lfo.library.pendulum(horizon=horizon, terminal_state=(0.0, 0.0, 0.0, 0.0), cutoff=None)
    lfo.write_problem(slow, tmp_path / "slow.toml")
    with (tmp_path / "slow.toml").open("a") as file:
        for kind, cutoff in (("low_pass", 2.5), ("high_pass", 0.0)):
            file.write(f'\n[[control_spectrum]]\nkind = "{kind}"\ncutoff = {cutoff}\n')
    arguments = [COMMAND, "solve", "slow.toml", "--json", "--backend", backend]
    with subprocess.Popen(
        arguments, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert "removes no bin" in process.stderr.readline()
            work_on(process, 0.3)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert (process.returncode, err.strip()) == (130, "")
    if out:  # nothing, if the solver had not yet begun
        summary = parsed(out)
        require(summary, SOLVE)
        assert summary["status"] == "limit"
