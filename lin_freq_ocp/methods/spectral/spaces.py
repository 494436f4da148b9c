"""All y_k = (x_k, u_k) that the dynamics and the stop bands allow at each bin (SPECTRAL.md, 1.3 to 1.5).

    F_k y_k = z w + d_k,  F_k = [zI - A, -B_allowed]   <=>   y_k = N_k v_k + (particular response to z w + d_k) + border

N_k spans the regular part of the null space of F_k, with N_k^* M N_k = I. The particular response P_k is M-orthogonal
to it. Far from eigenvalues of A, N = [(zI - A)^{-1} B; I]; near them both come from a singular value decomposition
of F_k, and directions of small cost or of small singular values become border directions, one complex unknown each.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.spectral.lti import Lti
from lin_freq_ocp.methods.spectral.resolvent import Resolvent
from lin_freq_ocp.problem.arrays import Array, ComplexArray, Indices, Mask

NEAR = 1e2
"""Size of the resolvent from which a bin is near an eigenvalue: what is divided by loses two digits there."""

NEAR_RADIUS = 0.3
"""Distance to an eigenvalue beyond which a bin is not near one, whatever the resolvent."""

SMALL_SINGULAR_VALUE = 1e-5
"""Relative singular value of F_k below which its direction becomes a border unknown instead of being divided by."""

ZERO_SINGULAR_VALUE = 1e-13
"""Relative singular value that is rounding: an equation without unknown. As a number it would decide the answer."""

SMALL_HESSIAN = 1e-4
"""Cost of a null direction, relative to that of a control, below which it becomes a border unknown."""

LEAST_HESSIAN = 1e-10
"""Cost below which it does so however many there are."""

MOST_BORDER = 128
"""Border directions of small cost beyond which only the smallest become ones: the border matrix is dense."""

SINGULAR_HESSIAN = 1e-13
"""Relative eigenvalue of N^*MN at which the cost does not see a direction, and the method refuses."""


@dataclass(frozen=True, eq=False)
class NearBins:
    """F_k = L diag(sigma) V^* at some near bins that share a passed mask.

    Attributes
    ----------
    k : (count,)
    left : (count, n, n); sigma : (count, n); right : (count, n+m, n)
        Rows of stopped controls in ``right`` are zero.
    good : (count, n)
        Which singular values are divided by.
    """

    k: Indices
    left: ComplexArray
    sigma: Array
    right: ComplexArray
    good: Mask

    def particular(self, rhs: ComplexArray) -> ComplexArray:
        """Return the pseudo-inverse applied to rhs (n, columns, count), shape (n+m, columns, count)."""
        inverse = np.where(self.good, 1 / np.where(self.good, self.sigma, 1.0), 0.0)
        projected = np.einsum("kij,ick->kjc", self.left.conj(), rhs) * inverse[:, :, None]
        return np.einsum("kij,kjc->ick", self.right, projected)

    def adjoint(self, rhs: ComplexArray) -> ComplexArray:
        """Return L diag(1/sigma) V^* rhs over the good singular values, for rhs (n+m, count), shape (n, count)."""
        inverse = np.where(self.good, 1 / np.where(self.good, self.sigma, 1.0), 0.0)
        projected = np.einsum("kij,ik->kj", self.right.conj(), rhs) * inverse
        return np.einsum("kij,kj->ik", self.left, projected)


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
        self.near = self._near_bins()
        self.N = self._far_null_spaces()
        self.groups: list[NearBins] = []
        self.singular: list[Singular] = []
        self.border_bin: Indices = np.zeros(0, dtype=np.intp)
        self.border_vector: ComplexArray = np.zeros((len(lti.M), 0), dtype=np.complex128)
        self._treat_near_bins()

    def _near_bins(self) -> Indices:
        distance = np.full(len(self.z), np.inf)
        for eigenvalue in self.resolvent.eigenvalues:
            np.minimum(distance, np.abs(self.z - eigenvalue), out=distance)
        close = np.flatnonzero(distance < NEAR_RADIUS)
        with np.errstate(all="ignore"):
            size = self.resolvent.size(self.z[close])
        return close[~(size < NEAR)]

    def _far_null_spaces(self) -> ComplexArray:
        """Return N normalised at far bins, zero at near ones."""
        lti, n, m = self.lti, self.lti.state_dim, self.lti.control_dim
        passed = np.array(lti.passed)
        passed[:, self.near] = False
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

    def _treat_near_bins(self) -> None:
        """Decompose F_k at the near bins, choose the border directions, and complete N."""
        null_groups = [self._decompose(k, allowed) for k, allowed in self._near_groups()]
        threshold = self._border_threshold(np.concatenate([*[h.ravel() for *_, h in null_groups], np.zeros(0)]))
        bins, vectors = list[Indices](), list[ComplexArray]()
        for group, null, h in null_groups:
            regular = h > threshold
            scaled = null / np.sqrt(np.where(regular, h, np.inf))[:, None, :]
            self.N[:, : h.shape[1], group.k] = scaled.transpose(1, 2, 0)
            self.groups.append(group)
            row, column = np.nonzero(~regular)
            bins.append(group.k[row])
            vectors.append(null[row, :, column].T)
            first = sum(map(len, bins))
            row, column = np.nonzero(~group.good)
            for j, (i, c) in enumerate(zip(row, column, strict=True)):
                entry = Singular(int(group.k[i]), group.left[i, :, c], float(group.sigma[i, c]), first + j)
                self.singular.append(entry)
            bins.append(group.k[row])
            vectors.append(group.right[row, :, column].T)
        if bins:
            self.border_bin, border = np.concatenate(bins), np.hstack(vectors)
            weighted = (self.lti.M @ border)[:, None]
            at = self.N[:, :, self.border_bin]
            self.border_vector = border - np.einsum("iak,ak->ik", at, np.einsum("iak,ick->ak", at.conj(), weighted))

    def _near_groups(self) -> Iterator[tuple[Indices, Mask]]:
        """Yield near bins that share a passed mask and are all real or all complex."""
        if not len(self.near):
            return
        labels = np.vstack([self.lti.passed[:, self.near], self.weight[self.near] == 1]).T
        alike: dict[bytes, list[int]] = {}
        for i, label in enumerate(labels):
            alike.setdefault(label.tobytes(), []).append(i)
        for places in alike.values():
            yield self.near[places], labels[places[0], :-1]

    def _decompose(self, k: Indices, passed: Mask) -> tuple[NearBins, ComplexArray, Array]:
        """Return the decomposition, and null vectors (count, n+m, columns) that diagonalise M, with their costs."""
        lti, n = self.lti, self.lti.state_dim
        allowed = np.concatenate([np.arange(n), n + np.flatnonzero(passed)])
        F = np.empty((len(k), n, len(allowed)), dtype=np.complex128)
        F[:, :, :n], F[:, :, n:] = -lti.A, -lti.B[:, passed]
        F[:, np.arange(n), np.arange(n)] += self.z[k, None]
        left, sigma, right = np.linalg.svd(F.real if self.weight[k[0]] == 1 else F)
        V = np.zeros((len(k), len(lti.M), len(allowed)), dtype=right.dtype)
        V[:, allowed] = right.conj().swapaxes(1, 2)
        largest = np.maximum(1.0, sigma[:, :1])
        sigma = np.where(sigma < ZERO_SINGULAR_VALUE * largest, 0.0, sigma)
        group = NearBins(k, left, sigma, V[:, :, :n], sigma > SMALL_SINGULAR_VALUE * largest)
        null = V[:, :, n:]
        cost = null.conj().swapaxes(1, 2) @ lti.M @ null
        if cost.shape[1] == 1:
            return group, null, cost.real[:, 0]
        h, vectors = np.linalg.eigh(cost)
        return group, null @ vectors, h

    def _border_threshold(self, costs: Array) -> float:
        unit = self.lti.curvature_unit
        smallest = np.sort(costs)[MOST_BORDER] if len(costs) > MOST_BORDER else np.inf
        return unit * max(LEAST_HESSIAN, min(SMALL_HESSIAN, smallest / unit))

    def particular(self, rhs: ComplexArray) -> ComplexArray:
        """Return (I - N N^* M) P rhs, shape (n+m, columns, bins), for rhs (n, columns, bins)."""
        lti, n = self.lti, self.lti.state_dim
        response = np.zeros((len(lti.M), *rhs.shape[1:]), dtype=np.complex128)
        with np.errstate(all="ignore"):
            response[:n] = self.resolvent.apply(self.z, rhs)
        for group in self.groups:
            response[:, :, group.k] = group.particular(rhs[:, :, group.k])
        if lti.state_cost:
            response -= self.project(np.tensordot(lti.M, response, 1))
        elif len(self.near):  # elsewhere the response has u = 0, and M sees u only
            at_near = response[:, :, self.near]
            weighted = (lti.M @ at_near.reshape(len(at_near), -1)).reshape(at_near.shape)
            response[:, :, self.near] = at_near - self.project(weighted, self.near)
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
