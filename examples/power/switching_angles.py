"""
An inverter with three levels: free switching angles
====================================================

Five switching angles of a quarter period remove the harmonics 5, 7, 11 and 13.

The output takes the levels -1, 0 and 1 with quarter-wave symmetry. ``PulseTrain`` makes
the angles controls: each step of the dynamics is one switch. The cost is the square of
the distortion. The search proves that no other five angles, and no other order of
steps, cost less.
"""

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

fundamental = 0.9  # amplitude, of levels -1, 0 and 1: change this number
switches, harmonics = 5, [5, 7, 11, 13]
train = lfo.dynamics.PulseTrain(step=1.0, orders=[1, *harmonics])
quarter, zeros = np.pi / 2, [0] * len(harmonics)
start = -(fundamental**2)  # of the energy: at the end, it is the squared distortion
problem = lfo.OptimalControlProblem(
    train,  # states: angle, level, integral of the level, energy, amplitudes
    horizon=switches + 1,
    cost=lfo.QuadraticCost(p=[0, 0, 0, 1, 0, *zeros]),
    control_set=lfo.Box([0, -1], [quarter, 1]),  # dwell, direction of the step
    state_set=lfo.Box(
        [0, -1, -quarter, start, *[-2] * 5], [quarter, 1, quarter, 4, *[2] * 5]
    ),
    initial_state=lfo.Box(
        [0, 0, -quarter, start, 0, *zeros], [0, 0, quarter, start, 0, *zeros]
    ),
    terminal_state=lfo.Box(
        [quarter, -1, 0, start, fundamental, *zeros],
        [quarter, 1, 0, 4, fundamental, *zeros],
    ),
    name="switching angles",
)
print("The search over all angles takes some seconds.")
result = lfo.solve(problem)
print(f"{result.status}: cost {result.cost:.6g}, gap {result.gap:.1e}")
x = result.trajectory.x
print("angles [deg]", np.degrees(x[1:-1, 0]).round(3))
print(f"distortion of the integrated output {100 * result.cost**0.5:.3f} %")
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.step(np.degrees(x[:, 0]), np.append(x[:-1, 1], x[-2, 1]), where="post")
axes.set(xlabel="angle [deg]", ylabel="level")
figure.savefig("switching_angles.png")
print("picture: switching_angles.png")
