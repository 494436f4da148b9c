"""States that follow from the controls alone, such as the last control: a loop completes the measured state by them."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.loops import pendulum
from helpers.seeds import expensive, seeds
from lin_freq_ocp.loop import known_states

X_0 = np.array([0.05, 0.03, 0.1, 0.1])
LIMITED = {
    "limit": lambda: lfo.rate_limited(pendulum(20, None), 1.0, previous=0.5),
    "price": lambda: lfo.rate_limited(pendulum(20, None), price=2.0),
}


def test_the_last_controls_and_those_before_are_known():
    """Two steps of dead time: w_{t+1} = u_t, v_{t+1} = w_t. A state of its own, and one that sees it, are not known."""
    A = [[0.9, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 1.0, 0.0]]
    dynamics = lfo.LinearDynamics(A, [[0.0], [1.0], [0.0], [0.0]])
    assert known_states(dynamics).tolist() == [False, True, True, False]
    assert known_states(lfo.rate_limited(pendulum(20), 1.0).linear).tolist() == [False] * 4 + [True]
    assert not known_states(pendulum(20).linear).any()


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("certify", ["each", "later"])
@pytest.mark.parametrize("name", seeds(LIMITED))
def test_a_step_without_the_last_control_is_that_with_it(name, certify, delay):
    problem, rng = LIMITED[name](), np.random.default_rng(0)
    whole, short = (lfo.RecedingHorizon(problem, certify=certify, delay=delay) for _ in range(2))
    x, step = np.append(X_0, 0.5 if name == "limit" else 0.0), problem.dynamics.stepper(1)
    acting = np.zeros(1)
    for k in range(6):
        u = whole.step(x)
        np.testing.assert_array_equal(short.step(x[:4]), u)
        acted = acting if delay else u
        x, acting = step(0, x, acted) + np.append(1e-3 * rng.standard_normal(4), 0.0), u
        assert short.log.steps[k].state.tolist() == whole.log.steps[k].state.tolist()
    assert short.certify().satisfied.all()


@pytest.mark.parametrize("rows", [(), (21,)], ids=["constant", "per time"])
@pytest.mark.parametrize("name", LIMITED)
def test_a_reference_may_leave_out_the_same_states(name, rows):
    reference = np.broadcast_to([0.1, 0.0, 0.0, 0.0], (*rows, 4))
    own = np.broadcast_to([0.1, 0.0, 0.0, 0.0, 0.0], (*rows, 5))
    short, whole = (
        lfo.RecedingHorizon(LIMITED[name]()).step(X_0, references={"x_ref": x_ref}) for x_ref in (reference, own)
    )
    np.testing.assert_array_equal(short, whole)


def test_a_control_that_acted_in_its_place_is_the_last_one():
    problem = LIMITED["limit"]()
    loop = lfo.RecedingHorizon(problem)
    loop.step(X_0)
    loop.step(X_0, applied=[-0.25])
    assert loop.log.steps[1].state.tolist() == [*X_0, -0.25]
    with pytest.raises(lfo.errors.ProblemError):
        loop.step([np.nan] * 4, applied=[0.125])
    assert loop.log.controls[1] != 0.125
    loop.step(X_0)
    assert loop.log.steps[2].state[4] == loop.log.controls[1, 0]


@expensive
@pytest.mark.parametrize("delay", [0, 1])
def test_a_run_with_the_plant_of_the_user(delay):
    """The plant knows nothing of the last control; its disturbance has its own components."""
    problem, plain = LIMITED["price"](), pendulum(20, None)
    noise = 1e-3 * np.random.default_rng(1).standard_normal((8, 4))
    whole = np.hstack([noise, np.zeros((8, 1))])
    plants = ((plain.dynamics, noise), (lambda x, u: plain.linear.A @ x + plain.linear.B @ u, noise), (None, whole))
    loops = [
        lfo.RecedingHorizon(problem, delay=delay).run(X_0, 8, plant=plant, disturbance=disturbance)
        for plant, disturbance in plants
    ]
    for loop in loops:
        assert not loop.stopped
        assert loop.states.shape == (9, 5)
        np.testing.assert_allclose(loop.states, loops[0].states, atol=1e-12)
        acted = np.append(np.zeros(delay), loop.controls[:, 0])[:8]
        np.testing.assert_array_equal(loop.states[1:, 4], acted)


def test_wrong_sizes_say_both_that_fit():
    loop = lfo.RecedingHorizon(LIMITED["limit"]())
    for state in (np.zeros(3), np.zeros((4, 1)), 0.0):
        with pytest.raises(lfo.errors.ProblemError, match=r"expected shape \(5,\)\. Or \(4,\), without"):
            loop.step(state)
    with pytest.raises(lfo.errors.ProblemError, match=r"^state"):
        loop.step([[1.0], [1.0, 2.0]])
    with pytest.raises(lfo.errors.ProblemError, match=r"plant: got \(5, 1\) states and controls; expected \(4, 1\)"):
        loop.run(X_0, 2, plant=LIMITED["limit"]().dynamics)
    assert not len(loop.log.steps)
