"""Masses joined by springs against Newton's law and the reference instance."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from helpers.library_physics import bins_around, energy, frequencies, removed, solved
from helpers.seeds import expensive
from lin_freq_ocp import library, simulate, stop_band

# --- two masses and a spring


def test_two_masses_move_as_newton_says():
    problem = library.two_mass_spring(stiffness=0.7)
    u = np.random.default_rng(1).uniform(-1, 1, (problem.horizon, 1))
    x = simulate(problem, u).x

    def newton(t, state):
        position_1, position_2, speed_1, speed_2 = state
        force = u[min(int(t / 0.05 + 1e-9), len(u) - 1), 0]
        spring = 0.7 * (position_2 - position_1)
        return [speed_1, speed_2, force + spring, -spring]

    state = np.zeros(4)
    for t in range(20):
        state = solve_ivp(newton, (0.05 * t, 0.05 * (t + 1) - 1e-12), state, rtol=1e-11, atol=1e-13).y[:, -1]
    expected = state[0], state[1] - state[0], state[2], state[3] - state[2]
    np.testing.assert_allclose(x[20], expected, atol=1e-9)


def test_two_masses_swing_at_their_flexible_frequency_and_keep_energy():
    problem = library.two_mass_spring()
    np.testing.assert_allclose(frequencies(problem), [np.sqrt(2)], rtol=1e-12)
    assert removed(problem, 1) == bins_around(np.sqrt(2), 0.2, problem)
    x = simulate(problem, np.zeros((problem.horizon, 1)), [0.0, 0.3, 0.1, -0.2]).x
    q = np.column_stack([x[:, 0], x[:, 0] + x[:, 1], x[:, 2], x[:, 2] + x[:, 3]])
    total = energy(q, np.eye(2), np.array([[1.0, -1.0], [-1.0, 1.0]]))
    np.testing.assert_allclose(total, total[0], rtol=1e-12)


# --- two-mass drive


def test_the_drive_turns_as_newton_says_and_its_masses_swing_at_12_hz():
    rigid, elastic = library.two_mass_drive(), library.two_mass_drive(elastic=True)
    np.testing.assert_allclose(frequencies(elastic), [2 * np.pi * 12], rtol=1e-3)
    poles = np.log(np.linalg.eigvals(elastic.dynamics.A).astype(complex)) / 0.005
    assert 0.01 < -poles.real[poles.imag > 1][0] / np.abs(poles[poles.imag > 1][0]) < 0.014  # spring and friction
    u = np.random.default_rng(0).uniform(-1, 1, (60, 1))
    x, both = simulate(rigid, u).x, simulate(elastic, u).x
    np.testing.assert_allclose((both[:, :2] + both[:, 2:]) / 2, x, atol=1e-10)  # the mean moves as one mass
    inertia, spring, damper = 0.5, 0.25 * (2 * np.pi * 12) ** 2, 0.01 * 0.5 * 2 * np.pi * 12

    def newton(t, state):
        angle, speed, load, load_speed = state
        joint = spring * (load - angle) + damper * (load_speed - speed)
        accelerations = (u[0, 0] + joint) / inertia - 0.5 * speed, -joint / inertia - 0.5 * load_speed
        return [speed, accelerations[0], load_speed, accelerations[1]]

    state = solve_ivp(newton, (0, 0.005), [0.3, 0.0, 0.3, 0.0], rtol=1e-11, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(both[1], state, atol=1e-9)


# --- mass chain


def test_mass_chain_is_the_reference_instance():
    dynamics = library.mass_chain().dynamics
    for (i, j), value in {
        (0, 0): 0.9752329835968522,
        (0, 1): 0.012313890524584481,
        (0, 2): 4.6280001562353116e-05,
        (0, 4): 0.04933825548659111,
        (1, 1): 0.9752792635984145,
        (1, 5): 0.049339234050821607,
        (4, 0): -0.983471102246856,
        (7, 7): 0.9653982725743836,
    }.items():
        assert dynamics.A[i, j] == pytest.approx(value, rel=1e-12)
    for (i, j), value in {(0, 0): 0.0012406747076181789, (1, 0): 4.6477749215747014e-06}.items():
        assert dynamics.B[i, j] == pytest.approx(value, rel=1e-12)
    stop = library.mass_chain().control_stop
    assert [np.flatnonzero(column)[[0, -1]].tolist() for column in stop.T] == [[80, 200], [120, 200]]


@expensive
def test_mass_chain_with_a_free_end_reaches_the_other_reference_optimum():
    chain = library.mass_chain(cutoffs_hz=None, terminal_state=None, force_bound=0.8, terminal_weight=1.0)
    notched = dataclasses.replace(chain, control_spectrum=stop_band(bins=range(18, 25)))
    assert solved(notched)[0] == pytest.approx(64.48606688009046, rel=1e-8)


def test_undamped_mass_chain_keeps_energy_and_has_the_frequencies_of_a_chain():
    problem = library.mass_chain(damping=0.0)
    x = simulate(problem, np.zeros((problem.horizon, 2))).x
    stiffness = 10 * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    total = energy(x, np.eye(4), stiffness)
    np.testing.assert_allclose(total, total[0], rtol=1e-11)
    np.testing.assert_allclose(frequencies(problem), 2 * np.sqrt(10) * np.sin(np.arange(1, 5) * np.pi / 10), rtol=1e-11)
