"""The error e = x - z of a plan under loads: e_{t+1} = (A_t + B_t K) e_t + E_t w_t, e_0 = 0, and its margins.

The largest value of c'x_t + d'u_t - c'z_t - d'v_t over all loads is sum_{j<t} h(S_tj) with
S_tj = E_j'(A_K,t-1 .. A_K,j+1)'(c + K'd): the loads of different times are independent, so the largest value of the sum
is the sum of the largest values (Chisci, Rossiter and Zappa, Automatica 37, 2001; docs/robust.md).

Rounding. Powers of A_K are computed with local errors of c eps |X| a, a = |A| + |B||K|, which act through true powers.
With N^ = sum |X| over all powers and D = c eps N^ a, the sum of the absolute values of the true powers is at most
N = (I - D)^-1 N^, and all margins together are rounded by at most |c + K'd|'c eps (N + N a N)|E| max|w|. The bound does
not depend on units: all its inequalities hold entry by entry.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.uncertainty.loads import Loads

EPS = float(np.finfo(np.float64).eps)
OPERATIONS = 20  # of a margin, beyond the lengths of its sums
TAIL = 1e-12  # of the margins after many steps: what all later powers add is proven to be less
MOST_POWERS = 2**24  # numbers in all powers that are kept


@dataclass(frozen=True, eq=False)
class ErrorLoop:
    """The loop of the error of a plan, with its loads."""

    loads: Loads
    start: Loads | None  # the error of the start, x_0 - z_0
    A: Array  # A + B K, (n, n), or (T, n, n) with all of A, a and E
    a: Array  # |A| + |B||K|
    K: Array  # (m, n)
    E: Array  # (n, k)
    horizon: int
    forever: bool  # whether the loads have acted since ever

    @property
    def constant(self) -> bool:
        """Whether the dynamics and the input of the loads do not depend on time."""
        return self.A.ndim == 2

    @cached_property
    def count(self) -> int:
        """The number of powers of A_K: T + 1, or forever so many that the later ones add next to nothing."""
        least, (n, k) = self.horizon + 1, self.E.shape[-2:]
        if not self.forever:
            return least
        power, powers = np.linalg.matrix_power(self.A, least), least
        total = np.abs([np.linalg.matrix_power(self.A, i) for i in range(least)]).sum(axis=0)
        while not self._tail(power, total)[1]:
            if 2 * powers * n * (n + k) > MOST_POWERS:
                got = "a loop in which loads fade too slowly"
                raise ProblemError("disturbance.gain", got, "a gain of faster feedback")
            total = total + np.abs(power) @ total  # at least the sum of twice as many powers
            power, powers = power @ power, 2 * powers
        return powers

    def _tail(self, power: Array, total: Array) -> tuple[Array, bool]:
        """Return bounds (n,) of what all powers from that of A_K on add, and whether these are small."""
        last = np.abs(power)
        reach = total @ np.abs(self.E) @ self.loads.largest
        if not np.abs(np.linalg.eigvals(last)).max() < 0.5:
            return reach, False
        tail = last @ np.linalg.solve(np.eye(len(last)) - last, reach)
        return np.asarray(tail, dtype=np.float64), bool((tail <= TAIL * reach).all())

    @cached_property
    def lags(self) -> list[Array]:
        """The products A_K,t-1 .. A_K,t-i, i = 0 .. count - 1, of all times t = i .. T; of one, if it is constant."""
        n, each = self.A.shape[-1], self.A.reshape(-1, *self.A.shape[-2:])
        X = [np.broadcast_to(np.eye(n), (1 if self.constant else self.horizon + 1, n, n))]
        with np.errstate(all="ignore"):
            while len(X) < self.count:
                X.append(X[-1] @ self.A if self.constant else X[-1][1:] @ each[: self.horizon + 1 - len(X)])
        return X

    @cached_property
    def powers(self) -> Array:
        """A_K^i, (count, n, n), of constant dynamics."""
        return np.concatenate(self.lags)

    def acts(self, i: int) -> Array:
        """Return A_K,t-1 .. A_K,t-i E_t-i-1, (times, n, k), what loads do at times t = i + 1 .. T, or at any."""
        return self.lags[i] @ self.E if self.constant else self.lags[i][1:] @ self.E[: self.horizon - i]

    @cached_property
    def rounding(self) -> Array:
        """Bounds of the rounding of all margins, per unit of |c + K'd|, (n,)."""
        (n, k), m = self.E.shape[-2:], len(self.K)
        largest = sum(np.abs(X).max(axis=0) for X in self.lags)
        a, E = (part if part.ndim == 2 else part.max(axis=0) for part in (self.a, np.abs(self.E)))
        unit = EPS * (n + m + k + self.count + OPERATIONS)
        with np.errstate(all="ignore"):
            D = unit * largest @ a
        if not np.isfinite(D).all() or np.abs(np.linalg.eigvals(D)).max() >= 0.5:
            got, expected = "effects of loads that grow beyond all numbers", "a stabilising gain, or a shorter horizon"
            raise ProblemError("disturbance.gain", got, expected, "gain='auto' finds one.")
        N = np.linalg.solve(np.eye(n) - D, largest)
        loads = unit * (N + N @ a @ N) @ E @ self.loads.largest + N @ E @ self.loads.error
        if self.start is not None:
            loads += unit * (N + N @ a @ N) @ self.start.largest + N @ self.start.error
        return loads + (self._tail(self.powers[-1] @ self.A, N)[0] if self.forever else 0.0)

    def rows(self, C: Array, D: Array) -> tuple[Array, Array]:
        """Return C + D K and |C| + |D||K|; of rows that depend on time, the last ones again at time T."""
        sums = C + D @ self.K, np.abs(C) + np.abs(D) @ np.abs(self.K)
        if sums[0].ndim == 3 and len(sums[0]) == self.horizon:
            sums = tuple(np.concatenate([part, part[-1:]]) for part in sums)
        return sums[0], sums[1]

    def margins(self, C: Array, D: Array) -> Array:
        """Return the margins (T+1, rows) of rows C x_t + D u_t, (rows, n) and (rows, m), or one for each time.

        They are never below the exact ones, and exactly zero where no load acts.
        """
        (R, size), T, loads = self.rows(C, D), self.horizon, self.loads
        rounding = size @ self.rounding
        if self.constant and not loads.front and (R.ndim == 2 or self.forever):
            each = np.swapaxes(R.reshape(-1, 1, *R.shape[-2:]) @ (self.powers @ self.E), 0, 1)  # (steps, times, ..)
            M = np.cumsum(loads.contribution(each, slice(0, 1)), axis=0)
            M = M[-1] if self.forever else loads.margin(np.concatenate([0 * M[:1, 0], M[:-1, 0]]))
            M = np.broadcast_to(M, (T + 1, R.shape[-2]))
        else:
            R, total = np.broadcast_to(R, (T + 1, *R.shape[-2:])), np.zeros((*loads.front, T + 1, R.shape[-2]))
            for i in range(T):
                total[..., i + 1 :, :] += loads.contribution(R[i + 1 :] @ self.acts(i), slice(0, T - i))
            M = loads.margin(total)
        if self.start is not None:
            M = M + self.start.contribution(R @ np.array([X[0] for X in self.lags[: T + 1]]), slice(0, 1))
        elif not self.forever:
            rounding = np.where(np.arange(T + 1)[:, None] > 0, rounding, 0.0)
        return M + rounding

    def worst(self, c: Array, d: Array, t: int) -> tuple[Array, Array] | None:
        """Return the error of the start (n,) and loads (T, k) that attain the margin of a row at time t."""
        row, T, steps = c + d @ self.K, self.horizon, self.count if self.forever else t
        S = np.array([row @ self.acts(i)[0 if self.constant else t - 1 - i] for i in range(steps)])
        S, start = S.reshape(steps, self.E.shape[-1]), np.zeros(len(row))
        w = self.loads.worst(S[:t][::-1], T)
        if self.forever:
            before = self.loads.worst(S[t:], steps - t)
            assert before is not None  # forever takes bounded sets
            start = ((self.powers[: steps - t] @ self.E) @ before[..., None])[..., 0].sum(axis=0)
        elif self.start is not None:
            first = row @ self.lags[t][0]
            farthest = self.start.worst(first[None], 1)
            start = start if farthest is None else farthest[0]
        return None if w is None else (start, w)

    def leakage(self, waves: ComplexArray, row: Array) -> ComplexArray:
        """Return M (bins, T, k) with sum_t waves_kt row_t'e_t = sum_j M_kj w_j, waves complex (bins, samples)."""
        T, (n, k) = self.horizon, self.E.shape[-2:]
        M, P = np.zeros((len(waves), T, k), dtype=np.complex128), np.zeros((len(waves), n), dtype=np.complex128)
        A, E = (np.broadcast_to(part, (T, *part.shape[-2:])) for part in (self.A, self.E))
        for j in reversed(range(T)):
            if j + 1 < T:
                P = P @ A[j + 1]
            if j + 1 < waves.shape[1]:
                P = P + waves[:, j + 1, None] * row
            M[:, j] = P @ E[j]
        return M
