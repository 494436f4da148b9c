"""
The price of bandwidth
======================

A sweep over the cut-off shows how much a faster actuator would save.

A cart moves an inverted pendulum by 0.3 m within 2.4 s. The cut-off of its force varies
from 0.7 to 3 rad/sample, 11 to 48 Hz.
"""

import lin_freq_ocp as lfo

table = lfo.sweep(lfo.library.pendulum, {"cutoff": [0.7, 0.8, 1.0, 1.25, 1.5, 2.0, 3.0]})
print(table)
figure = table.plot()
