"""What a trajectory leaves ringing over the natural frequency, within the box of a bound and on its sides."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.terms.semi_infinite import PlantBox
from lin_freq_ocp.problem.trajectory import Trajectory

FREQUENCIES, DAMPINGS = 401, 9  # at which the vibration is shown, and over which its largest value is taken
BESIDE = 1.5  # widths of the box that are shown on each of its sides
LEAST_BESIDE = 0.25  # of its highest frequency, if it is narrow
ABOVE = 3.0  # limits that fit into the picture


def frequencies_around(box: PlantBox) -> Array:
    """Return the natural frequencies at which vibrations are shown, in Hz."""
    low, high = float(box.low[0]), float(box.high[0])
    beside = max(BESIDE * (high - low), LEAST_BESIDE * high)
    return np.linspace(max(low - beside, 0.05 * low), high + beside, FREQUENCIES)


def vibration(box: PlantBox, trajectory: Trajectory, frequencies: Array) -> Array:
    """Return what a trajectory leaves at natural frequencies, the largest over the box's damping ratios."""
    dampings = np.linspace(box.low[1], box.high[1], DAMPINGS)
    modes = np.stack(np.meshgrid(frequencies, dampings, indexing="ij"), axis=-1).reshape(-1, 2)
    signal = box.map.signal(trajectory.x, trajectory.u)
    return np.abs(box.map.placed(modes).transform(signal)).reshape(len(frequencies), -1).max(axis=1)
