"""
Nothing is feasible: why, and what would help
=============================================

An actuator too slow for the task. The conflict is proven by a ray, and the least changes that cure it are computed.
"""

import lin_freq_ocp as lfo

problem = lfo.library.pendulum(cutoff=0.35)
try:
    lfo.solve(problem)
except lfo.errors.InfeasibleError as error:
    print(error)

# one of the cures: the bound on the force
cured = lfo.library.pendulum(cutoff=0.35, control_bound=5.54)
result = lfo.solve(cured)
print(f"with 5.54 N instead of 5 N: cost {result.cost:.6g}, {result.certificate.pmp}")
figure = result.plot()
