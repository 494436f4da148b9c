"""The conditions of a problem with piecewise-smooth dynamics: those of its linearisation along the trajectory.

To first order at a trajectory the problem is one with affine modes (``OptimalControlProblem.affine_at``), and the
conditions of the maximum principle, all of first order, are the same. Where the arguments q of a norm are zero, its
derivative may be any xi' Dq with |xi| <= 1: one selection xi for states and controls alike, the nearest to the one
that the adjoint equation and stationarity in u require. With c the derivative of <eta_t, f_t> by the norm, -<eta_t,
f_t> is regular there iff c <= 0; with c > 0 the printed form has no solution, and a step away from the kink raises H.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.certificate.bound import NUMERICAL, RIGOROUS, Bound, unit_rounding
from lin_freq_ocp.certificate.hamiltonian import Extremal, extremal_at, require_fitting
from lin_freq_ocp.certificate.hybrid.clarke import (
    NormKink,
    SwitchingFacts,
    judge_modes,
    modes_along,
    required_slopes,
    stationarity_scale,
)
from lin_freq_ocp.certificate.hybrid.qualification import dependent_gradients
from lin_freq_ocp.certificate.hybrid.second_order import second_order_test
from lin_freq_ocp.certificate.response_bound import best_bound, farkas_bound
from lin_freq_ocp.certificate.sizes import Scales, cost_scale, floors, scales_of, trajectory_sizes
from lin_freq_ocp.certificate.tolerances import ARITHMETIC_ROUNDING, CONDITION_TOLERANCE, GAP_TOLERANCE
from lin_freq_ocp.certificate.verdict import Judgement, SecondOrder
from lin_freq_ocp.formulas.convexity import convex_curvature, is_convex
from lin_freq_ocp.formulas.jets import interval_jets, jets_of
from lin_freq_ocp.formulas.nodes import Formula, text_of
from lin_freq_ocp.problem.costs.quadratic import CostSum
from lin_freq_ocp.problem.hybrid.affine_mode import ModeArrays
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.sets.path_constraint import PathConstraint
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.hybrid.cost_state import CostState, cost_as_state
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine, piecewise_smooth
from lin_freq_ocp.transform.reductions import Reduced
from lin_freq_ocp.transform.reformulations import at_frequencies
from lin_freq_ocp.transform.simulation import reach_of_bounds
from lin_freq_ocp.transform.sizes import stated_sizes

OF_STATES = ("C-iii", "C-iv", "C-vi", "S-x", "N-x")  # the conditions whose components are states


def _judge_linearised(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers, terminal: Array, scales: Scales
) -> Judgement:
    """Judge a trajectory of smooth pieces; ``terminal`` is the ``final`` of ``second_order_test``."""
    problem.require(trajectory)
    selections, norms = _judge_norms(problem, trajectory, multipliers, scales)
    judgement = judge_modes(problem.affine_at(trajectory, selections), trajectory, multipliers, scales)
    facts, rising = judgement.borders, any(kink.rate > 0 for kink in norms)
    if not isinstance(facts, SwitchingFacts):
        return judgement
    facts = replace(
        facts,
        norms=norms,
        flip_stationary=facts.flip_stationary and not rising,
        printed=facts.printed and not rising,
        regular=facts.regular and not rising,
        unqualified=dependent_gradients(problem, trajectory),
    )
    satisfied, test = all(condition.passed for condition in judgement.conditions), None
    if satisfied and facts.applicable and multipliers.eta_C == 1 and judgement.slopes is not None:
        test = SecondOrder(None, "modes meet or norms are zero")
        if not facts.times and not norms:
            sizes = np.concatenate(scales.sizes), judgement.slopes
            test = second_order_test(problem, trajectory, multipliers, sizes, terminal)
    return replace(judgement, borders=facts, second_order=test)


def judge_smooth(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Judgement:
    """Judge a trajectory of a problem with formulas; a cost by formulas is a state, which has its gradient."""
    problem.require(trajectory)
    problem = at_frequencies(problem, multipliers.frequencies)
    require_fitting(problem, multipliers)
    reduced, bound = cost_as_state(problem, trajectory), convex_bound(problem, trajectory, multipliers)
    hessian = _end_hessian(problem, trajectory)
    if reduced is None:
        scales = scales_of(problem, trajectory)
        return replace(_judge_linearised(problem, trajectory, multipliers, hessian, scales), bound=bound)
    at, scales = reduced.start(trajectory), scales_with_cost(reduced, trajectory)
    found = _judge_linearised(reduced.problem, at, reduced.with_adjoint(multipliers), np.pad(hessian, (0, 1)), scales)
    test, last = found.second_order, problem.state_dim
    own = tuple(  # in the given problem, the cost so far has no name
        replace(one, component=None) if one.label in OF_STATES and one.component == last else one
        for one in found.conditions
    )
    if test is not None and test.direction is not None:
        test = replace(test, direction=reduced.trajectory(test.direction))
    return replace(found, conditions=own, second_order=test, bound=bound, cost_scale=scales.cost)


def _end_hessian(problem: OptimalControlProblem, trajectory: Trajectory) -> Array:
    """Return the Hessian of the terminal cost by a formula, (n, n)."""
    n, terminal = problem.state_dim, problem.cost.formulas[1]
    last = np.append(trajectory.x[-1], np.zeros(problem.control_dim))[None]
    return np.zeros((n, n)) if terminal is None else jets_of([terminal], last).curvatures[0, 0, :n, :n]


def scales_with_cost(reduced: CostState, trajectory: Trajectory) -> Scales:
    """Return the scales of a problem with its cost by formulas as a state, which has no size of its own.

    Its size is what a stage cost changes within the sizes of states and controls, to second order. A cost counts in S
    up to that within their given values: constants in it do not.
    """
    problem, n, dynamics = reduced.given, reduced.given.state_dim, piecewise_smooth(reduced.problem)
    (x, u), y = trajectory_sizes(problem, trajectory), reduced.start(trajectory)
    jets_along, modes = dynamics.jets_at(np.hstack([y.x[:-1], y.u])), dynamics.sequence_of(y.x, y.u)
    _, steep, bent = (np.abs(part[:, n]) for part in jets_along.maps_of(modes, np.arange(len(modes))))
    steep[:, n], bent_end = 0.0, np.abs(_end_hessian(problem, trajectory))
    size, end = np.concatenate([x, [0.0], u]), np.abs(reduced.problem.quadratic.p[:n] - problem.quadratic.p)

    def slopes(of: Array) -> Array:
        return np.vstack([steep + bent @ of, np.pad(bent_end @ of[:n], (0, 1 + len(u)))])

    given = size + np.pad(np.zeros(n) if problem.origin is None else np.abs(problem.origin), (0, 1 + len(u)))
    within = np.append((steep + 0.5 * bent @ given) @ given, (end + 0.5 * bent_end @ given[:n]) @ given[:n])
    values = np.minimum(np.abs(problem.cost.formula_values(trajectory.x, trajectory.u)), within)
    stage = max(float(((steep + 0.5 * bent @ size) @ size).max()), float((end + 0.5 * bent_end @ x) @ x)) or 1.0
    stripped = replace_fields(problem, cost=problem.cost.without_formulas.at_dimensions(n, len(u), len(modes)))
    cost = cost_scale(stripped, trajectory) + float(values.sum())
    return Scales((np.append(x, stage), u), cost, np.insert(reach_of_bounds(problem), n, np.inf, axis=1), slopes)


def judged_modes(
    problem: OptimalControlProblem, trajectory: Trajectory
) -> tuple[Reduced, OptimalControlProblem, Trajectory, ModeArrays]:
    """Return a trajectory in the states in which it is judged, with its modes in the sizes of the judge.

    First come the way back to the given problem, and the problem in these states, linearised along the trajectory.
    """
    reduced = cost_as_state(problem, trajectory)
    if reduced is None:
        affine = problem.affine_at(trajectory)
        return Reduced(problem, problem), affine, trajectory, modes_along(affine, trajectory)
    at, sizes = reduced.start(trajectory), scales_with_cost(reduced, trajectory).sizes
    affine = reduced.problem.affine_at(at)
    return reduced, affine, at, modes_along(affine, at, sizes)


def convex_bound(problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers) -> Bound | None:
    """Return the global bound of a convex problem with formulas; None if it is not proven to be convex.

    At every time a cost is at least its tangent at the trajectory, and a parabola of the least curvature of its Hessian
    over the sets and the trajectory, which may be outside of them. A path constraint is at least its tangent. The
    problem with these in their place has a quadratic cost and rows, and the bound of one: a lower bound for the given
    problem, which is close if its multipliers fit. Rounding errors of values and slopes are those of enclosures.
    """
    stated, (n, m), T = problem.dynamics, (problem.state_dim, problem.control_dim), problem.horizon
    if stated.mode_names or multipliers.eta_C != 1:
        return None
    cost, (points, lower, upper) = problem.quadratic, _signals_with_bounds(problem, trajectory)
    slopes, curved = np.zeros_like(points), np.zeros_like(points)  # least curvatures
    for formula, times in zip(problem.cost.formulas, (slice(T), slice(T, T + 1)), strict=True):
        if formula is None:
            continue
        curvature = convex_curvature(formula, lower[times], upper[times])
        if curvature is None:
            return None
        slopes[times], curved[times] = jets_of([formula], points[times]).slopes[:, 0], curvature
    declared, proven, of_rows = list[str](), list[PathConstraint](), 0.0
    for one in problem.path_constraints:
        tangents = one.linearised(trajectory.x, trajectory.u)
        if not is_proven_convex(problem, one, trajectory):
            if not one.convex or one.bends_down(trajectory.x, trajectory.u):
                return None
            declared.append(f"{one.name!r} is convex, as declared")
        else:
            proven.append(one)
        terms = tangents.sizes_along(trajectory.x, trajectory.u)
        of_rows += float((np.maximum(multipliers.stage.get(one.name, 0.0 * terms), 0.0) * terms).sum())
    x, u = cost.deviations(trajectory.x, trajectory.u)
    slopes -= curved * np.hstack([x, np.pad(u, ((0, 1), (0, 0)))])  # the parabola has no slope at the trajectory
    minorant = replace(
        cost,
        Q=cost.Q + curved[:T, :n, None] * np.eye(n),
        R=cost.R + curved[:T, n:, None] * np.eye(m),
        q=cost.q + slopes[:T, :n],
        r=cost.r + slopes[:T, n:],
        P=cost.P + np.diag(curved[T, :n]),
        p=cost.p + slopes[T, :n],
    )
    costs, rows = CostSum([minorant, *problem.cost.without_formulas.norms]), problem.rows_along(trajectory)
    below, plain = problem.derived(dynamics=stated, cost=costs, stage_rows=rows), replace(multipliers, weights=None)
    extremal, lost = with_errors_of_tangents(extremal_at(below, trajectory, plain), problem.cost.formulas, proven)
    scale = cost_scale(problem, trajectory)
    bound = best_bound(extremal, GAP_TOLERANCE * scale)
    if bound is None:
        return None
    constant = problem.value(trajectory.x, trajectory.u) - extremal.cost
    rounding = lost + ARITHMETIC_ROUNDING * (scale + cost_scale(below, trajectory) + of_rows)
    kind, sets = NUMERICAL if declared else bound.kind, "; ".join([*filter(None, [bound.sets]), *declared])
    return replace(bound, value=bound.value + constant - rounding, kind=kind, sets=sets)


def tangents_exclude(
    problem: OptimalControlProblem, tangents: OptimalControlProblem, at: Trajectory, ray: Multipliers
) -> bool:
    """Whether a ray proves that path constraints leave no trajectory, by a problem with their tangents at one."""
    first = extremal_at(tangents, at, replace(ray, eta_C=0.0, weights=None))
    extremal, lost = with_errors_of_tangents(first, (), problem.path_constraints)
    bound = farkas_bound(extremal, stated_sizes(tangents))
    return bound.kind == RIGOROUS and bound.value > lost


def with_errors_of_tangents(
    extremal: Extremal, costs: Sequence[Formula | None], constraints: Sequence[PathConstraint]
) -> tuple[Extremal, float]:
    """Return an extremal of tangents with the rounding errors of their slopes, and what those of values may cost.

    ``costs`` are the formulas of the stage cost and of the terminal cost, if any.
    """
    trajectory, given = extremal.trajectory, extremal.multipliers.stage
    T, n, lost = len(trajectory.u), trajectory.x.shape[1], 0.0
    points = np.hstack([trajectory.x, np.pad(trajectory.u, ((0, 1), (0, 0)))]).astype(np.float64)
    steep, none, each = np.zeros_like(points), np.zeros((1, 1)), np.ones((1, 1))
    terms = [(np.arange(T * i, T + i), one) for i, one in enumerate(costs) if one is not None]
    weighted: list[tuple[Sequence[Formula], Indices, Array]] = [([one], times, each) for times, one in terms]
    weighted += [(one.formulas, one.map.times, np.maximum(given.get(one.name, none), 0.0)) for one in constraints]
    for formulas, times, weights in weighted:
        values, slopes = _rounding_errors(formulas, points[times], times)
        lost += float(np.where(weights > 0, weights * values, 0.0).sum())
        steep[times] += np.where(weights[..., None] > 0, weights[..., None] * slopes, 0.0).sum(axis=1)
    steep /= unit_rounding(extremal.problem)
    steep[-1, n:] = 0.0  # there is no u_T
    return replace(extremal, in_z_terms=extremal.in_z_terms + steep), lost


def _rounding_errors(formulas: Sequence[Formula], y: Array, times: Indices) -> tuple[Array, Array]:
    """Return by how much values at points may be too large, (points, formulas), and slopes wrong, (..., n + m).

    They are infinite where a function has no enclosures.
    """
    at = jets_of(formulas, y, times=times)
    try:
        found = interval_jets(formulas, y, y, curved=False, time=times)
    except UnsupportedError:
        return np.full(at.values.shape, np.inf), np.full(at.slopes.shape, np.inf)
    low, high = found.slopes
    return at.values - found.values[0], np.maximum(at.slopes - low, high - at.slopes)


def is_proven_convex(problem: OptimalControlProblem, constraint: PathConstraint, trajectory: Trajectory) -> bool:
    """Whether a path constraint is proven to be above its tangents at a trajectory: convex on the sets and there."""
    _, *bounds = _signals_with_bounds(problem, trajectory)
    lower, upper = (bound[: len(constraint.limits())] for bound in bounds)
    return all(is_convex(formula, lower, upper) for formula in constraint.formulas)


def _signals_with_bounds(problem: OptimalControlProblem, trajectory: Trajectory) -> tuple[Array, Array, Array]:
    """Return (x_t, u_t) and bounds of the sets and of them, (T + 1, n + m) each; for u_T, zeros."""
    states, controls = problem.state_tube, problem.control_tube
    pairs = (trajectory.x, trajectory.u), (states.lower, controls.lower), (states.upper, controls.upper)
    points, lower, upper = (np.hstack([x, np.pad(u, ((0, 1), (0, 0)))]).astype(np.float64) for x, u in pairs)
    return points, np.minimum(lower, points), np.maximum(upper, points)


def _judge_norms(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers, scales: Scales
) -> tuple[dict[Formula, Array], tuple[NormKink, ...]]:
    """Return the selection of every norm at the times at which its arguments are zero, not a number elsewhere."""
    selections: dict[Formula, Array] = {}
    kinks: list[NormKink] = []
    dynamics = piecewise_smooth(problem)
    for norm, active in dynamics.active_kinks(trajectory.x, trajectory.u, np.concatenate(scales.sizes)).items():
        selection = selections[norm] = np.full((problem.horizon, len(norm.arguments)), np.nan)
        if not active.any():
            continue
        selection[active] = 0.0
        linear = problem.affine_at(trajectory, selections)
        modes = piecewise_affine(linear)
        sequence = modes.sequence_of(trajectory.x, trajectory.u)
        alone = linear.with_dynamics(modes.along(sequence))
        extremal = extremal_at(alone, trajectory, multipliers)
        least = floors(extremal, scales)
        scale, required = stationarity_scale(extremal, least), required_slopes(extremal)
        base, columns = _norm_slopes(problem, trajectory, multipliers, selections, norm)
        for t in np.flatnonzero(active):
            own = np.asarray(columns[:, t].any(axis=(0, 2)))  # each mode may have a copy of the norm, which is one kink
            mode = int(sequence[t]) if own[sequence[t]] else int(np.argmax(own))
            missing = (required[t] - base[t, mode]) / scale[t]
            selection[t] = nearest_in_ball((columns[:, t, mode] / scale[t]).T, missing)
            if own.any() and not own[sequence[t]]:
                continue
            signals = np.append(trajectory.x[t], trajectory.u[t])
            pull = dynamics.pull_of_norm(norm, signals, int(t), mode, multipliers.eta[t])
            rate = pull if pull > CONDITION_TOLERANCE * float(scale[t].max()) else min(pull, 0.0)
            kinks.append(NormKink(int(t), _norm_text(problem, norm), tuple(float(part) for part in selection[t]), rate))
    return selections, tuple(kinks)


def _norm_text(problem: OptimalControlProblem, norm: Formula) -> str:
    return text_of(norm, [name.split(" [")[0] for name in (*problem.state_names, *problem.control_names)])


def _mode_slopes(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    multipliers: Multipliers,
    selections: Mapping[Formula, Array],
) -> Array:
    """Return D <eta_t, f_i> of every mode, (T, modes, n + m)."""
    maps = piecewise_affine(problem.affine_at(trajectory, selections)).arrays(problem.horizon).maps
    return np.einsum("tkij,ti->tkj", maps, multipliers.eta)


def _norm_slopes(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    multipliers: Multipliers,
    selections: Mapping[Formula, Array],
    norm: Formula,
) -> tuple[Array, Array]:
    """Return D <eta_t, f_i> for xi = 0 of a norm, and its change per component of xi, (components, T, modes, .)."""
    zero = np.where(np.isfinite(selections[norm]), 0.0, np.nan)
    base, *changed = (
        _mode_slopes(problem, trajectory, multipliers, {**selections, norm: zero + unit})
        for unit in np.vstack([np.zeros(zero.shape[1]), np.eye(zero.shape[1])])
    )
    return base, np.stack(changed) - base


def nearest_in_ball(columns: Array, wanted: Array) -> Array:
    """Return the shortest xi with |xi| <= 1 for which columns @ xi is nearest to ``wanted``."""
    from scipy.optimize import brentq  # slow to import

    xi = np.asarray(np.linalg.lstsq(columns, wanted, rcond=1e-12)[0], dtype=np.float64)
    if np.linalg.norm(xi) <= 1:
        return xi
    values, vectors = np.linalg.eigh(columns.T @ columns)
    along = vectors.T @ (columns.T @ wanted)

    def excess(shift: float) -> float:
        return float(np.linalg.norm(along / (values + shift))) - 1

    largest = float(np.linalg.norm(along))  # there the norm is at most 1
    least = 1e-14 * max(float(values[-1]), largest)
    shift = brentq(excess, least, largest) if excess(least) > 0 else least
    return np.asarray(vectors @ (along / (values + shift)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Kink:
    """A time at which several modes are active or the arguments of a norm are zero.

    Attributes
    ----------
    lower, upper : (n,)
        The least and the largest of each component of D_x <eta_t, f_i> over the active modes i and, at the zero of a
        norm, over all its selections |xi| <= 1.
    required : (n,)
        p_t in x, as the adjoint equation requires.
    """

    time: int
    lower: Array
    upper: Array
    required: Array

    def of(self, i: int) -> Array:
        """Return the three values of component i, (3,)."""
        return np.array([self.lower[i], self.upper[i], self.required[i]])


def kinks(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers, facts: SwitchingFacts
) -> tuple[Kink, ...]:
    """Return the kinks of judged switching facts along a trajectory, in time."""
    reduced = cost_as_state(problem, trajectory)
    if reduced is not None:
        n, augmented = problem.state_dim, (reduced.start(trajectory), reduced.with_adjoint(multipliers))
        found = kinks(reduced.problem, *augmented, facts)
        return tuple(Kink(kink.time, kink.lower[:n], kink.upper[:n], kink.required[:n]) for kink in found)
    times = sorted({*facts.times, *(kink.time for kink in facts.norms)})
    if not times:
        return ()
    n, x, u = problem.state_dim, trajectory.x, trajectory.u
    judged = {(kink.norm, kink.time): kink.selection for kink in facts.norms}
    sizes, selections = np.concatenate(trajectory_sizes(problem, trajectory)), dict[Formula, Array]()
    for norm, active in (piecewise_smooth(problem).active_kinks(x, u, sizes) if judged else {}).items():
        selections[norm] = np.full((problem.horizon, len(norm.arguments)), np.nan)
        for t in np.flatnonzero(active):
            selections[norm][t] = judged.get((_norm_text(problem, norm), int(t)), 0.0)
    affine = problem.affine_at(trajectory, selections)
    arrays = modes_along(affine, trajectory)
    alone = affine.with_dynamics(piecewise_affine(affine).along(arrays.sequence(x, u)))
    required = required_slopes(extremal_at(alone, trajectory, multipliers))[:, :n]
    centre, radius = _mode_slopes(problem, trajectory, multipliers, selections), 0.0
    for norm, selection in selections.items():
        columns = _norm_slopes(problem, trajectory, multipliers, selections, norm)[1]
        centre = centre - np.einsum("jtki,tj->tki", columns, np.nan_to_num(selection))
        radius = radius + np.linalg.norm(columns, axis=0)  # the largest of columns @ xi, |xi| <= 1
    lower, upper = (centre - radius)[..., :n], (centre + radius)[..., :n]
    modes = arrays.active_modes(x, u)
    return tuple(Kink(t, lower[t, modes[t]].min(axis=0), upper[t, modes[t]].max(axis=0), required[t]) for t in times)
