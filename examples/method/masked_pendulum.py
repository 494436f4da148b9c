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

PART = 0.01  # of the peak without a frequency constraint: change this number
BAND = range(97, 144)  # the stop band of the force, in bins of its 240 samples
FINE = 16  # points per bin at which the spectrum is computed


def peak(u: np.ndarray) -> float:
    """Return the largest magnitude of the zero-padded spectrum within the band."""
    spectrum = np.abs(np.fft.rfft(u[:, 0], n=FINE * len(u)))
    return float(spectrum[FINE * BAND[0] :].max())


cart = lfo.LinearDynamics.from_continuous(  # of 2.5 kg, with a pendulum of 0.6 kg
    [[0, 0, 1, 0], [0, 0, 0, 1], [0, -0.9645933, 0, 0], [0, 19.934928, 0, 0]],
    [[0], [0], [0.38277512], [-0.65618592]],
    sampling_time=0.01,
    state_names=["position [m]", "angle [rad]", "speed [m/s]", "angular speed [rad/s]"],
    control_names=["force [N]"],
)
free = lfo.OptimalControlProblem(
    cart,
    horizon=240,
    cost=lfo.QuadraticCost(R=2.0),
    control_set=lfo.Box(-5, 5),
    state_set=lfo.Box([-0.2, -np.pi / 9, -15, -30], [0.2, np.pi / 9, 15, 30]),
    initial_state=[-0.15, 0.1, 0, 0],
    terminal_state=[0.15, -0.1, 0, 0],
    name="masked pendulum",
)
classical = lfo.solve(free)
level = PART * peak(classical.control)
mask = lfo.MagnitudeBound(level, bins=BAND, oversampling=4, between=True)
masked = lfo.solve(replace(free, control_spectrum=mask))
bins_only = lfo.solve(replace(free, control_spectrum=lfo.stop_band(bins=BAND)))

print(f"mask: {PART:.0%} of the classical peak in the band, {level:.4g} N")
for name, result in (
    ("classical", classical),
    ("bins only", bins_only),
    ("mask", masked),
):
    certificate = result.certificate
    print(
        f"{name:10} cost {certificate.cost:10.2f}   "
        f"peak in the band {peak(result.control):.4g} N   "
        f"{certificate.pmp}, gap {certificate.gap:.0e}"
    )
figure = masked.plot()
figure.savefig("masked_pendulum.png")
print("picture: masked_pendulum.png")
