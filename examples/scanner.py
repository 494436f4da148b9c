"""
Following a triangle wave with a resonant scanner
=================================================

Two stop bands, one around the resonance and one above the bandwidth of the amplifier, united on one drive.
"""

import lin_freq_ocp as lfo

result = lfo.solve(lfo.library.scanner())
print(f"cost {result.cost:.6g}, gap {result.gap:.1e}; {result.certificate.pmp}")
figure = result.plot()
