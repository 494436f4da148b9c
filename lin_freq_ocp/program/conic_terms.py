"""The terms h(L(x, u)) of a problem as rows: v = L(x, u) with the conic form of h, and slacks with prices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class TermRows:
    """The rows of one term, with coefficients of signals and slacks.

    ``entries`` (rows,) is the value of the term whose multiplier a row's dual is (-1: none); ``paid`` (slacks, k) the
    values whose excess each slack measures.
    """

    term: Term
    signals: sp.csr_array
    slacks: sp.csr_array
    lower: Array
    upper: Array
    cones: tuple[slice, ...]
    prices: Array
    entries: Indices
    paid: Indices

    def multipliers(self, y: Array) -> Array:
        """Return the multipliers of the term, (groups, dim), from the duals of its rows."""
        multipliers = np.zeros(self.term.shape)
        of_values = self.entries >= 0
        np.add.at(multipliers.reshape(-1), self.entries[of_values], y[of_values])
        return multipliers

    def slack_units(self, sizes: Array) -> Array:
        """Return one unit for each slack, from the sizes of the values (groups, dim)."""
        units = sizes.ravel()[self.paid].max(axis=1, initial=0.0)
        return np.where(units > 0, units, 1.0)


@dataclass(frozen=True, eq=False)
class ConicTerms:
    """The rows of all terms of a problem, on the signals and all slacks."""

    parts: tuple[TermRows, ...]
    signals: int

    @property
    def slacks(self) -> int:
        """Return the number of slacks."""
        return sum(len(part.prices) for part in self.parts)

    @property
    def matrix(self) -> sp.csc_array:
        """Return the coefficients, (rows, signals + slacks)."""
        if not self.parts:
            return sp.csc_array((0, self.signals))
        of_signals = sp.vstack([part.signals for part in self.parts])
        return sp.csc_array(sp.hstack([of_signals, sp.block_diag([part.slacks for part in self.parts])]))

    @property
    def lower(self) -> Array:
        """Return the lower limits of the rows."""
        return _joined([part.lower for part in self.parts])

    @property
    def upper(self) -> Array:
        """Return the upper limits of the rows."""
        return _joined([part.upper for part in self.parts])

    @property
    def prices(self) -> Array:
        """Return the cost of one unit of each slack."""
        return _joined([part.prices for part in self.parts])

    @property
    def of_costs(self) -> Mask:
        """Return which slacks belong to nonsmooth costs: their prices give the size of the cost."""
        counts = [len(part.prices) for part in self.parts]
        return np.repeat(np.array([part.term.kind.is_cost for part in self.parts], dtype=bool), counts)

    @property
    def cones(self) -> list[slice]:
        """Return the rows of each second-order cone."""
        firsts = np.cumsum([0, *(len(part.lower) for part in self.parts)])
        return [
            slice(int(first) + cone.start, int(first) + cone.stop)
            for first, part in zip(firsts, self.parts, strict=False)
            for cone in part.cones
        ]

    def multipliers(self, y: Array) -> dict[str, Array]:
        """Return the multipliers of every term by its name, from the duals of all rows."""
        ends = np.cumsum([len(part.lower) for part in self.parts])
        pieces = np.split(y, ends[:-1]) if self.parts else []
        return {part.term.name: part.multipliers(piece) for part, piece in zip(self.parts, pieces, strict=True)}

    def slacks_of(self, trajectory: Trajectory) -> Array:
        """Return the slacks of a trajectory."""
        x, u = trajectory.x, trajectory.u
        return _joined([part.term.penalty.least_slacks(part.term.map.values(x, u)) for part in self.parts])

    def slack_units(self, x: Array, u: Array) -> Array:
        """Return one unit for each slack, with states and controls as large as x (T+1, n) and u (T, m)."""
        return _joined([part.slack_units(part.term.map.sizes(x, u)) for part in self.parts])


def conic_terms(problem: OptimalControlProblem) -> ConicTerms:
    """Return the rows of all terms."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    parts = tuple(term_rows(term, T, n, m) for term in problem.terms)
    return ConicTerms(parts, (T + 1) * n + T * m)


def term_rows(term: Term, horizon: int, n: int, m: int) -> TermRows:
    """Return the rows of one term; without the equations 0 = 0 that the real bins of a spectrum give."""
    (L, c), form = term.map.rows(horizon, n, m), term.penalty.conic(*term.shape)
    L = sp.csr_array(sp.vstack([L, sp.csr_array((1, L.shape[1]))]))  # a row of zeros, for -1
    c = np.append(c, 0.0)[form.entries]
    empty = np.diff(L.indptr)[form.entries] + np.diff(form.slacks.indptr) == 0
    kept = np.flatnonzero(~(empty & (form.lower == form.upper)))
    return TermRows(
        term,
        sp.csr_array(L[form.entries[kept]]),
        sp.csr_array(form.slacks[kept]),
        (form.lower - c)[kept],
        (form.upper - c)[kept],
        form.cones,
        form.prices,
        form.entries[kept],
        form.paid,
    )


def _joined(parts: Sequence[Array]) -> Array:
    return np.concatenate([np.zeros(0), *parts])
