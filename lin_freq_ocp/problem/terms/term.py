"""A term h(L(x, u)) of a problem: a hard constraint, a soft one, or a nonsmooth cost; a multiplier for each value."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.problem.terms.maps import AffineMap
from lin_freq_ocp.problem.terms.penalties import Within
from lin_freq_ocp.problem.terms.penalty import Penalty
from lin_freq_ocp.problem.terms.quantity import Reading, Statement
from lin_freq_ocp.problem.terms.semi_infinite import SemiInfiniteConstraint, peaks_above

HIGHEST = 0.99  # of the largest sample of a spectrum: a higher peak may be the highest one


class TermKind(StrEnum):
    """The field of the problem that a term comes from, with the traits of its terms.

    Attributes
    ----------
    of : str
        The only signal of the term: "states", "controls" or "outputs"; empty for joint rows, ends and costs.
    is_cost : bool
        Whether the term is part of the cost that the user stated.
    is_spectrum : bool
        Whether the term is a frequency constraint.
    is_rows : bool
        Whether the entries are joint rows, each with its own multiplier, limit and name.
    is_link : bool
        Whether the term is a system of equations on both ends.
    """

    of: str
    is_cost: bool
    is_spectrum: bool
    is_rows: bool
    is_link: bool

    STATE_SET = "state set", "states"
    CONTROL_SET = "control set", "controls"
    STAGE_ROWS = "stage rows", "", "rows"
    STATE_SPECTRUM = "state spectrum", "states", "spectrum"
    CONTROL_SPECTRUM = "control spectrum", "controls", "spectrum"
    OUTPUT_SPECTRUM = "output spectrum", "outputs", "spectrum"
    OUTPUT_LIMITS = "limits of outputs", "outputs"
    LINKED_ENDS = "linked ends", "", "link"
    STAGE_COST = "stage cost", "", "cost"
    TERMINAL_COST = "terminal cost", "", "cost"

    def __new__(cls, text: str, of: str, trait: str = "") -> TermKind:
        """Make a kind from its text, its signal and its only trait."""
        kind = str.__new__(cls, text)
        kind._value_, kind.of = text, of
        for name in ("cost", "spectrum", "rows", "link"):
            setattr(kind, f"is_{name}", name == trait)
        return kind


@dataclass(frozen=True, eq=False)
class LinearRows:
    """The rows C (x_t, u_t) <= e at some times."""

    name: str  # of their term
    times: Indices  # (groups,)
    C: Array  # (groups or 1, rows, n + m)
    e: Array  # (groups, rows)

    def matrix(self, group: int) -> Array:
        """Return C of one group, (rows, n + m)."""
        return self.C[min(group, len(self.C) - 1)]


@dataclass(frozen=True, eq=False)
class Term:
    """A convex function h of an affine map L of the trajectory: h(L(x, u))."""

    name: str  # of the term and of its multipliers, which have the shape of the values, (groups, dim)
    kind: TermKind
    map: AffineMap  # L
    penalty: Penalty  # h
    source: tuple[str, int] | None = None  # the field of the problem that states it, and the index there
    per_limit: Array | float = 1.0  # the penalty's limit per unit of a level of the stated limit, or one per group
    semi_infinite: SemiInfiniteConstraint | None = None  # the constraint that the map samples at its points
    band: str = ""  # of the constraint: it names terms that would have the same name
    statement: Statement | None = None  # of the limit of a spectrum

    @property
    def hard(self) -> bool:
        """Whether a part of the term must hold exactly."""
        return self.penalty.hard

    @property
    def shape(self) -> tuple[int, int]:
        """Return (groups, dim)."""
        return self.map.shape

    @property
    def takes_batches(self) -> bool:
        """Whether its values, prices and gaps may be those of many trajectories, with a leading axis."""
        return self.map.takes_batches and self.penalty.takes_batches

    def cost(self, x: Array, u: Array) -> Array:
        """Return the cost of each group, (groups,), or that of all groups, (1,)."""
        values, penalty, constraint = self.map, self.penalty, self.semi_infinite
        if constraint is not None and not self.hard:  # the price is on the largest violation at any point
            values, penalty = constraint.at(peaks_above(constraint, x, u, 1.0)[0])
        return penalty.cost(values.values(x, u))

    def sizes_of_prices(self, values: Array, paid: Array, apart: tuple[Array, Array]) -> Array:
        """Return the sizes of what groups pay, (..., groups): at most what states and controls so far apart change."""
        if self.semi_infinite is not None:  # its price is that of a peak
            return np.abs(paid)
        change = self.map.largest_changes(*apart)
        with np.errstate(over="ignore", invalid="ignore"):
            others = [np.abs(self.penalty.cost(values + sign * change) - paid) for sign in (-1, 1)]
        return np.fmin(np.abs(paid), np.fmax(*others))

    def readings(self, x: Array, u: Array) -> Iterator[Reading]:
        """Yield the values of a limited spectrum and their limits, in the unit in which the limits were stated."""
        statement, constraint = self.statement, self.semi_infinite
        if statement is None:
            return
        if constraint is not None:
            at, ratios = constraint.first_points()[:1], np.zeros(1)
            top = max(float(ratio.max()) for _, _, ratio in constraint.samples(constraint.map.signal(x, u)))
            if top > 0:  # the highest peaks alone: a long signal has many
                at, ratios = peaks_above(constraint, x, u, HIGHEST * top)
            levels = constraint.limit_at(at) / self.per_limit
            yield from statement.readings(ratios * levels, levels, at)
            return
        values, spectrum = self.map.values(x, u), self.map.spectrum
        frequencies = np.zeros(0) if spectrum is None else spectrum.frequencies
        first = values[:, :1] if statement.relative else np.zeros((len(values), 0))
        sizes = np.linalg.norm(values[:, first.shape[1] :], axis=1)
        levels = np.broadcast_to(statement.levels, sizes.shape)
        if statement.relative:
            share = np.where(sizes > 0, np.inf, 0.0)
            np.divide(sizes, first[:, 0], out=share, where=first[:, 0] > 0)
            yield from statement.readings(levels * share, levels, frequencies)
        else:
            yield from statement.readings(sizes / self.per_limit, levels, frequencies)

    def violation(self, x: Array, u: Array) -> Array:
        """Return the violation of the hard part, zero or above, (groups, dim) or (groups, 1)."""
        return self.penalty.violation(self.map.values(x, u))

    def polyhedron(self, n: int, m: int, soft: bool = False) -> LinearRows | None:
        """Return the rows of (x_t, u_t), one for each value, of a hard term, or of a soft one; None of other terms."""
        form = self.map.stage_form(n, m) if self.hard != soft and self.penalty.polyhedral else None
        if form is None or (soft and self.kind.is_cost):
            return None
        limits = self.penalty.bounds(self.shape) if soft else self.penalty.hard_bounds(self.shape)
        return LinearRows(self.name, self.map.positions, form[0], limits[1] - form[1])

    def implied_rows(self, n: int, m: int, level: float = np.inf) -> LinearRows | None:
        """Return rows of (x_t, u_t) that a term implies, such as the box around a ball; None without one.

        A hard term implies them; a price does where it costs at most ``level``.
        """
        form = self.map.stage_form(n, m) if self.hard or level < np.inf else None
        if form is None:
            return None
        lower, upper = self.penalty.hard_bounds(self.shape, level)
        sides = [(form[0], upper - form[1]), (-form[0], form[1] - lower)]
        finite = [(matrix, limits) for matrix, limits in sides if np.isfinite(limits).any()]
        if not finite:
            return None
        matrices, limits = zip(*finite, strict=True)
        return LinearRows(self.name, self.map.positions, np.concatenate(matrices, 1), np.concatenate(limits, 1))


@dataclass(frozen=True, eq=False)
class Link:
    """Equations on both ends: an affine map of the ends whose values must be within the reach of a penalty.

    ``periodic``: the equations are x_T = x_0. ``repeats``: they include x_T = x_0, so that spectra of states have T
    samples.
    """

    name: str
    values: AffineMap
    penalty: Within
    periodic: bool
    repeats: bool
