"""Rows of low rank, C = G V': masks on a grid finer than that of their band. The other rows are E.

With J = (E; V') P (E; V')' and the compliances C_e and C_g of E and of the rows G V', the Schur complement is

    (J_ee + C_e) nu_e + J_ev g = r_e,   G (J_ve nu_e + J_vv g) + C_g nu = r_g,   g = G'nu.

With the Schur complement L L' of J_ee + C_e in J, a = L'g lies between them. For r = r_g - G J_ve (J_ee + C_e)^-1 r_e,
H = G L, and rows split into weak ones (w), whose compliance is not small, and strong ones:

    M = 1 + H_w' C_w^-1 H_w,   (H_s M^-1 H_s' + C_s) nu_s = r_s - H_s M^-1 H_w' C_w^-1 r_w,
    M a = H_w' C_w^-1 r_w + H_s' nu_s,   nu_w = C_w^-1 (r_w - H_w a).

Sums of positive matrices lose no digits. The difference in nu_w loses as many as the stiffness of a weak row exceeds
that of the response; hence the split.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as la

from lin_freq_ocp.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.structured.kkt.dense import Cholesky
from lin_freq_ocp.methods.structured.kkt.response import Response
from lin_freq_ocp.methods.structured.kkt.side import Compliance, Step

STRONG = 1e6  # stiffness of a row times its response from which it is solved for itself: six of sixteen digits are lost
SPARE = 40  # directions beyond the number of bins of a band: its ends leak into as many, growing like log T
WORTH = 0.75  # rank relative to the number of rows below which the low rank pays


def fine_rows(response: Response) -> Indices | None:
    """Return the rows of low rank of F, if there are any that pay."""
    first, found, rank = response.coupling.equation_count, list[Indices](), SPARE
    first += sum(part.rows.count for part in response.coupling.inequalities)
    for part in response.coupling.balls:
        count = part.rows.count + (0 if part.heads is None else part.heads.count)
        if part.rows.oversampling > 1 and part.heads is None:
            found.append(first + np.arange(count))
            rank += count // part.rows.oversampling
        first += count
    rows = np.concatenate(found) if found else np.arange(0)
    return rows if rank < WORTH * len(rows) else None


class FineRows:
    """The side with rows of low rank."""

    def __init__(self, response: Response, fine: Indices):
        self._response, coupling = response, response.coupling
        self._fine, self._plain = fine, np.setdiff1d(np.arange(coupling.count), fine)
        self._chosen = [i for i, part in enumerate(coupling.balls) if part.rows.oversampling > 1 and part.heads is None]
        V, self._G = self._basis()
        of_plain, end = response.gradients(self._plain)
        none = np.zeros((len(end), V.shape[2]))
        self._gradients = np.concatenate([of_plain, V], axis=2), np.concatenate([end, none], axis=1)

    def factor(self, Phi: Array, compliance: Compliance) -> None:
        """Prepare for Phi (T+1, n+k, n+k) and C."""
        self._response.factor(Phi)
        J, e = self._response.gram(*self._gradients), len(self._plain)
        self._add_plain(J, compliance)
        self._rows, self._cross = Cholesky(J[:e, :e]), J[:e, e:]
        self._eliminated = self._rows.solve(self._cross)
        S = J[e:, e:] - self._cross.T @ self._eliminated
        self._stiffness = [compliance.stiffness[i] for i in self._chosen]
        self._H = self._G @ Cholesky(S).root
        self._split()
        M = self._H.T @ self._times_stiffness(self._H)
        M.flat[:: len(M) + 1] += 1.0
        self._M = Cholesky(M)
        if self._strong.any():
            of_strong = self._M.whitened(self._H[self._strong].T)
            T = of_strong.T @ of_strong
            T += la.block_diag(*self._strong_blocks(compliance))
            self._T = Cholesky(T)

    def solve(self, gradient: Array, c: Array, x0: Array, f: Array) -> Step:
        """Return the solution for gradient (T+1, n+k), c (T+1, n), x0 (n,), f (rows,)."""
        missing = self._response.missing(gradient, c, x0, f)
        alone = self._rows.solve(missing[self._plain])
        r = missing[self._fine] - self._G @ (self._cross.T @ alone)
        of_weak = self._H.T @ self._times_stiffness(r[:, None])[:, 0]
        a, strong = self._M.solve(of_weak), np.zeros(0)
        if self._strong.any():
            H = self._H[self._strong]
            strong = self._T.solve(r[self._strong] - H @ a)
            a = self._M.solve(of_weak + H.T @ strong)
        of_fine = self._times_stiffness((r - self._H @ a)[:, None])[:, 0]
        of_fine[self._strong] = strong
        nu = np.empty(len(missing))
        nu[self._fine], nu[self._plain] = of_fine, alone - self._eliminated @ (self._G.T @ of_fine)
        return self._response.step(gradient, c, x0, f, nu)

    def _basis(self) -> tuple[Array, Array]:
        """Return V (T+1, channels, rank), orthonormal, by a random range, and G, so that the fine rows are G V'."""
        response, rng = self._response, np.random.default_rng(0)
        families = [(rows, at) for rows, at in response.families if np.isin(at[0], self._fine)]
        rank = SPARE + sum(rows.count // rows.oversampling for rows, _ in families)
        rank = min(rank, response.empty(1).size)
        signals = response.empty(rank)
        for rows, _ in families:
            rows.add_adjoint(rng.standard_normal((rows.count, rank)), signals)
        basis = la.qr(signals.reshape(-1, rank), mode="economic", overwrite_a=True, check_finite=False)[0]
        V: Array = np.ascontiguousarray(basis.reshape(signals.shape), dtype=float)
        return V, np.concatenate([rows.forward(V) for rows, _ in families])

    def _add_plain(self, J: Array, compliance: Compliance) -> None:
        """Add C_e."""
        blocks = [np.diag(compliance.rows)]
        for i, ball in enumerate(compliance.balls):
            if i not in self._chosen:
                blocks.append(la.block_diag(*ball))
        J[: len(self._plain), : len(self._plain)] += la.block_diag(*blocks)

    def _split(self) -> None:
        """Set which of the fine rows are strong, (rows,)."""
        response = (self._H * self._H).sum(1)
        strong, first = list[Mask](), 0
        for blocks in self._stiffness:
            balls, d = blocks.shape[:2]
            own = response[first : first + balls * d].reshape(balls, d).max(1)
            strong.append(np.repeat(np.abs(blocks).sum(2).max(1) * own > STRONG, d))
            first += balls * d
        self._strong = np.concatenate(strong)

    def _strong_blocks(self, compliance: Compliance) -> list[Array]:
        """Return the compliances of the strong rows, ball by ball."""
        found, first = list[Array](), 0
        for i in self._chosen:
            balls, d = compliance.balls[i].shape[:2]
            found += list(compliance.balls[i][self._strong[first : first + balls * d : d]])
            first += balls * d
        return found

    def _times_stiffness(self, v: Array) -> Array:
        """Return C_w^-1 v for rows (rows, k), zero in the strong ones."""
        parts, first = list[Array](), 0
        for blocks in self._stiffness:
            balls, d = blocks.shape[:2]
            parts.append((blocks @ v[first : first + balls * d].reshape(balls, d, -1)).reshape(balls * d, -1))
            first += balls * d
        result = np.concatenate(parts)
        result[self._strong] = 0.0
        return result
