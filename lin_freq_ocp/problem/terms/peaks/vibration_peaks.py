"""Local maxima of the residual vibration on the edges of a box of modes: sampled, refined by Newton's method."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.terms.continua.vibration import PlantBox

FINENESS = 16  # points for each bin of the signal's DFT
STEPS = 4  # of Newton's method, from 1/16 of a bin: quadratic from the first on
DIFFERENCE = 1e-2  # distance of the points of differences, in that of the samples: they err by 1e-5 of a step
FARTHEST = 2.0  # distances of the samples that a maximum may be from the sample


def vibration_peaks(box: PlantBox, x: Array, u: Array, above: float) -> tuple[Array, Array]:
    """Return the modes of local maxima of |V|/limit above a ratio, (peaks, 2), and these ratios, (peaks,)."""
    signal, places = box.map.signal(x, u), list[Array]()
    for edge in box.edges:
        share = np.linspace(0.0, 1.0, int(np.ceil(FINENESS * box.bins(edge))) + 1)
        ratio = _ratios(box, signal, box.modes_on(edge, share))
        padded = np.concatenate([[-np.inf], ratio, [-np.inf]])
        highest = (ratio >= padded[:-2]) & (ratio >= padded[2:]) & (ratio > above * (1 - 1 / FINENESS))
        places.append(box.modes_on(edge, _refined(box, signal, edge, share[highest], 1.0 / max(len(share) - 1, 1))))
    found = np.unique(np.concatenate(places), axis=0)
    ratios = _ratios(box, signal, found)
    return found[ratios > above], ratios[ratios > above]


def _refined(box: PlantBox, signal: Array, edge: tuple[complex, complex], start: Array, step: float) -> Array:
    share, d = start, DIFFERENCE * step
    for _ in range(STEPS):
        inner = np.clip(share, d, 1 - d)
        left, here, right = (np.log(_ratios(box, signal, box.modes_on(edge, inner + move))) for move in (-d, 0.0, d))
        slope, curvature = (right - left) / (2 * d), (right - 2 * here + left) / d**2
        move = np.where(curvature < 0, -slope / np.where(curvature < 0, curvature, 1.0), np.sign(slope) * step)
        share = np.clip(np.clip(inner + move, start - FARTHEST * step, start + FARTHEST * step), 0.0, 1.0)
    return share


def _ratios(box: PlantBox, signal: Array, modes: Array) -> Array:
    return np.abs(box.map.placed(modes).transform(signal)) / box.limit
