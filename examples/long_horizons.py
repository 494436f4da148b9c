"""
Long horizons and repeated solves
=================================

Long horizons and repeated solves: the Fourier-domain method by name, set up once for many initial states.
"""

import numpy as np

import lin_freq_ocp as lfo

problem = lfo.library.pendulum(horizon=10_000)
result = lfo.solve(problem)  # method="auto" takes it for time-invariant dynamics
print(f"{problem.horizon} steps by method {result.method}: J = {result.cost:.6f}, gap {result.gap:.1e}")

figure = result.plot()
problem = lfo.library.pendulum()
solver = lfo.SpectralSolver(problem)  # everything that does not depend on ends, references and bounds
nominal = solver.solve()
for moved in ([0.002, 0, 0, 0], [0, 0.004, 0, 0], [0, 0, 0.02, 0]):
    start = problem.initial_box.lower + np.array(moved)
    solution = solver.solve(initial_state=start, warm_start=nominal)
    u = solution.trajectory.u
    print(f"from {start}: {solution.status} in {solution.rounds} rounds, largest control {np.abs(u).max():.3f} N")
