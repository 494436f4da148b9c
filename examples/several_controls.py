"""
Several actuators, several bands
================================

Several controls, each with an actuator of its own: different stop bands on the two forces of a chain of masses.
"""

import lin_freq_ocp as lfo

problem = lfo.library.mass_chain()
result = lfo.solve(problem)
for j, name in enumerate(problem.control_names):
    removed = problem.control_stop[:, j].sum()
    print(f"{name}: {removed} bins removed, largest value {abs(result.control[:, j]).max():.3f}")
print(result)
figure = result.plot()
