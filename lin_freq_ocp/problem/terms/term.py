"""A term h(L(x, u)) of a problem: a constraint, hard or soft, or a nonsmooth cost, with one multiplier per value."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.problem.terms.maps import AffineMap
from lin_freq_ocp.problem.terms.penalties import Within
from lin_freq_ocp.problem.terms.penalty import Penalty
from lin_freq_ocp.problem.terms.semi_infinite import Continuum, peaks_above


class TermKind(StrEnum):
    """Where a term comes from, the field of the problem that it was given in, and what that says of it.

    Attributes
    ----------
    of : str
        The signal that it is about alone: "states", "controls" or "outputs"; empty for joint rows, ends and costs.
    is_cost : bool
        Whether it is part of the cost as the user stated it.
    is_spectrum : bool
        Whether it is a frequency constraint.
    is_rows : bool
        Whether its entries are joint rows, which have multipliers, limits and names of their own.
    is_link : bool
        Whether it is equations on both ends.
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
    LINKED_ENDS = "linked ends", "", "link"
    STAGE_COST = "stage cost", "", "cost"
    TERMINAL_COST = "terminal cost", "", "cost"

    def __new__(cls, text: str, of: str, trait: str = "") -> TermKind:
        """Make a kind of its text, its signal, and the one trait that is true of it."""
        kind = str.__new__(cls, text)
        kind._value_, kind.of = text, of
        for name in ("cost", "spectrum", "rows", "link"):
            setattr(kind, f"is_{name}", name == trait)
        return kind


@dataclass(frozen=True, eq=False)
class LinearRows:
    """C (x_t, u_t) <= e at some times."""

    name: str  # of the term that they come from
    times: Indices  # (groups,)
    C: Array  # (groups or 1, rows, n + m)
    e: Array  # (groups, rows)

    def matrix(self, group: int) -> Array:
        """Return C of one group, (rows, n + m)."""
        return self.C[min(group, len(self.C) - 1)]


@dataclass(frozen=True, eq=False)
class Term:
    """h(L(x, u)), with h convex and L affine."""

    name: str  # of its multipliers, too, which have the shape of its values, (groups, dim)
    kind: TermKind
    map: AffineMap  # L
    penalty: Penalty  # h
    source: tuple[str, int] | None = None  # the problem's field that it was given in, and its index there
    per_limit: float = 1.0  # change of the penalty's limit per unit of the given limit (of an energy, of its root)
    everywhere: Continuum | None = None  # what must hold at all frequencies, and does at those of the map only

    @property
    def hard(self) -> bool:
        """Whether it is a constraint that must hold."""
        return self.penalty.hard

    @property
    def shape(self) -> tuple[int, int]:
        """Return (groups, dim)."""
        return self.map.shape

    def cost(self, x: Array, u: Array) -> Array:
        """Return what it adds to J, one number a group, or one of all groups together."""
        if self.everywhere is None or self.hard:
            return self.penalty.cost(self.map.values(x, u))
        values, penalty = self.everywhere.at(peaks_above(self.everywhere, x, u, 1.0)[0])
        return penalty.cost(values.values(x, u))

    def violation(self, x: Array, u: Array) -> Array:
        """Return by how much it is violated where it is hard, (groups, dim) or (groups, 1)."""
        return self.penalty.violation(self.map.values(x, u))

    def polyhedron(self, n: int, m: int) -> LinearRows | None:
        """Return the rows of a hard term that is nothing but rows of (x_t, u_t), one for each value; else None."""
        form = self.map.stage_form(n, m) if self.hard and self.penalty.polyhedral else None
        if form is None:
            return None
        return LinearRows(self.name, self.map.positions, form[0], self.penalty.hard_bounds(self.shape)[1] - form[1])

    def implied_rows(self, n: int, m: int) -> LinearRows | None:
        """Return rows of (x_t, u_t) that follow from a hard term, as from a ball those around it; None without any."""
        form = self.map.stage_form(n, m) if self.hard else None
        if form is None:
            return None
        lower, upper = self.penalty.hard_bounds(self.shape)
        sides = [(form[0], upper - form[1]), (-form[0], form[1] - lower)]
        kept = [(matrix, limits) for matrix, limits in sides if np.isfinite(limits).any()]
        if not kept:
            return None
        matrices, limits = zip(*kept, strict=True)
        return LinearRows(self.name, self.map.positions, np.concatenate(matrices, 1), np.concatenate(limits, 1))


@dataclass(frozen=True, eq=False)
class Link:
    """Equations on both ends: their values, what these must satisfy, and whether they say x_T = x_0.

    ``repeats`` says whether spectra of states have T samples: x_T repeats x_0, beside other equations or none.
    """

    name: str
    values: AffineMap
    penalty: Within
    periodic: bool
    repeats: bool
