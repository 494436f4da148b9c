"""
A smooth map: swing up a pendulum
=================================

The torque is too small to lift the pendulum at once.

Newton's method on the maximum principle finds a local optimum, and the status says so.
"""

import lin_freq_ocp as lfo

result = lfo.solve(lfo.library.pendulum_swing_up(), global_bound=False)
print(f"{result.status}: cost {result.cost:.6f}; {result.certificate.pmp}")
figure = result.plot()
