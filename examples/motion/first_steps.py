"""
First steps: a cart from rest to rest
=====================================

A cart of 1 kg moves 1 m in 2 s, with little force.

The force is at most 5 N and the speed at most 1 m/s. The actuator follows up to 20 Hz,
so that the force must not contain higher frequencies.
"""

import control

import lin_freq_ocp as lfo

plant = control.ss([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]])
problem = lfo.OptimalControlProblem(
    dynamics=lfo.LinearDynamics.from_statespace(
        plant,
        sampling_time=0.01,
        state_names=["position [m]", "speed [m/s]"],
        control_names=["force [N]"],
    ),
    horizon=200,
    cost=lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-5, 5),
    state_set=lfo.Box([None, -1], [None, 1]),
    initial_state=[0, 0],
    terminal_state=[1, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=20),  # change this number
    name="first steps",
)
result = lfo.solve(problem)
print(result)
print("last states:", result.trajectory.x[-3:].round(6).tolist())
figure = result.plot()
figure.savefig("first_steps.png")
print("picture: first_steps.png")
