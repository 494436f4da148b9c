"""Small problems over stages with rows that couple times, as arrays."""

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.methods.structured import Balls, Coupling, Equations, Inequalities, SparseRows, SpectrumRows, Stages


def spectrum(bins, samples, oversampling=1, scale=None):
    """Rows of the first channel."""
    bins = np.asarray(bins)
    scale = np.full(len(bins), 1 / np.sqrt(samples)) if scale is None else scale
    return SpectrumRows(
        np.array([1.0]), np.ones(samples), oversampling * samples, bins, scale, np.ones(2 * len(bins), dtype=bool)
    )


def stages(seed=0, T=12, n=2, k=1, cones=(), coupling=None, bound=2.0, free=False, growth=1.0):
    """Random stages with boxes on w, and with x_1 bounded; cones on all of y."""
    rng = np.random.default_rng(seed)
    A, B = growth * np.eye(n) + 0.1 * rng.standard_normal((T + 1, n, n)), rng.standard_normal((T + 1, n, k))
    A[-1], B[-1] = 0.0, 0.0
    d = 0.05 * rng.standard_normal((T + 1, n))
    d[-1] = 0.0
    root = rng.standard_normal((T + 1, n + k, n + k))
    H = np.einsum("tij,tkj->tik", root, root) / (n + k) + 0.1 * np.eye(n + k)
    H[-1, n:], H[-1, :, n:] = 0.0, 0.0
    H[-1, n:, n:] = np.eye(k)
    h = rng.standard_normal((T + 1, n + k))
    h[-1, n:] = 0.0
    G = np.zeros((T + 1, 2 * k + 1 + sum(cones), n + k))
    G[:, np.arange(k), n + np.arange(k)] = 1.0
    G[:, k + np.arange(k), n + np.arange(k)] = -1.0
    G[:, 2 * k, 0] = 1.0
    g = np.full(G.shape[:2], bound)
    g[-1, : 2 * k], g[0, 2 * k] = np.inf, np.inf
    first = 2 * k + 1
    for size in cones:
        G[:, first + 1 : first + size] = rng.standard_normal((T + 1, size - 1, n + k))
        g[:, first], g[:, first + 1 : first + size] = 3.0, 0.0
        g[2:4, first : first + size] = np.inf
        first += size
    initial = np.full(n, np.nan) if free else rng.standard_normal(n)
    none = Coupling(np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros(0))
    return Stages(A, B, d, H, h, G, g, tuple(cones), initial, coupling or none)


def every_kind(T=12, n=2):
    """Rows of every kind on w_0: a fixed x_T, a stop band, a sum, a mask on a fine grid, a soft energy."""
    kept = np.ones(4, dtype=bool)
    stop = spectrum([5, 6], T)
    kept[3] = False
    stop = SpectrumRows(stop.coefficients, stop.window, stop.points, stop.bins, stop.scale, kept)
    total = sp.csr_array(np.where(np.arange(2 * (T + 1)) % 2 == 0, 1.0, 0.0)[None])
    slack = sp.csr_array(([1.0], ([0], [1])), shape=(1, 2 * (T + 1)))
    mask, energy = spectrum(np.arange(13, 20), T, 4), spectrum([1, 2], T)

    def wider(rows):
        return SpectrumRows(np.array([1.0, 0.0]), rows.window, rows.points, rows.bins, rows.scale, rows.kept)

    return Coupling(
        np.array([n, n + 1]),
        np.array([0]),
        np.array([0.1]),
        (Equations(wider(stop), np.zeros(3)),),
        (Inequalities(SparseRows(total), np.array([0.5])),),
        (Balls(wider(mask), np.full(7, 0.2)), Balls(wider(energy), np.array([0.1]), SparseRows(slack))),
    )
