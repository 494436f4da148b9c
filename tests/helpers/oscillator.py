"""The oscillator of the benchmark."""

from __future__ import annotations

from math import pi

import numpy as np

import lin_freq_ocp as lfo


def oscillator(horizon: int, damping: float = 0.05) -> lfo.OptimalControlProblem:
    """Return a mass on a spring, 2 rad/s and 0.01 s, pushed within +-1 below 5 Hz; damping ratio < 0: unstable."""
    return lfo.OptimalControlProblem(
        dynamics=lfo.LinearDynamics.from_continuous([[0, 1], [-4, -4 * damping]], [[0], [1]], 0.01),
        horizon=horizon,
        cost=lfo.QuadraticCost(Q=np.diag([10, 0.1]), R=0.1),
        control_set=lfo.Box(-1, 1),
        initial_state=(1, 0),
        control_spectrum=lfo.low_pass(2 * pi * 5 * 0.01),
        name=f"oscillator, damping ratio {damping:g}",
    )
