"""
A rendezvous in an elliptic orbit
=================================

A satellite approaches another one in an elliptic orbit with a slowly changing thrust.

The chaser starts 10 km behind its target and meets it after 4 h. Both thrusts are at most
0.1 mm/s^2, with no frequencies above 0.3 mHz, and the radial distance is at most 0.8 km.
The dynamics vary in time, so the structured interior-point method solves the problem.
Without a C compiler, the sparse program takes less time and is solved instead.
"""

import lin_freq_ocp as lfo

result = lfo.solve(lfo.library.elliptic_rendezvous())
print(f"solved by method {result.method}: cost {result.cost:.6g}, gap {result.gap:.1e}")
figure = result.plot()
