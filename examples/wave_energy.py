"""
Wave energy: a plant known by its frequency response
====================================================

A buoy absorbs the most power from a wave. Its plant is a table of responses; the force is bounded at every sample.
"""

import lin_freq_ocp as lfo

for force in (None, 2000.0, 1000.0):
    result = lfo.solve(lfo.library.wave_energy(force=force))
    print(
        f"force {'free' if force is None else f'{force:g} N':>7}: mean power {-result.cost:.5f} W, gap {result.gap:.0e}"
    )
figure = result.plot()
