"""The range-space KKT solver: the unknowns are the multipliers of the coupling rows F.

The Schur complement on them is S = F P F' + C, a sum of squares, where P is the response of the regulator. A fixed x_T
adds rho |x_T - its value|^2 to the cost of the recursion: that does not change the answer, and keeps the closed loop
stable over long horizons of unstable dynamics.

Masks on a grid finer than that of their band have low rank, G V'. The other rows are E. With J = (E; V') P (E; V')' and
the compliances C_e and C_g of E and of the rows G V', the Schur complement is

    (J_ee + C_e) nu_e + J_ev g = r_e,   G (J_ve nu_e + J_vv g) + C_g nu = r_g,   g = G'nu.

With the Schur complement L L' of J_ee + C_e in J, a = L'g lies between them. For r = r_g - G J_ve (J_ee + C_e)^-1 r_e,
H = G L, and with the rows split into weak ones (w), whose compliance is not small, and strong ones (s),

    M = 1 + H_w' C_w^-1 H_w,   (H_s M^-1 H_s' + C_s) nu_s = r_s - H_s M^-1 H_w' C_w^-1 r_w,
    M a = H_w' C_w^-1 r_w + H_s' nu_s,   nu_w = C_w^-1 (r_w - H_w a).

Sums of positive matrices lose no digits. The difference in nu_w loses digits if a weak row is much stiffer than the
response; hence the split.
"""

from __future__ import annotations

from copy import copy
from itertools import pairwise
from typing import ClassVar, Self

import numpy as np
import scipy.linalg as la

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.structured.kkt.dense import Cholesky, gram
from lin_freq_ocp.methods.structured.kkt.recursions import Loops, Regulator
from lin_freq_ocp.methods.structured.kkt.system import Compliance, KKTSolver, SystemSolution
from lin_freq_ocp.methods.structured.stages import Balls, Stages

TERMINAL_WEIGHT = 1e2  # of the distance from the terminal state, relative to the largest curvature
LEAST_CURVATURE = 1e-3  # in units of order 1
STRONG = 1e6  # stiffness of a row times its response, from which the row is strong: six of sixteen digits would be lost
SPARE = 40  # directions in addition to the bins of a band: its edges leak into as many, which grow like log T
WORTH = 0.75  # rank relative to the number of rows, below which the low rank pays


def range_space_solver(stages: Stages, loops: Loops) -> KKTSolver:
    """Return the solver: the low-rank one if there are rows on a fine grid, otherwise the dense one."""
    response = CouplingResponse(stages, loops)
    fine = fine_rows(response)
    return RangeSpaceSolver(response) if fine is None else LowRankSolver(response, fine)


class CouplingResponse:
    """The regulator of one problem and the rows F of its coupling, in the order of ``Coupling``."""

    def __init__(self, stages: Stages, loops: Loops):
        self.stages, self.coupling, self._loops = stages, stages.coupling, loops
        self.rows = stages.coupled
        self._weights = np.zeros(stages.states)
        curvature = float(np.abs(np.einsum("tii->ti", stages.H[:-1])).max(initial=0.0))
        self._weights[self.coupling.terminal] = TERMINAL_WEIGHT * max(curvature, LEAST_CURVATURE)

    def exchanged(self, stages: Stages) -> CouplingResponse:
        """Return the response of stages with other dynamics and Hessians."""
        other = copy(self)
        other.stages = stages
        return other

    def factor(self, Phi: Array) -> None:
        """Factor the stages with Phi (T+1, n+k, n+k)."""
        stages, n = self.stages, self.stages.states
        Phi = Phi.copy()
        Phi[-1, :n, :n] += np.diag(self._weights)
        self._regulator: Regulator = self._loops.factor(stages.A, stages.B, Phi, stages.fixed)

    def missing(self, gradient: Array, c: Array, x0: Array, f: Array) -> Array:
        """Return F y - f of the answer without the rows F."""
        y, _, _ = self._regulator.solve(self._shift_terminal(gradient, f), c, x0)
        return self.rows.values(y) - f

    def step(self, gradient: Array, c: Array, x0: Array, f: Array, nu: Array) -> SystemSolution:
        """Return the answer with the multipliers nu of the rows F."""
        gradient, terminal = self._shift_terminal(gradient, f), self.coupling.terminal
        self.rows.add_adjoint(nu, gradient)
        y, eta, initial = self._regulator.solve(gradient, c, x0)
        nu = nu.copy()
        nu[: len(terminal)] += self._weights[terminal] * (y[-1, terminal] - f[: len(terminal)])
        return SystemSolution(y, eta, initial, nu)

    def gram(self, signals: Array, end: Array) -> Array:
        """Return the lower triangle of R'P R of gradients R on channels (T+1, channels, k) and on x_T (n, k)."""
        return self._regulator.gram(self.coupling.channels, signals, end)

    def _shift_terminal(self, gradient: Array, f: Array) -> Array:
        """Return the gradient with that of the weight on the distance from the terminal state."""
        gradient, terminal = gradient.copy(), self.coupling.terminal
        gradient[-1, terminal] -= self._weights[terminal] * f[: len(terminal)]
        return gradient


class _RangeSpace:
    """A solver for the multipliers of the rows; dynamics and Hessians enter by the response only."""

    indefinite: ClassVar[bool] = False
    _response: CouplingResponse

    def exchanged(self, stages: Stages) -> Self:
        """Return the solver for stages with other dynamics and Hessians."""
        other = copy(self)
        other._response = self._response.exchanged(stages)
        return other


class RangeSpaceSolver(_RangeSpace):
    """The dense Schur complement on all rows that couple times."""

    def __init__(self, response: CouplingResponse):
        self._response, self._count = response, response.coupling.count
        self._rows = response.rows.gradients

    def factor(self, Phi: Array, compliance: Compliance) -> bool:
        """Factor for Phi (T+1, n+k, n+k) and C."""
        self._response.factor(Phi)
        S = self._response.gram(*self._rows)
        compliance.add_to(S)
        self._schur = Cholesky(S)
        return True

    def solve(self, gradient: Array, c: Array, x0: Array, f: Array) -> SystemSolution:
        """Return the solution for gradient (T+1, n+k), c (T+1, n), x0 (n,), f (rows,)."""
        right = gradient, c, x0, f
        nu = self._schur.solve(self._response.missing(*right)) if self._count else np.zeros(0)
        return self._response.step(*right, nu)


def fine_rows(response: CouplingResponse) -> Indices | None:
    """Return the rows of F on a fine grid, if their low rank pays."""
    first, fine, rank = response.coupling.equation_count, list[Indices](), SPARE
    first += sum(part.rows.count for part in response.coupling.inequalities)
    for part in response.coupling.balls:
        count = part.rows.count + (0 if part.heads is None else part.heads.count)
        if _is_fine(part):
            fine.append(first + np.arange(count))
            rank += count // part.rows.oversampling
        first += count
    rows = np.concatenate(fine) if fine else np.arange(0)
    return rows if rank < WORTH * len(rows) else None


def _is_fine(part: Balls) -> bool:
    """Whether hard balls are on a grid finer than that of the DFT."""
    return part.rows.oversampling > 1 and part.heads is None


class LowRankSolver(_RangeSpace):
    """The Schur complement with rows of low rank."""

    def __init__(self, response: CouplingResponse, fine: Indices):
        self._response, coupling = response, response.coupling
        self._fine, self._plain = fine, np.setdiff1d(np.arange(coupling.count), fine)
        self._chosen = [_is_fine(part) for part in coupling.balls]
        self._of_hard = [fine for part, fine in zip(coupling.balls, self._chosen, strict=True) if part.heads is None]
        ends = np.cumsum([0, *(part.rows.count for part in coupling.balls if _is_fine(part))])
        self._families = [slice(a, b) for a, b in pairwise(ends.tolist())]  # of the fine rows
        # V (T+1, channels, rank) is orthonormal, by a random range finder, and the fine rows are G V'
        rng, families = np.random.default_rng(0), [rows for rows, at in coupling.families() if np.isin(at[0], fine)]
        shape = len(response.stages.H), len(coupling.channels)
        rank = min(SPARE + sum(rows.count // rows.oversampling for rows in families), shape[0] * shape[1])
        signals = np.zeros((*shape, rank))
        for rows in families:
            rows.add_adjoint(rng.standard_normal((rows.count, rank)), signals)
        basis = la.qr(signals.reshape(-1, rank), mode="economic", overwrite_a=True, check_finite=False)[0]
        V: Array = np.ascontiguousarray(basis.reshape(signals.shape), dtype=float)
        self._G = np.concatenate([rows.forward(V) for rows in families])
        of_plain, end = response.rows.chosen(self._plain)
        none = np.zeros((len(end), V.shape[2]))
        self._gradients = np.concatenate([of_plain, V], axis=2), np.concatenate([end, none], axis=1)

    def factor(self, Phi: Array, compliance: Compliance) -> bool:
        """Factor for Phi (T+1, n+k, n+k) and C."""
        self._response.factor(Phi)
        J, e = self._response.gram(*self._gradients), len(self._plain)
        of_plain = tuple(ball for ball, fine in zip(compliance.balls, self._chosen, strict=True) if not fine)
        Compliance(compliance.rows, of_plain).add_to(J[:e, :e])
        self._rows, self._cross = Cholesky(J[:e, :e]), J[e:, :e]
        self._eliminated = self._rows.solve(self._cross.T)
        self._H = Cholesky(J[e:, e:] - self._cross @ self._eliminated).rooted(self._G)
        self._roots = [roots for roots, fine in zip(compliance.roots, self._of_hard, strict=True) if fine]
        # which of the fine rows are strong, ball by ball
        response, strong = np.einsum("ij,ij->i", self._H, self._H), list[Mask]()
        for roots, family in zip(self._roots, self._families, strict=True):
            balls, d = roots.shape[:2]
            stiff = (roots * roots).sum((1, 2)) * response[family].reshape(balls, d).max(1) > STRONG
            strong.append(np.repeat(stiff, d))
        self._strong = np.concatenate(strong)
        self._stiff_H = self._apply_roots(self._H)
        M = gram(self._stiff_H)
        M.flat[:: len(M) + 1] += 1.0
        self._M, self._strong_H = Cholesky(M), self._H[self._strong]
        if len(self._strong_H):
            T = gram(self._M.whitened(self._strong_H.T))
            of_fine = [ball for ball, fine in zip(compliance.balls, self._chosen, strict=True) if fine]
            parts = zip(of_fine, self._families, strict=True)
            blocks = tuple(ball[self._strong[family][:: ball.shape[1]]] for ball, family in parts)
            Compliance(np.zeros(0), blocks).add_to(T)
            self._T = Cholesky(T)
        return True

    def solve(self, gradient: Array, c: Array, x0: Array, f: Array) -> SystemSolution:
        """Return the solution for gradient (T+1, n+k), c (T+1, n), x0 (n,), f (rows,)."""
        missing = self._response.missing(gradient, c, x0, f)
        alone = self._rows.solve(missing[self._plain])
        r = missing[self._fine] - self._G @ (self._cross @ alone)
        of_weak = self._stiff_H.T @ self._apply_roots(r[:, None])[:, 0]
        a, strong = self._M.solve(of_weak), np.zeros(0)
        if len(self._strong_H):
            strong = self._T.solve(r[self._strong] - self._strong_H @ a)
            a = self._M.solve(of_weak + self._strong_H.T @ strong)
        of_fine = self._apply_roots(self._apply_roots((r - self._H @ a)[:, None]))[:, 0]
        of_fine[self._strong] = strong
        nu = np.empty(len(missing))
        nu[self._fine], nu[self._plain] = of_fine, alone - self._eliminated @ (self._G.T @ of_fine)
        return self._response.step(gradient, c, x0, f, nu)

    def _apply_roots(self, v: Array) -> Array:
        """Return R v for v (rows, k), with R'R = C_w^-1 and zeros in the strong rows."""
        result = np.empty_like(v)
        for roots, family in zip(self._roots, self._families, strict=True):
            balls, d = roots.shape[:2]
            np.matmul(roots, v[family].reshape(balls, d, -1), out=result[family].reshape(balls, d, -1))
        result[self._strong] = 0.0
        return result
