"""The maps of a problem's terms as sparse rows on (x_0 .. x_T, u_0 .. u_{T-1}); spectra by cosines and sines."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.problem.terms.maps import SpectrumMap, StageMap, SumMap, TrajectoryMap


def map_rows(one: TrajectoryMap, horizon: int, n: int, m: int) -> tuple[sp.csr_array, Array]:
    """Return L, (groups * dim, signals), and c with values = L (x, u) + c, one group after the other."""
    if isinstance(one, StageMap):
        of_x = _stages(one.C, one.times, horizon + 1, n, one.shape)
        of_u = _stages(one.D, one.times, horizon, m, one.shape)
        constant = np.broadcast_to(one.constant, one.shape).ravel()
    elif isinstance(one, SpectrumMap):
        of_x, of_u = _spectrum(one, one.C, horizon + 1, n), _spectrum(one, one.D, horizon, m)
        constant = np.zeros(of_x.shape[0])
    else:
        of_x, of_u = _sums(one, one.Phi, horizon + 1, n), _sums(one, one.Psi, horizon, m)
        constant = one.constant
    rows = sp.csr_array(sp.hstack([of_x, of_u]))
    rows.eliminate_zeros()
    return rows, constant


def _stages(matrix: Array | None, times: Indices, samples: int, columns: int, shape: tuple[int, int]) -> sp.csr_array:
    groups, dim = shape
    if matrix is None:
        return sp.csr_array((groups * dim, samples * columns))
    blocks = np.broadcast_to(matrix, (groups, dim, columns))
    return sp.csr_array(sp.bsr_array((blocks, times, np.arange(groups + 1)), shape=(groups * dim, samples * columns)))


def _spectrum(one: SpectrumMap, row: Array | None, samples: int, columns: int) -> sp.csr_array:
    t = np.arange(len(one.window))
    angle = 2 * np.pi * (np.outer(one.bins, t) % one.points) / one.points
    waves = np.stack([np.cos(angle), -np.sin(angle)], axis=1) * one.window
    waves[one.single, 1] = 0.0  # and not the rounding error of sin(pi t)
    kept = np.ones((len(one.bins), 2), dtype=bool)
    if one.together:
        kept[one.single, 1] = False
    waves = waves.reshape(-1, len(t))[kept.ravel()]
    if row is None:
        return sp.csr_array((len(waves), samples * columns))
    rows = sp.csr_array(sp.kron(sp.csr_array(waves), row[None]))
    return sp.csr_array((rows.data, rows.indices, rows.indptr), shape=(len(waves), samples * columns))


def _sums(one: SumMap, matrices: Array | None, samples: int, columns: int) -> sp.csr_array:
    dim = len(one.constant)
    if matrices is None:
        return sp.csr_array((dim, samples * columns))
    return sp.csr_array(np.swapaxes(matrices, 0, 1).reshape(dim, samples * columns))
