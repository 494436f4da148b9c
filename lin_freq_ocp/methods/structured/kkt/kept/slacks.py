"""Elimination of the entries of w on which only their own stage depends: slacks, and u_T of controls with stop bands.

Of the core (x, u) of a stage and its slacks s, Phi_ss s + Phi_sc (x, u) + gradient_s = 0 gives s, and leaves on the
core Phi_cc - Phi_cs Phi_ss^-1 Phi_sc. All of this is local in time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.structured.model.stages import Stages


class Slacks:
    """The slacks of a problem, and what is left without them."""

    def __init__(self, stages: Stages, banded: Sequence[int]):
        """Find the slacks; ``banded`` are the entries of w with stop bands."""
        n = stages.states
        own: Mask = ~np.any(stages.B, axis=(0, 1))
        own[[entry - n for entry in stages.coupling.channels if entry >= n]] = False
        self.controls = np.flatnonzero(~own)
        self.core = np.concatenate([np.arange(n), n + self.controls])
        self._slacks = n + np.flatnonzero(own)
        self._last = np.union1d(self._slacks, n + np.array(banded, dtype=np.intp))
        self._left = np.flatnonzero(~np.isin(self.core, self._last))

    def reduced(self, Phi: Array) -> Array:
        """Return Phi (T+1, n+k, n+k) on the core, with 1 for entries that are not left at T."""
        self._inner = _Elimination(Phi[:-1], self.core, self._slacks)
        self._end = _Elimination(Phi[-1:], self.core[self._left], self._last)
        end = np.eye(len(self.core))[None]
        end[:, self._left[:, None], self._left] = self._end.left
        return np.ascontiguousarray(np.concatenate([self._inner.left, end]))

    def gradient(self, gradient: Array) -> Array:
        """Return a gradient (T+1, n+k) on the core."""
        end = np.zeros((1, len(self.core)))
        end[:, self._left] = self._end.gradient(gradient[-1:])
        return np.ascontiguousarray(np.concatenate([self._inner.gradient(gradient[:-1]), end]))

    def recovered(self, core: Array, gradient: Array) -> Array:
        """Return y (T+1, n+k) of a solution on the core and the gradient (T+1, n+k)."""
        end = self._end.recovered(core[-1:, self._left], gradient[-1:])
        return np.concatenate([self._inner.recovered(core[:-1], gradient[:-1]), end])


class _Elimination:
    """Schur complements of some entries of all stages."""

    def __init__(self, Phi: Array, kept: Indices, gone: Indices):
        self._kept, self._gone = kept, gone
        self.left = np.ascontiguousarray(Phi[:, kept[:, None], kept])
        if len(gone):
            across = Phi[:, gone[:, None], kept]
            self._own = Phi[:, gone[:, None], gone]
            self._gain = np.linalg.solve(self._own, across)
            self.left -= across.swapaxes(1, 2) @ self._gain

    def gradient(self, gradient: Array) -> Array:
        """Return the gradient on the entries that are kept."""
        left = gradient[:, self._kept]
        if len(self._gone):
            left = left - np.einsum("tsc,ts->tc", self._gain, gradient[:, self._gone])
        return left

    def recovered(self, kept: Array, gradient: Array) -> Array:
        """Return all entries."""
        y = np.empty_like(gradient)
        y[:, self._kept] = kept
        if len(self._gone):
            free = np.linalg.solve(self._own, gradient[:, self._gone, None])[:, :, 0]
            y[:, self._gone] = -free - np.einsum("tsc,tc->ts", self._gain, kept)
        return y
