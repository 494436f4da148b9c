"""Proofs by rays: that a problem is infeasible, that its cost has no lower bound, or that a trajectory is no extremal.

A problem is infeasible if multipliers with eta_C = 0 have a bound D above 0; the constraints that carry it are in
conflict. A direction (dx, du) that keeps every active constraint to first order and along which the cost falls leaves
no room for normal multipliers: with g the gradient of J and v any sum of normals, <g + v, d> <= <g, d> < 0, so that g +
v is not 0. A direction that is feasible at every length and along which the cost has no lower bound shows that the
problem is unbounded.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Mask
from lin_freq_ocp.certificate.bound import RIGOROUS, Bound
from lin_freq_ocp.certificate.hamiltonian import extremal_at
from lin_freq_ocp.certificate.response_bound import farkas_bound
from lin_freq_ocp.certificate.sizes import trajectory_sizes
from lin_freq_ocp.certificate.tolerances import SCALE_FLOOR
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reformulations import at_frequencies
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.problem.terms.maps import AffineMap
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

CLEAR_MARGIN = 1e-4  # margin of a proof from which half of its bound is far above the rounding of data
SHARE_TOLERANCE = 0.1
"""Bounds on a component with less than this share of the heaviest ones in a proof are not named."""

SMALL_TIME = 1e-2
"""Times and bins at which a block acts with less than this fraction of its largest multiplier are not named."""

PRACTICAL = 1e4
"""Multiple of the sizes in the data beyond which a trajectory is not looked for where nothing bounds it."""

OVER_BINS = ("stop band", "mask", "energy bound")
"""Words in the names of blocks that act at bins and not at times."""


@dataclass(frozen=True)
class Conflict:
    """One block of constraints that an infeasibility proof rests on.

    Attributes
    ----------
    block : str
        In words, with the component's name.
    share : float
        1 for ends, stop bands and terms, without which the ray proves nothing; for bounds and joint rows, how much of
        the proof would be lost if they were relaxed by their own size, relative to the heaviest ones.
    times : tuple of int
        Where it acts; bins for a stop band.
    """

    block: str
    share: float
    times: tuple[int, ...]

    def __str__(self) -> str:
        where = "bins" if any(word in self.block for word in OVER_BINS) else "t ="
        return f"{self.block}, {where} {_runs(self.times)}"


@dataclass(frozen=True, eq=False)
class InfeasibilityProof:
    """Multipliers with eta_C = 0 whose bound D is above 0: no trajectory satisfies all constraints.

    Attributes
    ----------
    bound : Bound
        Its kind is "numerical" if, in components without bounds, only trajectories of practical size are excluded.
    multipliers : Multipliers
        The verified ray.
    conflict : tuple of Conflict
        The blocks of constraints that carry it.
    """

    bound: Bound
    multipliers: Multipliers
    conflict: tuple[Conflict, ...]


def prove_infeasible(problem: OptimalControlProblem, ray: Multipliers) -> InfeasibilityProof | None:
    """Return a proof of infeasibility from a Farkas ray (its eta_C is taken as 0), or None if it proves nothing."""
    abnormal, problem = replace(ray, eta_C=0.0, weights=None), at_frequencies(problem, ray.frequencies)
    bound = _bound(problem, abnormal)
    if bound.value <= 0:
        return None
    conflict = tuple(one for find in (_ends, _bounds, _bands, _terms) for one in find(problem, abnormal))
    return InfeasibilityProof(bound, abnormal, conflict)


def proof_margin(problem: OptimalControlProblem, ray: Multipliers) -> float:
    """Return the bound D of a Farkas ray relative to the terms that it is a difference of: 1 at best."""
    rest, bound = _rest(problem), _bound(problem, ray)
    residual = rest.x[1:] - problem.equations.successors(rest.x, rest.u)
    terms = float(np.abs(ray.eta * residual).sum()) + abs(bound.stage_term)
    if bound.stage_gaps is not None:
        terms += float(np.abs(bound.stage_gaps).sum())
    return bound.value / terms if terms > 0 else 0.0


@dataclass(frozen=True, eq=False)
class Exclusion:
    """A rigorous ray that excludes initial states: its bound is an affine function of them.

    From x_0, it is ``value`` + slope (x_0 - start) > 0: the ray has no cost, and l_0 is linear at the fixed x_0.
    """

    start: Array
    slope: Array
    value: float

    def excludes(self, state: Array) -> bool:
        """Whether the bound from a state (n,) is at least half of that from ``start``: above all rounding."""
        return self.value + float(self.slope @ (state - self.start)) >= 0.5 * self.value


def exclusion(problem: OptimalControlProblem, ray: Multipliers) -> Exclusion | None:
    """Return what a ray proves of other initial states; None unless it excludes the problem's own, a point, clearly."""
    bound = _bound(problem, ray)
    start = problem.initial_box
    if not start.fixed.all() or bound.kind != RIGOROUS or proof_margin(problem, ray) <= CLEAR_MARGIN:
        return None
    return Exclusion(start.lower, -extremal_at(problem, _rest(problem), ray).in_x[0].astype(np.float64), bound.value)


def _rest(problem: OptimalControlProblem) -> Trajectory:
    """Return the point nearest to zero within the bounds, at every time."""
    return Trajectory(
        problem.state_tube.project(np.zeros((problem.horizon + 1, problem.state_dim))),
        problem.control_tube.project(np.zeros((problem.horizon, problem.control_dim))),
    )


def _bound(problem: OptimalControlProblem, ray: Multipliers) -> Bound:
    x, u = stated_sizes(problem)
    return farkas_bound(extremal_at(problem, _rest(problem), ray), (PRACTICAL * x, PRACTICAL * u))


def _ends(problem: OptimalControlProblem, ray: Multipliers) -> Iterator[Conflict]:
    for what, t, end in (("initial state", 0, problem.initial_box), ("terminal state", -1, problem.terminal_box)):
        if ray.mu[t, np.isfinite(end.lower) | np.isfinite(end.upper)].any():
            yield Conflict(what, 1.0, (t % len(ray.mu),))


def _bounds(problem: OptimalControlProblem, ray: Multipliers) -> Iterator[Conflict]:
    """Name the bounds and joint rows that weigh most, by their multipliers times the sizes of what they bound."""
    x, u = stated_sizes(problem)
    inside = np.abs(ray.mu) * x
    for t, end in ((0, problem.initial_box), (-1, problem.terminal_box)):
        inside[t, np.isfinite(end.lower) | np.isfinite(end.upper)] = 0.0
    blocks = [(f"state bound on {name}", inside[:, i]) for i, name in enumerate(problem.state_names)]
    outside = np.abs(ray.nu) * u
    blocks += [(f"control bound on {name}", outside[:, j]) for j, name in enumerate(problem.control_names)]
    for family in problem.stage_rows:
        joint = np.maximum(ray.stage.get(family.name, np.zeros((problem.horizon, family.rows))), 0.0)
        weighted = joint * family.sizes(x, u)
        blocks += [(f"row {i} of {family.name}", weighted[:, i]) for i in range(family.rows)]
    largest = max(float(weights.sum()) for _, weights in blocks)
    for block, weights in blocks:
        if weights.sum() > SHARE_TOLERANCE * largest:
            yield Conflict(block, float(weights.sum()) / largest, _important(weights))


def _bands(problem: OptimalControlProblem, ray: Multipliers) -> Iterator[Conflict]:
    """Name the stop bands without whose multipliers the ray proves nothing."""
    for signal, names, field in (("state", problem.state_names, "rho_x"), ("control", problem.control_names, "rho_u")):
        prices: ComplexArray = getattr(ray, field)
        for i, name in enumerate(names):
            rest = prices.copy()
            rest[:, i] = 0.0
            if prices[:, i].any() and _bound(problem, replace(ray, **{field: rest})).value <= 0:
                yield Conflict(f"{signal} stop band on {name}", 1.0, _important(np.abs(prices[:, i])))


def _terms(problem: OptimalControlProblem, ray: Multipliers) -> Iterator[Conflict]:
    """Name the terms other than joint rows without whose multipliers the ray proves nothing."""
    for term in problem.terms:
        weights = ray.stage.get(term.name)
        if term.kind.is_rows or weights is None or not weights.any():
            continue
        rest = {name: one for name, one in ray.stage.items() if name != term.name}
        if _bound(problem, replace(ray, stage=rest)).value <= 0:
            positions = term.map.positions
            acting = _important(np.abs(weights).sum(1)) if len(weights) == len(positions) else range(len(positions))
            yield Conflict(term.name, 1.0, tuple(sorted({int(positions[i]) for i in acting})))


def _important(weights: Array) -> tuple[int, ...]:
    return tuple(int(t) for t in np.flatnonzero(weights > SMALL_TIME * weights.max()))


def _runs(times: tuple[int, ...]) -> str:
    """Return increasing whole numbers as runs: 0..3, 7."""
    runs: list[list[int]] = []
    for t in times:
        if runs and t == runs[-1][1] + 1:
            runs[-1][1] = t
        else:
            runs.append([t, t])
    shown = [f"{first}" if first == last else f"{first}..{last}" for first, last in runs[:4]]
    return ", ".join(shown) + (", ..." if len(runs) > 4 else "")


DIRECTION_TOLERANCE = 1e-6
"""How far a direction may lead out of a constraint, relative to its own size; its slope must be below minus this."""

TOUCHING = 1e-6
"""A constraint is active, and a value at its kink, at this distance, relative to its size: what the judge forgives."""

LEAVING_MARGIN = 10.0
"""The cost must fall this many times faster than what leaving constraints, as far as it does, could account for."""


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction that was checked.

    Attributes
    ----------
    x : (T+1, n), u : (T, m)
        The change of states and controls; the largest is 1 in the sizes of the data.
    slope : float
        Change of the cost per unit of the direction, below zero.
    residual : float
        How far it leads out of constraints, relative to its size.
    """

    x: Array
    u: Array
    slope: float
    residual: float

    @property
    def steepest(self) -> int:
        """Return the time at which it changes a control most, in the units of the problem."""
        return int(np.argmax(np.abs(self.u).max(1)))


def descent_direction(problem: OptimalControlProblem, trajectory: Trajectory, along: Trajectory) -> Direction | None:
    """Return the direction if, to first order, it keeps what holds at the trajectory and lowers the cost; else None.

    Constraints that the trajectory violates count as active: the direction does not make them worse.
    """
    x, u = trajectory.x, trajectory.u
    sizes = trajectory_sizes(problem, trajectory)
    along = _normalised_direction(problem, along, sizes)
    residuals = _linear_residuals(problem, along, sizes)
    slopes, scales = _quadratic_slope(problem, along, problem.quadratic.gradient(x, u))
    scales.append(_least_slope(problem, trajectory, along, sizes))
    tubes = problem.state_tube, problem.control_tube
    for signal, change, tube, size in zip((x, u), (along.x, along.u), tubes, sizes, strict=True):
        near = TOUCHING * (size + np.abs(signal))
        residuals.append(_box_residual(change / size, tube.upper - signal <= near, signal - tube.lower <= near))
    for term in problem.terms:
        values, change = term.map.values(x, u), _change(term.map, along)
        size = float((term.map.sizes(x, u) + np.abs(change)).max())
        left = term.penalty.leaving(values, change, TOUCHING * size)
        residuals.append(left / (max(float(np.abs(change).max()), size) or 1.0))  # zero: a row that limits nothing
        slopes.append(term.penalty.slope(values, change, TOUCHING * size))
        scales.append(abs(slopes[-1]))
    steepest = _steepest(problem.quadratic.gradient(x, u), sizes)
    return _proven(along, residuals, slopes, scales, steepest)


def unbounded_direction(problem: OptimalControlProblem, along: Trajectory) -> Direction | None:
    """Return the direction if every multiple of it is feasible and the cost decreases without bound, else None."""
    sizes, tubes = stated_sizes(problem), (problem.state_tube, problem.control_tube)
    along = _normalised_direction(problem, along, sizes)
    residuals = _linear_residuals(problem, along, sizes)
    at_rest = problem.quadratic.gradient(np.zeros_like(along.x), np.zeros_like(along.u))
    slopes, scales = _quadratic_slope(problem, along, at_rest)
    # d'H d for the Hessian of the quadratic cost
    there = problem.quadratic.gradient(along.x, along.u)
    changes = zip(at_rest, there, (along.x, along.u), strict=True)
    curvature = float(sum(((after - before) * change).sum() for before, after, change in changes))
    residuals.append(curvature / max(curvature, *scales) if curvature > 0 else 0.0)
    for change, tube, size in zip((along.x, along.u), tubes, sizes, strict=True):
        residuals.append(_box_residual(change / size, np.isfinite(tube.upper), np.isfinite(tube.lower)))
    for term in problem.terms:
        change = _change(term.map, along)
        left, price = term.penalty.unbounded(change)
        steady = np.broadcast_to(sizes[0], along.x.shape), np.broadcast_to(sizes[1], along.u.shape)
        residuals.append(left / float(term.map.sizes(*steady).max()) if left > 0 else 0.0)
        slopes.append(price)
        scales.append(price)
    return _proven(along, residuals, slopes, scales, _steepest(at_rest, sizes))


def _proven(
    along: Trajectory, residuals: list[float], slopes: list[float], scales: list[float], steepest: float
) -> Direction | None:
    slope, residual = sum(slopes), max(residuals)
    needed = max(DIRECTION_TOLERANCE * sum(scales), LEAVING_MARGIN * residual * steepest)
    if residual > DIRECTION_TOLERANCE or not slope < -needed or slope == 0:
        return None
    return Direction(along.x, along.u, slope, residual)


def _steepest(gradient: tuple[Array, Array], sizes: tuple[Array, Array]) -> float:
    """Return what the cost changes by, at most, where every state and control changes by its size."""
    return float(sum((np.abs(part) * size).sum() for part, size in zip(gradient, sizes, strict=True)))


def _normalised_direction(problem: OptimalControlProblem, along: Trajectory, sizes: tuple[Array, Array]) -> Trajectory:
    """Return the direction with a largest entry of 1 in these sizes."""
    problem.require(along)
    largest = max(float(np.abs(along.x / sizes[0]).max()), float(np.abs(along.u / sizes[1]).max()))
    return Trajectory(along.x / largest, along.u / largest) if largest > 0 else along


def _linear_residuals(problem: OptimalControlProblem, along: Trajectory, sizes: tuple[Array, Array]) -> list[float]:
    """Return how far it leaves the dynamics and the stop bands; what should be zero holds rounding only."""
    dynamics = problem.equations
    rest = np.zeros_like(along.x), np.zeros_like(along.u)
    moved = dynamics.successors(along.x, along.u) - dynamics.successors(*rest)
    terms = np.abs(along.x[1:]) + dynamics.successor_sizes(along.x, along.u)
    terms = np.maximum((terms - dynamics.successor_sizes(*rest)).max(0), SCALE_FLOOR * sizes[0])
    residuals = [float((np.abs(along.x[1:] - moved).max(0) / terms).max())]
    stops = problem.state_stop, problem.control_stop
    for signal, stop, size in zip((along.x[: problem.state_samples], along.u), stops, sizes, strict=True):
        magnitude = np.where(stop, np.abs(np.fft.rfft(signal, axis=0)), 0.0).max(0)
        residuals.append(float((magnitude / np.maximum(np.linalg.norm(signal, axis=0), SCALE_FLOOR * size)).max()))
    return residuals


def _quadratic_slope(
    problem: OptimalControlProblem, along: Trajectory, gradient: tuple[Array, Array]
) -> tuple[list[float], list[float]]:
    products = [part * change for part, change in zip(gradient, (along.x, along.u), strict=True)]
    return [float(part.sum()) for part in products], [float(np.abs(part).sum()) for part in products]


def _least_slope(
    problem: OptimalControlProblem, trajectory: Trajectory, along: Trajectory, sizes: tuple[Array, Array]
) -> float:
    """Return what slopes are measured by: each component's largest gradient, on all of its change.

    At an optimum to six digits the gradient and the multipliers cancel to these digits of their largest entries.
    """
    T, (x, u) = problem.horizon, sizes
    natural = problem.quadratic.gradient_magnitudes(np.tile(x, (T + 1, 1)), np.tile(u, (T, 1)))
    there = problem.quadratic.gradient_magnitudes(trajectory.x, trajectory.u)
    return sum(
        float(np.maximum(now.max(0), SCALE_FLOOR * least.max(0)) @ np.abs(change).sum(0))
        for now, least, change in zip(there, natural, (along.x, along.u), strict=True)
    )


def _box_residual(change: Array, above: Mask, below: Mask) -> float:
    """Return by how much a change leads out of the bounds that are looked at."""
    return max(float(np.where(above, change, 0.0).max()), float(np.where(below, -change, 0.0).max()), 0.0)


def _change(one: AffineMap, along: Trajectory) -> Array:
    """Return the linear part of a map, of the direction."""
    return one.values(along.x, along.u) - one.values(np.zeros_like(along.x), np.zeros_like(along.u))
