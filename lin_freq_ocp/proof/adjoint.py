"""The multiplier of a fixed end from which the adjoint equation, run backwards exactly, stays near the given adjoint.

A checker defines eta_{t-1} = A_t' eta_t - s_t, with s_t = D_x c_t(z_t) + what is pulled back + mu_t, and eta_T = 0.
Where the dynamics are unstable, this enlarges the last digit of mu_T beyond all bounds. With mu_T + d, eta is affine in
d: the d that brings eta_0 and eta_{T-1} nearest to the given ones keeps all between near, as parts that grow backwards
are held at 0 and parts that decay at T - 1. It needs as many digits as the recursion loses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from flint import arb, arb_mat

from lin_freq_ocp.base.arrays import Array, Indices

Balls = list[arb]


@dataclass(frozen=True, eq=False)
class Recursion:
    """eta_{t-1} = A_t' eta_t - s_t for t = T .. 1; ``slopes`` are s_0 .. s_T."""

    A: Array  # (n, n) or (T, n, n)
    slopes: Sequence[Balls]

    def run(self, begin: arb_mat) -> tuple[arb_mat, Array]:
        """Return eta_0, (n, k), and of its first column all eta_t as floats, (T, n), from eta_{T-1} of columns (n, k).

        Slopes act on the first column.
        """
        T, n = len(self.slopes) - 1, begin.nrows()
        turned = self.A.T if self.A.ndim == 2 else np.swapaxes(self.A, 1, 2)
        constant = arb_mat(turned.tolist()) if self.A.ndim == 2 else None
        eta, found = begin, np.empty((T, n))
        found[T - 1] = [float(eta[i, 0]) for i in range(n)]
        for t in range(T - 1, 0, -1):
            eta = (arb_mat(turned[t].tolist()) if constant is None else constant) * eta
            for i, slope in enumerate(self.slopes[t]):
                eta[i, 0] -= slope
            found[t - 1] = [float(eta[i, 0]) for i in range(n)]
        return eta, found


def steered(recursion: Recursion, eta: Array, free: Indices) -> tuple[Balls, Array]:
    """Return d, (free,), as exact numbers, and the adjoint with mu_T + d as floats, (T, n)."""
    n, last = eta.shape[1], recursion.slopes[-1]
    begin = arb_mat(n, 1 + len(free))
    for i in range(n):
        begin[i, 0] = -last[i]
    for k, i in enumerate(free.tolist()):
        begin[i, 1 + k] = -1
    sizes = np.abs(eta).max(axis=0)
    weights = [arb(1.0 / size) if size > 0 else arb(1) for size in sizes.tolist()]
    first, _ = recursion.run(begin)
    rows = [
        (weight, [part[i, j] for j in range(1 + len(free))], float(goal[i]))
        for part, goal in ((first, eta[0]), (begin, eta[-1]))
        for i, weight in enumerate(weights)
    ]
    system = arb_mat([[weight * one for one in row[1:]] for weight, row, _ in rows])
    misses = arb_mat([[weight * (goal - row[0])] for weight, row, goal in rows])
    moved = (system.transpose() * system).solve(system.transpose() * misses)
    found = [moved[k, 0].mid() for k in range(len(free))]
    alone = arb_mat(n, 1)
    for i in range(n):
        alone[i, 0] = -last[i]
    for d, i in zip(found, free.tolist(), strict=True):
        alone[i, 0] -= d
    return found, recursion.run(alone)[1]
