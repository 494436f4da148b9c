"""Sizes of states and controls from the data of a problem, and the scale of a search. The judge has its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from weakref import WeakKeyDictionary

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, seal, split_signals, stack_signals
from lin_freq_ocp.formulas.jets import jets_of
from lin_freq_ocp.formulas.nodes import kinks
from lin_freq_ocp.formulas.operations import MAXIMUM, MINIMUM, VARIABLE
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.penalty import Penalty
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.reformulations import translation_of
from lin_freq_ocp.transform.simulation import reach_of_bounds, within_reach

SOLVER_ROUNDING = 1e-12  # deviations relative to sizes that the search does not distinguish from zero
FINEST_GAP = 1e-6  # smallest relative gap of a search: what SOLVER_ROUNDING costs is this part of the scale
WEIGHTY = 0.1  # a row limits a component whose coefficient is at least this part of the row's largest
NO_GAIN = 1e-14  # entries of a row of [A, B] below this part of its largest are rounding
NOTICED = 0.1  # part of what others cause in a component, or need of it, below which its end or reference says nothing
FAR_BEYOND = 1e4  # a bound that exceeds the other sizes of its component by this factor counts as none


# of the problems in use: methods and judge ask for the sizes of one problem again and again
KNOWN_SIZES: WeakKeyDictionary[OptimalControlProblem, tuple[Array, Array]] = WeakKeyDictionary()


def search_scale(problem: OptimalControlProblem, trajectory: Trajectory) -> float:
    """Return the sum of the absolute terms of the cost, at least the cost of rounding errors over FINEST_GAP.

    Each counts at most by what bounds and dynamics let it vary.
    """
    cost, (x, u), reach = problem.quadratic, (trajectory.x, trajectory.u), reach_of_bounds(problem)
    z, slopes = stack_signals(x, u), cost.linear_slopes(problem.horizon)
    deviations = cost.deviations_of(z)
    bent = cost.bend(deviations)
    varied = np.abs(bent) * reach + 0.5 * reach * cost.magnitudes.bend(reach)
    total = float(np.minimum(np.abs(0.5 * (deviations * bent).sum(-1)), varied.sum(-1)).sum())
    total += 0.0 if slopes is None else float((np.abs(slopes) * np.minimum(np.abs(z), reach)).sum())
    apart = split_signals(reach, problem.state_dim)
    for term in problem.terms:
        total += float(term.sizes_of_prices(term.map.values(x, u), term.cost(x, u), apart).sum())
    total += float(np.abs(problem.cost.formula_values(x, u)).sum())
    sizes = zip(stated_sizes(problem), (x, u), strict=True)
    rounding = (np.broadcast_to(SOLVER_ROUNDING * size, signal.shape) for size, signal in sizes)
    return max(total, cost.magnitudes.value(*rounding) / FINEST_GAP)


def stated_sizes(problem: OptimalControlProblem) -> tuple[Array, Array]:
    """Return sizes of states, (n,), and controls, (m,), from the data alone, before anything is solved.

    The first of these that a component has is its size: the largest of its ends, references, as far as bounds and
    dynamics let it reach them, and levels; its bounds; of
    a control, the limits of other sets and rows; what the other components cause in it within the horizon; what it must
    be to cause the sizes of the others; the limits of other sets and rows; its ends; 1. A bound far above what ends,
    references and dynamics imply counts as none, and so does an end or reference far below what the others make of the
    component, or of a component whose cost by formulas is not convex at the origin.
    States are measured from the origin of ``translation_of``.
    """
    if problem not in KNOWN_SIZES:
        x, u, _ = natural_sizes(translation_of(problem).problem)
        KNOWN_SIZES[problem] = seal(x), seal(u)
    return KNOWN_SIZES[problem]


def natural_sizes(problem: OptimalControlProblem) -> tuple[Array, Array, Mask]:
    """Return ``stated_sizes`` without a change of the origin, and which states have a size of their own, (n,)."""
    n, influence = problem.state_dim, Influence.of(problem)
    shift, unknown = _slope_of_cost(problem)
    ends = np.maximum(_sizes_of_ends(problem), shift)
    excess = _sizes_of_rows(problem, lambda penalty, at: penalty.excess(at), curved=True)
    stated = influence.without_rounding(np.where(unknown, 0.0, ends), excess, problem.level_sizes > 0)
    sizes = np.where(stated > 0, stated, _sizes_of_bounds(problem, influence, stated))
    known = sizes[:n] > 0
    if not sizes.all():
        limited = _sizes_of_rows(problem, lambda penalty, at: penalty.sizes() + np.abs(at), curved=False)
        first = np.append(np.zeros(n), limited[n:])  # those of controls imply states
        for others in (first, limited, excess, ends):  # an end says something where nothing else does
            sizes = _complete_sizes(np.where(sizes > 0, sizes, others), influence.implied)
    sizes = np.maximum(np.where(sizes > 0, sizes, 1.0), ends)
    return sizes[:n], sizes[n:], known


def _sizes_of_ends(problem: OptimalControlProblem) -> Array:
    """Return the largest of the ends, of values that controls are fixed at, of levels and references, (n+m,)."""
    cost = problem.quadratic
    of_x, of_u = cost.weighs
    reached = within_reach(problem, cost.x_ref) if cost.x_ref.any() else cost.x_ref
    states = np.abs(np.where(of_x, reached, 0.0)).reshape(-1, len(of_x)).max(0)
    controls = np.abs(np.where(of_u, cost.u_ref, 0.0)).reshape(-1, len(of_u)).max(0)
    ends = np.concatenate([_finite(problem.initial_box), _finite(problem.terminal_box)]).max(0)
    tube = problem.control_tube
    fixed = np.where(tube.fixed, np.abs(tube.lower), 0.0).max(0)
    return np.concatenate([np.maximum(ends, states), np.maximum.reduce([controls, fixed, problem.level_sizes])])


def _slope_of_cost(problem: OptimalControlProblem) -> tuple[Array, Mask]:
    """Return how far slopes take a component within its bounds, and which no curvature stops, (n+m,) each.

    Slopes and curvatures of the quadratic cost are taken at the references, those of formulas at the origin.
    """
    cost, T, n, size = problem.quadratic, problem.horizon, problem.state_dim, problem.state_dim + problem.control_dim
    steep = np.hstack([np.abs(cost.q).reshape(-1, n).max(0), np.abs(cost.r).reshape(-1, size - n).max(0)])
    bent, used = np.diagonal(cost.stage_hessians, axis1=1, axis2=2).max(0), np.zeros(size, dtype=bool)
    for formula, times in zip(problem.cost.formulas, (np.arange(T), np.array([T])), strict=True):
        if formula is not None:
            used[[int(node.data[0]) for node in kinks([formula], VARIABLE)]] = True
            if [*kinks([formula], MAXIMUM, MINIMUM)]:
                bent = np.where(used, -np.inf, bent)
                continue
            at = jets_of([formula], np.zeros((len(times), size)), times=times)
            steep = steep + np.abs(at.slopes[:, 0]).max(0)
            bent = bent + np.diagonal(at.curvatures[:, 0], axis1=1, axis2=2).min(0)
    stopped = (bent > 0) & np.isfinite(steep)
    shift = np.divide(steep, bent, out=np.zeros(size), where=stopped)
    states, controls = problem.state_boxes, problem.control_tube
    bounds = np.hstack(
        [np.maximum(-states.lower, states.upper).max(0), np.maximum(-controls.lower, controls.upper).max(0)]
    )
    return np.minimum(shift, bounds), used & ~stopped


def _sizes_of_bounds(problem: OptimalControlProblem, influence: Influence, stated: Array) -> Array:
    """Return the sizes of components, (n+m,), by their bounds; 0 without a bound."""
    tubes = problem.state_boxes, problem.control_tube
    bounds = np.concatenate([_median_size(np.stack(tube.bounds, 1)).max(axis=0) for tube in tubes])
    reach = reach_of_bounds(problem).max(axis=0)
    bounds = np.where((reach > 0) & (bounds > FAR_BEYOND * reach), reach, bounds)
    implied = partial(influence.implied, chosen=np.max)
    implied = _complete_sizes(stated, implied) if stated.any() else implied(bounds)
    # nor does a bound on one side say how far the other side reaches
    one_sided = np.hstack([(np.isinf(tube.lower) != np.isinf(tube.upper))[-problem.horizon :] for tube in tubes]).any(0)
    beyond = (bounds > FAR_BEYOND * implied) | (one_sided & (FAR_BEYOND * bounds < implied))
    return np.where((implied > 0) & beyond, implied, bounds)


def _median_size(bounds: Array) -> Array:
    """Return the median of the finite |bound| > 0 over axis 0, times; 0 without any."""
    sizes = np.where(np.isfinite(bounds), np.abs(bounds), 0.0)
    sizes.sort(axis=0)
    count = np.count_nonzero(sizes, axis=0)
    middle = len(sizes) - 1 - np.stack([count, np.maximum(count - 1, 0)]) // 2
    return np.take_along_axis(sizes, middle, axis=0).mean(axis=0)


def _sizes_of_rows(problem: OptimalControlProblem, reach: Callable[[Penalty, Array], Array], curved: bool) -> Array:
    """Return the least size at which a component alone has a row's reach, (n+m,), 0 without one.

    ``reach`` (times, rows) or (times, 1) is that of a penalty with the values of its rows at the origin. Rows by
    formulas count if ``curved``, with their slopes there.
    """
    n, m = problem.state_dim, problem.control_dim
    least = np.full(n + m, np.inf)
    for term in problem.terms:
        form = term.map.form_at_origin(n, m) if curved else term.map.stage_form(n, m)
        if form is None:
            continue
        coefficients, limit = np.abs(form[0]).max(0), reach(term.penalty, form[1]).max(0)[:, None]
        for weights, part in ((coefficients[:, :n], least[:n]), (coefficients[:, n:], least[n:])):
            counts = (weights >= WEIGHTY * weights.max(1, keepdims=True)) & (weights > 0) & (limit > 0)
            allowed = np.divide(limit, weights, out=np.full(weights.shape, np.inf), where=counts)
            np.minimum(part, allowed.min(0), out=part)
    return np.where(np.isfinite(least), least, 0.0)


@dataclass(frozen=True)
class Influence:
    """How far the components of a problem move its states in a step: the others (n, n+m), and the offset (n,).

    Sizes are (n+m,), 0 for unknown ones. ``chosen`` is np.min or np.max, of the values by which a component causes
    several states.
    """

    others: Array
    offset: Array
    horizon: int

    @classmethod
    def of(cls, problem: OptimalControlProblem) -> Influence:
        """Return the influence by the dynamics of a problem."""
        A, B, d = problem.form.gains()
        gain = np.hstack([A * (1 - np.eye(len(A))), B])
        return cls(np.where(gain > NO_GAIN * gain.max(axis=1, keepdims=True), gain, 0.0), d, problem.horizon)

    def needed(self, states: Array, chosen: Callable[..., Array] = np.min) -> Array:
        """Return the size with which each component alone causes a known state, 0 if it causes none."""
        known, absent = states > 0, np.inf if chosen is np.min else 0.0
        gain = self.horizon * self.others[known]
        alone = np.divide(states[known, None], gain, out=np.full(gain.shape, absent), where=gain > 0)
        needed = chosen(alone, axis=0, initial=absent)
        return np.where(np.isfinite(needed), needed, 0.0)

    def implied(self, known: Array, chosen: Callable[..., Array] = np.min) -> Array:
        """Return sizes of unknown components from |x_i| <= T (|A| |x| + |B| |u| + |d|)_i.

        A state gets the right side from the known components; if that is zero, or it is a control, the value with which
        it alone causes a known x_i.
        """
        n, drift = len(self.offset), self.horizon * self.offset
        caused = self.horizon * self.others @ np.append(np.maximum(known[:n], drift), known[n:]) + drift
        needed = self.needed(known[:n], chosen)
        return np.append(np.where(caused > 0, caused, needed[:n]), needed[n:])

    def without_rounding(self, stated: Array, excess: Array, levels: Mask) -> Array:
        """Return sizes of ends and references, with 0 for those that say nothing of their components.

        A speed of 1e-9 says nothing of the speed that takes a mass a metre away. The size of a state is at least
        NOTICED times what the others change in a single step. Where all of them together change a state by too little
        within the horizon, the one that changes it most is too small. The size of a control without ``levels``, (m,),
        is at least NOTICED times the least with which it causes a state. Any component may have to move by its
        ``excess``, (n+m,), to satisfy rows that the origin violates.
        """
        n, T = len(self.offset), self.horizon
        for _ in stated:  # without one of them, others may say nothing either
            x, u = np.maximum(stated, excess)[:n], stated[n:]
            moved = np.maximum(x, self.offset)
            changes = self.others * np.append(moved, np.where(u > 0, u, self.needed(moved)[n:]))
            change, largest = changes.sum(axis=1), changes.argmax(axis=1)
            needed = self.needed(_complete_sizes(moved, lambda states: self.needed(states)[:n]))[n:]
            others = np.append(change + self.offset, np.where(levels, 0.0, needed))
            lacking = np.flatnonzero((T * change < NOTICED * x) & (change > 0))
            causes = largest[lacking]
            np.maximum.at(others, causes, x[lacking] / (T * self.others[lacking, causes]))
            said = np.where(stated >= NOTICED * np.maximum(others, excess), stated, 0.0)
            if (said == stated).all():
                break
            stated = said
        return stated


def _complete_sizes(sizes: Array, implied: Callable[[Array], Array]) -> Array:
    """Return the sizes, unknown ones (0) as ``implied`` by known ones, over and over."""
    for _ in sizes:  # at least another component is known after each pass
        if sizes.all():
            break
        sizes = np.where(sizes > 0, sizes, implied(sizes))
    return sizes


def _finite(box: Box) -> Array:
    """Return |lower| and |upper| stacked, with 0 where there is no bound."""
    both = np.abs(np.stack([box.lower, box.upper]))
    return np.where(np.isfinite(both), both, 0.0)
