"""Time limits of the structured method: what cannot finish is not begun, and the best point is returned."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.linear_kinds import KINDS
from helpers.replacing import substitute
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.methods import SolveOptions
from lin_freq_ocp.methods.structured import (
    Embedding,
    End,
    StepSystem,
    System,
    Targets,
    assemble_stages,
    choose_kkt_solver,
    loops,
    solve_structured,
    step_seconds,
)


@pytest.mark.parametrize("limit", [4.0, 6.0, 9.0])
def test_no_step_is_begun_that_would_end_late(limit):
    problem = assemble_stages(KINDS["mask"]()).stages
    system = System(problem, loops(False))
    with use_clock(Clock(1.0)):
        answer = Embedding(
            system, StepSystem(system, choose_kkt_solver(problem, loops(False))), Targets(end=limit)
        ).run()
    assert answer.end is End.TIME
    # The first point ends at 2 s; a step takes 1 s from one look at the clock to the next, and 2 s are between two
    assert answer.steps == (limit - 2) // 2
    assert np.isfinite(answer.y).all()


def test_the_best_point_is_returned_with_what_it_reached():
    with use_clock(Clock(1.0)):
        (candidate,) = solve_structured(KINDS["mask"](), SolveOptions(time_limit=12.0, compiled=False))
    assert candidate.status == "limit"
    assert candidate.message.startswith("time limit after 4 steps: relative residuals of ")
    assert np.isfinite(candidate.trajectory.x).all()


def test_what_needs_longer_than_the_limit_is_not_begun(monkeypatch):
    def never(*given):
        raise AssertionError("it was begun")

    substitute(monkeypatch, "methods.structured.Embedding", never)
    substitute(monkeypatch, "methods.structured.step_seconds", lambda *given: 4.0)
    (candidate,) = solve_structured(KINDS["boxes"](), SolveOptions(time_limit=7.9))
    assert candidate.status == "limit"
    assert candidate.trajectory is None
    assert "time limit of 7.9 s; one step may need 8 s" in candidate.message


def test_estimates_grow_with_the_horizon_the_rows_and_loops_that_are_not_compiled():
    def seconds(horizon, compiled=False, **fields):
        problem = lfo.library.pendulum(horizon=horizon, **fields)
        return step_seconds(assemble_stages(problem).stages, loops(compiled))

    assert seconds(2000) > 1.9 * seconds(1000) > 0
    assert seconds(1000) > seconds(1000, cutoff=None)
    fine = lfo.MagnitudeBound(0.1, bins=range(100, 201), oversampling=4)
    problem = lfo.library.pendulum(horizon=400)
    masked = lfo.OptimalControlProblem(
        problem.dynamics, 400, problem.cost, initial_state=[1.0] * 4, control_spectrum=fine
    )
    assert step_seconds(assemble_stages(masked).stages, loops(False)) > seconds(400, cutoff=None)
