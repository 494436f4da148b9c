"""
A mask between the bins
=======================

A stop band acts at the bins of the DFT; a mask on a finer grid acts between them, too.

A force of at most 5 N moves an inverted pendulum within 240 samples. Bins 97 to 143 of
its spectrum are zero, or the spectrum in this band is at most 1 % of its peak without a
frequency constraint.
"""

from dataclasses import replace

import numpy as np

import lin_freq_ocp as lfo

BAND = range(97, 144)  # the stop band of the pendulum, in bins of its 240 samples
FINE = 16  # points per bin at which the spectrum is computed


def peak(u: np.ndarray) -> float:
    """Return the largest magnitude of the zero-padded spectrum within the band."""
    spectrum = np.abs(np.fft.rfft(u[:, 0], n=FINE * len(u)))
    return float(spectrum[FINE * BAND[0] :].max())


bins_only = lfo.library.pendulum()
classical = lfo.solve(lfo.library.pendulum(cutoff=None))
level = 0.01 * peak(classical.trajectory.u)
mask = lfo.MagnitudeBound(level, bins=BAND, oversampling=4, between=True)
masked = replace(bins_only, control_spectrum=mask)

print(f"mask: 1 % of the classical peak in the band, {level:.4g} N")
for name, result in (
    ("classical", classical),
    ("bins only", lfo.solve(bins_only)),
    ("mask", lfo.solve(masked)),
):
    certificate = result.certificate
    print(
        f"{name:10} cost {certificate.cost:10.2f}   "
        f"peak in the band {peak(result.trajectory.u):.4g} N   "
        f"{certificate.pmp}, gap {certificate.gap:.0e}"
    )
figure = lfo.solve(masked).plot()
