"""
Power electronics: which levels an inverter takes
=================================================

Five levels, a fundamental of 1.5, harmonics 3, 5 and 7 removed. A few samples stay between two levels, as duty cycles.
"""

import lin_freq_ocp as lfo

result = lfo.solve(lfo.library.pulse_pattern(kind="shep", samples=128))
print(f"cost {result.cost:.8f}, no waveform below {result.lower_bound:.8f}")
print(result)
figure = result.plot()
