"""
Wave energy: a plant known by its frequency response
====================================================

A buoy absorbs the most power from a wave, with a bounded force.

The plant is a buoy in heave, known only by a table of complex responses from force [N]
to velocity [m/s]. The wave has 0.3 Hz and an amplitude of 62.5 mm, and the record of
20 s repeats. The cost is minus the mean absorbed power [W]. The force is unlimited, or
at most 2000 N or 1000 N.
"""

import lin_freq_ocp as lfo

for force in (None, 2000.0, 1000.0):
    result = lfo.solve(lfo.library.wave_energy(force=force))
    bound = "free" if force is None else f"{force:g} N"
    print(f"force {bound:>7}: mean power {-result.cost:.5f} W, gap {result.gap:.0e}")
figure = result.plot()
