"""
An active suspension: less vibration where passengers feel it
=============================================================

A car crosses a bump with little vertical acceleration at 4 to 8 Hz.

Passengers are most sensitive in this band: it is bounded in the acceleration of the body.
"""

import lin_freq_ocp as lfo

comparison = lfo.compare(lfo.library.quarter_car())
constrained, classical = comparison.constrained.cost, comparison.classical.cost
print(f"with the bound: cost {constrained:.6g}; without: {classical:.6g}")
figure = comparison.plot()
