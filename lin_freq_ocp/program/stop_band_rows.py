"""Stop bands as rows of a program: orthonormal real rows of the DFT, and their multipliers per bin."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask


def real_rows(length: int, stopped: Mask) -> Array:
    """Return R, shape (rows, length), with R v = 0 iff the stopped DFT bins of v are zero, and R R' = I.

    Bins 0 and length/2 have one row, cos(2 pi k t/N)/sqrt(N); every other bin k has two, sqrt(2/N) cos(2 pi k t/N)
    and -sqrt(2/N) sin(2 pi k t/N), one after the other. ``length`` is N, ``stopped`` (N//2 + 1,) says which bins.
    """
    k = np.flatnonzero(stopped)
    angle = 2 * np.pi * (np.outer(k, np.arange(length)) % length) / length
    pairs = np.stack([np.cos(angle), -np.sin(angle)], axis=1) * np.sqrt(2 / length)
    pairs[_is_real_bin(k, length)] /= np.sqrt(2)
    return pairs.reshape(-1, length)[_existing_rows(k, length)]


def bin_multipliers(length: int, stopped: Mask, rho: Array) -> ComplexArray:
    """Return the multipliers per bin in the units of the DFT, shape (N//2 + 1,), from one real dual per row of R."""
    k = np.flatnonzero(stopped)
    pairs = np.zeros(2 * len(k))
    pairs[_existing_rows(k, length)] = rho
    values = np.sqrt(2 / length) * (pairs[::2] + 1j * pairs[1::2])
    values[_is_real_bin(k, length)] /= np.sqrt(2)
    result = np.zeros(len(stopped), dtype=np.complex128)
    result[k] = values
    return result


def stop_band_rows(stop: Mask, length: int, columns: int, first: int) -> sp.csc_array:
    """Return the rows of stopped bins, ``stop`` (bins, components).

    Component j at time t is the column first + components * t + j.
    """
    components = stop.shape[1]
    parts = [sp.csc_array((0, columns))]
    for j in range(components):
        rows = real_rows(length, stop[:, j])
        column = first + np.arange(length) * components + j
        row, time = np.nonzero(np.ones_like(rows, dtype=bool))
        parts.append(sp.csc_array((rows.ravel(), (row, column[time])), shape=(len(rows), columns)))
    return sp.csc_array(sp.vstack(parts))


def rows_per_component(stop: Mask, length: int) -> Indices:
    """Return the number of rows of each component."""
    real = _is_real_bin(np.arange(len(stop)), length)[:, None]
    return (stop * np.where(real, 1, 2)).sum(axis=0)


def stop_band_multipliers(stop: Mask, length: int, rho: Array) -> ComplexArray:
    """Return the multipliers per bin (bins, components) from the duals of ``stop_band_rows``."""
    parts = np.split(rho, np.cumsum(rows_per_component(stop, length))[:-1])
    return np.stack([bin_multipliers(length, stop[:, j], part) for j, part in enumerate(parts)], axis=1)


def _is_real_bin(k: np.ndarray, length: int) -> Mask:
    return (k == 0) | (2 * k == length)


def _existing_rows(k: np.ndarray, length: int) -> Mask:
    """Which of the (cos, sin) rows exist: all but the sine rows of the real bins, which are zero."""
    kept = np.ones(2 * len(k), dtype=bool)
    kept[1::2] = ~_is_real_bin(k, length)
    return kept
