"""
Vibration: an active suspension that spares its passengers
==========================================================

A car crosses a bump; the band in which passengers are sensitive is bounded in the acceleration of the body.
"""

import lin_freq_ocp as lfo

comparison = lfo.compare(lfo.library.quarter_car())
print(f"spared: cost {comparison.constrained.cost:.6g}; not spared: {comparison.classical.cost:.6g}")
figure = comparison.plot()
