"""Rows near the working rows, whose values after a step follow from kernels: rounds without FFTs (docs/spectral.md, 7).

Between two evaluations of all signals, the small QP is repeated with the rows that its own step violates.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.spectral.kkt.bordered_system import BorderedSystem
from lin_freq_ocp.methods.spectral.rows.violations import Violations, nearly_active
from lin_freq_ocp.methods.spectral.rows.working_set import WorkingSet

LEAST_HORIZON = 10_000  # from which kernels cost less than FFTs
WINDOW = 24  # samples on each side of a working row
MOST_ROWS = 20_000  # of a neighbourhood; with more, FFTs are cheaper


class Neighbourhood:
    """Rows F_f y_t, t < T, with both their bounds, in the order of f, then t."""

    def __init__(self, border: BorderedSystem, violations: Violations, t: Indices, f: Indices):
        lti = violations.lti
        bounded = np.isfinite(lti.lower[f, t]) | np.isfinite(lti.upper[f, t])
        free = bounded & ~np.isin(f * lti.horizon + t, violations.fixed_keys)
        t, f = t[free], f[free]
        self._border, self.t, self.f = border, t, f
        self._lower, self._upper, self._scale = lti.lower[f, t], lti.upper[f, t], violations.scale[f]
        self._is_state = ~lti.F[f, lti.state_dim :].any(1)
        self._coupling = np.hstack([border.values(t, f), -border.responses(t, f).T])

    def entering(
        self, y: Array, working: WorkingSet, step: Array, weights: Array, tolerance: float
    ) -> tuple[Indices, Indices, Array]:
        """Return (t, f, sign) of the rows that a border step with new weights violates, to add to the working rows."""
        border, inner = self._border, working.inner
        values = np.einsum("ri,ir->r", border.lti.F[self.f], y[:, self.t]) + self._coupling @ step
        change = working.sign * (weights - working.weights)
        acting = np.flatnonzero(inner & (change != 0))
        values -= border.kernels.gram(self.t, self.f, working.t[acting], working.f[acting]) @ change[acting]
        above, below = values - self._upper, self._lower - values
        excess = np.maximum(above, below) / self._scale
        chosen = np.flatnonzero(self._selected(excess, tolerance))
        return self.t[chosen], self.f[chosen], np.where(above[chosen] >= below[chosen], 1.0, -1.0)

    def _selected(self, excess: Array, tolerance: float) -> Mask:
        """Return violated peaks of states, and violated or nearly active samples of the others."""
        worst = float(excess.max(initial=0.0))
        if worst <= tolerance:
            return np.zeros(len(excess), dtype=bool)
        chosen = excess > np.where(self._is_state, tolerance, nearly_active(worst, tolerance))
        if self._is_state.any():
            follows = np.append(False, (np.diff(self.t) == 1) & (np.diff(self.f) == 0))
            rises = np.append(True, np.diff(excess) >= 0) | ~follows
            falls = np.append(np.append(True, np.diff(excess) <= 0)[1:], True) | ~np.append(follows[1:], False)
            chosen &= ~self._is_state | (rises & falls)
        return chosen


def around(border: BorderedSystem, violations: Violations, working: WorkingSet) -> Neighbourhood | None:
    """Return the samples around the working rows; None if there are none, many or soft, or the horizon is short."""
    T, inner = violations.lti.horizon, working.inner
    if T < LEAST_HORIZON or violations.lti.prices is not None:
        return None
    window = np.arange(-WINDOW, WINDOW + 1)
    times = (working.t[inner, None] + window).clip(0, T - 1)
    keys = np.unique((working.f[inner, None] * T + times).ravel())
    return Neighbourhood(border, violations, keys % T, keys // T) if 0 < len(keys) <= MOST_ROWS else None
