"""Local maxima of a spectrum relative to its limit: from a zero-padded FFT, refined by Newton's method.

Of f = ln |V|^2 - 2 ln l:  f' = 2 Re(V'/V) - 2 l'/l,  f'' = 2 Re(V''/V - (V'/V)^2) + 2 (l'/l)^2. Of a held signal, V
is multiplied by a factor S, the derivatives of ln S^2 are added, and the FFT's period is 2 pi.
"""

from __future__ import annotations

import numpy as np
from scipy import fft

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.terms.continuum import Frequencies

FINENESS = 16  # points of the FFT for each sample
STEPS = 4  # of Newton's method, from 1/16 of a bin: quadratic from the first on


def spectral_peaks(everywhere: Frequencies, x: Array, u: Array, above: float) -> tuple[Array, Array]:
    """Return where |V|/l has local maxima above a ratio, in rad/sample, and these ratios, both (peaks,)."""
    signal, limits = everywhere.map.signal(x, u), everywhere.limits
    points = fft.next_fast_len(FINENESS * len(signal), real=True)
    step, spectrum, places = 2 * np.pi / points, np.abs(fft.rfft(signal, n=points)), list[Array]()
    for low, high, at_low, at_high in zip(limits.low, limits.high, limits.at_low, limits.at_high, strict=True):
        k = np.arange(int(low / step), int(high / step) + 2)
        k = k[(step * k > low) & (step * k < high)]
        w = np.concatenate([[low], step * k, [high]])
        ends = np.abs(everywhere.map.placed(w[[0, -1]]).transform(signal))
        inner = spectrum[np.minimum(k % points, -k % points)] * everywhere.factor(w[1:-1])
        slope = (at_high - at_low) / (high - low) if high > low else 0.0
        ratio = np.concatenate([ends[:1], inner, ends[1:]]) / (at_low + slope * (w - low))
        padded = np.concatenate([[-np.inf], ratio, [-np.inf]])
        highest = (ratio >= padded[:-2]) & (ratio >= padded[2:]) & (ratio > above * (1 - 1 / FINENESS))
        places.append(_refined(everywhere, signal, w[highest], (low, high), at_low, slope, np.pi / points))
    found = np.unique(np.concatenate(places))
    ratios = np.abs(everywhere.map.placed(found).transform(signal)) / limits.at(found)
    return found[ratios > above], ratios[ratios > above]


def _refined(
    everywhere: Frequencies,
    signal: Array,
    w: Array,
    ends: tuple[float, float],
    level: float,
    slope: float,
    reach: float,
) -> Array:
    start, t = w, np.arange(len(signal))
    for _ in range(STEPS):
        at = everywhere.map.placed(w)
        V, first, second = (at.transform(part) for part in (signal, t * signal, -(t**2.0) * signal))
        V = np.where(V == 0, 1.0, V)
        growth, limit = -1j * first / V, slope / (level + slope * (w - ends[0]))
        slope_of_factor, bend_of_factor = everywhere.log_slopes(w)
        steepness = 2 * growth.real - 2 * limit + 2 * slope_of_factor
        curvature = 2 * (second / V - growth**2).real + 2 * limit**2 + 2 * bend_of_factor
        step = np.where(curvature < 0, -steepness / np.where(curvature < 0, curvature, 1.0), 0.0)
        w = np.clip(np.clip(w + step, start - 2 * reach, start + 2 * reach), *ends)
    return w
