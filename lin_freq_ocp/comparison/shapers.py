"""Input shapers: impulses by which the acceleration of a move is convolved, so that a mode does not ring after it.

With the half period of damped vibration, pi / (w sqrt(1 - zeta^2)), and K = exp(-zeta pi / sqrt(1 - zeta^2)), which is
what a vibration keeps over it, impulses half a period apart have the amplitudes, but for the factor that makes their
sum one,

    ZV   1, K                zero vibration at (w, zeta);
    ZVD  1, 2 K, K^2         and its derivative by w is zero: ZV convolved with itself;
    EI   (1 + V)/4, (1 - V)/2 K, (1 + V)/4 K^2    V of the vibration there, and zero on both sides of w.

The formula of EI is exact without damping, and the usual first approximation with it. Impulses stand on the samples
nearest to their times.

References: Singer and Seering, Journal of Dynamic Systems, Measurement, and Control 112, 1990 (ZV, ZVD). Singhose,
Command Generation for Flexible Systems, PhD thesis, MIT 1997 (EI).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.terms.semi_infinite import PlantBox

INSENSITIVITY = 0.05  # V of EI: the customary 5 %


def zero_vibration(K: float) -> Array:
    """Return the amplitudes of ZV, not scaled."""
    return np.array([1.0, K])


def zero_derivative(K: float) -> Array:
    """Return the amplitudes of ZVD, not scaled."""
    return np.array([1.0, 2 * K, K**2])


def extra_insensitive(K: float) -> Array:
    """Return the amplitudes of EI, not scaled."""
    V = INSENSITIVITY
    return np.array([(1 + V) / 4, (1 - V) / 2 * K, (1 + V) / 4 * K**2])


SHAPERS: dict[str, Callable[[float], Array]] = {"ZV": zero_vibration, "ZVD": zero_derivative, "EI": extra_insensitive}


def impulses(name: str, box: PlantBox) -> Array:
    """Return the impulses of a shaper for the middle of a box of modes, on the samples; their sum is one."""
    frequency, damping = (box.low + box.high) / 2
    root = float(np.sqrt(1 - damping**2))
    amplitudes = SHAPERS[name](float(np.exp(-np.pi * damping / root)))
    half_period = 1 / (2 * frequency * root * box.sampling_time)
    at = np.rint(half_period * np.arange(len(amplitudes))).astype(int)
    found = np.zeros(at[-1] + 1)
    np.add.at(found, at, amplitudes / amplitudes.sum())
    return found


def shaped(name: str, box: PlantBox, u: Array) -> Array:
    """Return controls (T, m), each convolved with the impulses of a shaper, and longer by their length less one."""
    given = impulses(name, box)
    return np.stack([np.convolve(column, given) for column in u.T], axis=1)


def described(name: str, box: PlantBox) -> str:
    """Return the impulses of a shaper in words."""
    given = impulses(name, box)
    at = np.flatnonzero(given)
    return ", ".join(f"{given[t]:.4g} at t = {t}" for t in at)
