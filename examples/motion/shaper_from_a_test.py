"""
An input shaper from the resonance test of a printer
====================================================

A test of resonances writes the power over frequency. Which shaper fits, beside MZV?

The file has the columns of a 3D printer's firmware; here it is made of two resonances,
at 41 and 57 Hz. The bands are where the power exceeds a share of its largest value.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

frequencies = np.arange(5.0, 120.0, 0.5)
resonances = {
    41.0: 1.0,
    57.0: 0.5,
}  # Hz, power: change these numbers, or read your file
power = sum(size / (1 + ((frequencies - f) / 2) ** 2) for f, size in resonances.items())
with TemporaryDirectory() as folder:
    path = Path(folder) / "calibration_data_x.csv"
    rows = [f"{f:.1f},{p:.6f}" for f, p in zip(frequencies, power, strict=True)]
    path.write_text("\n".join(["freq,psd_xyz", *rows]))
    bands = lfo.io.read_calibration(path, share=0.2)
print("bands [Hz]", bands)
print("The search takes some seconds.")
shaper = lfo.shaper(bands, damping=(0.05, 0.2), vibration=0.05)
print(shaper)

# %%
# MZV keeps the limit at no frequency here. It is drawn as made for the middle of the
# bands, for modes with a damping ratio of 0.05.

middle = (bands[0][0] + bands[-1][1]) / 2
period, low = 1 / middle, 1 - 0.5**0.5
amplitudes, times = np.array([low, 2**0.5 - 1, low]), 0.375 * period * np.arange(3)
s = 2 * np.pi * frequencies * (-0.05 + 1j * np.sqrt(1 - 0.05**2))
mzv = np.abs(np.exp(np.outer(s, times[-1] - times)) @ amplitudes) / amplitudes.sum()
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for name, left in (("ours", shaper.vibration(frequencies, 0.05)), ("MZV", mzv)):
    axes.plot(frequencies, 100 * left, label=name)
for band in bands:
    axes.axvspan(*band, alpha=0.15, linewidth=0)
axes.set(xlabel="natural frequency [Hz]", ylabel="vibration [%]", xlim=(20, 100))
axes.legend()
figure.savefig("shaper_from_a_test.png")
print("picture: shaper_from_a_test.png")
