"""Ctrl-C during a solve: the solver stops at a point, and the handler is given back."""

from __future__ import annotations

import os
import signal
import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from helpers.patience import PATIENCE
from helpers.programs import SOLVABLE, ask, is_accepted, long_program
from helpers.replacing import substitute
from helpers.seeds import expensive
from lin_freq_ocp import LinearDynamics, OptimalControlProblem, QuadraticCost
from lin_freq_ocp.base import interrupts_noted, use_clock
from lin_freq_ocp.methods import solve_convex
from lin_freq_ocp.program import Claim, Program, Solution

posix = pytest.mark.skipif(os.name != "posix", reason="a process cannot send itself Ctrl-C there")


def interrupt_when_listening(before: Any, stop: threading.Event, sent: threading.Event) -> None:
    """Send this process a Ctrl-C as soon as somebody else than ``before`` would receive it."""
    while not stop.is_set():
        if signal.getsignal(signal.SIGINT) is not before:
            os.kill(os.getpid(), signal.SIGINT)
            sent.set()
            return
        time.sleep(1e-4)


@expensive
@posix
def test_ctrl_c_stops_the_solver_at_a_point_and_gives_the_handler_back():
    """The solver looks at the clock after each iteration, and there waits until Ctrl-C was sent."""
    asked = long_program(300)
    before = signal.getsignal(signal.SIGINT)
    stop, sent = threading.Event(), threading.Event()
    sender = threading.Thread(target=interrupt_when_listening, args=(before, stop, sent))
    sender.start()
    try:
        with use_clock(lambda: float(not sent.wait(PATIENCE))):
            solution = ask("clarabel", asked)
    finally:
        stop.set()
        sender.join()
    assert signal.getsignal(signal.SIGINT) is before
    assert solution.claim is Claim.INTERRUPTED
    assert solution.z.shape == asked.q.shape
    assert np.isfinite(solution.z).all()
    assert not is_accepted(asked, solution)
    assert is_accepted(SOLVABLE["upper"].program, ask("clarabel", SOLVABLE["upper"].program))  # and the next one runs


@expensive
@pytest.mark.parametrize("solve", [1, 2])
def test_ctrl_c_is_remembered_in_whichever_solve_it_came(solve, monkeypatch):
    """A solve in revised units is a second one: stopping that one is stopping, too."""
    problem = OptimalControlProblem(
        LinearDynamics([[1.0]], [[1.0]]), 4, QuadraticCost(R=1.0), initial_state=[1.0], terminal_state=[0.0]
    )
    calls: list[Claim] = []

    def interrupted_later(asked: Program, tolerance: float, time_limit: float | None) -> Solution:
        answer = ask("clarabel", asked)
        claim = Claim.INTERRUPTED if len(calls) + 1 == solve else answer.claim
        calls.append(claim)
        return replace(answer, claim=claim)

    substitute(monkeypatch, "program.backend", lambda name: interrupted_later)
    substitute(monkeypatch, "methods.ACCURATE_ANSWER", -1.0)
    substitute(monkeypatch, "program.revised_scaling", lambda linear, scaling, z: scaling)
    candidate = solve_convex(problem, "clarabel")
    assert calls[-1] is Claim.INTERRUPTED
    assert candidate.interrupted
    assert candidate.trajectory is not None


@posix
def test_interrupts_are_noted_and_not_raised():
    before = signal.getsignal(signal.SIGINT)
    with interrupts_noted() as noted:
        assert not noted.is_set()
        os.kill(os.getpid(), signal.SIGINT)
        assert noted.wait(PATIENCE)
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_the_handler_is_given_back_after_an_error_too():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ZeroDivisionError), interrupts_noted():
        _ = 1 / 0
    assert signal.getsignal(signal.SIGINT) is before


def test_outside_the_main_thread_nothing_is_installed():
    before = signal.getsignal(signal.SIGINT)
    seen: list[Any] = []

    def work() -> None:
        with interrupts_noted() as noted:
            seen.append((signal.getsignal(signal.SIGINT), noted.is_set()))
        seen.append(ask("clarabel", SOLVABLE["upper"].program).claim)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [(before, False), Claim.SOLVED]
