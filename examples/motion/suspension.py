"""
An active suspension: less vibration where passengers feel it
=============================================================

A car crosses a bump without vertical motion of its body at 4 to 8 Hz.

The bump is 8 cm high and 0.25 s long. The suspension has a force of at most 2 kN and a
travel of 7.5 cm. The cost weighs the acceleration of the body, the deflection of the tyre
and the force. Passengers are most sensitive between 4 and 8 Hz: the speed of the body has
no bins in this band.
"""

import lin_freq_ocp as lfo

comparison = lfo.compare(lfo.library.quarter_car())
constrained, classical = comparison.constrained.cost, comparison.classical.cost
print(f"with the stop band: cost {constrained:.6g}; without: {classical:.6g}")
figure = comparison.plot()
