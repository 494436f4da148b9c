"""
Several actuators, each with its own band
=========================================

Two forces act on a chain of masses, and each actuator has a stop band of its own.
"""

import lin_freq_ocp as lfo

problem = lfo.library.mass_chain()
result = lfo.solve(problem)
for j, name in enumerate(problem.control_names):
    removed = problem.control_stop[:, j].sum()
    largest = abs(result.control[:, j]).max()
    print(f"{name}: {removed} bins removed, largest value {largest:.3f}")
print(result)
figure = result.plot()
