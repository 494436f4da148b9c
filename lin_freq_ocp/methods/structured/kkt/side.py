"""One step's linear system after the elimination of stage cones and of constant heads of balls.

    Phi y + gradient + (dynamics)'eta + (x_0 rows)'lam0 + F'nu = 0
    x_{t+1} - A x_t - B w_t = c_t,   x_0 = x0 where it is fixed,   F y - C nu = f

F are all coupling rows in the order of ``Coupling``: x_T, equations, inequalities, balls (each with its head in front
if it is soft). C > 0 is block diagonal: tiny for equations, squares of scalings else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.structured.model.stages import Stages


@dataclass(frozen=True, eq=False)
class Compliance:
    """C: (count,) for all equations and inequalities, and (balls, d, d) for every family of balls.

    ``roots``, (balls, d, d) for every family of hard balls, are R with R'R = C^-1, which inverting C would lose near
    the boundary.
    """

    rows: Array
    balls: tuple[Array, ...]
    roots: tuple[Array, ...] = ()

    def add_to(self, S: Array, chosen: Indices | None = None) -> None:
        """Add C to the last rows of S: those of ``rows`` that are chosen, or all, and those of the balls."""
        rows = self.rows if chosen is None else self.rows[chosen]
        first = len(S) - len(rows) - sum(len(part) * part.shape[1] for part in self.balls)
        for blocks in (rows[:, None, None], *self.balls):
            count, d = blocks.shape[:2]
            at = first + np.arange(count * d).reshape(count, d)
            S[at[:, :, None], at[:, None, :]] += blocks
            first += count * d


class Step(NamedTuple):
    """The solution of the system."""

    y: Array  # (T+1, n + k)
    eta: Array  # (T+1, n), the last zero
    initial: Array  # lam0, (n,)
    coupling: Array  # nu, (rows,)


class Side(Protocol):
    """A way to solve the system, exact up to rounding and the tolerance of an iteration; residuals are refined."""

    indefinite: ClassVar[
        bool
    ]  # whether Phi may be indefinite on the dynamics: ``factor`` says if the rows make up for it

    def exchanged(self, stages: Stages) -> Side:
        """Return the same for stages with other dynamics and Hessians."""
        ...

    def factor(self, Phi: Array, compliance: Compliance) -> bool:
        """Prepare for Phi (T+1, n+k, n+k) and C; return whether the problem is convex as far as it was looked at."""
        ...

    def solve(self, gradient: Array, c: Array, x0: Array, f: Array) -> Step:
        """Return the solution for gradient (T+1, n+k), c (T+1, n), x0 (n,), f (rows,)."""
        ...
