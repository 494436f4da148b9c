"""
An infeasible problem: the conflict, and its repairs
====================================================

An actuator is too slow for its task, and the error names the constraints in conflict.

The force on the cart of a pendulum follows only 5.6 Hz (0.35 rad/sample), which does not
suffice to move the pendulum within 2.4 s. For each constraint in conflict, the error
gives the smallest change that restores feasibility.
"""

import lin_freq_ocp as lfo

problem = lfo.library.pendulum(cutoff=0.35)
try:
    lfo.solve(problem)
except lfo.errors.InfeasibleError as error:
    print(error)

# one of the repairs: a larger bound on the force
repaired = lfo.library.pendulum(cutoff=0.35, control_bound=5.54)
result = lfo.solve(repaired)
print(f"with 5.54 N instead of 5 N: cost {result.cost:.6g}, {result.certificate.pmp}")
figure = result.plot()
