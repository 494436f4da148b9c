"""All rows that couple times as one map of y: by a matrix where that is small, else family by family."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.structured.model.coupling import Coupling

DENSE = 3e5  # entries up to which products with a matrix take less time than FFTs; measured


class AllRows:
    """The rows F of a coupling, in its order, on y (stages, n + k)."""

    def __init__(self, coupling: Coupling, stages: int, states: int):
        self._coupling, self._states, self._shape = coupling, states, (stages, len(coupling.channels))
        self._families = tuple(coupling.families())
        self._dense = coupling.count * stages * len(coupling.channels) <= DENSE

    @cached_property
    def gradients(self) -> tuple[Array, Array]:
        """Return all rows as gradients on channels (stages, channels, rows) and on x_T (n, rows)."""
        return self.chosen(np.arange(self._coupling.count))

    def chosen(self, chosen: Indices) -> tuple[Array, Array]:
        """Return chosen rows as gradients on channels (stages, channels, k) and on x_T (n, k)."""
        terminal, signals = self._coupling.terminal, np.zeros((*self._shape, len(chosen)))
        end = np.zeros((self._states, len(chosen)))
        of_end = np.flatnonzero(chosen < len(terminal))
        end[terminal[chosen[of_end]], of_end] = 1.0
        for rows, at in self._families:
            inside = np.flatnonzero(np.isin(chosen, at, assume_unique=True))
            if len(inside):
                part = np.zeros((*self._shape, len(inside)))
                rows.add_columns(np.searchsorted(at, chosen[inside]), part)
                signals[:, :, inside] += part
        return signals, end

    def values(self, y: Array) -> Array:
        """Return F y."""
        terminal, signals = self._coupling.terminal, y[:, self._coupling.channels]
        if self._dense:
            found = self._matrix.T @ signals.ravel()
        else:
            found = np.zeros(self._coupling.count)
            for rows, at in self._families:
                found[at] = rows.forward(signals[:, :, None])[:, 0]
        found[: len(terminal)] = y[-1, terminal]
        return found

    def add_adjoint(self, nu: Array, gradient: Array) -> None:
        """Add F'nu to a gradient (stages, n + k)."""
        terminal, channels = self._coupling.terminal, self._coupling.channels
        gradient[-1, terminal] += nu[: len(terminal)]
        if self._dense:
            gradient[:, channels] += (self._matrix @ nu).reshape(self._shape)
        elif len(channels):
            signals = np.zeros((*self._shape, 1))
            for rows, at in self._families:
                rows.add_adjoint(nu[at, None], signals)
            gradient[:, channels] += signals[:, :, 0]

    @cached_property
    def _matrix(self) -> Array:
        """F' without the rows of x_T, (stages * channels, rows)."""
        return self.gradients[0].reshape(self._shape[0] * self._shape[1], self._coupling.count)
