"""
MRI: the shortest gradient pulse
================================

The shortest gradient pulse with given moments, and the proof that one sample less is not enough.
"""

import lin_freq_ocp as lfo

found = lfo.minimum_time(lfo.library.mri_gradient, horizons=(120, 140))
print(found)
pulse = found.result.control[:, 0]
print(f"{found.horizon} samples of 10 us, at most {abs(pulse).max():.6g} mT/m; {found.proof}")
figure = found.result.plot()
