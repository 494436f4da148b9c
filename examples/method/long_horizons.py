"""
Ten thousand steps, and repeated solves
=======================================

The Fourier-domain method solves a long horizon, and many initial states with one set-up.

A cart moves an inverted pendulum by 0.3 m with a low-passed force of at most 5 N: first
over 10 000 steps of 10 ms, then over 240 steps from different initial states.
"""

import numpy as np

import lin_freq_ocp as lfo

problem = lfo.library.pendulum(horizon=10_000)
result = lfo.solve(problem)  # "auto" chooses the Fourier-domain method
print(f"{problem.horizon} steps by method {result.method}: gap {result.gap:.1e}")

figure = result.plot()
problem = lfo.library.pendulum()
solver = lfo.SpectralSolver(
    problem
)  # sets up everything that ends and bounds do not change
nominal = solver.solve()
for moved in ([0.002, 0, 0, 0], [0, 0.004, 0, 0], [0, 0, 0.02, 0]):
    start = problem.initial_box.lower + np.array(moved)
    solution = solver.solve(initial_state=start, warm_start=nominal)
    largest = np.abs(solution.trajectory.u).max()
    print(f"from {start}: {solution.status}, largest control {largest:.3f} N")
