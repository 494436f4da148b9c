"""
MRI: the shortest gradient pulse that spares two acoustic bands
===============================================================

The shortest gradient pulse with a moment of 5 mT/m ms and no first moment.

The amplitude is at most 33 mT/m, the slew rate 150 T/m/s, and the spectrum is small at
every frequency of two bands where the scanner is loud. The moments are states with
A = I, to which the samples of the pulse add, so that their dynamics depend on time:
``minimum_time`` takes a function that builds the problem for each horizon.
"""

from dataclasses import replace

import numpy as np

import lin_freq_ocp as lfo

bands_hz = [(550, 650), (1000, 1150)]  # of your scanner: change these numbers
raster = 0.02  # ms
amplitude, change = 33.0, 150.0 * raster  # mT/m; 150 T/m/s: change per sample, in mT/m
level = 50.0  # mT/m: largest |sum of g_t exp(-i w t)| within the bands


def pulse(horizon: int) -> lfo.OptimalControlProblem:
    """Return the problem of a pulse with so many samples."""
    centres = raster * (np.arange(horizon) + 0.5)
    gains = raster * np.stack([np.ones(horizon), centres], axis=1)
    moments = lfo.LinearDynamics(
        np.eye(2),
        gains[:, :, None],
        sampling_time=1e-3 * raster,
        state_names=["zeroth moment [mT/m ms]", "first moment [mT/m ms^2]"],
        control_names=["gradient [mT/m]"],
    )
    bands = [
        lfo.spectrum.notch(centre_hz=(a + b) / 2, width_hz=b - a) for a, b in bands_hz
    ]
    problem = lfo.OptimalControlProblem(
        moments,
        horizon,
        cost=lfo.QuadraticCost(R=1.0),
        control_set=lfo.Box(-amplitude, amplitude),
        initial_state=[0, 0],
        terminal_state=[5, 0],
        control_spectrum=[
            lfo.MagnitudeBound(level, band=band, every_frequency=True) for band in bands
        ],
        name="gradient pulse",
    )
    limited = lfo.rate_limited(problem, change, previous=[0.0])
    ends = [5, 0, 0]  # both moments, and the last sample
    return replace(limited, terminal_state=ends)


print("The search for the shortest pulse takes some seconds.")
minimum = lfo.minimum_time(pulse, horizons=(20, 120))
print(f"{minimum.horizon} samples of {1e3 * raster:g} us; {minimum.proof}")
figure = minimum.result.plot()
figure.savefig("minimum_time.png")
print("picture: minimum_time.png")
