"""
A smooth map: swing up a pendulum
=================================

The torque is too small to lift the pendulum at once.

A pendulum of 1 kg and 1 m hangs at rest, and must stand upright at rest after 4 s. The
torque is at most 5 N m, half of the torque that holds the pendulum level. The cost weighs
torque, angle and rate. Newton's method on the maximum principle finds a local optimum,
and the status says so.
"""

import lin_freq_ocp as lfo

result = lfo.solve(lfo.library.pendulum_swing_up(), global_bound=False)
print(f"{result.status}: cost {result.cost:.6f}; {result.certificate.pmp}")
figure = result.plot()
