"""What the maximum principle says of piecewise-affine dynamics where modes meet (docs/borders.md).

At (x_t, u_t), with I the modes that meet there, a_i = (A_i' eta_t, B_i' eta_t), G_i d <= 0 the region of mode i to
first order, p_t what the adjoint equation and stationarity in u require of the derivative of <eta_t, f_t>, and b_t the
same without the normals to the sets of the stage:

    joint     p_t = sum_i alpha_i a_i, one set of weights alpha >= 0, sum alpha = 1, for x and u alike   (Clarke's rule)
    flip      <a_i - b_t, d> <= 0 for all i in I, and all d with G_i d <= 0 in the tangent cone of the sets of the stage
    printed   that for d = (dx, 0), any dx at all and some mu_t, and for d = (0, du)            (paper, C-iii to C-v)
    regular   <a_i - a_k, d> <= 0 for all i, k in I and G_i d <= 0: -<eta_t, f_t> is Clarke-regular

By Farkas' lemma an inequality for all d of a polyhedral cone says that a vector is a nonnegative sum of the cone's
rows: nonnegative least squares decides, and what is left over is the residual.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.analysis.sizes import trajectory_sizes
from lin_freq_ocp.analysis.stage_normals import Normal, stage_normals
from lin_freq_ocp.arrays import Array, Indices, Mask, extended
from lin_freq_ocp.certificate.conditions import CONDITION_TOLERANCE, Condition
from lin_freq_ocp.certificate.hamiltonian import Lift
from lin_freq_ocp.certificate.scales import Floors
from lin_freq_ocp.problem.dynamics.mode_arrays import ModeArrays
from lin_freq_ocp.problem.dynamics.regions import Border
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

SHOWN_FLIPS = 4
"""Flips that the words name; all are in the data."""


class Flip(NamedTuple):
    """A mode towards which the Hamiltonian rises at a time: with these multipliers, changing to it there improves.

    Attributes
    ----------
    time, mode : int
    rate : float
        First-order fall of the cost per unit of the steepest direction into the mode that was found, whose largest
        entry is 1 in the sizes of the data.
    improves : bool or None
        True: a direction of descent in that mode was verified. False: the mode sequence with this flip has multipliers
        of its own (the given ones are not the only ones), so the flip does not improve to first order. None: not tried.
    """

    time: int
    mode: int
    rate: float
    improves: bool | None = None


class NormKink(NamedTuple):
    """A norm whose arguments q are zero at a time.

    Attributes
    ----------
    time : int
    norm : str
        In words.
    selection : (components,)
        xi, |xi| <= 1: the derivative of the norm that fits best is xi' Dq, the same in x and u.
    rate : float
        The derivative of <eta_t, f_t> by the norm. Above zero the kink is convex: the printed form has no solution.
    """

    time: int
    norm: str
    selection: tuple[float, ...]
    rate: float

    def told(self) -> str:
        """Return the kink in words."""
        xi = ", ".join(f"{part:.4g}" for part in self.selection)
        return f"{self.norm} = 0 at t = {self.time} with xi = ({xi})"


@dataclass(frozen=True, eq=False)
class BorderFacts:
    """What holds where modes meet, with the multipliers that were judged.

    Attributes
    ----------
    elsewhere : bool
        Whether all conditions that do not depend on borders hold, and stationarity where one mode holds alone. The
        following facts but ``regular`` include it; without it, flips mean nothing.
    joint : bool
        Clarke's multiplier rule, the necessary condition.
    flip_stationary : bool
        Joint in x and u, along directions: then no trajectory in any sequence of the modes that meet is better.
    flips : tuple of Flip
        Where it fails, the steepest first.
    printed : bool
        The paper's C-iii to C-v, apart in x and u.
    regular : bool
        Whether -<eta_t, f_t> is Clarke-regular wherever modes meet, as the printed form needs.
    times : tuple of int
        Where modes meet.
    weights : (len(times), modes)
        alpha there.
    jumping : Border or None
        Where the map jumps most, if it does: then the theorem does not apply.
    conditions : tuple of Condition
        "flip", "printed" (in x, in u) and "regular" at their worst; of each, the component is a mode.
    mode_names : tuple of str
    norms : tuple of NormKink
        Where the arguments of norms are zero.
    """

    elsewhere: bool
    joint: bool
    flip_stationary: bool
    flips: tuple[Flip, ...]
    printed: bool
    regular: bool
    times: tuple[int, ...]
    weights: Array
    jumping: Border | None
    conditions: tuple[Condition, ...]
    mode_names: tuple[str, ...]
    norms: tuple[NormKink, ...] = ()

    def __str__(self) -> str:
        parts = list[str]()
        if self.jumping is not None:
            first, second = (self.mode_names[i] for i in (self.jumping.first, self.jumping.second))
            parts.append(f"the map jumps between {first} and {second}: the theorem does not apply")
        parts += [kink.told() for kink in self.norms]
        if not self.times and not self.norms:
            return "; ".join([*parts, "modes meet nowhere along the trajectory"])
        if self.times:
            parts.append(f"modes meet at t = {', '.join(map(str, self.times))}")
        parts.append(f"joint inclusion {'holds' if self.joint else 'fails'}")
        parts.append("flip-stationary" if self.flip_stationary else "not flip-stationary")
        flips = self.flips if self.elsewhere else tuple(flip for flip in self.flips if flip.improves)
        parts += [self.told(flip) for flip in flips[:SHOWN_FLIPS]]
        parts += [f"{len(flips) - SHOWN_FLIPS} more flips"] if len(flips) > SHOWN_FLIPS else []
        regular = "regular" if self.regular else "not regular"
        parts.append(f"printed form {'holds' if self.printed else 'fails'} (-<eta, f> {regular})")
        return "; ".join(parts)

    def told(self, flip: Flip) -> str:
        """Return a flip in words."""
        known = {True: ", verified", False: ", which does not improve: it has other multipliers", None: ""}
        what = f"flip t = {flip.time} to {self.mode_names[flip.mode]}"
        return f"{what} (rate {flip.rate:.2g}{known[flip.improves]})"


@dataclass(frozen=True, eq=False)
class BorderStage:
    """A time at which modes meet; vectors are in (x, u), n + m entries.

    Attributes
    ----------
    time : int
    modes : (k,)
        Those that meet.
    slopes : (k, n + m)
        a_i.
    required : (n + m,)
        p_t.
    normals : tuple of Normal, with ``held`` (as many,)
        The active bounds and rows of the stage, and what of each is in p_t.
    facets : tuple of (n + m, rows)
        Of each mode, the rows of its region that touch, as columns.
    scale : (n + m,)
        What a residual is compared with.
    states : int
        n.
    """

    time: int
    modes: Indices
    slopes: Array
    required: Array
    normals: tuple[Normal, ...]
    held: Array
    facets: tuple[Array, ...]
    scale: Array
    states: int

    def without(self, dropped: Sequence[bool]) -> Array:
        """Return p_t without those of the normals."""
        taken = [value * one.column for value, one, drop in zip(self.held, self.normals, dropped, strict=True) if drop]
        return self.required - np.sum(taken, axis=0) if taken else self.required

    def generators(self, chosen: Sequence[bool]) -> Array:
        """Return the columns of those of the normals, (n + m, count)."""
        columns = [one.column for one, choose in zip(self.normals, chosen, strict=True) if choose]
        return np.array(columns).reshape(-1, len(self.scale)).T

    def of_one(self, part: slice) -> list[bool]:
        """Return which normals are normals in x alone, or in u alone: zero outside that part."""
        outside = np.ones(len(self.scale), dtype=bool)
        outside[part] = False
        return [not one.column[outside].any() for one in self.normals]


def border_stages(lift: Lift, least: Floors, arrays: ModeArrays, meeting: Mask) -> list[BorderStage]:
    """Return every time at which several modes meet; ``lift`` is that of any averaged dynamics, meeting (T, modes)."""
    trajectory, multipliers = lift.trajectory, lift.multipliers
    required, n = required_slopes(lift), lift.problem.state_dim
    normals = stage_normals(lift.problem, trajectory)
    touching = arrays.touching(trajectory.x, trajectory.u)
    rows = np.concatenate([arrays.G, arrays.H], axis=-1)
    maps = np.concatenate([arrays.A, arrays.B], axis=-1)
    slopes = np.einsum("tkij,ti->tkj", maps, multipliers.eta)
    terms = np.einsum("tkij,ti->tkj", np.abs(maps), np.abs(multipliers.eta))
    scale = np.maximum(stationarity_scale(lift, least), np.where(meeting[..., None], terms, 0.0).max(axis=(0, 1)))
    return [
        BorderStage(
            time=int(t),
            modes=(modes := np.flatnonzero(meeting[t])),
            slopes=slopes[t, modes],
            required=required[t],
            normals=tuple(normals[t]),
            held=np.array([one.value(multipliers) for one in normals[t]]),
            facets=tuple(rows[t, i, touching[t, i]].T for i in modes),
            scale=scale,
            states=n,
        )
        for t in np.flatnonzero(meeting.sum(axis=1) > 1)
    ]


def required_slopes(lift: Lift) -> Array:
    """Return p_t, (T, n + m): what D <eta_t, f_t> must be, whatever dynamics the lift is of."""
    through_x, through_u = lift.problem.linear.pull_back(extended(lift.multipliers.eta))
    in_x = (lift.eta_before - lift.in_x + lift.multipliers.mu)[:-1] + through_x
    return np.hstack([in_x, lift.multipliers.nu - lift.in_u + through_u]).astype(np.float64)


def stationarity_scale(lift: Lift, least: Floors) -> Array:
    """Return the scales of the adjoint equation and of stationarity in u, (n + m,)."""
    in_x = np.abs(lift.eta_before) + lift.in_x_terms + np.abs(lift.multipliers.mu)
    in_u = lift.in_u_terms + np.abs(lift.multipliers.nu)
    sizes = [np.maximum(terms.max(0), floor) for terms, floor in ((in_x, least.in_x), (in_u, least.in_u))]
    scale = np.concatenate(sizes).astype(np.float64)
    return np.where(scale > 0, scale, 1.0)  # without any terms there is no residual


def nearest_weights(stage: BorderStage) -> Array:
    """Return alpha >= 0, sum alpha = 1, with sum alpha_i a_i nearest to p_t, (k,).

    The nearest point of a polytope V alpha to 0: beta >= 0 with the least |V beta|^2 + (sum beta - 1)^2 is a multiple
    of alpha, as the sum s enters that as s^2 |V alpha|^2 + (s - 1)^2, which rises with |V alpha| for the best s.
    """
    from scipy.optimize import nnls  # slow to import

    columns = ((stage.slopes - stage.required) / stage.scale).T
    beta, _ = nnls(np.vstack([columns, np.ones(len(stage.modes))]), np.append(np.zeros(len(columns)), 1.0))
    return beta / beta.sum()


def border_facts(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    stages: Sequence[BorderStage],
    weights: Array,
    joint: bool,
    elsewhere: bool,
) -> BorderFacts:
    """Return the facts; ``joint`` is whether all conditions hold, ``elsewhere`` whether those not of borders do."""
    sizes = np.concatenate(trajectory_sizes(problem, trajectory))
    flips = [flip for stage in stages for flip in _flips(stage, sizes)]
    checks = (
        ("flip", "no mode towards which H rises", _flip_residuals),
        ("printed", "C-iii and C-iv as printed, in x alone", _printed_in_x),
        ("printed", "C-v as printed, in u alone", _printed_in_u),
        ("regular", "-<eta, f> Clarke-regular", _regular_residuals),
    )
    conditions = tuple(_worst(label, name, stages, of) for label, name, of in checks) if stages else ()
    passed = [condition.passed for condition in conditions] or [True] * len(checks)
    jumping = [border for border in problem.borders if not border.continuous]
    return BorderFacts(
        elsewhere=elsewhere,
        joint=joint,
        flip_stationary=elsewhere and passed[0],
        flips=tuple(sorted(flips, key=lambda flip: -flip.rate)),
        printed=elsewhere and passed[1] and passed[2],
        regular=passed[3],
        times=tuple(stage.time for stage in stages),
        weights=weights[[stage.time for stage in stages]],
        jumping=max(jumping, key=lambda border: border.jump, default=None),
        conditions=conditions,
        mode_names=problem.piecewise.mode_names,
    )


def _worst(
    label: str, name: str, stages: Sequence[BorderStage], residuals: Callable[[BorderStage], list[Array]]
) -> Condition:
    """Return the condition at the stage, mode and entry with the largest scaled residual."""
    worst = (-1.0, 0, 0, 1.0)
    for stage in stages:
        for mode, scaled in zip(stage.modes, residuals(stage), strict=True):
            k = int(np.argmax(np.abs(scaled)))
            worst = max(worst, (abs(float(scaled[k])), stage.time, int(mode), float(stage.scale[k])))
    relative, time, mode, scale = worst
    return Condition(label, name, relative * scale, scale, CONDITION_TOLERANCE, time, mode)


def _flips(stage: BorderStage, sizes: Array) -> Iterator[Flip]:
    """Yield the modes for which the residual r of the flip test is not zero.

    In the scaled metric r is orthogonal to what was subtracted and makes no acute angle with the generators, so that
    d = r / scale is a direction into the mode within the sets, and <a_i - b, d> = |r|^2.
    """
    for mode, residual in zip(stage.modes, _flip_residuals(stage), strict=True):
        if np.abs(residual).max() > CONDITION_TOLERANCE:
            direction = residual / stage.scale
            rate = float(residual @ residual) / float(np.abs(direction / sizes).max())
            yield Flip(stage.time, int(mode), rate)


def _flip_residuals(stage: BorderStage) -> list[Array]:
    every = [True] * len(stage.normals)
    base, normals = stage.without(every), stage.generators(every)
    return [
        _outside(slope - base, np.hstack([facets, normals]), stage.scale)
        for slope, facets in zip(stage.slopes, stage.facets, strict=True)
    ]


def _printed_in_u(stage: BorderStage) -> list[Array]:
    """Return the residual of D_v <eta, f> <= <b_u, v> for all v in the tangent cone of U_t, per mode."""
    part = slice(stage.states, None)
    own = stage.of_one(part)
    base, normals, no_state = stage.without(own)[part], stage.generators(own)[part], np.zeros(stage.states)
    return [
        np.append(no_state, _outside(slope[part] - base, np.hstack([facets[part], normals]), stage.scale[part]))
        for slope, facets in zip(stage.slopes, stage.facets, strict=True)
    ]


def _printed_in_x(stage: BorderStage) -> list[Array]:
    """Return the residual of D_y <eta, f> - <mu, y> <= <b_x, y> for all y and one mu in N_X(x_t), per mode."""
    part, k = slice(0, stage.states), len(stage.modes)
    own = stage.of_one(part)
    base, normals = stage.without(own)[part], stage.generators(own)[part]
    blocks = [np.hstack([np.zeros((stage.states, 0)), facets[part]]) for facets in stage.facets]
    generators = np.hstack([np.tile(normals, (k, 1)), _block_diagonal(blocks)])
    vector = np.concatenate([slope[part] - base for slope in stage.slopes])
    return np.split(_outside(vector, generators, np.tile(stage.scale[part], k)), k)


def _regular_residuals(stage: BorderStage) -> list[Array]:
    """Return, per mode, the largest residual of <a_i - a_k, d> <= 0 over the other modes."""
    worst = list[Array]()
    for slope, facets in zip(stage.slopes, stage.facets, strict=True):
        residuals = [_outside(slope - other, facets, stage.scale) for other in stage.slopes]
        worst.append(max(residuals, key=lambda residual: float(np.abs(residual).max())))
    return worst


def _outside(vector: Array, generators: Array, scale: Array) -> Array:
    """Return what is left of a vector after the nearest nonnegative sum of generators, both divided by the scale."""
    from scipy.optimize import nnls  # slow to import

    scaled, columns = vector / scale, generators / scale[:, None]
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0] / norms[norms > 0]
    if not columns.shape[1]:
        return scaled
    coefficients, _ = nnls(columns, scaled)
    return scaled - columns @ coefficients


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    rows, columns = len(blocks[0]), np.cumsum([0, *(block.shape[1] for block in blocks)])
    matrix = np.zeros((rows * len(blocks), int(columns[-1])))
    for i, block in enumerate(blocks):
        matrix[i * rows : (i + 1) * rows, columns[i] : columns[i + 1]] = block
    return matrix
