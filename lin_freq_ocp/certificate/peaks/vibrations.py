"""The largest residual vibration over a box of modes, with proof.

|V| = |Q| / sin(phi), Q(y) = (z - 1) sum_t v_t z^(N-1-t), z = exp(h e^y), y = ln w + i phi, is largest on an edge of the
rectangle of all y, as ln |V| is subharmonic (problem/terms/semi_infinite.py). An edge is divided into cells of
half-length r about y_c. Q at K points of the circle of radius r about y_c has the Fourier coefficients
a_j = q_j + q_{j+K} + ..., where Q = sum_j q_j ((y - y_c) / r)^j. By Cauchy, |q_j| <= M (r/R)^j with |Q| <= M on the
circle of radius R: with W = N h max w, M = 2 exp(W (e^R - 1)) sum |v_t|. The limit times sin(phi), which is concave, is
above its chord.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, extended
from lin_freq_ocp.certificate.peaks.cells import TERMS, Cells, Peak, joined, largest
from lin_freq_ocp.problem.terms.semi_infinite import PlantBox

GROWTH = 16.0  # W (e^R - 1): the least of exp(GROWTH) (r/R)^TERMS is near GROWTH = TERMS
INNER = 0.03  # r / R: what the series leaves is 2e-17 of the sum of the samples' absolute values
CHORD = 4e-4  # longest cell along phi: the chord is below sin(phi) by 2e-8 of it
EXTENDED = float(np.finfo(np.longdouble).eps)
DOUBLE = float(np.finfo(np.float64).eps)


def certified_vibration(samples: Array, box: PlantBox) -> Peak:
    """Return the largest |V| / limit of samples (N,), with proof."""
    size = float(np.abs(samples).max(initial=0.0))
    if size == 0 or not np.isfinite(size):
        ratio = 0.0 if size == 0 else np.inf
        return Peak(ratio, ratio, float(box.low[0]), float(box.low[1]))
    values, limit = extended(samples) / size, box.limit / size
    parts = [_cells(values, box, limit, k, edge) for k, edge in enumerate(box.edges)]
    peak = largest(joined(parts))
    k, share = divmod(peak.frequency, 2.0)
    ((frequency, damping),) = box.modes_on(box.edges[int(k)], np.array([share])).tolist()
    return Peak(peak.ratio, peak.found, frequency, damping)


def _cells(values: Array, box: PlantBox, limit: float, number: int, edge: tuple[complex, complex]) -> Cells:
    """Return the cells of an edge; their parameter is twice the edge's number, plus the share of the way along it."""
    (start, end), W = edge, 2 * np.pi * float(box.high[0]) * box.duration
    R = float(np.log1p(GROWTH / W))
    length = abs(end - start)
    across = end.imag != start.imag
    count = max(int(np.ceil(length / min(2 * INNER * R, CHORD if across else np.inf))), 1)
    share = (np.arange(count) + 0.5) / count
    step = (end - start) / (2 * count)
    radius = abs(step) or INNER * R
    direction = step / radius if step else 1.0
    centre, turns = start + (end - start) * share, np.exp(2j * np.pi * np.arange(TERMS) / TERMS)
    circles = (centre[:, None] + radius * direction * turns).astype(np.complex128)
    found = _at(values, circles, box.sampling_time)
    a = np.fft.fft(found.reshape(count, TERMS), axis=1) / TERMS
    if not step:
        a[:, 1:] = 0.0
    total = float(np.abs(values).sum())
    rest = 4 * total * np.exp(GROWTH) * (radius / R) ** TERMS / (1 - radius / R)
    near = 2 * total * np.exp(W * np.expm1(radius))  # what Q cannot exceed on the small circles
    rounding = (2 * np.sqrt(len(values)) + 30 + 4 * W) * EXTENDED + (TERMS + 4 * W) * DOUBLE
    sines = np.sin(np.array([start.imag, *(start + (end - start) * (np.arange(count) + 1) / count).imag]))
    below, slope = limit * (sines[:-1] + sines[1:]) / 2, limit * np.diff(sines) / 2
    ones = np.ones(count)
    error = (rest + rounding * near) * ones
    return Cells(a, 2 * number + share, ones / (2 * count), below, slope, error)


def _at(values: Array, points: ComplexArray, sampling_time: float) -> ComplexArray:
    """Return Q of samples at points y, flattened, in extended precision before it is rounded."""
    y, N = points.reshape(-1, 1).astype(np.clongdouble), len(values)
    sh = np.exp(y) * np.longdouble(sampling_time)
    B = int(np.ceil(np.sqrt(N)))
    A = -(-N // B)
    powers = np.zeros(A * B, dtype=values.dtype)
    powers[:N] = values[::-1]
    inner = np.exp(sh * np.arange(B)) @ powers.reshape(A, B).T
    return (np.expm1(sh[:, 0]) * (np.exp(sh * (B * np.arange(A))) * inner).sum(axis=1)).astype(np.complex128)
