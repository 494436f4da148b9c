"""All y_k = (x_k, u_k) that the dynamics and the stop bands allow at each bin (docs/spectral.md, 2 and 3).

    F_k y_k = z w + d_k,  F_k = [zI - A, -B_allowed]   <=>   y_k = N_k v_k + (particular response to z w + d_k) + border

N_k spans the regular part of the null space of F_k, with N_k^* M N_k = I. The particular response P_k is M-orthogonal
to it. Far from eigenvalues of A, N = [(zI - A)^{-1} B; I]; near them both come from a singular value decomposition
of F_k, and directions of small cost or of small singular values become border directions, one complex unknown each.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array, ComplexArray, Indices, Mask
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.spectral.model.lti import Lti
from lin_freq_ocp.methods.spectral.model.resolvent import Resolvent

NEAR = 1e2
"""Size of the resolvent from which a bin is near an eigenvalue: what is divided by loses two digits there."""

NEAR_RADIUS = 0.3
"""Distance to an eigenvalue beyond which a bin is far, however large the resolvent."""

SMALL_SINGULAR_VALUE = 1e-5
"""Relative singular value of F_k below which its direction may become a border unknown instead of being divided by."""

RESOLVED_PHASE = 10.0
"""Distance of a bin to every eigenvalue, times T, beyond which it does not: |1 - (lambda / z)^T| is then of order 1, or
|lambda| is far from 1 in T steps, and a jump leaves a response of its own size. Else few bins per eigenvalue are
nearer, on any horizon."""

LEAST_DIVISOR = 1e-11
"""Relative singular value below which its direction becomes a border unknown all the same: fewer than five digits of it
are known."""

ZERO_SINGULAR_VALUE = 1e-13
"""Relative singular value that is rounding: an equation without unknown. As a number it would decide the answer."""

SMALL_HESSIAN = 1e-4
"""Cost of a null direction, relative to that of a control, below which it becomes a border unknown."""

LEAST_HESSIAN = 1e-10
"""Cost below which it does so however many there are."""

MOST_BORDER = 128
"""BorderedSystem directions of small cost beyond which only the smallest become ones: the border matrix is dense."""

SINGULAR_HESSIAN = 1e-13
"""Relative eigenvalue of N^*MN at which the cost does not see a direction, and the method refuses."""


class NearBins:
    """F_k = L diag(sigma) V^* at the near bins.

    Attributes
    ----------
    k : (count,)
    left : (count, n, n); sigma : (count, n); right : (count, n+m, n)
        Rows of stopped controls in ``right`` are zero.
    good : (count, n)
        Which singular values are divided by.
    null : (count, n+m, m); cost : (count, m)
        Null vectors of F_k that diagonalise M, and their costs; zero, and inf, where a control is stopped.
    """

    def __init__(self, lti: Lti, k: Indices, z: ComplexArray, distance: Array):
        """Decompose bins k of all z (bins,), ``distance`` (bins,) from the nearest eigenvalue."""
        self.k, n, m = k, lti.state_dim, lti.control_dim
        self.left = np.empty((len(k), n, n), dtype=np.complex128)
        self.sigma = np.empty((len(k), n))
        self.right = np.zeros((len(k), n + m, n), dtype=np.complex128)
        self.null = np.zeros((len(k), n + m, m), dtype=np.complex128)
        self.cost = np.full((len(k), m), np.inf)
        for places, passed, real in _alike(lti.passed[:, k], (k == 0) | (2 * k == lti.horizon)):
            self._decompose(lti, places, passed, z[k[places]].real if real else z[k[places]])
        largest = np.maximum(1.0, self.sigma[:, :1])
        self.sigma[self.sigma < ZERO_SINGULAR_VALUE * largest] = 0.0
        resolved = lti.horizon * distance[k, None] > RESOLVED_PHASE
        self.good = self.sigma > np.where(resolved, LEAST_DIVISOR, SMALL_SINGULAR_VALUE) * largest
        self._inverse = np.divide(1.0, self.sigma, out=np.zeros_like(self.sigma), where=self.good)

    def _decompose(self, lti: Lti, places: Indices, passed: Mask, z: Array | ComplexArray) -> None:
        """Fill in bins that share a passed mask, in real arithmetic where z is real."""
        n = lti.state_dim
        allowed = np.concatenate([np.ones(n, dtype=bool), passed])
        F = z[:, None, None] * np.eye(n, len(lti.M)) - np.hstack([lti.A, lti.B])
        self.left[places], self.sigma[places], right = np.linalg.svd(F[:, :, allowed])
        V = np.zeros((len(z), len(lti.M), right.shape[1]), dtype=z.dtype)
        V[:, allowed] = right.conj().swapaxes(1, 2)
        self.right[places], null = V[:, :, :n], V[:, :, n:]
        columns, cost = null.shape[2], null.conj().swapaxes(1, 2) @ lti.M @ null
        if columns == 1:
            self.null[places, :, :1], self.cost[places, :1] = null, cost.real[:, 0]
        else:
            h, vectors = np.linalg.eigh(cost)
            self.null[places, :, :columns], self.cost[places, :columns] = null @ vectors, h

    def particular(self, rhs: ComplexArray) -> ComplexArray:
        """Return the pseudo-inverse applied to rhs (n, columns, count), shape (n+m, columns, count)."""
        projected = np.einsum("kij,ick->kjc", self.left.conj(), rhs) * self._inverse[:, :, None]
        return np.einsum("kij,kjc->ick", self.right, projected)

    def adjoint(self, rhs: ComplexArray) -> ComplexArray:
        """Return L diag(1/sigma) V^* rhs over the good singular values, for rhs (n+m, count), shape (n, count)."""
        projected = np.einsum("kij,ik->kj", self.right.conj(), rhs) * self._inverse
        return np.einsum("kij,kj->ik", self.left, projected)


def _alike(passed: Mask, real: Mask) -> Iterator[tuple[Indices, Mask, bool]]:
    """Yield (places, mask, real) of bins that share a passed mask and are all real or all complex."""
    groups: dict[bytes, list[int]] = {}
    labels = np.vstack([passed, real]).T
    for place, label in enumerate(labels):
        groups.setdefault(label.tobytes(), []).append(place)
    for places in groups.values():
        label = labels[places[0]]
        yield np.array(places), label[:-1], bool(label[-1])


@dataclass(frozen=True, eq=False)
class Singular:
    """A compatibility equation sigma xi = L^*(z w + d_k), xi the coefficient of a border direction."""

    k: int
    left: ComplexArray
    sigma: float
    direction: int


class BinSpaces:
    """The null spaces and particular responses of all bins 0 .. T/2; spectra are (component, bin).

    Attributes
    ----------
    z, weight : (bins,)
        exp(2 pi i k / T), and how often a bin counts in sums over the full circle (1 or 2).
    N : (n+m, m, bins)
    border_bin : (directions,), border_vector : (n+m, directions)
        The border directions, M-orthogonal to N.
    singular : list of Singular
    """

    def __init__(self, lti: Lti):
        self.lti = lti
        bins = np.arange(lti.horizon // 2 + 1)
        self.z = np.exp(2j * np.pi * bins / lti.horizon)
        self.weight = np.where((bins == 0) | (2 * bins == lti.horizon), 1.0, 2.0)
        self.resolvent = Resolvent(lti.A)
        distance = self._distance()
        self.near = NearBins(lti, self._near_bins(distance), self.z, distance)
        self.N = self._far_null_spaces()
        self.singular: list[Singular] = []
        self._set_border()

    def _distance(self) -> Array:
        """Return the distance of each bin to the nearest eigenvalue of A."""
        distance = np.full(len(self.z), np.inf)
        for eigenvalue in self.resolvent.eigenvalues:
            np.minimum(distance, np.abs(self.z - eigenvalue), out=distance)
        return distance

    def _near_bins(self, distance: Array) -> Indices:
        close = np.flatnonzero(distance < NEAR_RADIUS)
        with np.errstate(all="ignore"):
            size = self.resolvent.size(self.z[close])
        return close[~(size < NEAR)]

    def _far_null_spaces(self) -> ComplexArray:
        """Return N normalised at far bins, zero at near ones."""
        lti, n, m = self.lti, self.lti.state_dim, self.lti.control_dim
        passed = np.array(lti.passed)
        passed[:, self.near.k] = False
        N = np.zeros((n + m, m, len(self.z)), dtype=np.complex128)
        with np.errstate(all="ignore"):
            B = lti.B[:, :, None].astype(np.complex128)
            N[:n] = self.resolvent.apply(self.z, np.broadcast_to(B, (n, m, len(self.z))))
        N[:n, ~passed] = 0
        N[n + np.arange(m), np.arange(m)] = passed
        if m == 1:
            self._normalise_single(N[:, 0], passed[0])
        else:
            N = self._normalised(N, passed)
        return N

    def _normalise_single(self, N: ComplexArray, passed: Mask) -> None:
        """Normalise the null vectors N (n+m, bins) of a single control, in place."""
        H = (
            (N.conj() * (self.lti.M @ N)).sum(0).real
            if self.lti.state_cost
            else np.full(len(self.z), self.lti.M[-1, -1])
        )
        unseen = SINGULAR_HESSIAN**2 * self.lti.curvature_unit * (np.abs(N) ** 2).sum(0)
        if (H <= unseen)[passed].any():
            raise _flat()
        N /= np.sqrt(np.where(passed, H, 1.0))

    def _normalised(self, N: ComplexArray, passed: Mask) -> ComplexArray:
        lti, n, m = self.lti, self.lti.state_dim, self.lti.control_dim
        if lti.state_cost:
            H = np.einsum("iak,ibk->kab", N.conj(), np.tensordot(lti.M, N, 1))
            H[:, np.arange(m), np.arange(m)] += ~passed.T
            return np.einsum("iak,kba->ibk", N, _inverse_factor(H).conj())
        patterns, which = np.unique(passed, axis=1, return_inverse=True)
        H = np.array(lti.M[n:, n:] * (patterns[:, None] & patterns[None]).transpose(2, 0, 1), dtype=np.complex128)
        H[:, np.arange(m), np.arange(m)] += ~patterns.T
        factors = _inverse_factor(H)[which.ravel()]
        return np.einsum("iak,kba->ibk", N, factors.conj())

    def _set_border(self) -> None:
        """Choose the border directions among those of the near bins, and complete N by the others."""
        near = self.near
        regular = near.cost > self._border_threshold()
        scaled = near.null / np.sqrt(np.where(regular, near.cost, np.inf))[:, None, :]
        self.N[:, :, near.k] = scaled.transpose(1, 2, 0)
        small, column = np.nonzero(~regular)
        bad, which = np.nonzero(~near.good)
        for place, (i, j) in enumerate(zip(bad, which, strict=True), start=len(small)):
            self.singular.append(Singular(int(near.k[i]), near.left[i, :, j], float(near.sigma[i, j]), place))
        self.border_bin = near.k[np.concatenate([small, bad])]
        border = np.vstack([near.null[small, :, column], near.right[bad, :, which]]).T
        at = self.N[:, :, self.border_bin]
        seen = np.einsum("iak,ik->ak", at.conj(), self.lti.M @ border)
        self.border_vector: ComplexArray = border - np.einsum("iak,ak->ik", at, seen)

    def _border_threshold(self) -> float:
        costs = self.near.cost[np.isfinite(self.near.cost)]
        unit = self.lti.curvature_unit
        smallest = np.sort(costs)[MOST_BORDER] if len(costs) > MOST_BORDER else np.inf
        return unit * max(LEAST_HESSIAN, min(SMALL_HESSIAN, smallest / unit))

    def particular(self, rhs: ComplexArray) -> ComplexArray:
        """Return (I - N N^* M) P rhs, shape (n+m, columns, bins), for rhs (n, columns, bins)."""
        lti, n = self.lti, self.lti.state_dim
        response = np.zeros((len(lti.M), *rhs.shape[1:]), dtype=np.complex128)
        with np.errstate(all="ignore"):
            response[:n] = self.resolvent.apply(self.z, rhs)
        k = self.near.k
        response[:, :, k] = self.near.particular(rhs[:, :, k])
        if lti.state_cost:
            response -= self.project(np.tensordot(lti.M, response, 1))
        else:  # but at near bins the response has u = 0, and M sees u only
            at_near = response[:, :, k]
            weighted = (lti.M @ at_near.reshape(len(at_near), -1)).reshape(at_near.shape)
            response[:, :, k] = at_near - self.project(weighted, k)
        return response

    def project(self, g: ComplexArray, bins: Indices | slice = slice(None)) -> ComplexArray:
        """Return K g = N N^* g, for g (n+m, columns, bins)."""
        N = self.N[:, :, bins]
        return np.einsum("iak,ack->ick", N, np.einsum("iak,ick->ack", N.conj(), g))

    def response(self, force: ComplexArray) -> ComplexArray:
        """Return N N^* force, shape (n+m, bins)."""
        if self.lti.control_dim == 1:
            N = self.N[:, 0]
            return N * (N.conj() * force).sum(0)
        return self.project(force[:, None])[:, 0]

    def respond(self, force: ComplexArray, used: Mask, spectrum: ComplexArray) -> None:
        """Subtract N N^* force from the spectrum (n+m, bins), in place; only the ``used`` components are not zero."""
        components = np.flatnonzero(used)
        for a in range(self.lti.control_dim):
            v = sum((self.N[i, a].conj() * force[i] for i in components), start=np.zeros(len(self.z), complex))
            spectrum -= self.N[:, a] * v


def _inverse_factor(H: ComplexArray) -> ComplexArray:
    """Return L^{-1} with H = L L^*, per bin, (bins, m, m)."""
    units = np.sqrt(np.diagonal(H, axis1=1, axis2=2).real)
    if not (units > 0).all():
        raise _flat()
    try:
        factor = np.linalg.cholesky(H / (units[:, :, None] * units[:, None]))
    except np.linalg.LinAlgError:
        raise _flat() from None
    if np.diagonal(factor, axis1=1, axis2=2).real.min(initial=1.0) ** 2 <= SINGULAR_HESSIAN:
        raise _flat()
    return np.asarray(np.linalg.inv(factor) / units[:, None], dtype=np.complex128)


def _flat() -> UnsupportedError:
    return UnsupportedError(
        "method 'spectral': the cost does not see some direction that the bands allow (R singular); "
        "give every control a cost, or use method 'convex'."
    )
