"""Reductions of any problem: another origin, added states, rate limits, sampled frequencies.

A far origin costs digits: ``translation_of`` moves it to the trajectory. The memory of a constraint becomes a state; a
limit on the change of a control is joint rows on (x_t, u_{t-1}). Semi-infinite constraints have terms at finitely many
points, which ``at_frequencies`` chooses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Bound, Mask, brief, real_array
from lin_freq_ocp.base.errors import LinFreqOCPError, ProblemError
from lin_freq_ocp.base.names import ByName, values_by_name
from lin_freq_ocp.base.phrases import split_unit
from lin_freq_ocp.problem.costs.quadratic import CostSum, QuadraticCost
from lin_freq_ocp.problem.dynamics.base import Dynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.sets.base import ConvexSet, Intersection
from lin_freq_ocp.problem.sets.box import Box, SetOrSets, map_sets
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, component_indices, entries_of, map_constraints
from lin_freq_ocp.problem.terms.semi_infinite import SemiInfiniteConstraint
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.reductions import Change, Reduced
from lin_freq_ocp.transform.simulation import within_reach

FAR_FROM_ZERO = 10.0  # distance of an origin, in distances between the data of a state, that costs more than a digit
ROUNDING = 1e-12  # largest value of a bin, relative to its terms, that a constant does not change


@dataclass(frozen=True, eq=False)
class Translation(Reduced):
    """A problem, and the same problem in y = x - origin, (n,).

    A, B, control sets, multipliers and costs stay; offsets, ends, state sets, references, rows, guards and regions are
    translated. A move of 1 m at a northing of 5 000 000 m is badly posed in double precision, as every solver and every
    relative tolerance sees numbers of 5e6. With the start of the move as origin, its position makes no difference.
    """

    origin: Array

    @property
    def moves(self) -> bool:
        """Whether the origin is not zero."""
        return bool(self.origin.any())

    @property
    def cost(self) -> float:
        """Return the cost of the given problem less that of the translated one: that of linear terms at the origin."""
        if not self.moves:
            return 0.0
        cost, T = self.given.quadratic, self.given.horizon
        return float(np.broadcast_to(cost.q, (T, len(self.origin))).sum(0) @ self.origin + cost.p @ self.origin)

    def start(self, trajectory: Trajectory) -> Trajectory:
        """Return a trajectory of the given problem as one of the translated problem."""
        return Trajectory(trajectory.x - self.origin, trajectory.u) if self.moves else trajectory

    def change(self, change: Change, changed: OptimalControlProblem) -> Change:
        """Return a change of the given problem as one of the translated problem."""
        if not self.moves:
            return change
        references, bounds = change.references, change.bounds
        if references is not None and "x_ref" in references:
            references = {**references, "x_ref": changed.quadratic.translated(self.origin).x_ref}
        if bounds and "state_set" in bounds:
            bounds = {**bounds, "state_set": map_sets(bounds["state_set"], lambda one: one.translated(self.origin))}
        terminal = None if change.terminal_state is None else changed.terminal_state.translated(self.origin)
        return Change(changed.initial_state.translated(self.origin), terminal, references, bounds, change.disturbance)

    def trajectory(self, reduced: Trajectory) -> Trajectory:
        """Return a trajectory of the translated problem as one of the given problem, rounded to its digits."""
        return Trajectory(reduced.x + self.origin, reduced.u) if self.moves else reduced

    def judged_at(self, trajectory: Trajectory) -> tuple[OptimalControlProblem, Trajectory]:
        """Return the translated problem with the rounded trajectory: residuals there are not those of large numbers."""
        return self.problem, self.start(trajectory)


def translation_of(problem: OptimalControlProblem) -> Translation:
    """Return the translation of a problem to its ``far_origin``; without change if that is zero."""
    return translated_by(problem, far_origin(problem))


def translated_by(problem: OptimalControlProblem, origin: Array) -> Translation:
    """Return the translation of a problem to an origin (n,); no change if dynamics or cost cannot be translated.

    Nothing is checked again.
    """
    none = Translation(problem, problem, np.zeros(problem.state_dim))
    if not origin.any():
        return none
    dynamics, cost = problem.dynamics.translated(origin, problem.horizon), problem.cost.translated(origin)
    if dynamics is None or cost is None:
        return none
    moved = replace_fields(
        problem,
        dynamics=dynamics,
        cost=cost.at_dimensions(problem.state_dim, problem.control_dim, problem.horizon),
        state_set=map_sets(problem.state_set, lambda one: one.translated(origin)),
        initial_state=problem.initial_state.translated(origin),
        terminal_state=problem.terminal_state.translated(origin),
        stage_rows=tuple(rows.translated(origin) for rows in problem.stage_rows),
        output_spectrum=[outputs.translated(origin) for outputs in entries_of(problem.output_spectrum)] or None,
        _origin=origin if problem.origin is None else problem.origin + origin,
    )
    _ = moved.ends, moved.terms
    return Translation(problem, moved, origin)


def far_origin(problem: OptimalControlProblem) -> Array:
    """Return the origin for a translation, (n,); zero in components whose data are near zero.

    The position of a state is that of its fixed ends, else its reference, as far as bounds and dynamics let the state
    reach it, else the middle of its bounds. It is far from zero if it exceeds FAR_FROM_ZERO times the differences of
    these values, and FAR_FROM_ZERO times the drift over the horizon without control at the rate of the first step. A
    spectrum that limits the mean of a state keeps its zero.
    """
    ends = [np.where(end.fixed, end.lower, np.nan) for end in problem.ends]
    centre, spread = _centre_and_spread([*ends, *_references(problem)])
    nearest, apart = _centre_and_spread(ends)
    if ((np.abs(nearest) > FAR_FROM_ZERO * apart) & (np.abs(nearest) <= FAR_FROM_ZERO * spread)).any():
        centre, spread = _centre_and_spread([*ends, *_references(problem, partial(within_reach, problem))])
    unknown = np.isnan(centre)
    if unknown.any():  # of the first set that bounds the state on both sides
        middle = half = np.full(problem.state_dim, np.nan)
        for box in (problem.state_boxes.at(0), *reversed(problem.ends)):
            bounded = np.isfinite(box.lower) & np.isfinite(box.upper)
            lower, upper = np.where(bounded, box.lower, 0.0), np.where(bounded, box.upper, 0.0)
            middle, half = np.where(bounded, (lower + upper) / 2, middle), np.where(bounded, (upper - lower) / 2, half)
        centre, spread = np.where(unknown, middle, centre), np.where(unknown, half, spread)
    far = np.abs(centre) > FAR_FROM_ZERO * spread
    if not far.any():
        return np.zeros(problem.state_dim)
    centre, drift = np.nan_to_num(centre), np.zeros(problem.state_dim)
    with suppress(LinFreqOCPError):  # outside all modes, or without a recursion
        step = problem.dynamics.stepper(problem.horizon)
        drift = problem.horizon * np.nan_to_num(np.abs(step(0, centre, np.zeros(problem.control_dim)) - centre))
    far &= np.abs(centre) > FAR_FROM_ZERO * drift
    return np.where(far & ~_limited_about_zero(problem), centre, 0.0)


def _centre_and_spread(positions: Sequence[Array]) -> tuple[Array, Array]:
    """Return the first known position of each state, (n,), and the distance of the outermost ones; nan for none."""
    known = np.array(positions)
    first = np.argmin(np.isnan(known), axis=0)
    return np.take_along_axis(known, first[None], 0)[0], np.fmax.reduce(known) - np.fmin.reduce(known)


def _references(problem: OptimalControlProblem, reached: Callable[[Array], Array] = np.asarray) -> list[Array]:
    """Return references of the states, (n,) each, in order of preference; nan where there is none.

    ``reached`` returns what a trajectory can reach of references, (T+1, n).
    """
    n, T, cost = problem.state_dim, problem.horizon, problem.quadratic
    given = reached(cost.x_ref)
    references = [given] if given.ndim == 1 else [given[0], given.max(0), given.min(0)]
    positions = [*np.where(cost.weighs[0], references, np.nan)]
    for norm in problem.cost.norms:
        for i in range(n):
            reference, weighted = norm.references(i, True, T) or (np.zeros(()), np.zeros(T + 1, dtype=bool))
            if weighted.any():
                own = np.broadcast_to(reference if reference.ndim == 0 else reference[..., i], T + 1)
                values = np.broadcast_to(reached(np.broadcast_to(own[:, None], (T + 1, n))), (T + 1, n))[weighted, i]
                positions += [np.where(np.arange(n) == i, value, np.nan) for value in (values.max(), values.min())]
    return positions


def _limited_about_zero(problem: OptimalControlProblem) -> Mask:
    """Return the states whose mean a frequency constraint limits, (n,)."""
    n, none = problem.state_dim, np.zeros((problem.horizon, problem.control_dim))
    limited = problem.state_stop[0].copy()
    rest = np.zeros((problem.horizon + 1, n))
    for term in problem.terms:
        if not term.kind.is_spectrum:
            continue
        for i in range(n):
            steady = rest + (np.arange(n) == i)
            moved = term.map.values(steady, none) - term.map.values(rest, none)
            sizes = term.map.sizes(steady, none)
            limited[i] |= bool((np.abs(moved) > ROUNDING * sizes).any())
            if term.semi_infinite is not None:
                limited[i] |= bool(term.semi_infinite.map.signal(steady, none).any())
    return limited


@dataclass(frozen=True, eq=False)
class AddedStates:
    """States w of w_{t+1} = A w_t + B u_t, without cost."""

    A: Array  # (k, k)
    B: Array  # (k, m)
    initial: Box  # of w_0, bounds (k,)
    lower: Array  # (k,), of w_t at all times
    names: Sequence[str]
    terminal: Box | None = None  # of w_T


def add_states(problem: OptimalControlProblem, added: AddedStates) -> OptimalControlProblem:
    """Return the problem in the states (x, w), with the same constraints and cost."""
    dynamics = problem.dynamics.augmented(added.A, added.B, added.names, problem.horizon)
    return augment_states(problem, dynamics, added.initial, added.lower, problem.quadratic, terminal=added.terminal)


def augment_states(
    problem: OptimalControlProblem,
    dynamics: Dynamics,
    initial: Box,
    lower: Array,
    quadratic: QuadraticCost,
    weight: float = 0.0,
    terminal: Box | None = None,
) -> OptimalControlProblem:
    """Return the problem in the states (x, w) of other dynamics, with w_0 and w_T in boxes and w_t >= lower, (k,).

    Its cost is a quadratic one of x and u, weight/2 |w_t|^2 for t < T, and the nonsmooth costs of the given problem.
    """
    n, k = problem.state_dim, len(lower)
    free, state_set, boxes = np.full(k, np.inf), problem.state_set, problem.state_boxes
    if isinstance(state_set, Sequence):
        augmented_set: SetOrSets = [_with_box(one, boxes.at(t), Box(lower, free)) for t, one in enumerate(state_set)]
    elif all((bound == bound[0]).all() for bound in (boxes.lower, boxes.upper)):  # for every horizon
        augmented_set = _with_box(state_set, boxes.at(0), Box(lower, free))
    else:
        shape = problem.horizon + 1, k
        augmented_set = _with_box(state_set, boxes, Box(np.broadcast_to(lower, shape), np.broadcast_to(free, shape)))
    augmented = problem.derived(
        dynamics=dynamics,
        cost=CostSum([quadratic.augmented(k, weight), *(one.augmented(n, k) for one in problem.cost.norms)]),
        state_set=augmented_set,
        initial_state=_with_box(problem.initial_state, problem.initial_box, initial),
        terminal_state=_with_box(problem.terminal_state, problem.terminal_box, terminal or Box(-free, free)),
        state_spectrum=[more for one in entries_of(problem.state_spectrum) for more in one.augmented(n, k)] or None,
        stage_rows=[rows.augmented(n, k) for rows in problem.stage_rows],
        output_spectrum=[one.augmented(n, k) for one in entries_of(problem.output_spectrum)] or None,
    )
    return augmented if problem.origin is None else replace_fields(augmented, _origin=np.pad(problem.origin, (0, k)))


def _with_box(given: ConvexSet | None, bounds: Box, added: Box) -> ConvexSet:
    """Return the set of (x, w) with x in the given set, which has these bounds, and w in the added box."""
    box = Box(np.hstack([bounds.lower, added.lower]), np.hstack([bounds.upper, added.upper]))
    n, k = bounds.lower.shape[-1], added.lower.shape[-1]
    members = () if given is None else given.members
    return Intersection([box, *(member.augmented(n, k) for member in members)]) if members else box


@dataclass(frozen=True, eq=False)
class OwnStates(Reduced):
    """The problem with further states w after x, which the way back leaves out."""

    @property
    def own_values(self) -> dict[str, Mask]:
        """Return which values of terms are of x and u, (dim,), by the names of terms that have further values of w."""
        n, found = self.given.state_dim, dict[str, Mask]()
        sizes = {term.name: term.shape[1] for term in self.given.terms}
        for term in self.problem.terms:
            count = term.shape[1]
            if count > sizes.get(term.name, np.inf):
                form = term.map.stage_form(self.problem.state_dim, self.given.control_dim)
                others = np.zeros(count, dtype=bool)  # a component without a weight comes before those of w
                if form is not None:
                    others = ~np.delete(form[0][0], range(n, self.problem.state_dim), axis=1).any(axis=1)
                found[term.name] = np.isin(np.arange(count), np.argsort(others, kind="stable")[: sizes[term.name]])
        return found

    def trajectory(self, reduced: Trajectory) -> Trajectory:
        """Return the trajectory without w."""
        return Trajectory(reduced.x[:, : self.given.state_dim], reduced.u)

    def direction(self, reduced: Trajectory) -> Trajectory:
        """Return the direction without w."""
        return self.trajectory(reduced)

    def multipliers(self, reduced: Multipliers, at: Trajectory | None = None) -> Multipliers:
        """Return the multipliers without those of w; rows on x and w keep theirs."""
        n, stage = self.given.state_dim, dict(reduced.stage)
        for name, own in self.own_values.items():
            if name in stage:
                stage[name] = stage[name][:, own]
        return replace(reduced, eta=reduced.eta[:, :n], mu=reduced.mu[:, :n], rho_x=reduced.rho_x[:, :n], stage=stage)


RATE_LIMIT = "rate limit"  # of the added rows


def rate_limited(
    problem: OptimalControlProblem,
    limit: Bound | ByName = None,
    previous: ArrayLike | ByName | None = None,
    following: ArrayLike | ByName | None = None,
    price: ArrayLike | ByName = 0.0,
) -> OptimalControlProblem:
    """Return the problem with |u_t - u_{t-1}| <= limit, or with a price on changes, in the states (x, u_{t-1}).

    A move that starts and ends at rest without a jump of the control has ``previous=0`` and ``following=0``. With
    ``following=0``, a control of zero can follow the move, so that ``minimum_time`` needs few solves.

    Parameters
    ----------
    problem : OptimalControlProblem
    limit : float or (m,), optional
        Largest change per step, zero or above; None or inf: no limit on that control. A single number holds for all.
    previous : (m,), or a number for all controls, optional
        The control before the first, u_{-1}; without it, the first control is free of limit and price.
    following : (m,), or a number for all controls, optional
        The control after the last, u_T; without it, the last control is free of the limit.
    price : float or (m,)
        Of changes, zero or above: the cost has sum_t price/2 (u_t - u_{t-1})^2 of each control, t < T, in addition.
        Each of these may be a mapping from names of controls; those that it leaves out have no limit, and no price.

    Returns
    -------
    OptimalControlProblem
        With one more state for each control with a limit or a price, named after it, and stage rows "rate limit".

    Raises
    ------
    ProblemError
        If the limit, the price, the previous or the following control does not fit the problem.

    Examples
    --------
    >>> problem = lfo.rate_limited(lfo.library.double_integrator(), 0.5)
    >>> problem.state_dim
    3
    >>> smoother = lfo.rate_limited(lfo.library.double_integrator(), price=100.0, previous=0.0)
    >>> lfo.solve(smoother).status
    'optimal'
    """
    require_problem(problem)
    if problem.uncertainty is not None:
        raise ProblemError("problem", "one of robust, with margins", "one without", "Call rate_limited first.")
    return rate_limit(problem, limit, previous, following, price).problem


def rate_limit(
    problem: OptimalControlProblem,
    limit: Bound | ByName,
    previous: ArrayLike | ByName | None = None,
    following: ArrayLike | ByName | None = None,
    price: ArrayLike | ByName = 0.0,
) -> OwnStates:
    """Return the problem of ``rate_limited``, and the way back to its own states.

    The limits keep their multipliers under their name: those of the rows for u_t - u_{t-1} itself.
    """
    m = problem.control_dim

    def of_controls(field: str, value: Bound | ByName, absent: float | None = None) -> Bound:
        by_name = isinstance(value, Mapping)
        return values_by_name(field, value, problem.control_names, absent, allow_infinite=True) if by_name else value

    limit = of_controls("rate_limit", limit, np.inf)
    given = [np.inf if one is None else one for one in limit] if isinstance(limit, (list, tuple)) else limit
    limits = real_array("rate_limit", np.inf if given is None else given, allow_infinite=True)
    if limits.shape not in ((), (m,)) or (limits < 0).any():
        expected = f"one number, zero or above, or one for each of the {m} controls"
        raise ProblemError("rate_limit", brief(limit), expected)
    prices = real_array("price", of_controls("price", price, 0.0))
    if prices.shape not in ((), (m,)) or (prices < 0).any():
        raise ProblemError("price", brief(price), f"one number, zero or above, or one for each of the {m} controls")
    limits, prices = np.broadcast_to(limits, m), np.broadcast_to(prices, m)
    limited = np.flatnonzero(np.isfinite(limits) | (prices > 0))
    if not len(limited):
        advice = "Leave it out for none, or give a price."
        raise ProblemError("rate_limit", brief(limit), "a limit on at least one control", advice)
    if any(rows.name == RATE_LIMIT for rows in problem.stage_rows):
        raise ProblemError("rate_limit", "a problem with one", f"a problem without stage rows named '{RATE_LIMIT}'")
    k, chosen = len(limited), np.eye(m)[limited]
    before = after = Box(np.full(k, -np.inf), np.full(k, np.inf))
    if previous is not None:
        first = _outer_control("previous", of_controls("previous", previous), m)[limited]
        before = Box(first, first)
    if following is not None:
        last = _outer_control("following", of_controls("following", following), m)[limited]
        after = Box(last - limits[limited], last + limits[limited])
    labels = [split_unit(problem.control_names[j]) for j in limited]
    names = [f"{label} before [{unit}]" if unit else f"{label} before" for label, unit in labels]
    added = AddedStates(np.zeros((k, k)), chosen, before, np.full(k, -np.inf), names, after)
    remembering = add_states(problem, added)
    if prices.any():
        cost = _with_price_of_changes(remembering.quadratic, prices, chosen, problem.horizon)
        remembering = remembering.derived(cost=CostSum([cost, *remembering.cost.norms]))
    of_x = np.zeros((k, problem.state_dim))
    rows = StageRows(
        np.vstack([np.hstack([of_x, -np.eye(k)]), np.hstack([of_x, np.eye(k)])]),
        np.vstack([chosen, -chosen]),
        np.tile(limits[limited], 2),
        name=RATE_LIMIT,
    )
    if not np.isfinite(limits).any():
        return OwnStates(problem, remembering)
    return OwnStates(problem, remembering.derived(stage_rows=[*remembering.stage_rows, rows]))


def _with_price_of_changes(cost: QuadraticCost, prices: Array, chosen: Array, horizon: int) -> QuadraticCost:
    """Return a cost of (x, w) and u, w = ``chosen`` u_{t-1}, with 1/2 sum of prices (u_t - u_{t-1})^2 besides.

    In deviations from u_ref, (u - u_ref) - (w - u_ref) is the change; so u_ref is also the reference of w.
    """
    k, n = len(chosen), len(cost.p) - len(chosen)
    P = np.diag(prices)
    of_w, mixed = np.zeros((n + k, n + k)), np.vstack([np.zeros((n, len(prices))), chosen @ P])
    of_w[n:, n:] = chosen @ P @ chosen.T
    w_ref = cost.u_ref @ chosen.T
    if w_ref.ndim == 2:
        w_ref = np.vstack([w_ref, w_ref[-1:]])
    times = (horizon + 1,) if w_ref.ndim == 2 or cost.x_ref.ndim == 2 else ()
    x_ref = np.array(np.broadcast_to(cost.x_ref, (*times, n + k)))
    x_ref[..., n:] = w_ref
    return replace(cost, Q=cost.Q + of_w, R=cost.R + P, S=cost.S - mixed, x_ref=x_ref)


def _outer_control(field: str, value: Bound, m: int) -> Array:
    """Return the control before the first or after the last sample, (m,)."""
    control = real_array(field, value)
    if control.shape not in ((), (m,)):
        raise ProblemError(field, f"shape {control.shape}", f"one number, or one for each of the {m} controls")
    return np.broadcast_to(control, m)


Kind = TypeVar("Kind", bound=SemiInfiniteConstraint)


def semi_infinite_terms(problem: OptimalControlProblem, kind: type[Kind]) -> list[tuple[Term, Kind]]:
    """Return the terms with semi-infinite constraints of a kind, and these constraints."""
    return [(term, constraint) for term in problem.terms if isinstance(constraint := term.semi_infinite, kind)]


def at_frequencies(
    problem: OptimalControlProblem, frequencies: Mapping[str, Array], points_only: bool = False, share: float = 1.0
) -> OptimalControlProblem:
    """Return the problem with semi-infinite terms at these points, (groups,) in rad/sample or (groups, 2), by name.

    Terms without an entry keep their points. ``points_only``: nothing is required at other points. ``share``: of the
    limits, which stand there.
    """
    semi_infinite = [term for term in problem.terms if term.semi_infinite is not None]
    if not semi_infinite or not (frequencies or points_only):
        return problem
    pending = iter([frequencies.get(term.name, term.map.locations) for term in semi_infinite])

    def with_points(names: Sequence[str], one: FrequencyConstraint) -> FrequencyConstraint:
        """Return a constraint; one at every frequency takes the next points, an array for each component."""
        if not one.every_frequency:
            return one
        count = len(component_indices("spectrum", one.component, names))
        one = one.at_frequencies([next(pending) for _ in range(count)], points_only)
        return one if share == 1.0 or one.levels is None else one.at_levels(share * one.levels)

    of_outputs = [(one, partial(with_points, one.output_names)) for one in entries_of(problem.output_spectrum)]
    return problem.derived(
        state_spectrum=map_constraints(problem.state_spectrum, partial(with_points, problem.state_names)),
        control_spectrum=map_constraints(problem.control_spectrum, partial(with_points, problem.control_names)),
        output_spectrum=[changed for one in of_outputs for changed in map_constraints(*one) or ()],
    )


@dataclass(frozen=True, eq=False)
class SampledMasks(Reduced):
    """The relaxed problem with semi-infinite constraints at points only, by the names of their terms.

    At all other points their multipliers are zero.
    """

    points: Mapping[str, Array]

    def multipliers(self, reduced: Multipliers, at: Trajectory | None = None) -> Multipliers:
        """Return the multipliers that are not zero, with their points."""
        stage, frequencies = dict(reduced.stage), dict[str, Array]()
        for name, points in self.points.items():
            weights = reduced.stage.get(name, np.zeros((len(points), 2)))
            used = np.flatnonzero(weights.any(axis=1))
            stage[name], frequencies[name] = weights[used], points[used]
        return replace(reduced, stage=stage, frequencies=frequencies)


def sampled_masks(problem: OptimalControlProblem, points: Mapping[str, Array], share: float = 1.0) -> SampledMasks:
    """Return the problem with its semi-infinite constraints at points only, at a share of their limits."""
    return SampledMasks(problem, at_frequencies(problem, points, True, share), points)
