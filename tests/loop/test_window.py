"""What the problem of a step knows: the past of its frequency constraints, and previews; its first state is free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.loop import depends_on_past, free_first_state, with_past
from lin_freq_ocp.transform import Change

DYNAMICS = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], sampling_time=0.1)
COST = lfo.QuadraticCost(Q=1.0, R=0.1)
MASK = lfo.MagnitudeBound(0.5, band=lfo.low_pass(1.0))


def problem(**fields) -> lfo.OptimalControlProblem:
    given = {"dynamics": DYNAMICS, "horizon": 12, "cost": COST, "initial_state": [0.5, 0.0]}
    return lfo.OptimalControlProblem(**(given | fields))


def windows_of(one: lfo.OptimalControlProblem, now: int) -> list[int]:
    """Return the first samples of the windows of a problem, counted from the start of the loop."""
    (term,) = (term for term in one.terms if term.kind == "control spectrum")
    return [now + int(start) for start in term.map.starts]


@expensive
@pytest.mark.parametrize("hop", [1, 3, 4, 5])
def test_windows_stand_still_in_time(hop):
    base = problem(control_spectrum=lfo.spectrum.Spectrogram(MASK, length=5, hop=hop))
    controls = np.arange(40.0)[:, None]
    for k in range(40):
        now = with_past(base, np.zeros((k, 2)), controls[:k])
        starts = windows_of(now, k)
        assert starts == sorted({s for s in range(0, 60, hop) if k - 5 < s < k + 12} | {k + 11})
        past = now.control_spectrum[0].past
        known = 0 if past is None else len(past)
        assert past is None or past[:, 0].tolist() == list(range(k - known, k))


def test_windows_of_the_past_alone_are_left_out():
    """No control changes them: if one was above the limit, no problem of a later step would be feasible."""
    past = np.ones((5, 1))
    assert windows_of(problem(control_spectrum=lfo.spectrum.Spectrogram(MASK, 3, 1, past=past)), 0) == [*range(-2, 10)]


@pytest.mark.parametrize(("length", "hop"), [(5, 2), (4, 4), (2, 2)])
def test_windows_of_states_that_end_where_is_measured_are_left_out(length, hop):
    base = problem(state_spectrum=lfo.spectrum.Spectrogram(MASK, length, hop), state_set=None)
    for k in range(12):
        (term, _) = with_past(base, np.arange(2.0 * k).reshape(k, 2), np.zeros((k, 1))).terms
        starts = [k + int(start) for start in term.map.starts]
        assert starts == [s for s in range(0, 40, hop) if s + length > k + 1 and s + length <= k + 13]


def test_without_a_length_the_past_keeps_its_length():
    base = problem(control_spectrum=lfo.spectrum.Spectrogram(MASK, past=[[7.0], [8.0], [9.0]]))
    now = with_past(base, np.zeros((2, 2)), np.array([[1.0], [2.0]]))
    assert now.control_spectrum[0].past.tolist() == [[9.0], [1.0], [2.0]]
    assert with_past(base, np.zeros((0, 2)), np.zeros((0, 1))).control_spectrum[0].past.tolist() == [[7], [8], [9]]


def test_the_past_of_states_and_outputs_is_theirs():
    outputs = lfo.spectrum.OutputSpectrum([[1.0, 2.0]], [[3.0]], lfo.spectrum.Spectrogram(MASK, 4))
    base = problem(state_spectrum=lfo.spectrum.Spectrogram(MASK, 4, 2), output_spectrum=outputs)
    x, u = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[5.0], [6.0]])  # windows from 0 end at 3, after time 2
    now = with_past(base, x, u)
    assert now.state_spectrum[0].past.tolist() == x.tolist()
    assert now.output_spectrum[0].constraints[0].past.tolist() == [[1 + 4 + 15], [3 + 8 + 18]]


def test_what_remembers():
    assert not depends_on_past(problem(control_spectrum=MASK))
    assert depends_on_past(problem(control_spectrum=[MASK, lfo.spectrum.Spectrogram(MASK, 4)]))
    outputs = lfo.spectrum.OutputSpectrum([[1.0, 2.0]], None, lfo.spectrum.Spectrogram(MASK, 4))
    assert depends_on_past(problem(output_spectrum=outputs))


def sets():
    ball = lfo.sets.Ball(0.4)
    yield "box", lfo.Box(-0.4, 0.4)
    yield "ball", ball
    yield "both", lfo.Box(-0.4, 0.4) & ball
    yield "per time", [lfo.Box(-0.4, 0.4)] * 13


@pytest.mark.parametrize("given", [pytest.param(one, id=name) for name, one in sets()])
def test_the_first_state_may_lie_anywhere(given):
    base = problem(state_set=given, initial_state=[0.6, 0.0])
    assert lfo.solve(base, throw=False).status == "infeasible"
    free = free_first_state(base)
    plan = lfo.solve(replace(free, dynamics=replace(DYNAMICS, A=0.6 * DYNAMICS.A))).trajectory
    assert np.abs(plan.x[1:]).max() <= 0.4 + 1e-7


def test_rows_of_the_state_alone_are_left_out_at_the_first_time():
    rows = lfo.StageRows([[1.0, 0.0], [1.0, 0.0]], [[0.0], [1.0]], [0.1, 0.2])
    free = free_first_state(problem(stage_rows=rows))
    assert free.stage_rows[0].e[0].tolist() == [np.inf, 0.2]
    assert free.stage_rows[0].e[1].tolist() == [0.1, 0.2]


def test_a_disturbance_is_added_to_the_offset():
    now = Change(disturbance=[0.1, 0.2]).apply(problem())
    assert now.linear.offset.tolist() == [0.1, 0.2]
    with pytest.raises(lfo.errors.ProblemError) as caught:
        Change(disturbance=[1.0]).apply(problem())
    assert caught.value.field == "disturbance"
    with pytest.raises(lfo.errors.UnsupportedError, match="a preview needs linear dynamics; these are Piecewise"):
        lfo.RecedingHorizon(lfo.library.pendulum_with_wall(horizon=5)).step(np.zeros(2), disturbance=[0.0, 0.1])
