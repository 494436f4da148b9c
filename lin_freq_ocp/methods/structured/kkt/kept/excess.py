"""Weights too large for a matrix that holds them beside others: they are left to rows, as the compliance 1/weight.

A weight on a direction a of y_t counts as a'S a, where S is the covariance of y_t under white noise in the stopped
coefficients, relative to the weight of the control: a weight on a position hardly couples kept and stopped
coefficients, a weight on the control does. The white noise in all coefficients has a small part in S, so that rounding
does not take the digits that a very large weight on a state leaves the others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.structured.kkt.kept.space import KeptSpace, break_times

CLIP = 5.0  # of a'S a: (4/6)^2, so the approximation is within a factor of 2; 2 to 100 cost the same
LEAST_EXCESS = 0.5  # of a weight, relative to the clip, that is worth a direction
MOST_DIRECTIONS = 300  # beyond the clip; the largest are taken
NOISES = 4  # signals for a covariance
NOISE_GROWTH = 10.0  # of states between restarts: what grows further is slow, and left to the kept coefficients
SHARE = 1e-3  # of the noise in all coefficients: weights from CLIP/SHARE times those of the control on


class Excess(NamedTuple):
    """Directions a of y_t and their weights."""

    times: Indices
    directions: Array  # (directions, nz)
    weights: Array


class Noise:
    """The covariances of y in a space."""

    def __init__(self, space: KeptSpace):
        self._states, self._covariances = space.states, _covariances(space)

    def clipped(self, Phi: Array) -> tuple[Array, Excess]:
        """Return Phi (T+1, nz, nz) with clipped weights, and their excess."""
        return clip(Phi, np.einsum("j,jab->ab", 1 / control_weights(Phi, self._states), self._covariances))


def control_weights(Phi: Array, n: int) -> Array:
    """Return the median weight of every control, above zero."""
    level = np.median(np.einsum("tii->ti", Phi[:-1, n:, n:]), axis=0)
    return np.maximum(level, np.finfo(float).eps * max(float(level.max()), np.finfo(float).tiny))


def rows_of(excess: Excess, space: KeptSpace) -> Array:
    """Return the directions as rows on v."""
    found = np.empty((len(excess.times), space.size))
    of_y = np.zeros((space.horizon + 1, space.states + space.controls))
    for row, t, direction in zip(found, excess.times, excess.directions, strict=True):
        of_y[t] = direction
        row[:] = space.gradient(of_y)
        of_y[t] = 0.0
    return found


def clip(Phi: Array, S: Array, most: int = MOST_DIRECTIONS) -> tuple[Array, Excess]:
    """Return Phi without the excess of its largest weights, and the directions of these, ``most`` at most.

    Directions are columns of Cholesky factors, the noisiest diagonal entry first: large weights on single entries, such
    as bounds, do not touch the digits of the others.
    """
    rest, noise, every = Phi[:-1].copy(), np.diag(S), np.arange(len(Phi) - 1)
    times, directions, weights, limits = [every[:0]], [rest[:0, 0]], [rest[:0, 0, 0]], [rest[:0, 0, 0]]
    for _ in noise:
        diagonal = np.einsum("tii->ti", rest[every]) * noise
        every, pivot = every[diagonal.max(1) > CLIP], diagonal.argmax(1)[diagonal.max(1) > CLIP]
        columns = rest[every, :, pivot]
        weight = columns[np.arange(len(every)), pivot]
        columns = columns / weight[:, None]
        rest[every] -= weight[:, None, None] * columns[:, :, None] * columns[:, None, :]
        rest[every, pivot], rest[every, :, pivot] = 0.0, 0.0
        times.append(every)
        directions.append(columns)
        weights.append(weight)
        limits.append(np.minimum(weight, CLIP / np.einsum("ta,ab,tb->t", columns, S, columns)))
    peeled = Excess(np.concatenate(times), np.concatenate(directions), np.concatenate(weights))
    limit = np.concatenate(limits)
    chosen = np.argsort(limit / peeled.weights)[:most]
    chosen = np.sort(chosen[peeled.weights[chosen] > limit[chosen] * (1 + LEAST_EXCESS)])
    left = peeled.weights.copy()
    left[chosen] = limit[chosen]
    clipped = Phi.copy()
    clipped[:-1] = rest
    np.add.at(clipped, peeled.times, np.einsum("k,ka,kb->kab", left, peeled.directions, peeled.directions))
    return clipped, Excess(peeled.times[chosen], peeled.directions[chosen], (peeled.weights - left)[chosen])


def _covariances(space: KeptSpace) -> Array:
    """Return for every control the mean covariance of y under unit white noise in its coefficients."""
    n, m, T = space.states, space.controls, space.horizon
    random, still = np.random.default_rng(0), np.zeros((T + 1, n))
    breaks = break_times(space.A, NOISE_GROWTH)
    starts = np.zeros((len(breaks), n))
    found = np.zeros((m, n + m, n + m))
    for j, banded in enumerate(space.coefficients.banded):
        noise = random.standard_normal((NOISES, T))
        for share, signals in ((1.0, space.coefficients.stopped(j, noise)), (SHARE, noise)):
            own = np.zeros((n + m, n + m))
            for signal in signals:
                y = np.zeros((T + 1, n + m))
                y[:-1, n + j] = signal
                space.loops.forward(space.A, space.B, still, breaks, starts, y)
                own += y[:-1].T @ y[:-1] / (NOISES * T)
            if not banded:  # weights on single unknowns take no digits
                own[n + j], own[:, n + j] = 0.0, 0.0
            found[j] += share * own
    return found
