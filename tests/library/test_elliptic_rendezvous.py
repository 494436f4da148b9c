"""The elliptic rendezvous against two bodies in Kepler motion."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from lin_freq_ocp import library

MU = 3.986004418e14  # m^3/s^2


def inertial_target(anomaly: float, eccentricity: float, perigee: float) -> np.ndarray:
    """Return position [m] and velocity [m/s] on the orbit, perigee on the first axis."""
    p = perigee * (1 + eccentricity)
    radius = p / (1 + eccentricity * np.cos(anomaly))
    speed = np.sqrt(MU / p)
    return np.array(
        [
            radius * np.cos(anomaly),
            radius * np.sin(anomaly),
            -speed * np.sin(anomaly),
            speed * (eccentricity + np.cos(anomaly)),
        ]
    )


def frame(target: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the radial and along-track directions as rows, and the rate at which they turn."""
    radial = target[:2] / np.linalg.norm(target[:2])
    rate = (target[0] * target[3] - target[1] * target[2]) / (target[:2] @ target[:2])
    return np.array([radial, [-radial[1], radial[0]]]), rate


def chased(target: np.ndarray, relative: np.ndarray, u: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the target and the relative state [km, m/s] one step on, by Newton's law of gravity in inertial axes."""
    axes, rate = frame(target)
    turn = rate * np.array([[0, -1], [1, 0]])
    place, speed = 1e3 * relative[:2], relative[2:]
    chaser = target + np.concatenate([axes.T @ place, axes.T @ (speed + turn @ place)])

    def fall(_, both):
        target, chaser = both[:4], both[4:]
        thrust = frame(target)[0].T @ (1e-3 * u)
        pull = [-MU * body[:2] / np.linalg.norm(body[:2]) ** 3 for body in (target, chaser)]
        return np.concatenate([target[2:], pull[0], chaser[2:], pull[1] + thrust])

    both = solve_ivp(fall, (0, step), np.concatenate([target, chaser]), method="DOP853", rtol=1e-13, atol=1e-7).y[:, -1]
    target, gap = both[:4], both[4:] - both[:4]
    axes, rate = frame(target)
    place = axes @ gap[:2]
    speed = axes @ gap[2:] - rate * np.array([[0, -1], [1, 0]]) @ place
    return target, np.concatenate([1e-3 * place, speed])


def test_rendezvous_follows_two_bodies_in_kepler_motion():
    problem = library.elliptic_rendezvous(first_anomaly=-0.2)
    dynamics, size = problem.dynamics, 0.1
    target = inertial_target(-0.2, 0.7, 6.9e6)
    for t in range(4):  # across the perigee, where the matrices change most
        A, B, _ = dynamics.at(t)
        for column in range(6):
            direction = np.zeros(6)
            direction[column] = size
            ahead = chased(target, direction[:4], direction[4:], problem.sampling_time)[1]
            behind = chased(target, -direction[:4], -direction[4:], problem.sampling_time)[1]
            expected = (ahead - behind) / (2 * size)  # the even part of gravity cancels
            np.testing.assert_allclose(np.hstack([A, B])[:, column], expected, atol=2e-6)
        target = chased(target, np.zeros(4), np.zeros(2), problem.sampling_time)[0]


def test_rendezvous_on_the_same_orbit_ahead_in_time_repeats_every_period():
    period = 2 * np.pi * np.sqrt((6.9e6 / 0.7) ** 3 / MU)
    orbit = library.elliptic_rendezvous(
        horizon=101, sampling_time=period / 100, eccentricity=0.3, first_anomaly=1.0, cutoff_hz=None
    ).dynamics
    np.testing.assert_allclose(orbit.A[100], orbit.A[0], atol=1e-9)
    target = inertial_target(1.0, 0.3, 6.9e6)
    axes, rate = frame(target)
    place = axes @ target[2:]  # the chaser is where the target will be one second later
    speed = axes @ (-MU * target[:2] / np.linalg.norm(target[:2]) ** 3) - rate * np.array([-place[1], place[0]])
    x = start = np.concatenate([1e-3 * place, speed])
    for t in range(100):
        x = orbit.A[t] @ x
    np.testing.assert_allclose(x, start, atol=1e-7)


def test_rendezvous_on_a_circle_is_clohessy_wiltshire():
    problem = library.elliptic_rendezvous(10, 60.0, eccentricity=0.0, perigee_radius=7e6, cutoff_hz=None)
    n, h = np.sqrt(MU / 7e6**3), 60.0
    c, s = np.cos(n * h), np.sin(n * h)
    A = np.array(
        [
            [4 - 3 * c, 0, s / n, 2 * (1 - c) / n],
            [6 * (s - n * h), 1, 2 * (c - 1) / n, (4 * s - 3 * n * h) / n],
            [3 * n * s, 0, c, 2 * s],
            [6 * n * (c - 1), 0, -2 * s, 4 * c - 3],
        ]
    )
    km = np.diag([1e-3, 1e-3, 1, 1])
    for t in range(10):
        np.testing.assert_allclose(problem.dynamics.A[t], km @ A @ np.linalg.inv(km), atol=1e-10)
