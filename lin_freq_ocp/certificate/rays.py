"""Proofs by rays: a problem is infeasible or unbounded, or a trajectory is not an extremal.

A problem is infeasible if multipliers with eta_C = 0 have a bound D above 0; the constraints with these multipliers are
in conflict. If a direction d = (dx, du) keeps every active constraint to first order and lowers the cost, no normal
multipliers exist: with g the gradient of J and v any sum of normals, <g + v, d> <= <g, d> < 0, so g + v is not 0. If a
direction is feasible at every length and the cost falls along it without bound, the problem is unbounded.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Mask, first_largest
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
SHARE_TOLERANCE = 0.1  # share of the heaviest bounds in a proof from which bounds on a component are named
SMALL_TIME = 1e-2  # fraction of the largest multiplier of a block from which its times and bins are named
PRACTICAL = 1e4  # sizes in the data up to which unbounded components are covered by a proof
OVER_BINS = ("stop band", "mask", "energy bound")  # words in the names of blocks that act at bins and not at times
MOST_RUNS = 4  # of times, after which a conflict shows ...


@dataclass(frozen=True)
class Conflict:
    """One block of constraints in an infeasibility proof.

    Attributes
    ----------
    block : str
        In words, with the name of the component.
    share : float
        1 for ends, stop bands and terms that the proof needs. For bounds and joint rows: the part of the proof that is
        lost if they are relaxed by their own size, relative to the heaviest ones.
    times : tuple of int
        Times at which it acts; bins for a stop band.
    """

    block: str
    share: float
    times: tuple[int, ...]

    def __str__(self) -> str:
        axis = "bins" if any(word in self.block for word in OVER_BINS) else "t ="
        runs: list[list[int]] = []  # of increasing whole numbers: 0..3, 7
        for t in self.times:
            if runs and t == runs[-1][1] + 1:
                runs[-1][1] = t
            else:
                runs.append([t, t])
        shown = ", ".join(f"{first}" if first == last else f"{first}..{last}" for first, last in runs[:MOST_RUNS])
        return f"{self.block}, {axis} {shown}{', ...' if len(runs) > MOST_RUNS else ''}"


@dataclass(frozen=True, eq=False)
class InfeasibilityProof:
    """Multipliers with eta_C = 0 whose bound D is above 0: no trajectory satisfies all constraints.

    Attributes
    ----------
    bound : Bound
        Its kind is "numerical" if the proof covers components without bounds only up to a practical size.
    multipliers : Multipliers
        The verified ray.
    conflict : tuple of Conflict
        The conflicting blocks of constraints.
    """

    bound: Bound
    multipliers: Multipliers
    conflict: tuple[Conflict, ...]


def prove_infeasible(problem: OptimalControlProblem, ray: Multipliers) -> InfeasibilityProof | None:
    """Return the proof of infeasibility by a Farkas ray, whose eta_C is set to 0; None if it proves nothing."""
    abnormal, problem = replace(ray, eta_C=0.0, weights=None), at_frequencies(problem, ray.frequencies)
    bound = _bound(problem, abnormal)
    if bound.value <= 0:
        return None
    blocks = (_bounds_in_conflict, _bands_in_conflict, _terms_in_conflict)
    return InfeasibilityProof(bound, abnormal, tuple(block for find in blocks for block in find(problem, abnormal)))


def proof_margin(problem: OptimalControlProblem, ray: Multipliers) -> float:
    """Return the bound D of a Farkas ray relative to the absolute sum of its terms: 1 at best."""
    rest, bound = _point_nearest_zero(problem), _bound(problem, ray)
    residual = rest.x[1:] - problem.equations.successors(rest.x, rest.u)
    terms = float(np.abs(ray.eta * residual).sum()) + abs(bound.stage_term)
    if bound.stage_gaps is not None:
        terms += float(np.abs(bound.stage_gaps).sum())
    return bound.value / terms if terms > 0 else 0.0


@dataclass(frozen=True, eq=False)
class InfeasibilityCertificate:
    """A rigorous ray as a function of the initial state x_0.

    Its bound is D = ``value`` + slope (x_0 - start), as the ray has no cost and l_0 is linear in a fixed x_0. Initial
    states with D > 0 are infeasible.
    """

    start: Array
    slope: Array
    value: float

    def applies_to(self, state: Array) -> bool:
        """Whether the bound from a state (n,) is at least half of that from ``start``: above all rounding."""
        return self.value + float(self.slope @ (state - self.start)) >= 0.5 * self.value


def infeasibility_certificate(problem: OptimalControlProblem, ray: Multipliers) -> InfeasibilityCertificate | None:
    """Return the ray as a function of the initial state; None if its bound for this problem is not clearly above 0."""
    bound = _bound(problem, ray)
    start = problem.initial_box
    if not start.fixed.all() or bound.kind != RIGOROUS or proof_margin(problem, ray) <= CLEAR_MARGIN:
        return None
    slope = -extremal_at(problem, _point_nearest_zero(problem), ray).in_x[0].astype(np.float64)
    return InfeasibilityCertificate(start.lower, slope, bound.value)


def _point_nearest_zero(problem: OptimalControlProblem) -> Trajectory:
    """Return the point nearest to zero within the bounds, at every time."""
    return Trajectory(
        problem.state_tube.project(np.zeros((problem.horizon + 1, problem.state_dim))),
        problem.control_tube.project(np.zeros((problem.horizon, problem.control_dim))),
    )


def _bound(problem: OptimalControlProblem, ray: Multipliers) -> Bound:
    x, u = stated_sizes(problem)
    return farkas_bound(extremal_at(problem, _point_nearest_zero(problem), ray), (PRACTICAL * x, PRACTICAL * u))


def _bounds_in_conflict(problem: OptimalControlProblem, ray: Multipliers) -> Iterator[Conflict]:
    """Name the ends, then the heaviest bounds and joint rows: multipliers times the sizes of the components."""
    x, u = stated_sizes(problem)
    on_states, on_controls = np.abs(ray.mu) * x, np.abs(ray.nu) * u
    for block, t, end in (("initial state", 0, problem.initial_box), ("terminal state", -1, problem.terminal_box)):
        bounded = np.isfinite(end.lower) | np.isfinite(end.upper)
        if ray.mu[t, bounded].any():
            yield Conflict(block, 1.0, (t % len(ray.mu),))
        on_states[t, bounded] = 0.0
    blocks = [(f"state bound on {name}", on_states[:, i]) for i, name in enumerate(problem.state_names)]
    blocks += [(f"control bound on {name}", on_controls[:, j]) for j, name in enumerate(problem.control_names)]
    for family in problem.stage_rows:
        joint = np.maximum(ray.stage.get(family.name, np.zeros((problem.horizon, family.rows))), 0.0)
        weighted = joint * family.sizes(x, u)
        blocks += [(f"row {i} of {family.name}", weighted[:, i]) for i in range(family.rows)]
    largest = max(float(weights.sum()) for _, weights in blocks)
    for block, weights in blocks:
        if weights.sum() > SHARE_TOLERANCE * largest:
            yield Conflict(block, float(weights.sum()) / largest, _largest_indices(weights))


def _bands_in_conflict(problem: OptimalControlProblem, ray: Multipliers) -> Iterator[Conflict]:
    """Name the stop bands without whose multipliers the ray proves nothing."""
    for signal, names, field in (("state", problem.state_names, "rho_x"), ("control", problem.control_names, "rho_u")):
        prices: ComplexArray = getattr(ray, field)
        for i, name in enumerate(names):
            rest = prices.copy()
            rest[:, i] = 0.0
            if prices[:, i].any() and _bound(problem, replace(ray, **{field: rest})).value <= 0:
                yield Conflict(f"{signal} stop band on {name}", 1.0, _largest_indices(np.abs(prices[:, i])))


def _terms_in_conflict(problem: OptimalControlProblem, ray: Multipliers) -> Iterator[Conflict]:
    """Name the terms other than joint rows without whose multipliers the ray proves nothing."""
    for term in problem.terms:
        weights = ray.stage.get(term.name)
        if term.kind.is_rows or weights is None or not weights.any():
            continue
        rest = {name: on_term for name, on_term in ray.stage.items() if name != term.name}
        if _bound(problem, replace(ray, stage=rest)).value <= 0:
            positions = term.map.positions
            grouped = len(weights) == len(positions)
            acting = _largest_indices(np.abs(weights).sum(1)) if grouped else range(len(positions))
            yield Conflict(term.name, 1.0, tuple(sorted({int(positions[i]) for i in acting})))


def _largest_indices(weights: Array) -> tuple[int, ...]:
    return tuple(int(t) for t in np.flatnonzero(weights > SMALL_TIME * weights.max()))


DIRECTION_TOLERANCE = (
    1e-6  # violation of constraints by a direction, relative to its size; its slope is below minus this
)
TOUCHING = 1e-6  # distance, relative to sizes, of active constraints and of kinks: the judge accepts such violations
LEAVING_MARGIN = 10.0  # least slope of the cost over the one that the violation of constraints can explain


@dataclass(frozen=True, eq=False)
class Direction:
    """A verified direction of descent.

    Attributes
    ----------
    x : (T+1, n), u : (T, m)
        The change of states and controls; the largest is 1 in the sizes of the data.
    slope : float
        Change of the cost per unit of the direction, below zero.
    residual : float
        Violation of constraints along the direction, relative to its size.
    """

    x: Array
    u: Array
    slope: float
    residual: float

    @property
    def steepest(self) -> tuple[int, ...]:
        """Return the time and the component of the largest change of a control, in the units of the problem."""
        return first_largest(np.abs(self.u))


def descent_direction(problem: OptimalControlProblem, trajectory: Trajectory, along: Trajectory) -> Direction | None:
    """Return the direction if, to first order, it keeps all active constraints and lowers the cost; else None.

    Constraints that the trajectory violates count as active: the direction does not increase their violation.
    """
    x, u = trajectory.x, trajectory.u
    sizes = trajectory_sizes(problem, trajectory)
    along = _normalised_direction(problem, along, sizes)
    residuals = _linear_residuals(problem, along, sizes)
    slopes, scales = _quadratic_slope(along, problem.quadratic.gradient(x, u))
    # At an optimum to six digits, gradient and multipliers cancel to these digits of their largest entries: slopes are
    # relative to the largest gradient of each component, on all of its change
    natural = problem.quadratic.gradient_magnitudes(np.ones((len(x), 1)) * sizes[0], np.ones((len(u), 1)) * sizes[1])
    at_point = problem.quadratic.gradient_magnitudes(x, u)
    scales += [
        float(np.maximum(part.max(0), SCALE_FLOOR * least.max(0)) @ np.abs(change).sum(0))
        for part, least, change in zip(at_point, natural, (along.x, along.u), strict=True)
    ]
    tubes = problem.state_tube, problem.control_tube
    for signal, change, tube, size in zip((x, u), (along.x, along.u), tubes, sizes, strict=True):
        near = TOUCHING * (size + np.abs(signal))
        residuals.append(_box_residual(change / size, tube.upper - signal <= near, signal - tube.lower <= near))
    for term in problem.terms:
        values, change = term.map.values(x, u), _linear_part(term.map, along)
        size = float((term.map.sizes(x, u) + np.abs(change)).max())
        left = term.penalty.leaving(values, change, TOUCHING * size)
        residuals.append(left / (max(float(np.abs(change).max()), size) or 1.0))  # zero: a row that limits nothing
        slopes.append(term.penalty.slope(values, change, TOUCHING * size))
        scales.append(abs(slopes[-1]))
    steepest = _largest_slope(problem.quadratic.gradient(x, u), sizes)
    return _verified_direction(along, residuals, slopes, scales, steepest)


def unbounded_direction(problem: OptimalControlProblem, along: Trajectory) -> Direction | None:
    """Return the direction if every multiple of it is feasible and the cost decreases without bound, else None."""
    sizes, tubes = stated_sizes(problem), (problem.state_tube, problem.control_tube)
    along = _normalised_direction(problem, along, sizes)
    residuals = _linear_residuals(problem, along, sizes)
    at_rest = problem.quadratic.gradient(np.zeros_like(along.x), np.zeros_like(along.u))
    slopes, scales = _quadratic_slope(along, at_rest)
    # d'H d for the Hessian of the quadratic cost
    at_direction = problem.quadratic.gradient(along.x, along.u)
    changes = zip(at_rest, at_direction, (along.x, along.u), strict=True)
    curvature = float(sum(((after - before) * change).sum() for before, after, change in changes))
    residuals.append(curvature / max(curvature, *scales) if curvature > 0 else 0.0)
    for change, tube, size in zip((along.x, along.u), tubes, sizes, strict=True):
        residuals.append(_box_residual(change / size, np.isfinite(tube.upper), np.isfinite(tube.lower)))
    for term in problem.terms:
        change = _linear_part(term.map, along)
        left, price = term.penalty.unbounded(change)
        steady = np.broadcast_to(sizes[0], along.x.shape), np.broadcast_to(sizes[1], along.u.shape)
        residuals.append(left / float(term.map.sizes(*steady).max()) if left > 0 else 0.0)
        slopes.append(price)
        scales.append(price)
    return _verified_direction(along, residuals, slopes, scales, _largest_slope(at_rest, sizes))


def _verified_direction(
    along: Trajectory, residuals: list[float], slopes: list[float], scales: list[float], steepest: float
) -> Direction | None:
    """Return the direction if its residuals are small and the cost falls by more than they can explain, else None."""
    slope, residual = sum(slopes), max(residuals)
    needed = max(DIRECTION_TOLERANCE * sum(scales), LEAVING_MARGIN * residual * steepest)
    if residual > DIRECTION_TOLERANCE or not slope < -needed or slope == 0:
        return None
    return Direction(along.x, along.u, slope, residual)


def _largest_slope(gradient: tuple[Array, Array], sizes: tuple[Array, Array]) -> float:
    """Return the largest change of the cost, to first order, if every state and control changes by its size."""
    return float(sum((np.abs(part) * size).sum() for part, size in zip(gradient, sizes, strict=True)))


def _normalised_direction(problem: OptimalControlProblem, along: Trajectory, sizes: tuple[Array, Array]) -> Trajectory:
    """Return the direction with a largest entry of 1 in these sizes."""
    problem.require(along)
    largest = max(float(np.abs(along.x / sizes[0]).max()), float(np.abs(along.u / sizes[1]).max()))
    return Trajectory(along.x / largest, along.u / largest) if largest > 0 else along


def _linear_residuals(problem: OptimalControlProblem, along: Trajectory, sizes: tuple[Array, Array]) -> list[float]:
    """Return the violations of the dynamics and the stop bands; components near zero hold rounding errors only."""
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


def _quadratic_slope(along: Trajectory, gradient: tuple[Array, Array]) -> tuple[list[float], list[float]]:
    """Return the slopes of the quadratic cost in states and controls, and the sums of the absolute values of terms."""
    products = [part * change for part, change in zip(gradient, (along.x, along.u), strict=True)]
    return [float(part.sum()) for part in products], [float(np.abs(part).sum()) for part in products]


def _box_residual(change: Array, above: Mask, below: Mask) -> float:
    """Return the largest violation by a change of the upper bounds ``above`` and the lower bounds ``below``."""
    return max(float(np.where(above, change, 0.0).max()), float(np.where(below, -change, 0.0).max()), 0.0)


def _linear_part(affine: AffineMap, along: Trajectory) -> Array:
    """Return L(d) - L(0): the linear part of a map applied to a direction d."""
    return affine.values(along.x, along.u) - affine.values(np.zeros_like(along.x), np.zeros_like(along.u))
