"""
The price of bandwidth
======================

A sweep over the cut-off shows how much a faster actuator would save.
"""

import lin_freq_ocp as lfo

table = lfo.sweep(lfo.library.pendulum, {"cutoff": [0.7, 0.8, 1.0, 1.25, 1.5, 2.0, 3.0]})
print(table)
figure = table.plot()
