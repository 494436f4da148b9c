"""Stages with rows F that couple times: the regulator, and its response P to gradients of rows.

A fixed x_T adds rho |x_T - its state|^2 to what the recursion minimises: it leaves the answer alone and keeps the
closed loop stable on long horizons of unstable dynamics.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.structured.kkt.recursions import Loops, Regulator
from lin_freq_ocp.methods.structured.kkt.side import Step
from lin_freq_ocp.methods.structured.model.stages import Stages

TERMINAL_WEIGHT = 1e2  # of the distance from the terminal state, relative to the largest curvature
LEAST_CURVATURE = 1e-3  # of order 1 are the units


class Response:
    """The regulator of one problem and the rows F of its coupling, in the order of ``Coupling``; see ``side``."""

    def __init__(self, stages: Stages, loops: Loops):
        self.stages, self.coupling, self._loops = stages, stages.coupling, loops
        self.rows = stages.coupled
        self._weights = np.zeros(stages.states)
        curvature = float(np.abs(np.einsum("tii->ti", stages.H[:-1])).max(initial=0.0))
        self._weights[self.coupling.terminal] = TERMINAL_WEIGHT * max(curvature, LEAST_CURVATURE)

    def exchanged(self, stages: Stages) -> Response:
        """Return the same for stages with other dynamics and Hessians."""
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
        y, _, _ = self._regulator.solve(self._to_end(gradient, f), c, x0)
        return self.rows.values(y) - f

    def step(self, gradient: Array, c: Array, x0: Array, f: Array, nu: Array) -> Step:
        """Return the answer with the multipliers nu of the rows F."""
        gradient, terminal = self._to_end(gradient, f), self.coupling.terminal
        self.rows.add_adjoint(nu, gradient)
        y, eta, initial = self._regulator.solve(gradient, c, x0)
        nu = nu.copy()
        nu[: len(terminal)] += self._weights[terminal] * (y[-1, terminal] - f[: len(terminal)])
        return Step(y, eta, initial, nu)

    def gram(self, signals: Array, end: Array) -> Array:
        """Return the lower triangle of R'P R of gradients R on channels (T+1, channels, k) and on x_T (n, k)."""
        return self._regulator.gram(self.coupling.channels, signals, end)

    def _to_end(self, gradient: Array, f: Array) -> Array:
        gradient, terminal = gradient.copy(), self.coupling.terminal
        gradient[-1, terminal] -= self._weights[terminal] * f[: len(terminal)]
        return gradient
