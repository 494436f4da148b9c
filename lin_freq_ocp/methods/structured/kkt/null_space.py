"""The null-space KKT solver: the unknowns are the Fourier coefficients that the stop bands of controls leave free.

A control is u = N z + u_p. Its real DFT, t < T, is orthonormal here: Re and Im of every bin in turn, times 1/sqrt(T)
at the bins 0 and T/2, and sqrt(2/T) between. A stop band fixes some of these coefficients, the others are z; z of a
control without a stop band are its samples, t <= T. Vectors are the rows of arrays, so that transforms run along
contiguous memory.

Slacks, on which only their own stage depends, are eliminated first. The unknowns v are z, free entries of x_0, and
starts: as open loop diverges for unstable dynamics, the simulation starts anew at break times (multiple shooting). The
rows E on v are, in this order, starts - ends of the simulations before them, x_T, and coupling rows other than stop
bands. ``ReducedSolver`` solves the remaining system:

    M v + E'nu = r,   E v - C nu = e,   M the Hessian of 1/2 y'Phi y in v
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask, times_vectors
from lin_freq_ocp.methods.structured.kkt.recursions import Loops, break_times
from lin_freq_ocp.methods.structured.kkt.system import Compliance, SystemSolution
from lin_freq_ocp.methods.structured.stages import CoupledRows, SpectrumRows, Stages

GROWTH = 1e3  # of the states between breaks: three digits are lost at most


class ReducedSolver(Protocol):
    """A way to solve the reduced system."""

    def factor(self, Phi: Array, C: Array) -> bool:
        """Factor for Phi (T+1, nz, nz) without slacks, and C (rows, rows); return whether M is known to be definite."""
        ...

    def solve(self, r: Array, e: Array) -> tuple[Array, Array]:
        """Return v and nu."""
        ...


class NullSpaceSolver:
    """The solver that satisfies stop bands exactly; ``reduced`` solves the remaining system."""

    indefinite: ClassVar[bool] = True

    def __init__(self, stages: Stages, loops: Loops, reduced: Callable[[NullSpace], ReducedSolver]):
        self._stages, self._loops, self._solved_by = stages, loops, reduced
        bands, rest = sort_rows(stages)
        self._slacks = Slacks(stages, [band.entry for band in bands])
        self._space = NullSpace(stages, self._slacks, bands, rest, loops)
        self._reduced = reduced(self._space)

    def exchanged(self, stages: Stages) -> NullSpaceSolver:
        """Return the solver for stages with other dynamics and Hessians."""
        return NullSpaceSolver(stages, self._loops, self._solved_by)

    def factor(self, Phi: Array, compliance: Compliance) -> bool:
        """Factor for Phi (T+1, n+k, n+k) and C."""
        space = self._space
        C = np.zeros((space.row_count, space.row_count))
        compliance.add_to(C, space.chosen[space.chosen < len(compliance.rows)])
        self._Phi = self._slacks.reduced(Phi)
        return self._reduced.factor(self._Phi, C)

    def solve(self, gradient: Array, c: Array, x0: Array, f: Array) -> SystemSolution:
        """Return the solution for gradient (T+1, n+k), c (T+1, n), x0 (n,), f (rows,)."""
        space, n = self._space, self._space.states
        core = self._slacks.gradient(gradient)
        y = np.zeros_like(core)
        y[0, :n] = np.where(space.fixed, x0, 0.0)
        y[:, n:] = space.coefficients.particular(f)
        y, ends = space.simulate(np.zeros(space.size), y, c)
        of_v = space.gradient(core + times_vectors(self._Phi, y))
        right = np.concatenate([np.zeros(space.continuity), f[space.chosen]])
        v, nu = self._reduced.solve(-of_v, right - space.values(y, ends))
        y, _ = space.simulate(v, y, c)
        of_y, prices = space.price_rows(nu)
        of_y += core + times_vectors(self._Phi, y)
        p, gw, _ = self._loops.backward(space.A, space.B, of_y, space.breaks, prices)
        coupling = np.zeros(len(f))
        coupling[space.chosen] = nu[space.continuity :]
        space.coefficients.multipliers(gw, coupling)
        eta = np.zeros_like(c)
        eta[:-1] = -p[1:]
        initial = np.where(space.fixed, -p[0], 0.0)
        return SystemSolution(self._slacks.recovered(y, gradient), eta, initial, coupling)


class Slacks:
    """Elimination of entries of w that only their own stage contains: slacks, and u_T of controls with stop bands.

    For the core (x, u) of a stage and its slacks s, Phi_ss s + Phi_sc (x, u) + gradient_s = 0 gives s, and leaves
    Phi_cc - Phi_cs Phi_ss^-1 Phi_sc on the core. All of this is local in time.
    """

    def __init__(self, stages: Stages, banded: Sequence[int]):
        """Find the slacks; ``banded`` are the entries of w with stop bands."""
        n = stages.states
        undriven: Mask = ~np.any(stages.B, axis=(0, 1))
        undriven[[entry - n for entry in stages.coupling.channels if entry >= n]] = False
        self.controls = np.flatnonzero(~undriven)
        self.core = np.concatenate([np.arange(n), n + self.controls])
        self._slacks = n + np.flatnonzero(undriven)
        self._last = np.union1d(self._slacks, n + np.array(banded, dtype=np.intp))
        self._left = np.flatnonzero(~np.isin(self.core, self._last))

    def reduced(self, Phi: Array) -> Array:
        """Return Phi (T+1, n+k, n+k) on the core, with 1 for entries that are eliminated at T."""
        self._inner = _Elimination(Phi[:-1], self.core, self._slacks)
        self._end = _Elimination(Phi[-1:], self.core[self._left], self._last)
        end = np.eye(len(self.core))[None]
        end[:, self._left[:, None], self._left] = self._end.complement
        return np.ascontiguousarray(np.concatenate([self._inner.complement, end]))

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
    """The elimination of some entries of all stages, by Schur complements."""

    def __init__(self, Phi: Array, core: Indices, eliminated: Indices):
        self._core, self._eliminated = core, eliminated
        self.complement = np.ascontiguousarray(Phi[:, core[:, None], core])
        if len(eliminated):
            across = Phi[:, eliminated[:, None], core]
            self._block = Phi[:, eliminated[:, None], eliminated]
            self._gain = np.linalg.solve(self._block, across)
            self.complement -= across.swapaxes(1, 2) @ self._gain

    def gradient(self, gradient: Array) -> Array:
        """Return the gradient on the remaining entries."""
        remaining = gradient[:, self._core]
        if len(self._eliminated):
            remaining = remaining - np.einsum("tsc,ts->tc", self._gain, gradient[:, self._eliminated])
        return remaining

    def recovered(self, core: Array, gradient: Array) -> Array:
        """Return all entries."""
        y = np.empty_like(gradient)
        y[:, self._core] = core
        if len(self._eliminated):
            free = np.linalg.solve(self._block, gradient[:, self._eliminated, None])[:, :, 0]
            y[:, self._eliminated] = -free - np.einsum("tsc,tc->ts", self._gain, core)
        return y


@dataclass(frozen=True, eq=False)
class StopBand:
    """Rows of F that fix coefficients of one entry of w: F u = gain * coefficient."""

    entry: int
    rows: Indices  # within F
    coefficients: Indices  # 2 bin + (0: Re, 1: Im)
    gain: Array


@dataclass(frozen=True, eq=False)
class Remaining:
    """A family of coupling rows other than stop bands, and its rows of F."""

    rows: CoupledRows
    at: Indices


def sort_rows(stages: Stages) -> tuple[list[StopBand], list[Remaining]]:
    """Return the stop bands among the coupling rows after x_T, and the rest."""
    taken: dict[int, set[int]] = {}
    bands: list[StopBand] = []
    rest: list[Remaining] = []
    equations = len(stages.coupling.equations)
    for i, (rows, at) in enumerate(stages.coupling.families()):
        band = _stop_band(stages, rows, at) if i < equations else None
        if band is None or not taken.setdefault(band.entry, set()).isdisjoint(band.coefficients.tolist()):
            rest.append(Remaining(rows, at))
        else:
            taken[band.entry].update(band.coefficients.tolist())
            bands.append(band)
    return bands, rest


def _stop_band(stages: Stages, rows: CoupledRows, at: Indices) -> StopBand | None:
    """Return rows as a stop band if they are the plain DFT of a single control, otherwise None."""
    if not isinstance(rows, SpectrumRows) or rows.points != stages.horizon:
        return None
    used, T, n = np.flatnonzero(rows.coefficients), stages.horizon, stages.states
    even = len(rows.window) == T and bool(np.all(rows.window == rows.window[0]))
    if len(used) != 1 or stages.coupling.channels[used[0]] < n or not even or len(set(rows.bins)) < len(rows.bins):
        return None
    pairs = (2 * rows.bins[:, None] + [0, 1]).ravel()[rows.kept]
    factor = np.repeat(rows.scale, 2)[rows.kept] * rows.window[0] * rows.coefficients[used[0]]
    unit = unit_scale(T)[pairs]
    if not np.all(unit * factor):
        return None
    return StopBand(int(stages.coupling.channels[used[0]] - n), at, pairs, factor / unit)


def unit_scale(T: int) -> Array:
    """Return the factors that make the DFT orthonormal, (2 bins,); zero for the imaginary parts that do not exist."""
    scale = np.full((T // 2 + 1, 2), np.sqrt(2 / T))
    scale[0] = np.sqrt(1 / T), 0.0
    if T % 2 == 0:
        scale[-1] = np.sqrt(1 / T), 0.0
    return scale.ravel()


class Coefficients:
    """The coefficients z of all controls, one after the other."""

    def __init__(self, stages: Stages, bands: list[StopBand], controls: Indices):
        self.horizon = stages.horizon
        self._scale = unit_scale(self.horizon)
        self._bands = [(int(np.flatnonzero(controls == band.entry)[0]), band) for band in bands]
        self._free: list[Indices | None] = []
        for j in range(len(controls)):
            stopped = [band.coefficients for control, band in self._bands if control == j]
            exist = self._scale > 0
            for part in stopped:
                exist[part] = False
            self._free.append(np.flatnonzero(exist) if stopped else None)
        counts = [self.horizon + 1 if free is None else len(free) for free in self._free]
        self._ends = np.cumsum([0, *counts])
        self.count = int(self._ends[-1])
        self.banded = np.array([free is not None for free in self._free], dtype=bool)

    def analysis(self, w: Array) -> Array:
        """Return N'w, (m, count), for signals (T+1, controls, m)."""
        z = np.empty((w.shape[2], self.count))
        for j, free in enumerate(self._free):
            part = z[:, self._ends[j] : self._ends[j + 1]]
            if free is None:
                part[:] = w[:, j].T
            else:
                signals = np.ascontiguousarray(w[:-1, j].T)
                np.multiply(self._transform(signals)[:, free], self._scale[free], out=part)
        return z

    def synthesis(self, z: Array) -> Array:
        """Return N z, (T+1, controls, m), for coefficients (m, count)."""
        w = np.zeros((self.horizon + 1, len(self._free), len(z)))
        for j, free in enumerate(self._free):
            part = z[:, self._ends[j] : self._ends[j + 1]]
            if free is None:
                w[:, j] = part.T
            else:
                w[:-1, j] = self._signals(free, part).T
        return w

    def particular(self, f: Array) -> Array:
        """Return u_p (T+1, controls), which satisfies the stop bands, F u_p = f, and has no free coefficients."""
        w = np.zeros((self.horizon + 1, len(self._free)))
        for j, band in self._bands:
            values = f[band.rows] / band.gain
            if values.any():
                w[:-1, j] += self._signals(band.coefficients, values[None])[0]
        return w

    def multipliers(self, gw: Array, nu: Array) -> None:
        """Write into nu (rows of F,) those of the stop bands, which cancel a gradient (T+1, controls)."""
        for j, band in self._bands:
            pairs = self._transform(np.ascontiguousarray(gw[None, :-1, j]))[0]
            nu[band.rows] = -pairs[band.coefficients] * self._scale[band.coefficients] / band.gain

    def stopped(self, j: int, signals: Array) -> Array:
        """Return signals (m, T) of a control without their free coefficients."""
        free = self._free[j]
        if free is None:
            return np.zeros_like(signals)
        return signals - self._signals(free, self._transform(signals)[:, free] * self._scale[free])

    @staticmethod
    def _transform(signals: Array) -> Array:
        """Return the DFT of signals (m, T), Re and Im in turn."""
        return np.fft.rfft(signals, axis=1).view(np.float64)

    def _signals(self, chosen: Indices, values: Array) -> Array:
        """Return the signals (m, T) of some coefficients (m, chosen)."""
        pairs = np.zeros((len(values), len(self._scale)))
        pairs[:, chosen] = values / self._scale[chosen]
        return np.fft.irfft(pairs.view(np.complex128), n=self.horizon, axis=1)


class NullSpace:
    """The map from v to y, and its adjoint."""

    def __init__(self, stages: Stages, slacks: Slacks, bands: list[StopBand], rest: list[Remaining], loops: Loops):
        self.loops, self.A = loops, stages.A
        self.B = np.ascontiguousarray(stages.B[:, :, slacks.controls])
        self.horizon, self.states, self.controls = stages.horizon, stages.states, len(slacks.controls)
        self.coefficients = Coefficients(stages, bands, slacks.controls)
        self.breaks = break_times(stages.A, stages.horizon, GROWTH)
        self.free, self.fixed = np.flatnonzero(~stages.fixed), stages.fixed
        self._starts = self.coefficients.count + len(self.breaks) * self.states
        self.size = self._starts + len(self.free)
        self.terminal, self._rest = stages.coupling.terminal, rest
        position = np.full(stages.H.shape[1], -1)
        position[slacks.core] = np.arange(len(slacks.core))
        self._channels = position[stages.coupling.channels]
        self.continuity = len(self.breaks) * self.states
        self.counts = [self.continuity, len(self.terminal), *(len(part.at) for part in rest)]
        self.row_count = sum(self.counts)
        self.chosen = np.concatenate([np.arange(len(self.terminal)), *(part.at for part in rest)])
        self.zero = np.zeros((len(self.breaks), self.states))
        self._still = np.zeros_like(stages.d)

    def simulate(self, v: Array, y: Array | None = None, c: Array | None = None) -> tuple[Array, Array]:
        """Add the controls of v to y (T+1, nz), write its states, and return it with the ends (K, n)."""
        n, count = self.states, self.coefficients.count
        if y is None:
            y = np.zeros((self.horizon + 1, n + self.controls))
        y[:, n:] += self.coefficients.synthesis(v[None, :count])[:, :, 0]
        y[0, self.free] = v[self._starts :]
        starts = np.ascontiguousarray(v[count : self._starts]).reshape(self.zero.shape)
        return y, self.loops.forward(self.A, self.B, self._still if c is None else c, self.breaks, starts, y)

    def gradient(self, of_y: Array, prices: Array | None = None) -> Array:
        """Return the gradient in v of of_y'y + prices'(starts - ends)."""
        prices = self.zero if prices is None else prices
        p, gw, of_starts = self.loops.backward(self.A, self.B, of_y, self.breaks, prices)
        z = self.coefficients.analysis(gw[:, :, None])[0]
        return np.concatenate([z, (of_starts + prices).ravel(), p[0, self.free]])

    def curvature(self, Phi: Array, v: Array) -> Array:
        """Return the gradient in v of 1/2 y'Phi y."""
        y, _ = self.simulate(v)
        return self.gradient(times_vectors(Phi, y))

    def values(self, y: Array, ends: Array) -> Array:
        """Return the values of the rows for y whose simulations start from zero."""
        signals = y[:, self._channels, None] if self._rest else y[:, :0, None]
        rest = [part.rows.forward(signals)[:, 0] for part in self._rest]
        return np.concatenate([-ends.ravel(), y[-1, self.terminal], *rest])

    def price_rows(self, nu: Array) -> tuple[Array, Array]:
        """Return the gradient in y (T+1, nz), and the prices (K, n), of multipliers of the rows."""
        prices, terminal, rest = np.split(nu, np.cumsum(self.counts[:2]))
        of_y = np.zeros((self.horizon + 1, self.states + self.controls))
        of_y[-1, self.terminal] = terminal
        signals = np.zeros((self.horizon + 1, len(self._channels), 1))
        first = 0
        for part in self._rest:
            part.rows.add_adjoint(rest[first : first + len(part.at), None], signals)
            first += len(part.at)
        if first:
            of_y[:, self._channels] += signals[:, :, 0]
        return of_y, prices.reshape(self.zero.shape)

    def rows(self) -> Array:
        """Return the rows as a matrix (rows, size)."""
        matrix = np.empty((self.row_count, self.size))
        for i in range(self.row_count):
            of_y, prices = self.price_rows(np.eye(1, self.row_count, i)[0])
            matrix[i] = self.gradient(of_y, prices)
        return matrix
