"""
A hundred initial states in one call
====================================

``lfo.solve_many`` sets up the problem once, and certifies every answer.

A cart moves an inverted pendulum by 0.3 m within 2.4 s, with a low-passed force of at
most 5 N. The hundred initial states differ by up to 1 cm and 0.01 rad, and their rates
by 2 cm/s and 0.02 rad/s.
"""

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

spread = [0.01, 0.01, 0.02, 0.02]  # of the initial states: change these numbers
start = [-0.15, 0.1, 0, 0]
cart = lfo.LinearDynamics.from_continuous(  # of 2.5 kg, with a pendulum of 0.6 kg
    [[0, 0, 1, 0], [0, 0, 0, 1], [0, -0.9645933, 0, 0], [0, 19.934928, 0, 0]],
    [[0], [0], [0.38277512], [-0.65618592]],
    sampling_time=0.01,
    state_names=["position [m]", "angle [rad]", "speed [m/s]", "angular speed [rad/s]"],
    control_names=["force [N]"],
)
problem = lfo.OptimalControlProblem(
    cart,
    horizon=240,
    cost=lfo.QuadraticCost(R=2.0),
    control_set=lfo.Box(-5, 5),
    state_set=lfo.Box([-0.2, -np.pi / 9, -15, -30], [0.2, np.pi / 9, 15, 30]),
    initial_state=start,
    terminal_state=[0.15, -0.1, 0, 0],
    control_spectrum=lfo.low_pass(cutoff_hz=40),
    name="pendulum",
)
starts = start + np.random.default_rng(0).uniform(-1, 1, (100, 4)) * spread
solutions = lfo.solve_many(problem, starts)
feasible = np.isfinite(solutions.costs)
costs = solutions.costs[feasible]
print(f"{feasible.sum()} of {len(starts)} feasible; all proven: {solutions.proven}")
print(f"costs from {costs.min():.4g} to {costs.max():.4g}")

figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
axes.plot(problem.times[:-1], solutions.controls[feasible, :, 0].T, linewidth=0.5)
axes.set(xlabel="time [s]", ylabel=problem.control_names[0])
figure.savefig("many_initial_states.png")
print("picture: many_initial_states.png")
