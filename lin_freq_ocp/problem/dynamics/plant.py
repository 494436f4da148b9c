"""The continuous-time model of sampled linear dynamics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, matrix_balance

from lin_freq_ocp.base.arrays import Array

SAME_ENTRY = 1e-9  # relative difference of sampled matrices that is rounding: of expm, or of a translation


@dataclass(frozen=True, eq=False)
class ContinuousPlant:
    """dx/dt = A x + B u + d, with u constant over each sampling period (zero-order hold).

    Attributes
    ----------
    A, B, offset : (n, n), (n, m), (n,)
        The matrices, and d.

    Examples
    --------
    >>> dynamics = lfo.LinearDynamics.from_continuous([[0, 1], [0, 0]], [[0], [1]], sampling_time=0.1)
    >>> dynamics.plant.A
    array([[0., 1.],
           [0., 0.]])
    """

    A: Array
    B: Array
    offset: Array

    def sampled(self, step: float) -> tuple[Array, Array, Array]:
        """Return A, B and offset of x_{t+1} = A x_t + B u_t + d for a sampling time in seconds (Van Loan, 1978)."""
        n, m = self.B.shape
        generator = np.zeros((n + m + 1, n + m + 1))
        generator[:n] = np.hstack([self.A, self.B, self.offset[:, None]])
        with np.errstate(over="ignore", invalid="ignore"):
            flow = expm(generator * step)
        return flow[:n, :n], flow[:n, n : n + m], flow[:n, -1]

    def flow(self, time: float) -> Array:
        """Return e^(A time), (n, n), which maps states without control over a time in seconds."""
        return np.asarray(expm(self.A * time), dtype=np.float64)

    def balance(self) -> tuple[float, Array]:
        """Return the norm (largest sum of a row) of D^-1 A D, and the units D, (n,), that balance A (Osborne, 1960)."""
        balanced, (units, _) = matrix_balance(self.A, permute=False, separate=True)
        return float(np.abs(balanced).sum(axis=1).max()), np.asarray(units, dtype=np.float64)

    def agrees(self, A: Array, B: Array, offset: Array, step: float | None) -> bool:
        """Whether its samples are the first n states of discrete dynamics, up to rounding."""
        n, m = self.B.shape
        if step is None or A.ndim == 3 or B.ndim == 3 or offset.ndim == 2 or len(A) < n or B.shape[1] != m:
            return False
        if A[:n, n:].any():
            return False
        pairs = zip(self.sampled(step), (A[:n, :n], B[:n], offset[:n, None]), strict=True)
        return all(
            bool((np.abs(own.reshape(other.shape) - other) <= SAME_ENTRY * np.abs(other).max(1, keepdims=True)).all())
            for own, other in pairs
        )

    def translated(self, origin: Array) -> ContinuousPlant:
        """Return the plant of x - origin; the origin may have further components."""
        return ContinuousPlant(self.A, self.B, self.offset + self.A @ origin[: len(self.A)])
