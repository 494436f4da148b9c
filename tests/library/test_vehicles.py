"""Quadcopter and quarter car against their physics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from helpers.library_physics import solved
from lin_freq_ocp import library, simulate

# --- quadcopter


def test_quadcopter_is_a_rigid_body_with_drag_under_gravity_to_the_printed_decimals():
    dynamics = library.quadcopter().dynamics
    h, drag = 0.1, -np.log(0.9846) / 0.1
    tilting, yawing, lift = 14.512, 3.049, 0.2107 * drag / (1 - 0.9846)  # accelerations by one unit of a rotor
    torques = np.array([[0, -tilting, 0, tilting], [-tilting, 0, tilting, 0], [-yawing, yawing, -yawing, yawing]])

    def newton(_, state):
        angles, _, rates, speeds, rotors = np.split(state, [3, 6, 9, 12])
        thrust = np.array([9.81 * angles[0], -9.81 * angles[1], lift * rotors.sum()])
        return np.concatenate([rates, speeds, torques @ rotors, thrust - drag * speeds, np.zeros(4)])

    flow = [solve_ivp(newton, (0, h), start, rtol=1e-10, atol=1e-12).y[:12, -1] for start in np.eye(16)]
    np.testing.assert_allclose(np.hstack([dynamics.A, dynamics.B]), np.transpose(flow), atol=0.5001e-4)
    assert dynamics.sampling_time == h


def test_quadcopter_pays_as_the_source_does_and_keeps_its_bounds():
    problem = library.quadcopter()
    rng = np.random.default_rng(7)
    x, u = rng.normal(size=(61, 12)), rng.normal(size=(60, 4))
    paid = 10 * ((x[:, 2] - 1) ** 2 + (x[:, 3:6] ** 2).sum(axis=1)) + 5 * (x[:, 9:] ** 2).sum(axis=1)
    assert problem.cost.value(x, u) == pytest.approx(paid.sum() + 0.1 * (u**2).sum(), rel=1e-12)
    hover, tube = 10.5916, problem.state_tube
    np.testing.assert_allclose(problem.control_tube.lower, 9.6 - hover)
    np.testing.assert_allclose(problem.control_tube.upper, 13 - hover)
    assert tube.lower[1].tolist() == [-np.pi / 6] * 2 + [-np.inf] * 3 + [-1] + [-np.inf] * 6
    assert tube.upper[1].tolist() == [np.pi / 6] * 2 + [np.inf] * 10


def test_quadcopter_turns_sooner_and_climbs_higher_where_its_rotors_are_free():
    x, u = solved(library.quadcopter())[1:]
    free_x, free_u = solved(library.quadcopter(cutoff_hz=None))[1:]
    for rotors in (u, free_u):
        assert rotors.min() == pytest.approx(9.6 - 10.5916, rel=1e-6)
    np.testing.assert_allclose(x[:, [0, 1, 3, 4]], 0, atol=1e-6)  # it turns where it is
    assert x[:, 5].max() < 0.51 * free_x[:, 5].max()
    assert free_u.max() > 1.5 * u.max()
    assert (free_x[1:6, 2] > x[1:6, 2]).sum() >= 4
    assert np.abs(free_u[-10:]).max() < 0.01 < np.abs(u[-10:]).max()


def test_quadcopter_tilts_to_its_bound_to_reach_a_place():
    place = (0.0, 0.0, 1.0, 1.0, -1.0, 0.5, *(0.0,) * 6)
    _, x, _ = solved(library.quadcopter(reference=place))
    assert x[:, 0].max() == pytest.approx(np.pi / 6, rel=1e-6)
    assert (np.abs(x).max(axis=0) > 0.1).all()
    np.testing.assert_allclose(x[40, 2:6], place[2:6], atol=0.05)


# --- quarter car


def test_quarter_car_follows_newton_over_the_bump():
    problem = library.quarter_car()
    u = np.random.default_rng(3).uniform(-1, 1, (problem.horizon, 1))
    x = simulate(problem, u).x
    t = 0.01 * np.arange(301)
    road = np.where((t > 0.5) & (t < 0.75), 0.04 * (1 - np.cos(8 * np.pi * t)), 0)

    def newton(time, state, k):
        body, wheel, body_speed, wheel_speed = state
        ground = np.interp(time, t, road)
        suspension = 16812 * (body - wheel) + 1000 * (body_speed - wheel_speed) - 1000 * u[k, 0]
        return [body_speed, wheel_speed, -suspension / 290, (suspension - 190000 * (wheel - ground)) / 59]

    state = np.zeros(4)
    for k in range(80):
        state = solve_ivp(newton, (t[k], t[k + 1]), state, args=(k,), rtol=1e-10, atol=1e-12).y[:, -1]
        body, wheel, body_speed, wheel_speed = state
        np.testing.assert_allclose(x[k + 1], [body - wheel, body_speed, wheel - road[k + 1], wheel_speed], atol=1e-8)


def test_quarter_car_pays_for_acceleration_tyre_and_force():
    problem = library.quarter_car()
    u = np.random.default_rng(4).uniform(-1, 1, (problem.horizon, 1))
    x = simulate(problem, u).x
    travel, body_speed, tyre, wheel_speed = x[:-1].T
    acceleration = (1000 * u[:, 0] - 16812 * travel - 1000 * (body_speed - wheel_speed)) / 290
    paid = (acceleration**2 + 1000 * tyre**2 + 0.1 * u[:, 0] ** 2).sum() / 2
    assert problem.cost.value(x, u) == pytest.approx(paid, rel=1e-12)


def test_quarter_car_loses_the_bins_from_4_to_8_hz_of_the_body_speed_alone():
    stop = library.quarter_car().state_stop
    assert stop.any(axis=0).tolist() == [False, True, False, False]
    removed = np.flatnonzero(stop[:, 1]) / 3.01  # Hz
    assert removed.min() - 1 / 3.01 < 4 < removed.min()
    assert removed.max() < 8 < removed.max() + 1 / 3.01
