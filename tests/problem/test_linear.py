"""Linear dynamics against the sums of their definition, their adjoint and other samplers."""

from __future__ import annotations

import re

import control
import numpy as np
import pytest
from scipy import signal
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from helpers.linear_problems import VARYING, M, N, T, at_time, dynamics_data, generator
from lin_freq_ocp import LinearDynamics
from lin_freq_ocp.errors import ProblemError


@pytest.mark.parametrize("varying", VARYING)
def test_successors_are_the_sums_of_the_definition(varying):
    data = dynamics_data(1, varying)
    dynamics = LinearDynamics(**data)
    rng = generator(2)
    x, u = rng.normal(size=(T + 1, N)), rng.normal(size=(T, M))
    found = dynamics.successors(x, u)
    assert found.shape == (T, N)
    assert dynamics.time_varying == ("A" in varying or "B" in varying)
    for t in range(T):
        A, B, d = at_time(data["A"], t, 2), at_time(data["B"], t, 2), at_time(data["offset"], t, 1)
        for i in range(N):
            by_hand = sum(A[i, j] * x[t, j] for j in range(N)) + sum(B[i, j] * u[t, j] for j in range(M)) + d[i]
            assert found[t, i] == pytest.approx(by_hand, rel=1e-13)
        for expected, given_back in zip((A, B, d), dynamics.at(t), strict=True):
            np.testing.assert_array_equal(given_back, expected)
    np.testing.assert_array_equal(found, dynamics.successors(x[:-1], u))  # x_T is not used


def test_magnitudes_bound_every_term():
    data = dynamics_data(5, "A B offset")
    x, u = generator(6).normal(size=(T, N)), generator(7).normal(size=(T, M))
    sums = LinearDynamics(**data).magnitudes.successors(np.abs(x), np.abs(u))
    by_hand = np.array(
        [
            np.abs(data["A"][t] * x[t]).sum(1) + np.abs(data["B"][t] * u[t]).sum(1) + np.abs(data["offset"][t])
            for t in range(T)
        ]
    )
    np.testing.assert_allclose(sums, by_hand, rtol=1e-13)


def test_zero_order_hold_is_the_flow_of_the_differential_equation():
    rng = generator(8)
    A, B, d, h = rng.normal(size=(N, N)), rng.normal(size=(N, M)), rng.normal(size=N), 0.7
    dynamics = LinearDynamics.from_continuous(A, B, h, offset=d)
    assert dynamics.sampling_time == h
    for _ in range(3):
        x, u = rng.normal(size=N), rng.normal(size=M)
        flow = solve_ivp(lambda t, state, u=u: A @ state + B @ u + d, (0, h), x, rtol=1e-11, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(dynamics.successors(x[None], u[None])[0], flow, rtol=1e-8)


def test_zero_order_hold_agrees_with_scipy_and_with_the_double_integrator():
    rng = generator(9)
    A, B = rng.normal(size=(4, 4)), rng.normal(size=(4, 2))
    sampled = cont2discrete((A, B, np.eye(4), np.zeros((4, 2))), 0.3)
    dynamics = LinearDynamics.from_continuous(A, B, 0.3)
    np.testing.assert_allclose(dynamics.A, sampled[0], rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(dynamics.B, sampled[1], rtol=1e-12, atol=1e-13)
    assert not dynamics.offset.any()
    h = 0.25  # A is singular here: no formula with its inverse would do
    fall = LinearDynamics.from_continuous([[0, 1], [0, 0]], [[0], [2]], h, offset=[0, -9.81])
    np.testing.assert_allclose(fall.A, [[1, h], [0, 1]], atol=1e-15)
    np.testing.assert_allclose(fall.B, [[h**2], [2 * h]], rtol=1e-14)
    np.testing.assert_allclose(fall.offset, [-9.81 * h**2 / 2, -9.81 * h], rtol=1e-14)


def test_two_half_steps_are_one_step():
    rng = generator(10)
    A, B, d = rng.normal(size=(N, N)), rng.normal(size=(N, M)), rng.normal(size=N)
    half, whole = (LinearDynamics.from_continuous(A, B, h, offset=d) for h in (0.1, 0.2))
    x, u = rng.normal(size=(1, N)), rng.normal(size=(1, M))
    np.testing.assert_allclose(half.successors(half.successors(x, u), u), whole.successors(x, u), rtol=1e-12)


PLANT = ([[0.0, 1.0], [-2.0, -0.3]], [[0.0], [1.5]], [[1.0, 0.0]], [[0.0]])


def test_continuous_plant_is_sampled_as_python_control_does():
    plant = control.ss(*PLANT)
    expected = control.c2d(plant, 0.05)
    dynamics = LinearDynamics.from_statespace(plant, sampling_time=0.05)
    np.testing.assert_allclose(dynamics.A, expected.A, rtol=1e-12)
    np.testing.assert_allclose(dynamics.B, expected.B, rtol=1e-12)
    assert dynamics.sampling_time == 0.05
    assert dynamics.state_names == tuple(plant.state_labels)
    assert dynamics.control_names == tuple(plant.input_labels)


def test_a_transfer_function_is_its_realisation():
    plant = control.tf([2.0], [1.0, 0.3, 2.0])
    realised = control.ss(plant)
    dynamics = LinearDynamics.from_statespace(plant, 0.05)
    np.testing.assert_allclose(dynamics.A, control.c2d(realised, 0.05).A, rtol=1e-12)
    discrete = LinearDynamics.from_statespace(control.tf([1.0], [1.0, -0.5], 0.1))
    assert (discrete.A.item(), discrete.sampling_time) == (0.5, 0.1)


@pytest.mark.parametrize(
    "plant", [signal.StateSpace(*PLANT), signal.lti(*PLANT), signal.TransferFunction([1.5], [1.0, 0.3, 2.0])]
)
def test_continuous_plants_of_scipy_are_those_of_python_control(plant):
    dynamics, expected = (LinearDynamics.from_statespace(one, 0.05) for one in (plant, control.ss(*PLANT)))
    np.testing.assert_allclose(np.linalg.eigvals(dynamics.A), np.linalg.eigvals(expected.A), rtol=1e-12)
    assert dynamics.state_names == ("x_0", "x_1")


def test_discrete_plants_of_scipy_keep_their_sampling_time():
    dynamics = LinearDynamics.from_statespace(signal.dlti([1.0], [1.0, -0.5], dt=0.1))
    assert (dynamics.A.item(), dynamics.sampling_time) == (0.5, 0.1)
    assert LinearDynamics.from_statespace(signal.dlti([1.0], [1.0, -0.5])).sampling_time is None  # dt is not stated


def test_discrete_plant_is_taken_as_it_is():
    for own, asked, result in ((0.1, None, 0.1), (0.1, 0.1, 0.1), (True, None, None), (True, 0.2, 0.2)):
        dynamics = LinearDynamics.from_statespace(control.ss(*PLANT, own), sampling_time=asked, state_names=["a", "b"])
        np.testing.assert_array_equal(dynamics.A, PLANT[0])
        np.testing.assert_array_equal(dynamics.B, PLANT[1])
        assert dynamics.sampling_time == result
        assert dynamics.state_names == ("a", "b")


@pytest.mark.parametrize(
    ("plant", "sampling_time", "field"),
    [
        (control.ss(*PLANT, None), 0.1, "plant.dt"),  # unspecified, which is neither continuous nor discrete
        (control.ss(*PLANT), None, "sampling_time"),
        (control.ss(*PLANT, 0.1), 0.2, "sampling_time"),
        (control.ss(*PLANT, 1e-5), 1.0005e-5, "sampling_time"),  # small, but a disagreement of 0.05 %
        (control.ss(*PLANT, 1e-9), 5e-9, "sampling_time"),
        (control.ss(*PLANT), -0.1, "dynamics.sampling_time"),
        (control.tf([1, 0, 1], [1, 1]), 0.1, "plant"),  # no state equation: it differentiates
        (control.frd([1.0, 0.5], [1.0, 2.0]), 0.1, "plant"),
        ("plant", 0.1, "plant"),
    ],
    ids=[
        "no dt",
        "no step",
        "mismatch",
        "100 kHz mismatch",
        "GHz mismatch",
        "negative",
        "improper",
        "measured",
        "text",
    ],
)
def test_plants_that_say_too_little_or_contradict_are_refused(plant, sampling_time, field):
    with pytest.raises(ProblemError) as caught:
        LinearDynamics.from_statespace(plant, sampling_time=sampling_time)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: LinearDynamics(np.ones((2, 3)), np.ones((2, 1))), "dynamics.A"),
        (lambda: LinearDynamics(np.ones(2), np.ones((2, 1))), "dynamics.A"),
        (lambda: LinearDynamics(np.ones((0, 0)), np.ones((0, 1))), "dynamics.A"),
        (lambda: LinearDynamics(np.eye(2), np.ones(2)), "dynamics.B"),
        (lambda: LinearDynamics(np.eye(2), np.ones((3, 1))), "dynamics.B"),
        (lambda: LinearDynamics(np.eye(2), np.ones((2, 0))), "dynamics.B"),
        (lambda: LinearDynamics(np.eye(2), np.ones((2, 1)), offset=[1.0]), "dynamics.offset"),
        (lambda: LinearDynamics([[1.0, np.nan], [0.0, 1.0]], np.ones((2, 1))), "dynamics.A[0][1]"),
        (lambda: LinearDynamics(np.eye(2), [[np.inf], [0.0]]), "dynamics.B[0][0]"),
        (lambda: LinearDynamics(np.eye(2) * 1j, np.ones((2, 1))), "dynamics.A"),
        (lambda: LinearDynamics([["a"]], [[1.0]]), "dynamics.A"),
        (lambda: LinearDynamics([[1.0, 2.0], [3.0]], [[1.0]]), "dynamics.A"),
        (lambda: LinearDynamics([[1.0]], [[1.0]], sampling_time=0.0), "dynamics.sampling_time"),
        (lambda: LinearDynamics([[1.0]], [[1.0]], sampling_time=[0.1, 0.2]), "dynamics.sampling_time"),
        (lambda: LinearDynamics([[1.0]], [[1.0]], state_names=["a", "b"]), "dynamics.state_names"),
        (lambda: LinearDynamics(np.eye(2), np.eye(2), control_names=["a", "a"]), "dynamics.control_names"),
        (lambda: LinearDynamics([[1.0]], [[1.0]], state_names="a, b"), "dynamics.state_names"),
        (lambda: LinearDynamics([[1.0]], [[1.0]], state_names=[" "]), "dynamics.state_names"),
        (lambda: LinearDynamics.from_continuous(np.eye(2), np.ones((3, 1)), 0.1), "dynamics.A, B"),
        (lambda: LinearDynamics.from_continuous([[1e6]], [[1.0]], 1.0), "dynamics.A[0][0]"),  # exp(1e6)
    ],
)
def test_dynamics_that_are_none_are_refused_by_name(make, field):
    with pytest.raises(ProblemError) as caught:
        make()
    assert caught.value.field == field
    assert str(caught.value).startswith(f"{field}: got ")


def test_known_inputs_are_sampled_like_controls():
    """A room with the weather: dx/dt = -(x - d)/tau + b u, with d held over each hour."""
    A, B, E, h = np.array([[-0.5, 0.3], [0.2, -0.4]]), np.array([[1.0], [0.0]]), np.array([[0.2], [0.2]]), 0.3
    weather = np.sin(np.arange(6.0))[:, None]
    dynamics = LinearDynamics.from_continuous(A, B, h, offset=[0.1, 0.0], disturbance=E, d=weather)
    for t, d in enumerate(weather):
        plain = LinearDynamics.from_continuous(A, B, h, offset=np.array([0.1, 0.0]) + E @ d)
        assert np.allclose(dynamics.offset[t], plain.offset, rtol=1e-14, atol=1e-16)
    assert (dynamics.A == plain.A).all()
    assert (dynamics.B == plain.B).all()
    assert dynamics.plant is None
    assert (LinearDynamics.from_continuous(A, B, h, disturbance=E, d=weather[:, 0]).offset.shape) == (6, 2)
    constant = LinearDynamics.from_continuous(A, B, h, disturbance=E, d=[2.0])
    assert constant.plant is not None
    assert np.allclose(constant.offset, LinearDynamics.from_continuous(A, B, h, offset=E[:, 0] * 2).offset)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"d": [1.0]}, "dynamics.disturbance: got nothing"),
        ({"disturbance": [[1.0], [0.0]]}, "dynamics.d: got nothing"),
        ({"disturbance": [[1.0]], "d": [1.0]}, "dynamics.disturbance: got shape (1, 1); expected shape (2, k)"),
        ({"disturbance": [[1.0], [0.0]], "d": [[1.0, 2.0]]}, "dynamics.d: got shape (1, 2); expected shape (T, 1)"),
        ({"disturbance": [[1.0], [np.nan]], "d": [1.0]}, "dynamics.disturbance[1][0]: got nan"),
    ],
)
def test_known_inputs_that_do_not_fit_are_named(given, message):
    with pytest.raises(ProblemError, match=re.escape(message)):
        LinearDynamics.from_continuous(np.eye(2), np.ones((2, 1)), 0.1, **given)
