# ruff: noqa: D102
"""Loads that are only known to be in a set: what the set adds to a row at most, and the loads that do it.

S_tj = E_j'(A_K,t-1 .. A_K,j+1)'(c + K'd) is the effect of the load w_j on a row at time t. Every kind of loads sums up
``contributions`` of single times, and makes a margin of the total. ``Loads`` documents the methods without a docstring.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from statistics import NormalDist
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, ComplexArray, brief, real_array
from lin_freq_ocp.base.errors import ProblemError, rename_field
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.problem.sets.base import ConvexSet

SET = "disturbance.set"
ANGLES_OF_BOUND = 720  # directions in the plane in which the size of a complex number is bounded
SEMIDEFINITE = 1e-12  # of the largest eigenvalue of a covariance: a negative one within this is zero


class Loads(ABC):
    """Loads w_t, t = 0 .. T-1, of some kind."""

    anew: ClassVar[bool] = False  # whether every time takes any load of one bounded set
    front: tuple[int, ...] = ()  # axes of totals in front of (times, rows); with any, loads belong to times
    horizon: int | None = None  # T, if a load is stated for each time
    dimension: int  # k
    largest: Array  # (k,): bounds of |w_t|
    error: Array  # (k,): S'error bounds the rounding of ``contribution``, beyond that of its products
    words: str

    @abstractmethod
    def contribution(self, S: Array, times: slice) -> Array:
        """Return what the loads of some times j add to the total of rows, for S (rows, k) or (times, rows, k)."""

    def margin(self, total: Array) -> Array:
        """Return the margins (T+1, rows) from the totals, which may have more axes in front."""
        return total

    def worst(self, S: Array, count: int) -> Array | None:
        """Return loads (count, k) that attain the margin of a row with the effects S (t, k); None if none does."""
        return None

    def modulus(self, M: ComplexArray, centre: ComplexArray) -> tuple[Array, Array] | None:
        """Return bounds of |centre_b + sum_j M_bj w_j|, (bins,), for M (bins, T, k), and loads (bins, T, k) near them.

        None if the loads have no bounds.
        """
        return None


class LoadSet(Loads):
    """Any load of one bounded set, at each time anew."""

    anew: ClassVar[bool] = True

    def __init__(self, farthest: Callable[[Array], Array], error: Array, words: str):
        self.farthest, self.error, self.words, self.dimension = farthest, error, words, len(error)
        identity = np.eye(self.dimension)
        ends = np.array([np.diag(farthest(side)) for side in (identity, -identity)])
        self.largest = np.abs(ends).max(axis=0) + error
        if not np.isfinite(self.largest).all():
            advice = "State both bounds of every component."
            raise ProblemError(SET, f"{words}, without bounds", "a bounded set", advice)

    def contribution(self, S: Array, times: slice) -> Array:
        return (S * self.farthest(S)).sum(axis=-1)

    def worst(self, S: Array, count: int) -> Array:
        rest = self.farthest(np.zeros((count - len(S), self.dimension)))
        return np.concatenate([self.farthest(S), rest])

    def modulus(self, M: ComplexArray, centre: ComplexArray) -> tuple[Array, Array]:
        """Bound by the largest values in some directions; between two of them, |v| is larger by 1/cos at most."""
        best, loads = np.full(len(M), -np.inf), np.zeros(M.shape)
        for turn in np.exp(-2j * np.pi * np.arange(ANGLES_OF_BOUND) / ANGLES_OF_BOUND):
            S = (turn * M).real
            w = self.farthest(S)
            value = (turn * centre).real + (S * w).sum(axis=(1, 2))
            loads[value > best] = w[value > best]
            best = np.maximum(best, value)
        return np.maximum(best, 0.0) / np.cos(np.pi / ANGLES_OF_BOUND) + (np.abs(M) @ self.error).sum(axis=1), loads


class BoxLoads(LoadSet):
    """Any load of a box, at each time anew: sums M_j w_j are a zonogon in the plane, with vertices in closed form."""

    def modulus(self, M: ComplexArray, centre: ComplexArray) -> tuple[Array, Array]:
        upper, lower = self.farthest(np.ones(self.dimension)), self.farthest(-np.ones(self.dimension))
        half, middle, bins = (upper - lower) / 2, (upper + lower) / 2, np.arange(len(M))
        g, around = (M * half).reshape(len(M), -1), centre + (M @ middle).sum(axis=1)
        side = np.where((g.imag > 0) | ((g.imag == 0) & (g.real > 0)), 1.0, -1.0)  # turned to the upper half plane
        order = np.argsort(np.angle(g * side), axis=1)
        turned = np.take_along_axis(g * side, order, axis=1)
        # from the sum of all, the vertices of one half of the boundary flip one generator after the other
        flips = 2 * np.cumsum(np.concatenate([np.zeros((len(M), 1)), turned], axis=1), axis=1)
        vertices = turned.sum(axis=1, keepdims=True) - flips
        sizes = np.abs(np.stack([around[:, None] + vertices, around[:, None] - vertices]))
        best = sizes.max(axis=0).argmax(axis=1)
        sign = np.where(sizes[0, bins, best] >= sizes[1, bins, best], 1.0, -1.0)
        flipped = np.where(np.arange(g.shape[1]) < best[:, None], -1.0, 1.0) * sign[:, None]
        chosen = np.empty(g.shape)
        np.put_along_axis(chosen, order, flipped, axis=1)
        return sizes[:, bins, best].max(axis=0), middle + half * (chosen * side).reshape(M.shape)


class Records(Loads):
    """Recorded loads over the horizon: a plan holds for each of the records and for all their mixtures.

    Parameters
    ----------
    loads : (records, T, k)
        A load for each record, time and column of the input.

    Raises
    ------
    ProblemError
        If it is no such array.

    Examples
    --------
    >>> gusts = [[[0.1], [0.0], [-0.1]], [[0.0], [0.1], [0.1]]]
    >>> lfo.Disturbance(lfo.uncertainty.Records(gusts), input=[[0.0], [1.0]]).set.words
    '2 records of loads and their mixtures'
    """

    def __init__(self, loads: ArrayLike):
        self.loads = real_array("Records.loads", loads)
        if self.loads.ndim != 3 or 0 in self.loads.shape:
            raise ProblemError("Records.loads", f"shape {self.loads.shape}", "shape (records, T, k)")
        self.front, (_, self.horizon, self.dimension) = self.loads.shape[:1], self.loads.shape
        self.largest, self.error = np.abs(self.loads).max(axis=(0, 1)), np.zeros(self.dimension)
        self.words = f"{plural(len(self.loads), 'record')} of loads and their mixtures"

    def contribution(self, S: Array, times: slice) -> Array:
        return (S @ self.loads[:, times, :, None])[..., 0]

    def margin(self, total: Array) -> Array:
        return total.max(axis=0)

    def worst(self, S: Array, count: int) -> Array:
        return self.loads[np.argmax((S * self.loads[:, : len(S)]).sum(axis=(1, 2)))]

    def modulus(self, M: ComplexArray, centre: ComplexArray) -> tuple[Array, Array]:
        sizes = np.abs(centre + np.tensordot(self.loads, M, axes=([1, 2], [1, 2])))
        best = sizes.argmax(axis=0)
        return sizes.max(axis=0), self.loads[best]


class Gaussian(Loads):
    """Gaussian loads of mean zero, independent over time: each row at each time by itself holds with a probability.

    Parameters
    ----------
    covariance : (k, k), or a number for k = 1
        Of the load of each time; symmetric and positive semidefinite.
    probability : float
        Above 0.5 and below 1.

    Raises
    ------
    ProblemError
        If the covariance or the probability is not of this kind.

    Examples
    --------
    >>> lfo.uncertainty.Gaussian([[1e-4]], 0.95).probability
    0.95
    """

    def __init__(self, covariance: ArrayLike, probability: float):
        matrix = np.atleast_2d(real_array("Gaussian.covariance", covariance))
        if matrix.shape != matrix.T.shape or not np.array_equal(matrix, matrix.T):
            raise ProblemError("Gaussian.covariance", brief(covariance), "a symmetric matrix (k, k)")
        size = np.sqrt(np.diag(matrix).clip(min=0.0))
        scale = np.where(size > 0, size, 1.0)
        values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
        if (np.diag(matrix) < 0).any() or values[0] < -SEMIDEFINITE * max(values[-1], 1.0):
            raise ProblemError("Gaussian.covariance", brief(covariance), "a positive semidefinite matrix")
        share = real_array("Gaussian.probability", probability)
        if share.ndim or not 0.5 < share < 1:
            raise ProblemError("Gaussian.probability", brief(probability), "one number above 0.5 and below 1")
        self.covariance, self.probability, self.dimension = matrix, float(share), len(matrix)
        self.root = scale[:, None] * vectors * np.sqrt(values.clip(min=0.0))
        self.largest, self.error = NormalDist().inv_cdf(float(share)) * size, np.zeros(self.dimension)
        self.words = f"Gaussian loads; each limit at each time by itself holds with probability {self.probability:g}"

    def contribution(self, S: Array, times: slice) -> Array:
        return ((S @ self.root) ** 2).sum(axis=-1)

    def margin(self, total: Array) -> Array:
        return NormalDist().inv_cdf(self.probability) * np.sqrt(total)


def loads_of(given: object, dimension: int, field: str = SET, each: str = "column of the input") -> Loads:
    """Return the loads of a set, of measured samples (samples, k), or of a kind of their own, for k columns of E.

    Errors name the field, and say what there is one component for.
    """
    if isinstance(given, Loads):
        loads = given
    elif isinstance(given, ConvexSet):
        if given.dimension not in (None, dimension):
            raise ProblemError(field, f"a set in {given.dimension} dimensions", f"{dimension}, one per {each}")
        kind, words = LoadSet if given.members else BoxLoads, f"a {type(given).__name__}"
        with rename_field(lambda name: field + name.removeprefix(SET)):
            loads = kind(*given.farthest(dimension), f"every load of {words} of {plural(dimension, 'component')}")
    else:
        samples = real_array(SET, given)
        if samples.ndim != 2 or 0 in samples.shape:
            expected = "a set such as Box, or measured loads of shape (samples, k)"
            raise ProblemError(SET, f"shape {samples.shape}" if samples.ndim else brief(given), expected)
        words = f"every load of the convex hull of {plural(len(samples), 'sample')}"
        loads = LoadSet(lambda y: samples[(y @ samples.T).argmax(axis=-1)], np.zeros(samples.shape[1]), words)
    if loads.dimension != dimension:
        got = f"loads of {plural(loads.dimension, 'component')}"
        raise ProblemError(SET, got, f"{dimension}, one for each column of the input")
    return loads
