"""
A rendezvous in an elliptic orbit
=================================

A satellite approaches another one in an elliptic orbit with a slowly changing thrust.

The dynamics vary in time, so the structured interior-point method solves the problem.
"""

import lin_freq_ocp as lfo

result = lfo.solve(lfo.library.elliptic_rendezvous())
print(f"solved by method {result.method}: cost {result.cost:.6g}, gap {result.gap:.1e}")
figure = result.plot()
