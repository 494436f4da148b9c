"""Crane, flexible joint arm and flexible satellite against their physics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from helpers.library_physics import bins_around, energy, frequencies, removed, solved
from lin_freq_ocp import library, simulate

# --- crane


def test_crane_follows_the_nonlinear_pendulum_at_small_angles():
    problem = library.crane(cable_length=4.0)
    u = np.random.default_rng(5).uniform(-0.15, 0.15, (problem.horizon, 1))
    x = simulate(problem, u).x

    def newton(_, state, k):
        _, speed, swing, rate = state
        return [speed, u[k, 0], rate, -(9.81 * np.sin(swing) + u[k, 0] * np.cos(swing)) / 4.0]

    state = np.zeros(4)
    for k in range(50):
        state = solve_ivp(newton, (0.1 * k, 0.1 * (k + 1)), state, args=(k,), rtol=1e-10, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(x[k + 1], state, atol=1e-5)
    assert np.abs(x[:51, 2]).max() > 0.005


def test_crane_loses_the_bins_around_its_pendulums_frequency():
    for length in (4.0, 5.0):
        problem = library.crane(cable_length=length)
        np.testing.assert_allclose(frequencies(problem), [np.sqrt(9.81 / length)], rtol=1e-12)
        hertz = np.fft.rfftfreq(problem.horizon, 0.1)
        near = np.abs(hertz - np.sqrt(9.81 / length) / (2 * np.pi)) < 0.05
        assert (problem.control_stop[:, 0] == near).all()
        assert near.any()


def test_crane_is_at_rest_with_its_own_cable_anyway_and_with_others_thanks_to_the_band():
    band = solved(library.crane())[2]
    free = solved(library.crane(notch_width_hz=None))[2]

    def swing(u, length):  # amplitude after the move
        last = simulate(library.crane(cable_length=length, notch_width_hz=None), u).x[-1]
        return np.hypot(last[2], last[3] / np.sqrt(9.81 / length))

    for u in (band, free):
        assert swing(u, 5.0) < 1e-7
        transform = u[:, 0] @ np.exp(-1j * np.sqrt(9.81 / 5.0) * 0.1 * np.arange(len(u)))
        assert abs(transform) < 1e-5
    for length in (4.0, 4.5, 5.5, 6.0):
        assert swing(band, length) < swing(free, length) / 3.5


# --- flexible joint arm


def test_arm_moves_as_its_two_inertias_say():
    problem = library.flexible_joint_arm(stiffness_ratio=1.3)
    u = np.random.default_rng(6).uniform(-6, 6, (problem.horizon, 1))
    x = simulate(problem, u).x

    def newton(_, state, k):
        motor, link, motor_speed, link_speed = state
        torsion = 1.3 * (motor - link)
        return [motor_speed, link_speed, u[k, 0] - 1.25 * motor_speed - 48.6 * torsion, 19.5 * torsion]

    state = np.zeros(4)
    for k in range(40):
        state = solve_ivp(newton, (0.02 * k, 0.02 * (k + 1)), state, args=(k,), rtol=1e-11, atol=1e-13).y[:, -1]
        motor, link, motor_speed, link_speed = state
        np.testing.assert_allclose(x[k + 1], [link, motor - link, link_speed, motor_speed - link_speed], atol=1e-9)


def test_arm_without_torque_loses_energy_and_coasts_to_a_stop_where_its_momentum_says():
    problem = library.flexible_joint_arm(horizon=1500)
    x = simulate(problem, np.zeros((problem.horizon, 1)), [0.2, 0.1, 0.5, -0.3]).x
    motor = x[:, [0, 2]] + x[:, [1, 3]]
    total = energy(
        np.column_stack([motor[:, 0], x[:, 0], motor[:, 1], x[:, 2]]),
        np.diag([1, 48.6 / 19.5]),  # inertias of motor and link, over that of the motor
        48.6 * np.array([[1, -1], [-1, 1]]),
    )
    assert (np.diff(total) < 0).all()
    momentum = motor[:, 1] + 48.6 / 19.5 * x[:, 2] + 1.25 * motor[:, 0]
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-10)
    np.testing.assert_allclose(x[-1], [momentum[0] / 1.25, 0, 0, 0], atol=1e-4)


def test_arm_loses_the_bins_around_its_resonance():
    problem = library.flexible_joint_arm()
    resonance = np.sqrt(48.6 + 19.5)
    np.testing.assert_allclose(frequencies(problem), [resonance], rtol=0.01)  # friction changes it a little
    hertz = np.fft.rfftfreq(problem.horizon, 0.02)
    near = np.abs(hertz - resonance / (2 * np.pi)) < 0.5
    assert (problem.control_stop[:, 0] == near).all()
    assert near.sum() == 3


def test_arm_uses_all_its_torque_and_torsion_and_vibrates_less_where_its_stiffness_is_not_known():
    answers = {width: solved(library.flexible_joint_arm(notch_width_hz=width)) for width in (1.0, None)}
    for _, x, u in answers.values():
        assert np.abs(u).max() == pytest.approx(6.3, rel=1e-6)
        assert np.abs(x[:, 1]).max() == pytest.approx(np.radians(5), rel=1e-6)

    def vibration(u, ratio):  # amplitude of the torsion after the move
        last = simulate(library.flexible_joint_arm(stiffness_ratio=ratio, notch_width_hz=None), u).x[-1]
        return np.hypot(last[1], last[3] / np.sqrt(ratio * (48.6 + 19.5)))

    for ratio in (0.8, 0.9, 1.1, 1.2):
        assert vibration(answers[1.0][2], ratio) < 0.75 * vibration(answers[None][2], ratio)


# --- flexible satellite


def test_satellite_loses_the_bins_around_its_free_hub_frequencies():
    problem = library.flexible_satellite()

    def characteristic(frequency):  # of the undamped satellite: the inertia that the torque feels
        modes = ((6.45637, 0.7681), (-1.25819, 1.1038))
        return 350 + sum(c**2 * frequency**2 / (held**2 - frequency**2) for c, held in modes)

    free = [brentq(characteristic, low, high) for low, high in ((0.7682, 1.1037), (1.1039, 2.0))]
    np.testing.assert_allclose(frequencies(problem), free, rtol=1e-4)  # damping adds its square
    for mode, frequency in enumerate(free, start=1):
        assert removed(problem, mode) == bins_around(frequency, 0.05, problem)
    assert not problem.state_stop[:, [0, 3, 4, 5]].any()


def test_satellite_keeps_angular_momentum_and_loses_energy():
    problem = library.flexible_satellite()
    mass = np.array([[350, 6.45637, -1.25819], [6.45637, 1, 0], [-1.25819, 0, 1]])
    u = np.random.default_rng(2).uniform(-1, 1, (problem.horizon, 1))
    momentum = simulate(problem, u).x[:, 3:] @ mass[0]
    np.testing.assert_allclose(momentum[1:], problem.sampling_time * np.cumsum(u), atol=1e-11)
    x = simulate(problem, 0 * u, [0.1, 0.2, -0.1, 0.01, 0.0, 0.05]).x
    total = energy(x, mass, np.diag([0, 0.7681**2, 1.1038**2]))
    assert (np.diff(total) < 0).all()
