"""
The price of bandwidth
======================

A sweep over the cut-off shows how much a faster actuator would save.

A cart moves an inverted pendulum by 0.3 m within 2.4 s, with a force of at most 5 N.
The cut-off of its force varies from 11 to 48 Hz.
"""

import numpy as np

import lin_freq_ocp as lfo

cutoffs_hz = [11, 13, 16, 20, 24, 32, 48]  # change these numbers
cart = lfo.LinearDynamics.from_continuous(  # of 2.5 kg, with a pendulum of 0.6 kg
    [[0, 0, 1, 0], [0, 0, 0, 1], [0, -0.9645933, 0, 0], [0, 19.934928, 0, 0]],
    [[0], [0], [0.38277512], [-0.65618592]],
    sampling_time=0.01,
    state_names=["position [m]", "angle [rad]", "speed [m/s]", "angular speed [rad/s]"],
    control_names=["force [N]"],
)


def pendulum(cutoff_hz: float) -> lfo.OptimalControlProblem:
    """Return the problem of an actuator that follows up to this frequency."""
    return lfo.OptimalControlProblem(
        cart,
        horizon=240,
        cost=lfo.QuadraticCost(R=2.0),
        control_set=lfo.Box(-5, 5),
        state_set=lfo.Box([-0.2, -np.pi / 9, -15, -30], [0.2, np.pi / 9, 15, 30]),
        initial_state=[-0.15, 0.1, 0, 0],
        terminal_state=[0.15, -0.1, 0, 0],
        control_spectrum=lfo.low_pass(cutoff_hz=cutoff_hz),
        name="pendulum",
    )


table = lfo.sweep(pendulum, {"cutoff_hz": cutoffs_hz})
print(table)
figure = table.plot()
figure.savefig("price_of_bandwidth.png")
print("picture: price_of_bandwidth.png")
