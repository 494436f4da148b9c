"""The description of a problem: validation, tubes, ends, and that nothing changes after construction."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.linear_problems import problem
from lin_freq_ocp import Box, LinearDynamics, QuadraticCost, Trajectory, simulate
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.results import Multipliers
from lin_freq_ocp.sets import Point


@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        ({"dynamics": np.eye(2)}, "dynamics", "LinearDynamics"),
        ({"horizon": 0}, "horizon", "whole number"),
        ({"horizon": 4.0}, "horizon", "whole number"),
        ({"horizon": True}, "horizon", "whole number"),
        ({"horizon": "4"}, "horizon", "whole number"),
        ({"cost": 1.0}, "cost", "QuadraticCost"),
        ({"cost": QuadraticCost(R=np.eye(2))}, "cost.R", "(1, 1)"),
        ({"cost": QuadraticCost(q=np.ones((5, 2)))}, "cost.q", "(4, 2)"),
        ({"cost": QuadraticCost(x_ref=np.ones((4, 2)))}, "cost.x_ref", "(5, 2)"),
        ({"dynamics": LinearDynamics(np.ones((5, 2, 2)), np.ones((2, 1)))}, "dynamics.A", "4 steps"),
        ({"dynamics": LinearDynamics(np.eye(2), np.ones((3, 2, 1)))}, "dynamics.B", "4 steps"),
        ({"dynamics": LinearDynamics(np.eye(2), np.ones((2, 1)), np.ones((5, 2)))}, "dynamics.offset", "4 steps"),
        ({"control_set": Box([-1, -1], [1, 1])}, "control_set", "bounds for 1"),
        ({"control_set": 5.0}, "control_set", "Box"),
        ({"control_set": "box"}, "control_set", "Box"),
        ({"control_set": [Box(-1, 1)] * 5}, "control_set", "4 sets"),
        ({"control_set": [Box(-1, 1), 0, 0, 0]}, "control_set", "4 sets"),
        ({"control_set": Box(np.zeros((5, 1)), None)}, "control_set", "4 times"),
        ({"state_set": [Box(-1, 1)] * 4}, "state_set", "5 sets"),
        ({"state_set": Box(np.zeros((4, 2)), None)}, "state_set", "5 times"),
        ({"state_set": [Box(-1, 1)] * 4 + [Box([0] * 3, 1)]}, "state_set[4]", "bounds for 2"),
        ({"initial_state": [0.0, 0.0, 0.0]}, "initial_state", "2"),
        ({"initial_state": [0.0, np.nan]}, "initial_state[1]", "finite"),
        ({"initial_state": "origin"}, "initial_state", "numbers"),
        ({"terminal_state": Box(np.zeros((5, 2)), 1)}, "terminal_state", "single set"),
        ({"terminal_state": [1.0]}, "terminal_state", "2"),
        ({"control_spectrum": "low"}, "control_spectrum", "a band"),
        ({"control_spectrum": 20}, "control_spectrum", "a band"),
        ({"state_spectrum": [lfo.low_pass(2.0), None]}, "state_spectrum[1]", "a band"),
        ({"state_spectrum": lfo.low_pass(1.0, component="angle")}, "state_spectrum.component", "'position [m]'"),
        ({"control_spectrum": lfo.low_pass(1.0, component=1)}, "control_spectrum.component", "an index 0 or"),
        ({"control_spectrum": lfo.low_pass(cutoff_hz=6)}, "control_spectrum.low_pass", "Nyquist frequency 5 Hz"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_a_description_that_is_no_problem_names_field_got_and_expected(changes, field, words):
    with pytest.raises(ProblemError) as caught:
        problem(**changes)
    error = caught.value
    assert error.field == field
    assert error.got
    assert words in str(error)
    assert re.match(rf"{re.escape(field)}: got .+; expected .+\.", str(error))
    assert isinstance(error, ValueError)  # so that plain "except ValueError" works


@pytest.mark.parametrize(("end", "value"), [("initial_state", 0.0), ("terminal_state", [[0.0, 0.0]])])
def test_an_end_of_the_wrong_kind_is_named_after_the_end(end, value):
    with pytest.raises(ProblemError) as caught:
        problem(**{end: value})
    assert caught.value.field == end


def test_tubes_take_the_ends_into_the_sets_of_their_times():
    states = [Box([-1.0, -2.0], [1.0 + t, None]) for t in range(5)]
    made = problem(
        state_set=states, initial_state=[0.5, 7.0], terminal_state=Box([0.0, None], [None, 3.0]), control_set=Box(-2, 3)
    )
    tube = made.state_tube
    np.testing.assert_array_equal(tube.lower[0], [0.5, 7.0])
    np.testing.assert_array_equal(tube.upper[0], [0.5, 7.0])
    for t in (1, 2, 3):
        np.testing.assert_array_equal(tube.lower[t], [-1.0, -2.0])
        np.testing.assert_array_equal(tube.upper[t], [1.0 + t, np.inf])
    np.testing.assert_array_equal(tube.lower[4], [0.0, -2.0])
    np.testing.assert_array_equal(tube.upper[4], [5.0, 3.0])
    np.testing.assert_array_equal(made.control_tube.lower, np.full((4, 1), -2.0))
    np.testing.assert_array_equal(made.control_tube.upper, np.full((4, 1), 3.0))


def test_without_sets_and_ends_nothing_is_bounded():
    made = problem()
    for tube, shape in ((made.state_tube, (5, 2)), (made.control_tube, (4, 1))):
        np.testing.assert_array_equal(tube.lower, np.full(shape, -np.inf))
        np.testing.assert_array_equal(tube.upper, np.full(shape, np.inf))
    assert made.control_stop.shape == (3, 1)
    assert made.state_stop.shape == (3, 2)
    assert not made.control_stop.any()
    assert not made.state_stop.any()


def all_arrays(*owners: Any) -> dict[str, np.ndarray]:
    return {
        f"{type(owner).__name__}.{name}": value
        for owner in owners
        for name, value in [(field.name, getattr(owner, field.name)) for field in dataclasses.fields(owner)]
        if isinstance(value, np.ndarray)
    }


def test_nothing_can_be_changed_after_construction():
    A, lower, u = np.eye(2), np.array([-1.0]), np.zeros((4, 1))
    made = problem(dynamics=LinearDynamics(A, np.ones((2, 1))), control_set=Box(lower, [1.0]), initial_state=[0, 0])
    trajectory = simulate(made, u)
    multipliers = Multipliers(1, np.zeros((4, 2)), np.zeros((5, 2)), u, np.zeros((3, 1)), np.zeros((3, 2)))
    arrays = all_arrays(
        made.dynamics, made.cost, made.initial_state, made.state_tube, made.control_tube, trajectory, multipliers
    ) | {"control_stop": made.control_stop, "state_stop": made.state_stop, "Point.value": Point([1.0]).value}
    assert len(arrays) > 20
    for name, array in arrays.items():
        assert not array.flags.writeable, name
    A[0, 0], lower[0], u[0, 0] = 9.0, 9.0, 9.0  # the user's own arrays stay the user's
    assert made.dynamics.A[0, 0] == 1.0
    assert made.control_tube.lower[0, 0] == -1.0
    assert trajectory.u[0, 0] == 0.0
    for owner, field in ((made, "horizon"), (made.dynamics, "A"), (made.cost, "R"), (trajectory, "x")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(owner, field, None)


def test_a_read_only_view_of_writable_numbers_is_copied():
    base = {name: np.zeros(shape) for name, shape in (("A", (2, 2)), ("rho", (3, 1)), ("lower", (2,)))}
    views = {name: array.view() for name, array in base.items()}
    for view in views.values():
        view.flags.writeable = False
    dynamics, box = LinearDynamics(views["A"], np.ones((2, 1))), Box(views["lower"], None)
    complex_base = np.zeros((3, 1), dtype=complex)
    complex_view = complex_base.view()
    complex_view.flags.writeable = False
    zero = np.zeros((4, 2)), np.zeros((5, 2)), np.zeros((4, 1))
    multipliers = Multipliers(1, *zero, complex_view, np.zeros((3, 2)))
    for array in (*base.values(), complex_base):
        array[...] = 5.0
    assert not dynamics.A.any()
    assert not box.lower.any()
    assert not multipliers.rho_u.any()


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Trajectory(np.zeros((4, 2)), np.zeros((4, 1))), "trajectory"),
        (lambda: Trajectory(np.zeros(5), np.zeros((4, 1))), "trajectory"),
        (lambda: Trajectory(np.full((5, 2), np.nan), np.zeros((4, 1))), "trajectory.x[0][0]"),
        (lambda: problem().require(Trajectory(np.zeros((6, 2)), np.zeros((5, 1)))), "trajectory"),
        (lambda: problem().require(Trajectory(np.zeros((5, 1)), np.zeros((4, 1)))), "trajectory"),
    ],
)
def test_trajectories_of_another_shape_are_refused(make, field):
    with pytest.raises(ProblemError) as caught:
        make()
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("eta_C", [1.0, 2.0]),
        ("eta_C", np.nan),
        ("eta", np.zeros(4)),
        ("mu", np.zeros((4, 2))),
        ("nu", np.zeros((5, 1))),
        ("rho_u", np.zeros((4, 1))),
        ("rho_u", np.full((3, 1), np.nan * 1j)),
        ("rho_x", np.zeros((3, 1))),
    ],
)
def test_multipliers_of_another_shape_are_refused(field, value):
    right = {
        "eta_C": 1.0,
        "eta": np.zeros((4, 2)),
        "mu": np.zeros((5, 2)),
        "nu": np.zeros((4, 1)),
        "rho_u": np.zeros((3, 1)),
        "rho_x": np.zeros((3, 2)),
    }
    Multipliers(**right)  # or the test would say nothing
    with pytest.raises(ProblemError) as caught:
        Multipliers(**(right | {field: value}))
    assert caught.value.field.startswith(f"multipliers.{field}")


def test_other_ends_make_the_problem_that_a_new_one_would_be():
    made = problem(state_set=Box([-2, -3], [2, 3]), initial_state=[1.0, 0.0], terminal_state=Box([0, -1], [1, 5]))
    _ = made.state_tube, made.ends  # known by now: the other problem must not take them over
    moved = made.with_ends(initial_state=[-1.0, 2.0], terminal_state=Box([-9, 0], [9, 1]))
    anew = problem(state_set=Box([-2, -3], [2, 3]), initial_state=[-1.0, 2.0], terminal_state=Box([-9, 0], [9, 1]))
    for one, other in zip((moved.state_tube, *moved.ends), (anew.state_tube, *anew.ends), strict=True):
        np.testing.assert_array_equal(one.lower, other.lower)
        np.testing.assert_array_equal(one.upper, other.upper)
    np.testing.assert_array_equal(made.state_tube.lower[0], [1.0, 0.0])
    np.testing.assert_array_equal(made.with_ends(initial_state=[0, 0]).ends[1].upper, [1, 3])
