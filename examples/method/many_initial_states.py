"""
A hundred initial states in one call
====================================

``lfo.solve_many`` sets up the problem once, and certifies every answer.

A cart moves an inverted pendulum by 0.3 m within 2.4 s, with a low-passed force of at
most 5 N. The hundred initial states differ by up to 1 cm and 0.01 rad, and their rates by
2 cm/s and 0.02 rad/s.
"""

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

problem = lfo.library.pendulum()
start = problem.initial_box.lower
starts = start + np.random.default_rng(0).uniform(-1, 1, (100, 4)) * [
    0.01,
    0.01,
    0.02,
    0.02,
]
solutions = lfo.solve_many(problem, starts)
feasible = np.isfinite(solutions.costs)
print(f"{feasible.sum()} of {len(starts)} feasible; all proven: {solutions.proven}")

figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
axes.plot(problem.times[:-1], solutions.controls[feasible, :, 0].T, linewidth=0.5)
axes.set_xlabel("time [s]")
axes.set_ylabel(problem.control_names[0])
