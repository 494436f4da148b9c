"""
Several actuators, each with its own band
=========================================

Two forces act on a chain of masses, and each actuator has a stop band of its own.

Four masses vibrate. Forces on the first and on the last one, each at most 0.9 N, bring
them to rest within 20 s. The first actuator follows up to 3.95 Hz, the other one up to
5.95 Hz. The cost weighs positions, speeds and forces.
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
