"""The problems of structured.py: families that the Fourier-domain method refuses, or is slow at."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

import lin_freq_ocp as lfo

STEP = 0.02  # sampling time of the time-varying system [s]
ORBIT = 90.0  # period of the reference orbit [min]
CHASER = (1.5, -3.0, 0.5, 0.0, 0.05, 0.0)  # initial position [100 m] and velocity [100 m/min]


def time_varying(horizon: int) -> lfo.OptimalControlProblem:
    """Return an oscillator whose stiffness changes its sign: a low pass of 5 of 25 Hz, bounds on speed and force.

    Half of the horizon is unstable: over 1e4 steps, the states grow by e^100 in open loop.
    """
    t = np.arange(horizon)
    phase = 2 * np.pi * t / horizon
    A, B = np.empty((horizon, 2, 2)), np.zeros((horizon, 2, 1))
    A[:, 0, 0], A[:, 0, 1] = 1.0, STEP + 0.005 * np.sin(phase)
    A[:, 1, 0], A[:, 1, 1] = -STEP * np.cos(2 * phase), 1 - 0.002 * t / horizon
    B[:, 1, 0] = STEP * (1 + 0.3 * np.sin(4 * phase))
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B, sampling_time=STEP),
        horizon,
        lfo.QuadraticCost(Q=0.1, R=1.0),
        control_set=lfo.Box(-1, 1),
        state_set=lfo.Box([None, -0.5], [None, 0.5]),
        initial_state=[1, 0],
        terminal_state=[0, 0],
        control_spectrum=lfo.low_pass(cutoff_hz=5),
        name=f"time-varying oscillator, T = {horizon}",
    )


def rate_limited(horizon: int) -> lfo.OptimalControlProblem:
    """Return the pendulum with a force that changes by 2 N a step at most."""
    return lfo.rate_limited(lfo.library.pendulum(horizon=horizon), 2.0)


def masked(horizon: int, level: float = 0.05218) -> lfo.OptimalControlProblem:
    """Return the pendulum with a mask of 1 % above 40 Hz, on a grid four times as fine as the DFT's and between it."""
    first = math.floor(0.4 * horizon) + 1
    mask = lfo.MagnitudeBound(level, bins=range(first, horizon + 1 - first), oversampling=4, between=True)
    return replace(lfo.library.pendulum(horizon=horizon), control_spectrum=mask)


def rendezvous(horizon: int) -> lfo.OptimalControlProblem:
    """Return an approach on an eccentric orbit within an hour and a half, with a thrust of limited magnitude."""
    step = ORBIT / horizon
    A, B = np.empty((horizon, 6, 6)), np.empty((horizon, 6, 3))
    for t in range(horizon):
        w = 2 * np.pi / ORBIT * (1 + 0.15 * np.cos(2 * np.pi * t / horizon))
        rates = np.zeros((9, 9))
        rates[:3, 3:6], rates[3:6, 6:] = np.eye(3), np.eye(3)
        rates[3, 0], rates[3, 4], rates[4, 3], rates[5, 2] = 3 * w * w, 2 * w, -2 * w, -w * w
        moved = expm(rates * step)
        A[t], B[t] = moved[:6, :6], moved[:6, 6:]
    speed = [None] * 3 + [0.4] * 3
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, B, sampling_time=step),
        horizon,
        lfo.QuadraticCost(Q=1e-3, R=1e2),
        control_set=lfo.sets.Ball(0.03, [0, 0, 0]),
        state_set=lfo.Box([None if limit is None else -limit for limit in speed], speed),
        initial_state=CHASER,
        terminal_state=np.zeros(6),
        name=f"rendezvous, T = {horizon}",
    )


@dataclass(frozen=True)
class Case:
    """A family, its horizons, and those at which the sparse program is solved, too."""

    problem: Callable[[int], lfo.OptimalControlProblem]
    horizons: tuple[int, ...]
    compared: tuple[int, ...]


CASES = {
    "time-varying": Case(time_varying, (200, 1000, 2000, 10_000, 20_000), (200, 1000, 2000)),
    "rate-limited": Case(rate_limited, (1000, 4000), (1000, 4000)),
    "mask": Case(masked, (240, 1000, 4000), (240, 1000)),
    "cone-limited": Case(rendezvous, (1000, 5000), (1000, 5000)),
}
