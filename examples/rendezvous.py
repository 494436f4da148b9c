"""
Satellites: rendezvous in an elliptic orbit
===========================================

The dynamics vary in time, so the structured method solves it. The thrust changes slowly: a low pass.
"""

import lin_freq_ocp as lfo

result = lfo.solve(lfo.library.elliptic_rendezvous())
print(f"solved by method {result.method}: cost {result.cost:.6g}, gap {result.gap:.1e}; {result.certificate.pmp}")
figure = result.plot()
