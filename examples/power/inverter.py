"""
An inverter with three levels: duty cycles and whole samples
============================================================

An inverter removes the harmonics 5, 7, 11 and 13 from its output.

The output takes the levels -1, 0 and 1 over 96 samples of a period. Its fundamental has
the amplitude 0.9, and the cost is its mean square. With duty cycles, a few samples lie
between two levels, and the harmonics are exactly zero. With whole samples, every sample
takes a level, and the harmonics are at most 0.02: the search starts from the best
rounding of the few samples in between, and proves how much better any other sequence
can be. For free switching angles, see :doc:`switching_angles`.
"""

from dataclasses import replace
from itertools import product

import matplotlib.pyplot as plt
import numpy as np

import lin_freq_ocp as lfo

fundamental = 0.9  # amplitude, of levels -1, 0 and 1: change this number
harmonics, samples, tolerance = [5, 7, 11, 13], 96, 0.02
angle = 2 * np.pi * np.arange(samples) / samples
waves = 2 / samples * np.stack([np.cos(angle), np.sin(angle)], axis=1)
costs = np.array([1, 0, 1]) / samples  # the mean square of the output
duty = lfo.OptimalControlProblem(
    lfo.LinearDynamics(
        np.eye(2),
        waves[:, :, None],
        state_names=["cosine of the fundamental", "sine of the fundamental"],
        control_names=["level"],
    ),
    horizon=samples,
    cost=lfo.QuadraticCost(),
    control_set=lfo.FiniteSet([-1, 0, 1], costs, duty_cycles=True),
    initial_state=[0, 0],
    terminal_state=[0, fundamental],
    control_spectrum=lfo.stop_band(bins=harmonics),
    name="inverter",
)
shared = lfo.solve(duty)
print(f"duty cycles: mean square {shared.cost:.4f}; {shared.level_use}")

# %%
# Whole samples: the harmonics as a mask, and the best of all roundings as a start.
ends = np.array([0, fundamental])
whole = replace(
    duty,
    control_set=lfo.FiniteSet([-1, 0, 1], costs),
    terminal_state=lfo.Box(ends - tolerance, ends + tolerance),
    control_spectrum=lfo.MagnitudeBound(amplitude=tolerance, bins=harmonics),
)
level = shared.control[:, 0].round(6)
between = np.flatnonzero(level % 1)
rounded = np.tile(np.floor(level), (2 ** len(between), 1))
rounded[:, between] += list(product([0, 1], repeat=len(between)))
amplitudes = 2 / samples * np.fft.rfft(rounded)[:, [1, *harmonics]]
errors = np.abs(amplitudes - [-1j * fundamental, 0, 0, 0, 0]).max(axis=1)
start = rounded[errors.argmin()]
print(f"best of {len(rounded)} roundings: harmonics within {errors.min():.4f}")

search = lfo.solvers.BranchAndBound(node_limit=50)
result = lfo.solve(whole, search, start=start[:, None], throw=False)
print(f"mean square {result.cost:.4f}, none below {result.lower_bound:.4f}")
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
degrees = np.degrees(angle)
axes.step(degrees, level, where="post", linewidth=3, alpha=0.5, label="duty cycles")
axes.step(degrees, result.control, where="post", label="whole samples")
axes.set(xlabel="angle [deg]", ylabel="level")
axes.legend()
figure.savefig("inverter.png")
print("picture: inverter.png")
