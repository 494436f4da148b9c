"""
Wave energy: a plant known by its frequency response
====================================================

A buoy absorbs the most power from a wave, with a bounded force.

Its plant is a table of complex responses over frequency, without a state-space model.
"""

import lin_freq_ocp as lfo

for force in (None, 2000.0, 1000.0):
    result = lfo.solve(lfo.library.wave_energy(force=force))
    bound = "free" if force is None else f"{force:g} N"
    print(f"force {bound:>7}: mean power {-result.cost:.5f} W, gap {result.gap:.0e}")
figure = result.plot()
