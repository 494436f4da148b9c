"""All y_k = (x_k, u_k) that satisfy the dynamics and the stop bands at each bin (docs/spectral.md, 2, 3 and 5).

    D_k y_k = z w + d_k,  D_k = [zI - A, -B_passed],  w = x_0 - x_T
    <=>   y_k = N_k v_k + D_k^+ (z w + d_k) + (bordering directions)

The jump w closes the period: x_1 .. x_T have the spectrum z (x_k - w). N_k spans the regular part of the null space of
D_k, with N_k^* M N_k = I. The particular response is M-orthogonal to it: N_k^* M D_k^+ = 0. Far from eigenvalues of A,
before these normalisations, N = [(zI - A)^{-1} B; I] and D^+ = [(zI - A)^{-1}; 0]. Near them, both follow from a
singular value decomposition of D_k; directions of small cost or of small singular values become bordering directions,
one complex unknown each.

The inverse transform of F_f N N^* F_g' is a circulant kernel kappa_fg, the response of row f to a unit force on row g,
by their distance in time. A first reader may skip NearBins and ``_choose_bordering_directions``: they only matter at
the few bins near eigenvalues.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from scipy.linalg import schur

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask, seal
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.spectral.model import Lti

MOST_BORDERING = 128  # directions of small cost; of more, only the smallest become bordering unknowns, which are dense
SMALL_TABLE = 500_000  # entries up to which all kernels are computed at once
NEAR_RESOLVENT = 1e2  # sum of the absolute entries of the resolvent at a near bin: dividing loses two digits there
NEAR_RADIUS = 0.3  # distance to an eigenvalue up to which the resolvent is tested: a back substitution for these bins
# Singular value of D_k, relative to the largest, below which its direction becomes a bordering unknown: a division by
# it would lose five digits of the response to a jump ...
SMALL_SINGULAR_VALUE = 1e-5
# ... unless the distance to every eigenvalue, times T, is above this: |1 - (lambda / z)^T| is then of order 1, or
# |lambda| is far from 1 in T steps, and a jump leaves a response of its own size. Few bins per eigenvalue are nearer.
RESOLVED_PHASE = 10.0
LEAST_DIVISOR = 1e-11  # ... and below which it does at any distance: fewer than five digits of the value are known
ZERO_SINGULAR_VALUE = 1e-13  # relative singular value that is rounding; as a number it would decide the answer
# Cost of a null direction, relative to a control's, below which it becomes a bordering unknown: N would be the vector
# over the root of its cost, and kernels 1e4 times as large as the others lose four digits of their sums ...
SMALL_HESSIAN = 1e-4
LEAST_HESSIAN = 1e-10  # ... also if there are MOST_BORDERING cheaper ones: ten digits of the sums would be lost
SINGULAR_HESSIAN = 1e-13  # relative eigenvalue of N^*MN that is rounding of 0: the cost does not see this direction

FLAT_COST = (
    "method 'spectral': some direction that the bands allow costs nothing (R singular); "
    "give every control a cost, or use method 'convex'."
)


class Resolvent:
    """(zI - A)^{-1} at all bins at once, by back substitution in a Schur form of A: no powers of A occur."""

    def __init__(self, A: Array):
        self.triangle, self.unitary = schur(A.astype(np.complex128), output="complex")
        self.eigenvalues: ComplexArray = np.diagonal(self.triangle)

    def apply(self, z: ComplexArray, rhs: ComplexArray, adjoint: bool = False) -> ComplexArray:
        """Return (z_k I - A)^{-1} rhs_k, or (z_k I - A)^{-*} rhs_k; inf or NaN at eigenvalues.

        z is (bins,), and rhs (n, columns, bins).
        """
        solution, triangle, order = times_columns(self.unitary.conj().T, rhs), self.triangle, range(len(rhs))[::-1]
        if adjoint:  # of a lower triangle, the first unknown follows first
            z, triangle, order = z.conj(), triangle.conj().T, order[::-1]
        for i in order:
            for j in range(len(rhs)):
                if j != i and triangle[i, j]:
                    solution[i] += triangle[i, j] * solution[j]
            solution[i] /= z - triangle[i, i]
        return times_columns(self.unitary, solution)


def times_columns(matrix: Array | ComplexArray, X: ComplexArray) -> ComplexArray:
    """Return the matrix times all vectors along the first axis of X."""
    return (matrix @ X.reshape(len(X), -1)).reshape(len(matrix), *X.shape[1:])


class NearBins:
    """D_k = U diag(sigma) V^* at the near bins k (count,): left (count, n, n), sigma (count, n), right (count, n+m, n).

    ``good`` (count, n) marks the singular values that the particular response divides by. ``null`` (count, n+m, m) are
    the null vectors of D_k that diagonalise M, and ``cost`` (count, m) their costs; both are padded for stopped
    controls, by zeros and inf.
    """

    def __init__(self, lti: Lti, k: Indices, z: ComplexArray, distance: Array):
        """Decompose bins k of all z (bins,), at ``distance`` (bins,) from the nearest eigenvalue."""
        self.k, n, m = k, lti.state_dim, lti.control_dim
        self.left = np.empty((len(k), n, n), dtype=np.complex128)
        self.sigma = np.empty((len(k), n))
        self.right = np.zeros((len(k), n + m, n), dtype=np.complex128)
        self.null = np.zeros((len(k), n + m, m), dtype=np.complex128)
        self.cost = np.full((len(k), m), np.inf)
        real = (k == 0) | (2 * k == lti.horizon)
        # bins that share a mask of passed controls are decomposed at once, in real arithmetic where z is real
        groups = defaultdict[bytes, list[int]](list)
        for i, mask in enumerate(np.vstack([lti.passed[:, k], real]).T):
            groups[mask.tobytes()].append(i)
        for members in map(np.array, groups.values()):
            z_k = z[k[members]].real if real[members[0]] else z[k[members]]
            passed = np.append(np.ones(n, dtype=bool), lti.passed[:, k[members[0]]])
            D = z_k[:, None, None] * np.eye(n, n + m) - np.hstack([lti.A, lti.B])
            self.left[members], self.sigma[members], right = np.linalg.svd(D[:, :, passed])
            V = np.zeros((len(z_k), n + m, right.shape[1]), dtype=z_k.dtype)
            V[:, passed] = right.conj().swapaxes(1, 2)
            self.right[members], null = V[:, :, :n], V[:, :, n:]
            columns, cost = null.shape[2], null.conj().swapaxes(1, 2) @ lti.M @ null
            self.cost[members, :columns], vectors = np.linalg.eigh(cost)
            self.null[members, :, :columns] = null @ vectors
        largest = np.maximum(1.0, self.sigma[:, :1])
        self.sigma[self.sigma < ZERO_SINGULAR_VALUE * largest] = 0.0
        resolved = lti.horizon * distance[k, None] > RESOLVED_PHASE
        self.good = self.sigma > np.where(resolved, LEAST_DIVISOR, SMALL_SINGULAR_VALUE) * largest
        self._inverse = np.divide(1.0, self.sigma, out=np.zeros_like(self.sigma), where=self.good)

    def particular(self, rhs: ComplexArray) -> ComplexArray:
        """Return the pseudo-inverse applied to rhs (n, columns, count), shape (n+m, columns, count)."""
        projected = np.einsum("kij,ick->kjc", self.left.conj(), rhs) * self._inverse[:, :, None]
        return np.einsum("kij,kjc->ick", self.right, projected)

    def adjoint(self, rhs: ComplexArray) -> ComplexArray:
        """Return U diag(1/sigma) V^* rhs over the good singular values, for rhs (n+m, columns, count)."""
        projected = np.einsum("kij,ick->kjc", self.right.conj(), rhs) * self._inverse[:, :, None]
        return np.einsum("kij,kjc->ick", self.left, projected)


@dataclass(frozen=True, eq=False)
class CompatibilityEquation:
    """At bin k: sigma xi = U_j^*(z w + d_k), sigma small, xi the coefficient of bordering direction ``direction``."""

    k: int
    left: ComplexArray
    sigma: float
    direction: int


class BinSpaces:
    """The null spaces N (n+m, m, bins) and particular responses of all bins 0 .. T/2; spectra are (component, bin).

    z = exp(2 pi i k / T); ``multiplicity`` is how often a bin counts in sums over the full circle (1 or 2).
    The bordering directions bordering_vector (n+m, directions) at bordering_bin (directions,) are M-orthogonal to N.
    """

    def __init__(self, lti: Lti):
        self.lti = lti
        bins = np.arange(lti.horizon // 2 + 1)
        self.z: ComplexArray = np.exp(2j * np.pi * bins / lti.horizon)
        self.multiplicity = bin_multiplicity(lti.horizon)
        self.resolvent = Resolvent(lti.A)
        distance = np.full(len(self.z), np.inf)  # to the nearest eigenvalue
        for eigenvalue in self.resolvent.eigenvalues:
            np.minimum(distance, np.abs(self.z - eigenvalue), out=distance)
        close = np.flatnonzero(distance < NEAR_RADIUS)
        with np.errstate(all="ignore"):
            identity = np.repeat(np.eye(lti.state_dim, dtype=np.complex128)[:, :, None], len(close), axis=2)
            size = np.abs(self.resolvent.apply(self.z[close], identity)).sum((0, 1))
        self.near = NearBins(lti, close[~(size < NEAR_RESOLVENT)], self.z, distance)
        self.N = self._far_null_spaces()
        self.compatibility: list[CompatibilityEquation] = []
        self._choose_bordering_directions()

    def _far_null_spaces(self) -> ComplexArray:
        """Return N at far bins, normalised by a Cholesky factor of N^*MN; 0 at near bins and for stopped controls."""
        lti, n, m = self.lti, self.lti.state_dim, self.lti.control_dim
        passed = np.array(lti.passed)
        passed[:, self.near.k] = False
        N = np.zeros((n + m, m, len(self.z)), dtype=np.complex128)
        with np.errstate(all="ignore"):
            B = lti.B[:, :, None].astype(np.complex128) if lti.response is None else lti.response
            N[:n] = self.resolvent.apply(self.z, np.broadcast_to(B, (n, m, len(self.z))))
        N[:n, ~passed] = 0
        N[n + np.arange(m), np.arange(m)] = passed
        weighted = slice(0 if lti.state_cost else n, None)  # the components that M weighs
        part, M = N[weighted], lti.M[weighted, weighted]
        cost = np.asarray(np.einsum("iak,ibk->kab", part.conj(), times_columns(M, part)), dtype=np.complex128)
        if m == 1:  # several are checked below
            rounding = SINGULAR_HESSIAN**2 * lti.curvature_unit * (np.abs(part[:, 0]) ** 2).sum(0)
            if (cost[:, 0, 0].real <= rounding)[passed[0]].any():
                raise UnsupportedError(FLAT_COST)
        cost[:, np.arange(m), np.arange(m)] += ~passed.T  # stopped controls: their zero columns stay zero
        sizes = np.sqrt(np.diagonal(cost, axis1=1, axis2=2).real)
        if not (sizes > 0).all():
            raise UnsupportedError(FLAT_COST)
        if m == 1:
            N /= sizes.T
            return N
        try:
            factor = np.linalg.cholesky(cost / (sizes[:, :, None] * sizes[:, None]))
        except np.linalg.LinAlgError:
            raise UnsupportedError(FLAT_COST) from None
        if np.diagonal(factor, axis1=1, axis2=2).real.min(initial=1.0) ** 2 <= SINGULAR_HESSIAN:
            raise UnsupportedError(FLAT_COST)
        return np.einsum("iak,kba->ibk", N, (np.linalg.inv(factor) / sizes[:, None]).conj())

    def _choose_bordering_directions(self) -> None:
        """Choose the bordering directions among those of the near bins, and complete N by the others."""
        near, unit = self.near, self.lti.curvature_unit
        costs = near.cost[np.isfinite(near.cost)]
        smallest = np.sort(costs)[MOST_BORDERING] if len(costs) > MOST_BORDERING else np.inf
        regular = near.cost > unit * max(LEAST_HESSIAN, min(SMALL_HESSIAN, smallest / unit))
        scaled = near.null / np.sqrt(np.where(regular, near.cost, np.inf))[:, None, :]
        self.N[:, :, near.k] = scaled.transpose(1, 2, 0)
        small, column = np.nonzero(~regular)
        bad, which = np.nonzero(~near.good)
        for direction, (i, j) in enumerate(zip(bad, which, strict=True), start=len(small)):
            equation = CompatibilityEquation(int(near.k[i]), near.left[i, :, j], float(near.sigma[i, j]), direction)
            self.compatibility.append(equation)
        self.bordering_bin = near.k[np.concatenate([small, bad])]
        vectors = np.vstack([near.null[small, :, column], near.right[bad, :, which]]).T
        N = self.N[:, :, self.bordering_bin]
        along = np.einsum("iak,ik->ak", N.conj(), self.lti.M @ vectors)
        self.bordering_vector: ComplexArray = vectors - np.einsum("iak,ak->ik", N, along)

    def particular(self, rhs: ComplexArray) -> ComplexArray:
        """Return D^+ rhs, with D^+ <- (I - N N^* M) D^+, shape (n+m, columns, bins), for rhs (n, columns, bins)."""
        lti, n = self.lti, self.lti.state_dim
        response = np.zeros((len(lti.M), *rhs.shape[1:]), dtype=np.complex128)
        with np.errstate(all="ignore"):
            response[:n] = self.resolvent.apply(self.z, rhs)
        k = self.near.k
        response[:, :, k] = self.near.particular(rhs[:, :, k])
        if lti.state_cost:
            response -= self.project(times_columns(lti.M, response))
        else:  # at far bins the response has u = 0, and M weighs u only
            response[:, :, k] -= self.project(times_columns(lti.M, response[:, :, k]), k)
        return response

    def project(self, g: ComplexArray, bins: Indices | slice = slice(None)) -> ComplexArray:
        """Return N N^* g, for g (n+m, columns, bins)."""
        N = self.N[:, :, bins]
        return np.einsum("iak,ack->ick", N, np.einsum("iak,ick->ack", N.conj(), g))

    def respond(self, force: ComplexArray, used: Mask, spectrum: ComplexArray) -> None:
        """Subtract N N^* force from the spectrum (n+m, bins), in place; only the ``used`` components are not zero."""
        components = np.flatnonzero(used)
        for a in range(self.lti.control_dim):
            v = sum((self.N[i, a].conj() * force[i] for i in components), start=np.zeros(len(self.z), complex))
            for row, response in zip(spectrum, self.N[:, a], strict=True):
                row -= response * v


@lru_cache(maxsize=4)  # a loop reads the multipliers of one horizon at every step
def bin_multiplicity(horizon: int) -> Array:
    """Return how often each bin of the DFT counts in sums over the full circle, 1 or 2, (T//2 + 1,)."""
    bins = np.arange(horizon // 2 + 1)
    return seal(np.where((bins == 0) | (2 * bins == horizon), 1.0, 2.0))


class CirculantKernels:
    """kappa_fg(t) = irfft of F_f N N^* F_g': a unit force on F_g y_0 lowers F_f y_t by kappa_fg(t).

    ``table`` is (rows, rows, T). If it is not ``complete``, pairs f <= g are computed on demand; the others are
    undefined, and use no memory.
    """

    def __init__(self, lti: Lti, spaces: BinSpaces):
        self.lti, self.spaces, rows = lti, spaces, len(lti.F)
        self._computed = np.zeros((rows, rows), dtype=bool)
        self.complete = rows * rows * lti.horizon <= SMALL_TABLE
        if self.complete:
            NF = self.of_rows(np.arange(rows))
            kernels = np.fft.irfft((NF[:, None] * NF[None].conj()).sum(2), lti.horizon)
            self.table = (kernels + kernels[:, :, -np.arange(lti.horizon)].swapaxes(0, 1)) / 2
        else:
            self.table = np.empty((rows, rows, lti.horizon))

    def gram(self, t: Indices, f: Indices, t_force: Indices, g: Indices) -> Array:
        """Return kappa_{f_i g_j}(t_i - t_force_j), shape (len(t), len(t_force)); all times are below T."""
        if not self.complete:
            self._compute(product(np.unique(f), np.unique(g)))
        f, lag = f[:, None], t[:, None] - t_force  # a negative index counts from the end of the circle
        if self.complete:
            return self.table[f, g, lag]
        return self.table[np.minimum(f, g), np.maximum(f, g), np.where(f <= g, lag, -lag)]

    def gram_of_rows(self, t: Indices, f: Indices) -> Array:
        """Return kappa between the rows f at times t, (count, count); 0 for components of x_T, which are at t = T."""
        inner = t < self.lti.horizon
        if inner.all():
            return self.gram(t, f, t, f)
        gram = np.zeros((len(t), len(t)))
        gram[np.ix_(inner, inner)] = self.gram(t[inner], f[inner], t[inner], f[inner])
        return gram

    def free_response(self, t: Indices, f: Indices) -> Array:
        """Return the response of each row to a unit force on it, without equations, kappa_ff(0), (count,).

        Components of x_T are unknowns of their own.
        """
        inner = t < self.lti.horizon
        if not self.complete:
            self._compute((a, a) for a in np.unique(f[inner]))
        return np.where(inner, self.table[f, f, 0], 1 / self.lti.curvature_unit)

    def _compute(self, pairs: Iterable[tuple[int, int]]) -> None:
        for f, g in map(sorted, pairs):
            if not self._computed[f, g]:
                row, column = self.of_rows(np.array([f, g]))
                self.table[f, g] = np.fft.irfft((row * column.conj()).sum(0), self.lti.horizon)
                if f == g:
                    self.table[f, f] += np.roll(self.table[f, f, ::-1], 1)
                    self.table[f, f] /= 2
                self._computed[f, g] = True

    def of_rows(self, rows: Indices) -> ComplexArray:
        """Return F_f N of some rows, shape (rows, m, bins)."""
        dimension = len(self.lti.M)
        return self.spaces.N[rows] if len(self.lti.F) == dimension else times_columns(self.lti.F[rows], self.spaces.N)
