"""
An infeasible problem: the conflict, and its repairs
====================================================

An actuator is too slow for its task, and the error names the constraints in conflict.

The force on the cart of a pendulum follows only 5.6 Hz, which does not suffice to move
the pendulum within 2.4 s with a force of at most 5 N. For each constraint in conflict,
the error gives the smallest change that restores feasibility.
"""

from dataclasses import replace

import numpy as np

import lin_freq_ocp as lfo

cutoff_hz, force = 5.6, 5.0  # change these numbers
period, horizon = 0.01, 240
cart = lfo.LinearDynamics.from_continuous(  # of 2.5 kg, with a pendulum of 0.6 kg
    [[0, 0, 1, 0], [0, 0, 0, 1], [0, -0.9645933, 0, 0], [0, 19.934928, 0, 0]],
    [[0], [0], [0.38277512], [-0.65618592]],
    sampling_time=period,
    state_names=["position [m]", "angle [rad]", "speed [m/s]", "angular speed [rad/s]"],
    control_names=["force [N]"],
)
problem = lfo.OptimalControlProblem(
    cart,
    horizon,
    cost=lfo.QuadraticCost(R=2.0),
    control_set=lfo.Box(-force, force),
    state_set=lfo.Box([-0.2, -np.pi / 9, -15, -30], [0.2, np.pi / 9, 15, 30]),
    initial_state=[-0.15, 0.1, 0, 0],
    terminal_state=[0.15, -0.1, 0, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=cutoff_hz),
    name="pendulum",
)
print("The search for the conflict and its repairs takes some seconds.")
try:
    lfo.solve(problem)
except lfo.errors.InfeasibleError as error:
    print(error)

# one of the repairs: a larger bound on the force
result = lfo.solve(replace(problem, control_set=lfo.Box(-5.54, 5.54)))
print(f"with 5.54 N instead of 5 N: cost {result.cost:.6g}, {result.certificate.pmp}")
figure = result.plot()
figure.savefig("infeasible.png")
print("picture: infeasible.png, of the repaired problem")
