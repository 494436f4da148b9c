"""
Satellites: a turn that does not ring the panels
================================================

A satellite turns by 60 degrees. One stop band for each of two modes of its panels, on the modes themselves.
"""

import lin_freq_ocp as lfo

problem = lfo.library.flexible_satellite()
result = lfo.solve(problem)
removed = int(problem.state_stop.sum())
print(f"{removed} bins of states removed, largest torque {abs(result.control).max():.4g}; {result.certificate.pmp}")
figure = result.plot()
