"""The terms h(L(x, u)) of a problem as rows: v = L(x, u), with slacks s >= 0 that are paid for where h is a price.

    Below, hard             v <= limit
    Below, soft             v - s <= limit, s >= 0                              cost weight * s, one s for each entry
    Norm, 1                 -a <= v <= a                                        cost weight * a, one a for each entry
    Norm, largest, hard     -radius <= v <= radius
    Norm, largest, soft     -radius - s <= v <= radius + s, s >= 0              cost weight * s, one s for each group
    Norm, Euclidean, hard   (radius, v) in the second-order cone, or v = 0
    Norm, Euclidean, soft   (radius + s, v) in the second-order cone, s >= 0    cost weight * s
    Cone                    v in the second-order cone

The multiplier of v_i is the sum of the duals of the rows that v_i stands in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.penalties import Below, Cone, Norm
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transcription.linear.map_rows import map_rows


@dataclass(frozen=True, eq=False)
class TermRows:
    """The rows of one term.

    Attributes
    ----------
    term : Term
    signals : sparse (rows, signals), slacks : sparse (rows, slacks)
        Coefficients.
    lower, upper : (rows,)
    cones : tuple of slice
    prices : (slacks,)
    entries : (rows,)
        Which value of the term a row's dual is a multiplier of; -1: of none.
    charged : (groups * dim,) or (groups,)
        Which entry or group has a slack.
    """

    term: Term
    signals: sp.csr_array
    slacks: sp.csr_array
    lower: Array
    upper: Array
    cones: tuple[slice, ...]
    prices: Array
    entries: Indices
    charged: Mask

    def multipliers(self, y: Array) -> Array:
        """Return the multipliers of the term, (groups, dim), from the duals of its rows."""
        multipliers = np.zeros(self.term.shape)
        of_values = self.entries >= 0
        np.add.at(multipliers.reshape(-1), self.entries[of_values], y[of_values])
        return multipliers

    def slacks_of(self, values: Array) -> Array:
        """Return the least slacks with which values (groups, dim) fit the rows."""
        penalty = self.term.penalty
        if not len(self.prices) or isinstance(penalty, Cone):
            return np.zeros(0)
        if isinstance(penalty, Below):
            return np.maximum(values - penalty.limit, 0.0).ravel()[self.charged]
        if penalty.order == 1:
            return np.abs(values).ravel()[self.charged]
        return Norm(penalty.order, penalty.radius, np.ones(len(values))).cost(values)[self.charged]

    def slack_units(self, sizes: Array) -> Array:
        """Return one unit for each slack, from the sizes of the values (groups, dim)."""
        per_group = len(self.charged) == len(sizes) and len(self.charged) != sizes.size
        units = (sizes.max(1) if per_group else sizes.ravel())[self.charged] if len(self.prices) else np.zeros(0)
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
        """Return which slacks are those of nonsmooth costs: their prices say how large the cost is."""
        return np.concatenate(
            [
                np.zeros(0, dtype=bool),
                *(np.full(len(part.prices), part.term.kind.endswith("cost")) for part in self.parts),
            ]
        )

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
        return _joined([part.slacks_of(part.term.map.values(x, u)) for part in self.parts])

    def slack_units(self, x: Array, u: Array) -> Array:
        """Return one unit for each slack, with states and controls as large as x (T+1, n) and u (T, m)."""
        return _joined([part.slack_units(part.term.map.sizes(x, u)) for part in self.parts])


def conic_terms(problem: OptimalControlProblem) -> ConicTerms:
    """Return the rows of all terms."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    parts = tuple(_term_rows(term, *map_rows(term.map, T, n, m)) for term in problem.terms)
    return ConicTerms(parts, (T + 1) * n + T * m)


def _term_rows(term: Term, L: sp.csr_array, c: Array) -> TermRows:
    penalty = term.penalty
    if isinstance(penalty, Cone):
        groups, dim = term.shape
        cones = tuple(slice(g * dim, (g + 1) * dim) for g in range(groups))
        return _plain(term, L, -c, np.full(len(c), np.inf), np.arange(len(c)), cones)
    if isinstance(penalty, Below):
        return _below(term, penalty, L, c)
    radius = np.broadcast_to(penalty.radius, term.shape[:1])
    if penalty.order == 1:
        return _absolute(term, penalty, L, c)
    if penalty.order == 2 and term.shape[1] > 1:
        return _euclidean(term, penalty, radius, L, c)
    return _largest(term, penalty, radius, L, c)


def _below(term: Term, penalty: Below, L: sp.csr_array, c: Array) -> TermRows:
    limit = np.broadcast_to(penalty.limit, term.shape).ravel()
    entries = np.flatnonzero(np.isfinite(limit))
    upper, none = (limit - c)[entries], np.full(len(entries), -np.inf)
    if term.hard:
        return _plain(term, L[entries], none, upper, entries)
    weight = np.broadcast_to(penalty.weight, term.shape).ravel()[entries]
    return TermRows(
        term,
        sp.csr_array(sp.vstack([L[entries], sp.csr_array((len(entries), L.shape[1]))])),
        _signed(len(entries), -1, 1),
        np.concatenate([none, np.zeros(len(entries))]),
        np.concatenate([upper, -none]),
        (),
        weight,
        np.concatenate([entries, np.full(len(entries), -1)]),
        np.isfinite(limit),
    )


def _absolute(term: Term, penalty: Norm, L: sp.csr_array, c: Array) -> TermRows:
    count = len(c)
    weight = np.repeat(np.broadcast_to(penalty.weight, term.shape[:1]), term.shape[1])
    unlimited = np.full(count, np.inf)
    return TermRows(
        term,
        sp.csr_array(sp.vstack([L, L])),
        _signed(count, -1, 1),
        np.concatenate([-unlimited, -c]),
        np.concatenate([-c, unlimited]),
        (),
        weight,
        np.tile(np.arange(count), 2),
        np.ones(count, dtype=bool),
    )


def _largest(term: Term, penalty: Norm, radius: Array, L: sp.csr_array, c: Array) -> TermRows:
    dim = term.shape[1]
    limited = np.isfinite(radius)
    entries = np.flatnonzero(np.repeat(limited, dim))
    reach = np.repeat(radius, dim)[entries]
    low, high = -reach - c[entries], reach - c[entries]
    if term.hard:
        return _plain(term, L[entries], low, high, entries)
    count, unlimited = int(limited.sum()), np.full(len(entries), np.inf)
    spread = sp.csr_array(sp.kron(sp.eye_array(count), np.ones((dim, 1))))
    return TermRows(
        term,
        sp.csr_array(sp.vstack([L[entries], L[entries], sp.csr_array((count, L.shape[1]))])),
        sp.csr_array(sp.vstack([-spread, spread, sp.eye_array(count)])),
        np.concatenate([-unlimited, low, np.zeros(count)]),
        np.concatenate([high, unlimited, np.full(count, np.inf)]),
        (),
        np.broadcast_to(penalty.weight, radius.shape)[limited],
        np.concatenate([entries, entries, np.full(count, -1)]),
        limited,
    )


def _euclidean(term: Term, penalty: Norm, radius: Array, L: sp.csr_array, c: Array) -> TermRows:
    """Return the rows (radius + s, v) of every group in turn; hard groups of radius 0 are equations."""
    dim, groups = term.shape[1], np.flatnonzero(np.isfinite(radius))
    if term.hard and not radius[groups].any():
        entries = np.repeat(groups * dim, dim) + np.tile(np.arange(dim), len(groups))
        entries = entries[np.diff(L.indptr)[entries] > 0]  # the imaginary part of a real bin is no equation
        return _plain(term, L[entries], -c[entries], -c[entries], entries)
    entries = np.full((len(groups), dim + 1), -1)
    entries[:, 1:] = groups[:, None] * dim + np.arange(dim)
    lower = np.concatenate([-radius[groups, None], -c.reshape(-1, dim)[groups]], axis=1)
    with_radius = sp.vstack([L, sp.csr_array((1, L.shape[1]))], format="csr")  # a row of zeros, for -1
    values = sp.csr_array(with_radius[entries.ravel()])
    count = 0 if term.hard else len(groups)
    rows = np.arange(len(groups)) * (dim + 1)
    slacks = sp.csr_array((np.ones(count), (rows[:count], np.arange(count))), shape=(entries.size, count))
    positive = sp.eye_array(count, format="csr")[radius[groups][:count] > 0]
    none = sp.csr_array((positive.shape[0], L.shape[1]))
    limits = np.concatenate([lower.ravel(), np.zeros(positive.shape[0])])
    return TermRows(
        term,
        sp.csr_array(sp.vstack([values, none])),
        sp.csr_array(sp.vstack([slacks, positive])),
        limits,
        np.full(len(limits), np.inf),
        tuple(slice(int(row), int(row) + dim + 1) for row in rows),
        np.broadcast_to(penalty.weight, radius.shape)[groups][:count],
        np.concatenate([entries.ravel(), np.full(positive.shape[0], -1)]),
        np.isfinite(radius),
    )


def _plain(
    term: Term, L: sp.csr_array, lower: Array, upper: Array, entries: Indices, cones: tuple[slice, ...] = ()
) -> TermRows:
    """Return rows without slacks."""
    none = sp.csr_array((len(entries), 0))
    return TermRows(term, L, none, lower, upper, cones, np.zeros(0), entries, np.zeros(0, dtype=bool))


def _signed(count: int, first: float, second: float) -> sp.csr_array:
    """Return the identity times two numbers, one below the other."""
    identity = sp.eye_array(count)
    return sp.csr_array(sp.vstack([first * identity, second * identity]))


def _joined(parts: Sequence[Array]) -> Array:
    return np.concatenate([np.zeros(0), *parts])
