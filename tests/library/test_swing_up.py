"""Smooth library problems: energies and equilibria."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp import library

GRAVITY = 9.81  # m/s^2


def test_a_pendulum_without_torque_keeps_its_energy():
    problem = library.pendulum_swing_up(horizon=400, sampling_time=0.01, mass=2.0, length=0.7)
    x = lfo.simulate(problem, np.zeros((400, 1)), [2.5, 0.0]).x
    energy = 0.5 * 2.0 * (0.7 * x[:, 1]) ** 2 - 2.0 * GRAVITY * 0.7 * np.cos(x[:, 0])
    np.testing.assert_allclose(energy, energy[0], rtol=1e-6)
    assert np.ptp(x[:, 0]) > 4


def test_a_cart_pole_without_force_keeps_energy_and_momentum():
    problem = library.cart_pole(horizon=400, sampling_time=0.005)
    x = lfo.simulate(problem, np.zeros((400, 1)), [0.0, 2.5, 0.3, 0.0]).x
    tip = x[:, 2] + 0.5 * x[:, 3] * np.cos(x[:, 1]), 0.5 * x[:, 3] * np.sin(x[:, 1])
    energy = 0.5 * x[:, 2] ** 2 + 0.15 * (tip[0] ** 2 + tip[1] ** 2) - 0.3 * GRAVITY * 0.5 * np.cos(x[:, 1])
    np.testing.assert_allclose(energy, energy[0], rtol=1e-6)
    np.testing.assert_allclose(x[:, 2] + 0.3 * tip[0], 0.3 + 0.3 * 0.3, rtol=1e-6)


def test_a_planar_quadrotor_hovers_falls_and_turns():
    problem = library.planar_quadrotor(horizon=20)
    hover = np.asarray(problem.quadratic.u_ref)
    assert 2 * hover[0] == pytest.approx(0.486 * GRAVITY)
    np.testing.assert_allclose(lfo.simulate(problem, np.tile(hover, (20, 1)), np.zeros(6)).x, 0.0, atol=1e-12)
    fallen = lfo.simulate(problem, np.zeros((20, 2)), np.zeros(6)).x[-1]
    assert fallen[1] == pytest.approx(-GRAVITY / 2)
    turned = lfo.simulate(problem, np.tile(hover + np.array([1e-3, -1e-3]), (20, 1)), np.zeros(6)).x[-1]
    assert turned[5] == pytest.approx(2e-3 * 0.25 / 0.00383)
    assert turned[0] < 0


@pytest.mark.parametrize("build", [library.pendulum_swing_up, library.cart_pole, library.planar_quadrotor])
def test_bands_are_removed_from_controls(build):
    problem = build(horizon=40, sampling_time=0.05, cutoff_hz=4.0)
    assert (problem.control_stop.sum(axis=0) == 12).all()
    assert not build(horizon=40).control_stop.any()
