"""The maximum principle for piecewise-affine dynamics at points where several modes are active (docs/borders.md).

A point at a gap between regions may have a single active mode, whose region ends there.

At (x_t, u_t), with I the active modes, a_i = (A_i' eta_t, B_i' eta_t), G_i d <= 0 the region of mode i to first order,
p_t what the adjoint equation and stationarity in u require of the derivative of <eta_t, f_t>, and b_t the same without
the normals to the sets of the stage:

    joint     p_t = sum_i alpha_i a_i, one set of weights alpha >= 0, sum alpha = 1, for x and u alike   (Clarke's rule)
    flip      <a_i - b_t, d> <= 0 for all i in I, and all d with G_i d <= 0 in the tangent cone of the sets of the stage
    printed   that for d = (dx, 0), any dx at all and some mu_t, and for d = (0, du)            (paper, C-iii to C-v)
    regular   <a_i - a_k, d> <= 0 for all i, k in I and G_i d <= 0: -<eta_t, f_t> is Clarke-regular

By Farkas' lemma an inequality for all d of a polyhedral cone says that a vector is a nonnegative sum of the cone's
rows: nonnegative least squares decides, and its residual is that of the condition.

``judge_modes`` has all conditions: those of the averaged linear problem, and those of its modes. With weights alpha,
the derivative of f_t is sum_i alpha_i (A_i, B_i): Clarke's rule is then the adjoint equation and stationarity in u of
the linear problem with these dynamics, if the sum is a convex combination of active modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from lin_freq_ocp.base.arrays import Array, Indices, Mask, first_largest, stack_signals, to_long_double
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import runs_in_words, runs_of
from lin_freq_ocp.base.polyhedra import hull_weights
from lin_freq_ocp.certificate.conditions import Condition, all_conditions, state_equation
from lin_freq_ocp.certificate.hamiltonian import Extremal, extremal_at, state_residual
from lin_freq_ocp.certificate.sizes import Floors, Scales, Sizes, floors, scales_of, trajectory_sizes
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, SCALE_FLOOR
from lin_freq_ocp.certificate.verdict import Certificate, Facts, Judgement
from lin_freq_ocp.problem.hybrid.affine_mode import ModeArrays
from lin_freq_ocp.problem.hybrid.regions import SwitchingFacet, meets_gap
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import fix_values
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.hybrid.forms import active_normals, piecewise_affine

SHOWN_FLIPS = 4  # flips in the text; all are in the data


class Flip(NamedTuple):
    """A mode towards which the Hamiltonian rises at a time: with these multipliers, changing to it there improves.

    Attributes
    ----------
    rate : float
        First-order fall of the cost per unit of the steepest direction into the mode that was found, whose largest
        entry is 1 in the sizes of the data.
    improves : bool or None
        True: a direction of descent in that mode was verified. False: the mode sequence with this flip has multipliers
        of its own, so the flip does not improve to first order. None: not tried.
    """

    time: int
    mode: int
    rate: float
    improves: bool | None = None


class NormKink(NamedTuple):
    """A norm whose arguments q are zero at a time.

    Attributes
    ----------
    norm : str
        As text.
    selection : (components,)
        xi, |xi| <= 1: the derivative of the norm that fits best is xi' Dq, the same in x and u.
    rate : float
        The derivative of <eta_t, f_t> by the norm. Above zero the kink is convex: the printed form has no solution.
    """

    time: int
    norm: str
    selection: tuple[float, ...]
    rate: float

    def describe(self) -> str:
        """Return the kink as text."""
        xi = ", ".join(f"{part:.4g}" for part in self.selection)
        return f"{self.norm} = 0 at t = {self.time} with xi = ({xi})"


@dataclass(frozen=True, eq=False)
class SwitchingFacts(Facts):
    """The conditions where several modes are active, for the multipliers that were judged.

    Attributes
    ----------
    elsewhere : bool
        Whether all conditions without weights hold, and stationarity where a single mode is active. All following facts
        except ``regular`` presuppose it; without it, flips have no meaning.
    joint : bool
        Clarke's multiplier rule, the necessary condition.
    flip_stationary : bool
        Joint in x and u, along directions: then no trajectory in any sequence of the active modes is better.
    flips : tuple of Flip
        Where it fails, the steepest first.
    printed : bool
        The paper's C-iii to C-v, apart in x and u.
    regular : bool
        Whether -<eta_t, f_t> is Clarke-regular wherever several modes are active, as the printed form needs.
    times : tuple of int
        Where several modes are active, or the trajectory touches a gap.
    weights : (len(times), modes)
        alpha there.
    jumping : SwitchingFacet or None
        The facet with the largest jump of the map, if there is one: then the theorem does not apply.
    conditions : tuple of Condition
        "flip", "printed" (in x, in u) and "regular" at their worst; of each, the component is a mode.
    norms : tuple of NormKink
        Where the arguments of norms are zero.
    gaps : tuple of int
        Where the trajectory touches a gap between regions: f_t is not defined around it, so that the theorem does not
        apply.
    rim_modes : tuple of int
        Of smooth modes, the mode whose region ends at each of the ``gaps``.
    unqualified : tuple of (str, int)
        The names of path constraints, and the times, at which their active gradients are dependent: their normal cone
        is then not known, and the theorem does not apply.
    at_levels : bool
        Whether the gaps are those between levels of the controls.
    """

    elsewhere: bool
    joint: bool
    flip_stationary: bool
    flips: tuple[Flip, ...]
    printed: bool
    regular: bool
    times: tuple[int, ...]
    weights: Array
    jumping: SwitchingFacet | None
    conditions: tuple[Condition, ...]
    mode_names: tuple[str, ...]
    norms: tuple[NormKink, ...] = ()
    gaps: tuple[int, ...] = ()
    rim_modes: tuple[int, ...] = ()
    unqualified: tuple[tuple[str, int], ...] = ()
    at_levels: bool = False

    @property
    def applicable(self) -> bool:
        """Whether the theorem applies: the map does not jump and is defined around the trajectory, and cones are known.

        These are the normal cones of path constraints.
        """
        return self.jumping is None and not self.gaps and not self.unqualified

    @property
    def dependent_gradients(self) -> str:
        """Return where active gradients of path constraints are dependent, in words."""
        names = dict.fromkeys(name for name, _ in self.unqualified)
        times = [np.array([t for one, t in self.unqualified if one == name]) for name in names]
        parts = [f"{name!r} at t = {runs_in_words(runs_of(at))}" for name, at in zip(names, times, strict=True)]
        return f"the active gradients of {' and of '.join(parts)} are dependent or zero"

    @property
    def stationary_on_rims(self) -> bool:
        """Whether all conditions hold with the regions as constraints, where the trajectory touches their rims."""
        return bool(self.rim_modes) and self.jumping is None and self.flip_stationary

    @property
    def touched_gaps(self) -> str:
        """Return where the trajectory touches gaps, and in which modes, in words."""
        where = runs_in_words(runs_of(np.array(self.gaps)))
        alone = sorted({self.mode_names[mode] for mode in self.rim_modes})
        what = f"the rim of the region of {' and of '.join(map(repr, alone))}" if alone else "a gap between regions"
        return f"the trajectory touches {what} at t = {where}"

    def __str__(self) -> str:
        parts = list[str]()
        if self.jumping is not None:
            first, second = (self.mode_names[i] for i in (self.jumping.first, self.jumping.second))
            parts.append(f"the map jumps between {first} and {second}: the theorem does not apply")
        if self.gaps:
            parts.append(f"{self.touched_gaps}: the theorem does not apply")
        if self.unqualified:
            parts.append(f"{self.dependent_gradients}: the theorem does not apply there")
        if self.at_levels and self.jumping is None:
            return "levels of controls are isolated: the theorem does not apply, and the bound alone proves an optimum"
        parts += [kink.describe() for kink in self.norms]
        if not self.times and not self.norms:
            several = len(self.mode_names) > 1
            return "; ".join([*parts, *(["modes meet nowhere along the trajectory"] if several else [])])
        if self.times:
            where = runs_in_words(runs_of(np.array(self.times)))
            parts.append(f"modes meet{' or end' if self.gaps else ''} at t = {where}")
        parts.append(f"joint inclusion {'holds' if self.joint else 'fails'}")
        parts.append("flip-stationary" if self.flip_stationary else "not flip-stationary")
        flips = self.flips if self.elsewhere else tuple(flip for flip in self.flips if flip.improves)
        parts += [self.describe(flip) for flip in flips[:SHOWN_FLIPS]]
        parts += [f"{len(flips) - SHOWN_FLIPS} more flips"] if len(flips) > SHOWN_FLIPS else []
        regular = "regular" if self.regular else "not regular"
        parts.append(f"printed form {'holds' if self.printed else 'fails'} (-<eta, f> {regular})")
        return "; ".join(parts)

    def describe(self, flip: Flip) -> str:
        """Return a flip in words."""
        known = {True: ", verified", False: ", which does not improve: it has other multipliers", None: ""}
        what = f"flip t = {flip.time} to {self.mode_names[flip.mode]}"
        return f"{what} (rate {flip.rate:.2g}{known[flip.improves]})"


def facts_where_modes_meet(certificate: Certificate) -> SwitchingFacts | None:
    """Return the facts where modes meet of a certificate, if it has any."""
    return certificate.borders if isinstance(certificate.borders, SwitchingFacts) else None


def modes_along(problem: OptimalControlProblem, trajectory: Trajectory, sizes: Sizes | None = None) -> ModeArrays:
    """Return the modes of a problem at all times, which measure components by their sizes along a trajectory."""
    sizes = sizes or trajectory_sizes(problem, trajectory)
    return piecewise_affine(problem).arrays(problem.horizon).with_sizes(*sizes, problem.level_sizes)


@dataclass(frozen=True, eq=False)
class SwitchingStage:
    """A time at which several modes are active; vectors are in (x, u), n + m entries.

    ``slopes`` (k, n + m) are the a_i of the modes and ``required`` is p_t. ``normals`` (count, n + m) are the active
    bounds and rows of the stage, ``multipliers`` (count,) theirs in p_t. ``facets`` are, per mode, the active rows
    of its region as columns; ``scale`` is the unit of residuals, and ``states`` is n.
    """

    time: int
    modes: Indices
    slopes: Array
    required: Array
    normals: Array
    multipliers: Array
    facets: tuple[Array, ...]
    scale: Array
    states: int

    def own_normals(self, part: slice) -> Mask:
        """Return which normals are zero outside a part of (x, u), (count,)."""
        outside = np.ones(len(self.scale), dtype=bool)
        outside[part] = False
        return np.asarray(~self.normals[:, outside].any(axis=1))

    def without(self, chosen: Mask) -> Array:
        """Return p_t without some of the normals."""
        return self.required - self.multipliers[chosen] @ self.normals[chosen]


def switching_stages(
    extremal: Extremal, least: Floors, arrays: ModeArrays, active: Mask, gaps: Indices
) -> list[SwitchingStage]:
    """Return every time with several active modes (T, modes), or at a gap; the extremal is of any averaged dynamics."""
    trajectory, multipliers = extremal.trajectory, extremal.multipliers
    required, n = required_slopes(extremal), extremal.problem.state_dim
    active_facets = arrays.active_facets(trajectory.x, trajectory.u)
    slopes = np.einsum("tkij,ti->tkj", arrays.maps, multipliers.eta)
    terms = np.einsum("tkij,ti->tkj", np.abs(arrays.maps), np.abs(multipliers.eta))
    scale = np.maximum(stationarity_scale(extremal, least), np.where(active[..., None], terms, 0.0).max(axis=(0, 1)))
    sizes = least.z / SCALE_FLOOR + np.abs(stack_signals(trajectory.x, trajectory.u))
    of_stages = active_normals(extremal.problem, trajectory, sizes, CONDITION_TOLERANCE)
    stages = list[SwitchingStage]()
    for t in np.union1d(np.flatnonzero(active.sum(axis=1) > 1), gaps):
        modes, found = np.flatnonzero(active[t]), of_stages[t]
        normals = np.array([one.column for one in found]).reshape(-1, len(scale[t]))
        weights = np.array([one.value(multipliers) for one in found])
        facets = tuple(arrays.rows[t, i, active_facets[t, i]].T for i in modes)
        own = slopes[t, modes], required[t], normals, weights, facets, scale[t], n
        stages.append(SwitchingStage(int(t), modes, *own))
    return stages


def required_slopes(extremal: Extremal) -> Array:
    """Return p_t, (T, n + m), the derivative of <eta_t, f_t> that an extremal of any dynamics requires."""
    through = extremal.problem.linear.pull_back(to_long_double(extremal.multipliers.eta))
    return ((extremal.slopes + extremal.normals)[:-1] + through).astype(np.float64)


def stationarity_scale(extremal: Extremal, least: Floors) -> Array:
    """Return the scales of the adjoint equation and of stationarity in u, (T, n + m)."""
    terms = extremal.slope_terms + np.abs(extremal.normals)
    scale = np.maximum(terms.max(0), least.slopes[:-1]).astype(np.float64)
    return np.where(scale > 0, scale, 1.0)  # without any terms there is no residual


def switching_facts(
    problem: OptimalControlProblem,
    stages: Sequence[SwitchingStage],
    weights: Array,
    gaps: Indices,
    joint: bool,
    elsewhere: bool,
    sizes: Array,
) -> SwitchingFacts:
    """Return the facts; ``joint``: all conditions hold, ``elsewhere``: those that do not depend on weights do."""
    flips = list[Flip]()
    for stage in stages:
        for mode, residual in zip(stage.modes, _flip_residuals(stage), strict=True):
            if np.abs(residual).max() > CONDITION_TOLERANCE:
                # in the scaled metric the residual r is orthogonal to the part that was subtracted and makes no acute
                # angle with the generators: d = r / scale leads into the mode within the sets, <a_i - b, d> = |r|^2
                longest = np.abs(residual / stage.scale / sizes).max()
                flips.append(Flip(stage.time, int(mode), float(residual @ residual / longest)))
    checks = (
        ("flip", "no mode towards which H rises", _flip_residuals),
        ("printed", "C-iii and C-iv as printed, in x alone", _printed_residuals_in_x),
        ("printed", "C-v as printed, in u alone", _printed_residuals_in_u),
        ("regular", "-<eta, f> Clarke-regular", _regular_residuals),
    )
    conditions = list[Condition]()
    for label, name, residuals in checks if stages else ():
        worst = (-1.0, 0, 0, 1.0)  # the stage, mode and entry with the largest scaled residual
        for stage in stages:
            for mode, scaled in zip(stage.modes, residuals(stage), strict=True):
                k = int(np.argmax(np.abs(scaled)))
                worst = max(worst, (abs(float(scaled[k])), stage.time, int(mode), float(stage.scale[k])))
        relative, time, mode, scale = worst
        conditions.append(Condition(label, name, relative * scale, scale, CONDITION_TOLERANCE, time, mode))
    passed = [condition.passed for condition in conditions] or [True] * len(checks)
    facets = [facet for facet in problem.borders if isinstance(facet, SwitchingFacet)]
    jumping = [facet for facet in facets if not facet.continuous]
    return SwitchingFacts(
        elsewhere=elsewhere,
        joint=joint,
        flip_stationary=elsewhere and passed[0],
        flips=tuple(sorted(flips, key=lambda flip: -flip.rate)),
        printed=elsewhere and passed[1] and passed[2],
        regular=passed[3],
        times=tuple(stage.time for stage in stages),
        weights=weights[[stage.time for stage in stages]],
        jumping=max(jumping, key=lambda facet: facet.jump, default=None),
        conditions=tuple(conditions),
        mode_names=piecewise_affine(problem).mode_names,
        gaps=tuple(gaps.tolist()),
        at_levels=problem.form.levels is not None,
    )


def _flip_residuals(stage: SwitchingStage) -> list[Array]:
    base = stage.without(np.ones(len(stage.multipliers), dtype=bool))
    return [
        _cone_residual(slope - base, np.hstack([facets, stage.normals.T]), stage.scale)
        for slope, facets in zip(stage.slopes, stage.facets, strict=True)
    ]


def _printed_residuals_in_u(stage: SwitchingStage) -> list[Array]:
    """Return the residual of D_v <eta, f> <= <b_u, v> for all v in the tangent cone of U_t, per mode."""
    part = slice(stage.states, None)
    of_controls = stage.own_normals(part)
    base, normals, no_state = (
        stage.without(of_controls)[part],
        stage.normals[of_controls, part].T,
        np.zeros(stage.states),
    )
    return [
        np.append(no_state, _cone_residual(slope[part] - base, np.hstack([facets[part], normals]), stage.scale[part]))
        for slope, facets in zip(stage.slopes, stage.facets, strict=True)
    ]


def _printed_residuals_in_x(stage: SwitchingStage) -> list[Array]:
    """Return the residual of D_y <eta, f> - <mu, y> <= <b_x, y> for all y and one mu in N_X(x_t), per mode."""
    part, k = slice(0, stage.states), len(stage.modes)
    of_states = stage.own_normals(part)
    facets = block_diag(*(facets[part] for facets in stage.facets))
    generators = np.hstack([np.tile(stage.normals[of_states, part].T, (k, 1)), facets])
    vector = np.concatenate([slope[part] - stage.without(of_states)[part] for slope in stage.slopes])
    return np.split(_cone_residual(vector, generators, np.tile(stage.scale[part], k)), k)


def _regular_residuals(stage: SwitchingStage) -> list[Array]:
    """Return, per mode, the largest residual of <a_i - a_k, d> <= 0 over the other modes."""
    worst = list[Array]()
    for slope, facets in zip(stage.slopes, stage.facets, strict=True):
        residuals = [_cone_residual(slope - other_slope, facets, stage.scale) for other_slope in stage.slopes]
        worst.append(max(residuals, key=lambda residual: float(np.abs(residual).max())))
    return worst


def _cone_residual(vector: Array, generators: Array, scale: Array) -> Array:
    """Return the residual of a vector from the nearest nonnegative sum of generators, both divided by the scale."""
    from scipy.optimize import nnls  # slow to import

    scaled, columns = vector / scale, generators / scale[:, None]
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0] / norms[norms > 0]
    return scaled - columns @ nnls(columns, scaled)[0] if columns.shape[1] else scaled


# Conditions that depend on the weights: at times where only one mode is active they are checked apart
OF_WEIGHTS = ("adjoint equation", "transversality at 0", "Hamiltonian stationary in u", "Hamiltonian maximal in u")


def judge_modes(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers, linear_at: Scales | None = None
) -> Judgement:
    """Judge a trajectory of affine modes, which may be smooth modes linearised along it, with their scales."""
    problem.require(trajectory)
    linearised, scales = linear_at is not None, linear_at or scales_of(problem, trajectory)
    sizes, arrays = scales.sizes, modes_along(problem, trajectory, scales.sizes)
    sequence, distance = arrays.sequence(trajectory.x, trajectory.u), region_distance(problem, trajectory, sizes)
    active = arrays.active_modes(trajectory.x, trajectory.u) & (distance <= CONDITION_TOLERANCE)
    active[np.arange(len(sequence)), sequence] = True
    gaps = np.zeros(0, dtype=np.intp)
    if problem.gap is not None or linearised:  # where the regions of the active modes leave a part of the sets out
        x, u, sets = trajectory.x, trajectory.u, problem.stage_sets
        touches = (arrays.active_facets(x, u).any(axis=2) & active).any(axis=1)
        # regions that are linearised need not cover the sets where several meet: a region ends where it is alone
        touched = np.flatnonzero(touches & (active.sum(axis=1) == 1) if linearised else touches).tolist()
        gaps = np.array([t for t in touched if meets_gap(arrays, sets, t, np.append(x[t], u[t]), active[t])], np.intp)
    weights = multipliers.weights
    if weights is not None and weights.shape != active.shape:
        raise ProblemError("multipliers.weights", f"shape {weights.shape}", f"shape {active.shape}")
    if weights is None:
        # alpha >= 0, sum alpha = 1, with sum alpha_i a_i nearest to p_t
        weights = np.eye(active.shape[1])[sequence]
        extremal = extremal_at(_averaged_problem(problem, weights, sequence), trajectory, multipliers)
        least, none = floors(extremal, scales), np.zeros(0, dtype=np.intp)
        for stage in switching_stages(extremal, least, arrays, active, none):
            weights[stage.time] = 0.0
            points = (stage.slopes - stage.required) / stage.scale
            beta = hull_weights(points, points[:0])
            weights[stage.time, stage.modes] = beta / beta.sum()
    extremal = extremal_at(_averaged_problem(problem, weights, sequence), trajectory, multipliers)
    least = floors(extremal, scales, problem.origin)
    levels = np.append(np.zeros(problem.state_dim), problem.level_sizes)
    least = replace(least, z=np.maximum(least.z, levels))  # be the trajectory zero or not
    along = problem.with_dynamics(piecewise_affine(problem).along(sequence))
    motion = along.equations.motion_sizes(trajectory.x, trajectory.u)
    dynamics_condition = state_equation(state_residual(along, trajectory), motion, least)
    linear = [
        dynamics_condition if condition.name == dynamics_condition.name else condition
        for condition in all_conditions(extremal, least)
    ]
    own_distance = distance[np.arange(len(sequence)), sequence]  # from the region of the mode that leads to x_{t+1}
    (t,) = first_largest(own_distance)
    mode, worst = int(sequence[t]), float(own_distance[t])
    name = "a mode holds that leads to the next state"
    active_mode = Condition("S-f", name, worst, 1.0, CONDITION_TOLERANCE, t, mode)
    violation = np.maximum(-weights, np.where(active, 0.0, np.abs(weights)))
    violation = np.maximum(violation, np.abs(weights.sum(axis=1, keepdims=True) - 1))
    t, mode = first_largest(violation)
    name = "weights >= 0, sum 1, of modes that hold"
    of_weights = Condition("N-f", name, float(violation[t, mode]), 1.0, CONDITION_TOLERANCE, t, mode)
    stages = switching_stages(extremal, least, arrays, active, gaps)
    others = all(condition.passed for condition in (*linear, active_mode) if condition.name not in OF_WEIGHTS)
    # the adjoint equation and stationarity in u at all times with a single mode
    scale, single = stationarity_scale(extremal, least), np.ones(problem.horizon, dtype=bool)
    single[[stage.time for stage in stages]] = False
    relative = np.abs(extremal.slopes + extremal.normals)[:-1] / scale
    residual = float(relative[single].max(initial=0.0))
    elsewhere = others and residual <= CONDITION_TOLERANCE
    conditions = (*linear, active_mode, of_weights)
    joint = all(condition.passed for condition in conditions)
    facts = switching_facts(problem, stages, weights, gaps, joint, elsewhere, np.concatenate(sizes))
    facts = replace(facts, rim_modes=tuple(sequence[gaps].tolist()) if linearised else ())
    return Judgement(conditions, facts, float(extremal.cost_of_residuals), slopes=scale)


def region_distance(problem: OptimalControlProblem, trajectory: Trajectory, sizes: tuple[Array, Array]) -> Array:
    """Return by how much (x_t, u_t) lies outside each region, relative to the terms of its rows, (T, modes)."""
    arrays, (of_x, of_u) = piecewise_affine(problem).arrays(problem.horizon), sizes
    least = np.append(SCALE_FLOOR * of_x, np.maximum(SCALE_FLOOR * of_u, problem.level_sizes))
    x, y = trajectory.x, np.hstack([trajectory.x[:-1], trajectory.u])
    n = x.shape[1]
    images = np.einsum("tkij,tj->tki", np.abs(arrays.maps), np.abs(y)) + np.abs(arrays.offset)
    largest = np.maximum(np.abs(y).max(axis=0), least)
    largest[:n] = np.maximum.reduce([largest[:n], np.abs(x[-1]), images.min(axis=1).max(axis=0)])
    limits = np.where(np.isfinite(arrays.h), np.abs(arrays.h), 0.0)
    scale = (np.abs(arrays.rows) @ largest + limits).max(axis=0)
    violation = (np.einsum("tkrj,tj->tkr", arrays.rows, y) - arrays.h) / np.where(scale > 0, scale, 1.0)
    return np.maximum(violation.max(axis=2), 0.0)


def _averaged_problem(problem: OptimalControlProblem, weights: Array, sequence: Indices) -> OptimalControlProblem:
    """Return the linear problem with the weights of modes; controls that modes fix are fixed."""
    dynamics, choices = piecewise_affine(problem).averaged(weights), problem.form.choices
    fixed = None if choices is None else choices[sequence]
    return problem.derived(dynamics=dynamics, control_set=fix_values(problem.control_hull, fixed))
