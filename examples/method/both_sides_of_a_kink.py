"""
Both sides of a kink
====================

Where a control just touches its bound, the optimum has two derivatives.

A mass comes to rest from 1 m; its force may not fall below the least force of the free
optimum. From a start farther away the bound holds the first force, from a nearer one it
does not. ``derivatives.jvp`` has both slopes, and names the bound.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

free = lfo.OptimalControlProblem(
    lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]]),
    horizon=40,
    cost=lfo.QuadraticCost(Q=1.0, R=0.1, P=5.0),
    initial_state=[1.0, 0.0],
)
least = lfo.solve(free).derivatives.trajectory.u.min()
problem = replace(free, control_set=lfo.Box(least, 10.0))  # change the bound

step = lfo.solve(problem).derivatives.jvp(initial_state=[1.0, 0.0])
print(f"exists: {step.exists}; {step.rows[0]}")
left, right = step.left.u[:, 0], step.right.u[:, 0]
print(f"slopes of the second force: {left[1]:.4f} and {right[1]:.4f}")

starts = np.linspace(0.8, 1.2, 41)
optima = [lfo.solve(problem.with_ends([start, 0.0])).trajectory for start in starts]
figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), sharex=True)
for t, axis in enumerate(axes):
    forces = np.array([optimum.u[t, 0] for optimum in optima])
    axis.plot(starts, forces, ".", label="optima")
    for name, slope, part in (
        ("left", left, starts <= 1),
        ("right", right, starts >= 1),
    ):
        axis.plot(starts[part], forces[20] + slope[t] * (starts[part] - 1), label=name)
    axis.set(xlabel="start [m]", ylabel=f"force at t = {t}")
    axis.legend()
figure.tight_layout()
figure.savefig("both_sides_of_a_kink.png")
print("picture: both_sides_of_a_kink.png")
