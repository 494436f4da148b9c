"""Time limits of the structured method: what cannot finish is not begun, and the best point is returned."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.linear_kinds import KINDS
from lin_freq_ocp.methods.structured import solver
from lin_freq_ocp.methods.structured.algorithm import embedding
from lin_freq_ocp.methods.structured.algorithm.embedding import End, Targets
from lin_freq_ocp.methods.structured.choice import step_seconds
from lin_freq_ocp.methods.structured.kkt.recursions import loops
from lin_freq_ocp.methods.structured.model.assembly import stages_of


class Clock:
    """A module ``time`` in which every look at the clock takes a second."""

    def __init__(self):
        self._ticks = itertools.count()

    def perf_counter(self) -> float:
        return float(next(self._ticks))


@pytest.mark.parametrize("limit", [6.0, 9.0, 12.0])
def test_no_step_is_begun_that_would_end_late(limit, monkeypatch):
    steps = []
    taken = embedding.Embedding._next
    monkeypatch.setattr(embedding, "time", Clock())
    monkeypatch.setattr(embedding.Embedding, "_next", lambda *given: steps.append(1) or taken(*given))
    problem = KINDS["mask"]()
    answer = solver._solved(stages_of(problem), loops(False), Targets(end=limit), lambda ray: False)
    assert answer.end is End.TIME
    # The first point ends at 1 s; a step takes 1 s from one look at the clock to the next, and 2 s are between two
    assert len(steps) == (limit - 1) // 2
    assert np.isfinite(answer.y).all()


def test_the_best_point_is_returned_with_what_it_reached(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(embedding, "time", clock)
    monkeypatch.setattr(solver, "time", clock)
    (candidate,) = solver.solve_structured(KINDS["mask"](), compiled=False, time_limit=12.0)
    assert candidate.status == "limit"
    assert candidate.message.startswith("time limit after 4 steps: relative residuals of ")
    assert np.isfinite(candidate.trajectory.x).all()


def test_what_needs_longer_than_the_limit_is_not_begun(monkeypatch):
    def never(*given):
        raise AssertionError("it was begun")

    monkeypatch.setattr(solver, "_solved", never)
    monkeypatch.setattr(solver, "step_seconds", lambda *given: 4.0)
    (candidate,) = solver.solve_structured(KINDS["boxes"](), time_limit=7.9)
    assert candidate.status == "limit"
    assert candidate.trajectory is None
    assert "time limit of 7.9 s; one step may need 8 s" in candidate.message


def test_estimates_grow_with_the_horizon_the_rows_and_loops_that_are_not_compiled():
    def seconds(horizon, compiled=False, **fields):
        problem = lfo.library.pendulum(horizon=horizon, **fields)
        return step_seconds(stages_of(problem).stages, loops(compiled))

    assert seconds(2000) > 1.9 * seconds(1000) > 0
    assert seconds(1000) > seconds(1000, cutoff=None)
    fine = lfo.MagnitudeBound(0.1, bins=range(100, 201), oversampling=4)
    problem = lfo.library.pendulum(horizon=400)
    masked = lfo.OptimalControlProblem(
        problem.dynamics, 400, problem.cost, initial_state=[1.0] * 4, control_spectrum=fine
    )
    assert step_seconds(stages_of(masked).stages, loops(False)) > seconds(400, cutoff=None)
