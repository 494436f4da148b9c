"""Soft sets whose rows are bounds on single components, in the places of hard bounds (docs/spectral.md, 12).

A row c y_f + d <= e with a price is a bound (e - d)/|c| on y_f with the price times |c|, upper where c > 0. It stands
in the place of the hard bound of that component, side and time, which must be absent. Where an end fixes the component,
the excess is a constant, and its subgradient is the price or zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask, sealed
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.term import Term, TermKind

SETS = (TermKind.STATE_SET, TermKind.CONTROL_SET)


@dataclass(frozen=True, eq=False)
class SoftSet:
    """The rows of a soft set as bounds sign y_f <= limit of the components f of (x, u), in the user's units."""

    name: str
    times: Indices  # (groups,)
    f: Indices  # (dim,)
    sign: Array  # (dim,), +1 for an upper bound
    size: Array  # (dim,), |c|
    limit: Array  # (groups, dim), inf where there is none
    price: Array  # (groups, dim), per unit of y_f
    constant: Mask  # (groups, dim): where an end fixes y_f
    excess: Array  # (groups, dim), of constant rows

    def multipliers(self, forces: Array, eta_C: float) -> Array:
        """Return the multipliers of the rows from the forces on all components, (T+1, n+m), and subtract theirs there.

        Where no end fixes the component, a force is that of this set alone.
        """
        own = np.maximum(self.sign * forces[self.times[:, None], self.f], 0.0)
        paid = np.where(self.excess > 0, eta_C * self.price, 0.0)
        found = np.where(self.constant, paid, np.where(np.isfinite(self.limit), own, 0.0))
        np.subtract.at(forces, (self.times[:, None], self.f[None]), self.sign * found)
        return sealed(found / self.size)


def soft_set(problem: OptimalControlProblem, term: Term) -> SoftSet | None:
    """Return a soft set as bounds; None if it is hard, or some row concerns several components."""
    form = term.map.stage_form(problem.state_dim, problem.control_dim)
    if form is None or term.kind not in SETS or not term.penalty.polyhedral or len(form[0]) > 1:
        return None
    (rows,), constant, shape = form[0], form[1], term.shape
    weights = np.broadcast_to(term.penalty.weights, shape)
    if np.isinf(weights).any() or (np.count_nonzero(rows, axis=1) != 1).any():
        return None
    f, times = np.argmax(rows != 0, axis=1), term.map.positions
    coefficient = rows[np.arange(len(f)), f]
    sign, size = np.sign(coefficient), np.abs(coefficient)
    limit = (term.penalty.bounds(shape)[1] - constant) / size
    fixed = np.zeros((len(times), len(f)), dtype=bool)
    excess = np.zeros(fixed.shape)
    if term.kind == TermKind.STATE_SET:
        for t, end in zip((0, problem.horizon), problem.ends, strict=True):
            here = times == t
            fixed[here] = end.fixed[f]
            excess[here] = sign * np.where(end.fixed, end.lower, 0.0)[f] - limit[here]
    return SoftSet(term.name, times, f, sign, size, limit, weights * size, fixed, excess)


def soft_sets(problem: OptimalControlProblem) -> tuple[SoftSet, ...] | None:
    """Return all sets as soft sets; None if some is none, or needs the place of another bound."""
    found = list[SoftSet]()
    for term in problem.terms:
        if term.kind not in (TermKind.STAGE_ROWS, TermKind.LINKED_ENDS):
            one = soft_set(problem, term)
            if one is None:
                return None
            found.append(one)
    return tuple(found) if not found or placed(problem, found) is not None else None


@dataclass(frozen=True, eq=False)
class Placed:
    """Bounds lower, upper and their prices, (T+1, n+m), in the user's units; controls have none at T."""

    lower: Array
    upper: Array
    of_lower: Array
    of_upper: Array


def placed(problem: OptimalControlProblem, sets: list[SoftSet] | tuple[SoftSet, ...]) -> Placed | None:
    """Return all bounds, hard and soft; None if two would need one place, or a soft one is not within the other."""
    tubes, m = (problem.state_tube, problem.control_tube), problem.control_dim
    sides = [
        np.hstack([states, np.vstack([controls, np.full((1, m), absent)])])
        for states, controls, absent in (
            (tubes[0].lower, tubes[1].lower, -np.inf),
            (tubes[0].upper, tubes[1].upper, np.inf),
        )
    ]
    prices = [np.full(side.shape, np.inf) for side in sides]
    for one in sets:
        group, row = np.nonzero(np.isfinite(one.limit) & ~one.constant)
        t, f, limit = one.times[group], one.f[row], one.limit[group, row]
        for above, sign in ((False, -1.0), (True, 1.0)):
            mine = one.sign[row] == sign
            at, side = (t[mine], f[mine]), sides[above]
            places = at[0] * side.shape[1] + at[1]
            if np.isfinite(side[at]).any() or len(np.unique(places)) < len(places):
                return None
            side[at], prices[above][at] = sign * limit[mine], one.price[group[mine], row[mine]]
    soft = np.isfinite(prices[0]) | np.isfinite(prices[1])
    return None if (soft & (sides[0] >= sides[1])).any() else Placed(*sides, *prices)
