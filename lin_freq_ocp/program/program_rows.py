"""The rows of a linear program: bounds, stop bands, and every other term h(L(x, u)) in the conic form of h.

    lower <= weights * L(x, u) + S s <= upper,   or rows less their lower limits in second-order cones,

for deviations (x, u) and s from an origin of signals and slacks. A row has at most one value of L, whose multiplier is
the sum of the duals of its rows times their weights. Stop bands are terms, too: (Re, Im) of the bins of one component,
with weights that make the rows orthonormal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.maps import AffineMap, SpectrumForm
from lin_freq_ocp.problem.terms.penalty import Penalty
from lin_freq_ocp.problem.terms.spectrum_maps import SpectrumMap
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.program import Block

ROUNDING = 1e-12  # of the limit of a row without coefficients, relative to the terms that it is made of


@dataclass(frozen=True, eq=False)
class ProgramRows:
    """The rows of a stop band, of a term, or of the bounds on states or controls; these have no map."""

    block: Block
    name: str  # of the term
    shape: tuple[int, int, int]  # T, n, m
    map: AffineMap | None  # L
    entries: Indices  # (rows,): the value in each row; -1: none
    targets: Indices  # (rows,): the position of the multiplier of that value among all; -1: none
    weights: Array | None  # (rows,); None: ones
    lower: Array  # (rows,)
    upper: Array  # (rows,)
    slacks: sp.csr_array  # (rows, slacks)
    origin: Array  # (slacks,): the slacks from which the variables are deviations
    prices: Array  # (slacks,)
    paid: Indices  # (slacks, k): the values whose violation each slack measures
    cones: Indices  # (cones, 2): first row, and the one after the last

    @cached_property
    def signals(self) -> sp.csr_array:
        """Return the coefficients of x_0 .. x_T, u_0 .. u_{T-1}, (rows, (T+1) n + T m)."""
        T, n, m = self.shape
        if self.map is None:
            count, shape = len(self.entries), (len(self.entries), (T + 1) * n + T * m)
            return sp.csr_array((np.ones(count), self.entries, np.arange(count + 1)), shape=shape)
        L = self.map.rows(T, n, m)[0]
        if not np.array_equal(self.entries, np.arange(L.shape[0])):
            first, last = (np.append(ends, L.nnz)[self.entries] for ends in (L.indptr[:-1], L.indptr[1:]))  # -1: none
            at = cone_members(np.stack([first, last], axis=1))[0]
            pointers = np.append(0, np.cumsum(last - first))
            L = sp.csr_array((L.data[at], L.indices[at], pointers), shape=(len(first), L.shape[1]))
        if self.weights is not None:
            L.data *= np.repeat(self.weights, np.diff(L.indptr))
        return L

    def same_matrix(self, other: ProgramRows) -> bool:
        """Whether other rows differ in their limits alone."""
        if self.block is not other.block or self.name != other.name or self.shape != other.shape:
            return False
        maps = self.map, other.map
        same = maps[0] is maps[1] if maps[0] is None or maps[1] is None else maps[0].same_rows(maps[1])
        arrays = [(getattr(self, name), getattr(other, name)) for name in ("entries", "weights", "prices", "cones")]
        arrays += [(getattr(self.slacks, name), getattr(other.slacks, name)) for name in ("data", "indices", "indptr")]
        return same and all(one is another or np.array_equal(one, another) for one, another in arrays)

    @cached_property
    def spectrum(self) -> SpectrumForm | None:
        """Return the spectrum whose values are in the rows; None for other maps."""
        return None if self.map is None else self.map.spectrum_form(*self.shape[1:])

    @cached_property
    def times(self) -> Indices | None:
        """Return the time of the value in each row (-1: no value); None if values depend on several times."""
        T, n, m = self.shape
        if self.map is None:
            last = (T + 1) * n
            return np.where(self.entries < last, self.entries // n, (self.entries - last) // m)
        if self.map.stage_form(n, m) is None:
            return None
        return np.where(self.entries >= 0, self.map.positions[self.entries // self.map.shape[1]], -1)

    @property
    def empty(self) -> Mask:
        """Return which rows have no coefficient."""
        if self.spectrum is None:
            without = np.diff(self.signals.indptr) == 0
        else:
            zero = np.append(self.spectrum.zero[self.spectrum.kept], True)
            without = zero[self.entries]
        return without & (np.diff(self.slacks.indptr) == 0)

    def rounding(self, origin: Trajectory) -> Array:
        """Return the rounding error of the limits, (rows,), as deviations from the origin."""
        if self.map is None:
            return np.zeros(len(self.lower))
        return ROUNDING * np.append(self.map.sizes(np.abs(origin.x), np.abs(origin.u)), 0.0)[self.entries]

    def selected(self, chosen: Indices) -> ProgramRows:
        """Return the chosen rows, which must include all rows of cones."""
        assert self.weights is None  # all rows of a stop band are needed
        parts = {name: getattr(self, name)[chosen] for name in ("entries", "targets", "lower", "upper")}
        return replace(self, **parts, slacks=sp.csr_array(self.slacks[chosen]))

    def priced_duals(self, duals: Array) -> Array:
        """Return the duals of the rows, scaled so that they pay the price of each slack exactly, as at an optimum.

        A solver misses the price by its tolerance, relative to multipliers that may be far larger.
        """
        if not self.prices.all():  # norms within norms: rows have several slacks
            return duals
        paid, factors, slacks = -(self.slacks.T @ duals), np.ones(len(duals)), sp.coo_array(self.slacks)
        factors[slacks.row] = np.divide(self.prices, paid, out=np.ones(len(paid)), where=paid > 0)[slacks.col]
        rows, cones = cone_members(self.cones)
        factors[rows] = factors[self.cones[:, 0]][cones]
        return factors * duals

    def slack_sizes(self, x: Array, u: Array) -> Array:
        """Return the size of each slack for states and controls of the sizes x (T+1, n) and u (T, m).

        It is zero where all weights are.
        """
        if self.map is None or not len(self.prices):
            return np.zeros(0)
        return self.map.largest_changes(x, u).ravel()[self.paid].max(axis=1, initial=0.0)


def cone_members(cones: Indices) -> tuple[Indices, Indices]:
    """Return the rows of all cones (first, after the last), (cones, 2), and the cone of each of them."""
    sizes = cones[:, 1] - cones[:, 0]
    cone = np.repeat(np.arange(len(cones)), sizes)
    return np.arange(len(cone)) + np.repeat(cones[:, 0] - np.cumsum(sizes) + sizes, sizes), cone


def box_rows(block: Block, tube: Box, origin: Trajectory, target: int) -> ProgramRows:
    """Return the finite bounds on the states, or on the controls, in deviations from the origin."""
    signal, first = (origin.x, 0) if block is Block.STATE_SET else (origin.u, origin.x.size)
    bounded = np.flatnonzero(np.isfinite(tube.lower) | np.isfinite(tube.upper))
    lower, upper = ((side - signal).ravel()[bounded] for side in (tube.lower, tube.upper))
    at, shape = (None, first + bounded, target + bounded, None), (len(origin.u), origin.x.shape[1], origin.u.shape[1])
    return ProgramRows(block, block.value, shape, *at, lower, upper, *_no_slacks(len(bounded)))


def stop_band_rows(map: SpectrumMap, origin: Trajectory, targets: tuple[int, int]) -> ProgramRows:
    """Return the orthonormal rows of the stopped bins of a state or control, one of a problem's ``stop_band_maps``.

    ``targets`` are the positions of the first multipliers of states and of controls; those of (Re, Im) of every bin
    follow, component by component.
    """
    weights, shape = orthonormal_weights(map), (len(origin.u), origin.x.shape[1], origin.u.shape[1])
    block = Block.CONTROL_SPECTRUM if map.C is None else Block.STATE_SPECTRUM
    first = targets[map.C is None] + map.component * 2 * (map.points // 2 + 1)
    pairs, right = (2 * map.bins[:, None] + [0, 1]).ravel()[map.kept], -weights * map.values(origin.x, origin.u)[0]
    at = map, np.arange(len(pairs)), first + pairs, weights
    return ProgramRows(block, block.value, shape, *at, right, right, *_no_slacks(len(pairs)))


@lru_cache(maxsize=64)  # a sparse matrix takes as long to make as the other arrays of a stop band
def _no_slacks(rows: int) -> tuple[sp.csr_array, Array, Array, Indices, Indices]:
    """Return empty slacks, their origin, prices, paid values and cones for so many rows."""
    none = np.zeros(0)
    return sp.csr_array((rows, 0)), none, none, np.zeros((0, 1), dtype=int), np.zeros((0, 2), dtype=int)


def map_rows(
    name: str, map: AffineMap, penalty: Penalty, origin: Trajectory, target: int, slacks: Array
) -> ProgramRows:
    """Return the rows of a term h(L(x, u)) in deviations from the origin; ``target`` is its first multiplier.

    The slacks are deviations from ``slacks``. Equations 0 = 0, such as those of the imaginary parts of real bins, are
    left out.
    """
    form = penalty.conic(*map.shape)
    slacks = np.broadcast_to(slacks, form.prices.shape)
    values = np.append(map.values(origin.x, origin.u), 0.0)[form.entries] + form.slacks @ slacks
    limits = form.lower - values, form.upper - values
    targets = np.where(form.entries >= 0, target + form.entries, -1)
    cones = np.array([(cone.start, cone.stop) for cone in form.cones], dtype=int).reshape(-1, 2)
    at, shape = (map, form.entries, targets, None), (len(origin.u), origin.x.shape[1], origin.u.shape[1])
    rows = ProgramRows(Block.TERMS, name, shape, *at, *limits, form.slacks, slacks, form.prices, form.paid, cones)
    equal = np.flatnonzero(form.lower == form.upper)
    empty = equal[rows.empty[equal]] if len(equal) else equal
    if not len(empty):
        return rows
    satisfied = empty[np.abs(rows.lower[empty]) <= rows.rounding(origin)[empty]]
    return rows.selected(np.setdiff1d(np.arange(len(targets)), satisfied))


def orthonormal_weights(map: SpectrumMap) -> Array:
    """Return the weights, (rows,), that make the rows of a joint map of N samples orthonormal.

    Bins 0 and N/2 have one row, cos(2 pi k t/N)/sqrt(N); every other bin k has two, sqrt(2/N) cos(2 pi k t/N)
    and -sqrt(2/N) sin(2 pi k t/N), one after the other.
    """
    return np.repeat(np.sqrt(np.where(map.real, 1, 2) / map.points), 2)[map.kept]


def stopped_bins_of_one(length: int, stopped: Mask) -> SpectrumMap:
    """Return the map from one control of so many samples to (Re, Im) of its stopped bins, (N//2 + 1,)."""
    return SpectrumMap(None, np.ones(1), np.ones(length), length, np.flatnonzero(stopped), joint=True)


def real_rows(length: int, stopped: Mask) -> Array:
    """Return R, shape (rows, length), with R v = 0 iff the stopped DFT bins of v are zero, and R R' = I."""
    map = stopped_bins_of_one(length, stopped)
    return orthonormal_weights(map)[:, None] * map.waves()


def bin_multipliers(length: int, stopped: Mask, rho: Array) -> ComplexArray:
    """Return the multipliers per bin in the units of the DFT, shape (N//2 + 1,), from one real dual per row of R."""
    map, result = stopped_bins_of_one(length, stopped), np.zeros(len(stopped), dtype=np.complex128)
    result[map.bins] = map.pairs((orthonormal_weights(map) * rho)[None]) @ [1, 1j]
    return result
