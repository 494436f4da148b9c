"""x = base + irfft(G rfft(u)): all outputs of a record as a linear function of all controls.

A record has N samples. Periodic: N = T, and x_0 .. x_T is one period with the first sample of the next. Zero-padded:
N = 2T, and the controls are zero from T on, so that no response wraps around.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, to_long_double


@dataclass(frozen=True, eq=False)
class Response:
    """The response to T controls, with G (N//2 + 1, p, m); ``base`` (T+1, p) are the outputs without controls."""

    G: ComplexArray
    base: Array
    horizon: int
    record: int  # N

    @property
    def closed(self) -> bool:
        """Whether the record is one period: x_T repeats x_0."""
        return self.record == self.horizon

    @property
    def weight(self) -> Array:
        """Return the multiplicity of each bin in sums over all N, (N//2 + 1,)."""
        k = np.arange(len(self.G))
        return np.where((k == 0) | (2 * k == self.record), 1.0, 2.0)

    def states(self, u: Array) -> Array:
        """Return the outputs (T+1, p) of controls (T, m)."""
        return self.base + self.linear(u)

    def linear(self, u: Array) -> Array:
        """Return the outputs (T+1, p) of controls (T, m), without ``base``."""
        spectrum = np.fft.rfft(u, n=self.record, axis=0)
        y = np.fft.irfft(_apply_response(self._in_precision(u.dtype), spectrum), n=self.record, axis=0)
        return y[np.arange(self.horizon + 1) % self.record]

    def pull_back(self, weights: Array) -> Array:
        """Return the adjoint of ``linear``, (T, m), for weights (T+1, p)."""
        G = np.swapaxes(self._in_precision(weights.dtype), 1, 2).conj()
        if self.closed:  # x_T repeats x_0
            weights = np.concatenate([weights[:1] + weights[-1:], weights[1:-1]])
        spectrum = np.fft.rfft(weights, n=self.record, axis=0)
        return np.fft.irfft(_apply_response(G, spectrum), n=self.record, axis=0)[: self.horizon]

    @cached_property
    def matrix(self) -> Array:
        """The matrix of ``linear``, ((T+1) p, T m)."""
        impulse = np.fft.irfft(self.G, n=self.record, axis=0)
        t, s = np.arange(self.horizon + 1)[:, None], np.arange(self.horizon)
        (_, p, m), T = self.G.shape, self.horizon
        return impulse[(t - s) % self.record].transpose(0, 2, 1, 3).reshape((T + 1) * p, T * m)

    def _in_precision(self, dtype: np.dtype[np.floating]) -> ComplexArray:
        """Return G in the precision of a type."""
        return to_long_double(self.G) if dtype == np.longdouble else self.G


def _apply_response(G: ComplexArray, spectrum: ComplexArray) -> ComplexArray:
    """Return G_k v_k, for G (bins, p, m) and v (bins, m)."""
    return (G * spectrum[:, None, :]).sum(axis=2)
