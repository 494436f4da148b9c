"""Orthonormal real rows of the DFT: a stop band as linear equations of full rank."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.arrays import Array, ComplexArray, Mask


def real_rows(length: int, stopped: Mask) -> Array:
    """Return R, shape (rows, length), with R v = 0 iff the stopped DFT bins of v are zero, and R R' = I.

    Bins 0 and length/2 have one row, cos(2 pi k t/N)/sqrt(N); every other bin k has two, sqrt(2/N) cos(2 pi k t/N)
    and -sqrt(2/N) sin(2 pi k t/N), one after the other.

    Parameters
    ----------
    length : int
        N, samples of the signal.
    stopped : (N//2 + 1,)
        Which bins are removed.
    """
    k = np.flatnonzero(stopped)
    angle = 2 * np.pi * (np.outer(k, np.arange(length)) % length) / length
    pairs = np.stack([np.cos(angle), -np.sin(angle)], axis=1) * np.sqrt(2 / length)
    pairs[_single(k, length)] /= np.sqrt(2)
    return pairs.reshape(-1, length)[_kept(k, length)]


def bin_multipliers(length: int, stopped: Mask, rho: Array) -> ComplexArray:
    """Return the multipliers per bin in the units of the DFT, shape (N//2 + 1,), from one real dual per row of R."""
    k = np.flatnonzero(stopped)
    pairs = np.zeros(2 * len(k))
    pairs[_kept(k, length)] = rho
    values = np.sqrt(2 / length) * (pairs[::2] + 1j * pairs[1::2])
    values[_single(k, length)] /= np.sqrt(2)
    result = np.zeros(len(stopped), dtype=np.complex128)
    result[k] = values
    return result


def _single(k: np.ndarray, length: int) -> Mask:
    return (k == 0) | (2 * k == length)


def _kept(k: np.ndarray, length: int) -> Mask:
    """Which of the (cos, sin) rows exist: all but the sine rows of the real bins, which are zero."""
    kept = np.ones(2 * len(k), dtype=bool)
    kept[1::2] = ~_single(k, length)
    return kept
