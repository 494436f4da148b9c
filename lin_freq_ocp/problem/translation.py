"""States counted from where they move: x = origin + y, and the same problem in y.

A, B, control sets, multipliers and costs stay; offsets, ends, state sets, references, rows, guards and regions move
along. A move of 1 m at a northing of 5 000 000 m is badly posed in double precision, as every solver and every relative
tolerance sees numbers of 5e6; counted from the start of the move, it is the same problem as anywhere else.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, assign
from lin_freq_ocp.base.errors import BandWarning, LinFreqOCPError
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import SetOrSets
from lin_freq_ocp.problem.trajectory import Trajectory

OF_STATES = ("state_boxes", "met_ends", "state_tube", "terms", "borders", "gap")  # what a problem caches of its states
FAR = 10.0  # distances between the data of a state beyond which its origin is moved; nearer, a digit is lost at most


@dataclass(frozen=True, eq=False)
class Translation:
    """A problem, and the same problem with its states counted from an origin, (n,)."""

    given: OptimalControlProblem
    problem: OptimalControlProblem
    origin: Array

    @property
    def moves(self) -> bool:
        """Whether the origin is not zero."""
        return bool(self.origin.any())

    @property
    def cost(self) -> float:
        """Return the cost of the given problem less that of the translated one: that of linear terms at the origin."""
        cost, T = self.given.quadratic, self.given.horizon
        return float(np.broadcast_to(cost.q, (T, len(self.origin))).sum(0) @ self.origin + cost.p @ self.origin)

    def translated(self, trajectory: Trajectory) -> Trajectory:
        """Return a trajectory of the given problem as one of the translated problem."""
        return Trajectory(trajectory.x - self.origin, trajectory.u) if self.moves else trajectory

    def restored(self, trajectory: Trajectory) -> Trajectory:
        """Return a trajectory of the translated problem as one of the given problem."""
        return Trajectory(trajectory.x + self.origin, trajectory.u) if self.moves else trajectory


def translation_of(problem: OptimalControlProblem) -> Translation:
    """Return a problem with its states counted from where they move; itself where they move near zero."""
    return translated_by(problem, far_origin(problem))


def translated_by(problem: OptimalControlProblem, origin: Array) -> Translation:
    """Return a problem with its states counted from an origin (n,), where its classes allow that.

    Nothing is checked again.
    """
    none = Translation(problem, problem, np.zeros(problem.state_dim))
    if not origin.any():
        return none
    dynamics, cost = problem.dynamics.translated(origin), problem.cost.translated(origin)
    if dynamics is None or cost is None:
        return none
    moved = copy(problem)
    assign(
        moved,
        dynamics=dynamics,
        cost=cost.at_dimensions(problem.state_dim, problem.control_dim, problem.horizon),
        state_set=translated_set(problem.state_set, origin),
        initial_state=problem.initial_state.translated(origin),
        terminal_state=problem.terminal_state.translated(origin),
        stage_rows=tuple(rows.translated(origin) for rows in problem.stage_rows),
        _origin=origin if problem.origin is None else problem.origin + origin,
    )
    for name in OF_STATES:
        moved.__dict__.pop(name, None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BandWarning)  # the given problem has said so
        _ = moved.ends, moved.terms
    return Translation(problem, moved, origin)


def translated_set(given: SetOrSets, origin: Array) -> SetOrSets:
    """Return one set for all times, or one per time, of x - origin."""
    if isinstance(given, Sequence):
        return [one.translated(origin) for one in given]
    return given and given.translated(origin)


def far_origin(problem: OptimalControlProblem) -> Array:
    """Return the origin from which states are to be counted, (n,); zero in components that are near it.

    A state lies where its ends are fixed, else at its references, else in the middle of its bounds. It is far from zero
    if it lies FAR times farther than these values differ, and than it drifts from there over the horizon without
    control. Spectra of a state that depend on its mean keep its zero.
    """
    places = _fixed_places(problem)
    centre, highest, lowest = places[0], places[0], places[0]
    for place in places[1:]:
        centre = np.where(np.isnan(centre), place, centre)
        highest, lowest = np.fmax(highest, place), np.fmin(lowest, place)
    spread, unknown = highest - lowest, np.isnan(centre)
    if unknown.any():
        middle, half = _middle(problem)
        centre, spread = np.where(unknown, middle, centre), np.where(unknown, half, spread)
    far = np.abs(centre) > FAR * spread
    if not far.any():
        return np.zeros(problem.state_dim)
    centre = np.nan_to_num(centre)
    far &= np.abs(centre) > FAR * _drift(problem, centre)
    return np.where(far & ~_about_zero(problem), centre, 0.0)


def _fixed_places(problem: OptimalControlProblem) -> list[Array]:
    """Return where the data say that states are, (n,) each, in order of preference; nan where they do not."""
    n, T, cost = problem.state_dim, problem.horizon, problem.quadratic
    found = [np.where(end.fixed, end.lower, np.nan) for end in problem.ends]
    references = [cost.x_ref]
    if cost.x_ref.ndim == 2:
        references = [cost.x_ref[0], cost.x_ref.max(0), cost.x_ref.min(0)]
    found += [np.where(cost.weighs, reference, np.nan) for reference in references]
    for norm in problem.cost.norms:
        for i in range(n):
            given = norm.references(i, True, T)
            if given is not None and given[1].any():
                values = np.broadcast_to(given[0] if given[0].ndim == 0 else given[0][..., i], T + 1)[given[1]]
                found += [np.where(np.arange(n) == i, value, np.nan) for value in (values.max(), values.min())]
    return found


def _middle(problem: OptimalControlProblem) -> tuple[Array, Array]:
    """Return the middle of the first set that bounds a state on both sides, and half its width; nan without any."""
    middle = half = np.full(problem.state_dim, np.nan)
    for box in (problem.state_boxes.at(0), *reversed(problem.ends)):
        bounded = np.isfinite(box.lower) & np.isfinite(box.upper)
        lower, upper = np.where(bounded, box.lower, 0.0), np.where(bounded, box.upper, 0.0)
        middle, half = np.where(bounded, (lower + upper) / 2, middle), np.where(bounded, (upper - lower) / 2, half)
    return middle, half


def _drift(problem: OptimalControlProblem, place: Array) -> Array:
    """Return how far states move from a place (n,) over the horizon if they go on as in the first step, (n,)."""
    try:
        step = problem.dynamics.given[0].stepper(problem.horizon)
        moved = step(0, place, np.zeros(problem.control_dim)) - place
    except LinFreqOCPError:  # no mode holds there, or there are no steps
        return np.zeros(problem.state_dim)
    return problem.horizon * np.nan_to_num(np.abs(moved))


def _about_zero(problem: OptimalControlProblem) -> Mask:
    """Return which states a frequency constraint limits by their distance from zero, (n,)."""
    n, none = problem.state_dim, np.zeros((problem.horizon, problem.control_dim))
    found = problem.state_stop[0].copy()
    rest = np.zeros((problem.horizon + 1, n))
    for term in problem.terms:
        if not term.kind.is_spectrum:
            continue
        for i in range(n):
            steady = rest + (np.arange(n) == i)
            moved = term.map.values(steady, none) - term.map.values(rest, none)
            sizes = term.map.sizes(steady, none)
            found[i] |= bool((np.abs(moved) > ROUNDING * sizes).any())
            if term.everywhere is not None:
                found[i] |= bool(term.everywhere.map.signal(steady, none).any())
    return found


ROUNDING = 1e-12  # of a bin that a constant leaves at zero, relative to its terms
