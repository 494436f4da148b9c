"""The side of the coefficients that stop bands keep.

A reduced system is left of the step, with the rows E of space.py:

    M v + E'nu = r,   E v - C nu = e,   M the Hessian of 1/2 y'Phi y in v
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Protocol

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.structured.kkt.kept.coefficients import sort_rows
from lin_freq_ocp.methods.structured.kkt.kept.slacks import Slacks
from lin_freq_ocp.methods.structured.kkt.kept.space import KeptSpace
from lin_freq_ocp.methods.structured.kkt.recursions import Loops
from lin_freq_ocp.methods.structured.kkt.side import Compliance, Step
from lin_freq_ocp.methods.structured.model.stages import Stages


class Reduced(Protocol):
    """A way to solve the reduced system."""

    def factor(self, Phi: Array, C: Array) -> bool:
        """Prepare for Phi (T+1, nz, nz) without slacks, and C (rows, rows); return whether M is seen to be definite."""
        ...

    def solve(self, r: Array, e: Array) -> tuple[Array, Array]:
        """Return v and nu."""
        ...


class KeptSide:
    """Stop bands hold exactly; what they leave is solved by ``reduced``."""

    indefinite: ClassVar[bool] = True

    def __init__(self, stages: Stages, loops: Loops, reduced: Callable[[KeptSpace], Reduced]):
        self._stages, self._loops, self._solved_by = stages, loops, reduced
        bands, rest = sort_rows(stages)
        self._slacks = Slacks(stages, [band.entry for band in bands])
        self._space = KeptSpace(stages, self._slacks, bands, rest, loops)
        self._reduced = reduced(self._space)

    def exchanged(self, stages: Stages) -> KeptSide:
        """Return the same for stages with other dynamics and Hessians."""
        return KeptSide(stages, self._loops, self._solved_by)

    def factor(self, Phi: Array, compliance: Compliance) -> bool:
        """Prepare for Phi (T+1, n+k, n+k) and C."""
        space = self._space
        C = np.zeros((space.row_count, space.row_count))
        compliance.add_to(C, space.chosen[space.chosen < len(compliance.rows)])
        self._Phi = self._slacks.reduced(Phi)
        return self._reduced.factor(self._Phi, C)

    def solve(self, gradient: Array, c: Array, x0: Array, f: Array) -> Step:
        """Return the solution for gradient (T+1, n+k), c (T+1, n), x0 (n,), f (rows,)."""
        space, n = self._space, self._space.states
        core = self._slacks.gradient(gradient)
        y = np.zeros_like(core)
        y[0, :n] = np.where(space.fixed, x0, 0.0)
        y[:, n:] = space.coefficients.particular(f)
        y, ends = space.simulated(np.zeros(space.size), y, c)
        of_v = space.gradient(core + self._loops.times(self._Phi, y))
        v, nu = self._reduced.solve(-of_v, space.right(f) - space.values(y, ends))
        y, _ = space.simulated(v, y, c)
        of_y, prices = space.priced(nu)
        of_y += core + self._loops.times(self._Phi, y)
        p, gw, _ = self._loops.backward(space.A, space.B, of_y, space.breaks, prices)
        coupling = np.zeros(len(f))
        space.unpriced(nu, coupling)
        space.coefficients.multipliers(gw, coupling)
        eta = np.zeros_like(c)
        eta[:-1] = -p[1:]
        initial = np.where(space.fixed, -p[0], 0.0)
        return Step(self._slacks.recovered(y, gradient), eta, initial, coupling)
