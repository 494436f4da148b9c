"""A linear problem over stages, in the units of the method.

    minimise    sum_t 1/2 y_t'H_t y_t + h_t'y_t + constant,  t = 0 .. T,  y_t = (x_t, w_t)
    subject to  x_{t+1} = A_t x_t + B_t w_t + d_t,  t < T;   x_0 given where it is fixed
                s_t = g_t - G_t y_t in K:  entries >= 0, then second-order cones s_0 >= |(s_1, ...)|
                rows that couple times: coupling.py

w_t holds the controls u_t, then slacks, on which no state depends. At t = T, A, B and d are zero, and u_T costs
1/2 |u_T|^2, so that every stage is alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.methods.structured.model.all_rows import AllRows
from lin_freq_ocp.methods.structured.model.coupling import Coupling


@dataclass(frozen=True, eq=False)
class Stages:
    """The arrays of a problem, contiguous, with n states, k entries of w, and p rows a stage."""

    A: Array  # (T+1, n, n)
    B: Array  # (T+1, n, k)
    d: Array  # (T+1, n)
    H: Array  # (T+1, n+k, n+k), symmetric positive semidefinite
    h: Array  # (T+1, n+k)
    G: Array  # (T+1, p, n+k)
    g: Array  # (T+1, p): inf where there is no such row; all entries of a cone are inf, or none
    cones: tuple[int, ...]  # sizes of the second-order cones, which are the last rows of every stage
    initial: Array  # (n,): nan where x_0 is free
    coupling: Coupling
    constant: float = 0.0

    @property
    def horizon(self) -> int:
        """Return T."""
        return len(self.A) - 1

    @property
    def states(self) -> int:
        """Return n."""
        return self.A.shape[1]

    @property
    def present(self) -> Mask:
        """Return which rows there are, (T+1, p)."""
        return np.isfinite(self.g)

    @property
    def fixed(self) -> Mask:
        """Return which entries of x_0 are given, (n,)."""
        return ~np.isnan(self.initial)

    @cached_property
    def coupled(self) -> AllRows:
        """Return all rows that couple times."""
        return AllRows(self.coupling, len(self.A), self.states)
