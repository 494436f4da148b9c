"""Proofs by rays: a problem is infeasible or unbounded, or a trajectory is not an extremal.

A problem is infeasible if multipliers with eta_C = 0 have a bound D above 0; the constraints with these multipliers are
in conflict. If a direction d = (dx, du) keeps every active constraint to first order and lowers the cost, no normal
multipliers exist: with g the gradient of J and v any sum of normals, <g + v, d> <= <g, d> < 0, so g + v is not 0. If a
direction is feasible at every length and the cost falls along it without bound, the problem is unbounded, provided
that it is feasible. Such a direction satisfies every constraint at every time up to rounding of its own terms there.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, first_largest, split_signals, stack_signals, to_long_double
from lin_freq_ocp.base.phrases import number
from lin_freq_ocp.certificate.bound import RIGOROUS, Bound
from lin_freq_ocp.certificate.hamiltonian import extremal_at
from lin_freq_ocp.certificate.response_bound import farkas_bound
from lin_freq_ocp.certificate.sizes import trajectory_sizes
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE, SCALE_FLOOR, STATE_ROUNDING, TRIVIALITY
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.reformulations import at_frequencies
from lin_freq_ocp.transform.sizes import stated_sizes

CLEAR_MARGIN = 1e-4  # margin of a proof from which half of its bound is far above the rounding of data
SHARE_TOLERANCE = 0.1  # share of the heaviest bounds in a proof from which bounds on a component are named
SMALL_TIME = 1e-2  # fraction of the largest multiplier of a block from which its times and bins are named
OVER_BINS = ("stop band", "mask", "energy bound")  # words in the names of blocks that act at bins and not at times
MOST_RUNS = 4  # of times, after which a conflict shows ...
Needs = Callable[[Multipliers], bool]  # whether a ray proves nothing without its other multipliers


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
    margin : float
        By how much ``robust`` has tightened its limits there for loads, the most.
    """

    block: str
    share: float
    times: tuple[int, ...]
    margin: float = 0.0

    def __str__(self) -> str:
        axis = "bins" if any(word in self.block for word in OVER_BINS) else "t ="
        runs: list[list[int]] = []  # of increasing whole numbers: 0..3, 7
        for t in self.times:
            if runs and t == runs[-1][1] + 1:
                runs[-1][1] = t
            else:
                runs.append([t, t])
        shown = ", ".join(f"{first}" if first == last else f"{first}..{last}" for first, last in runs[:MOST_RUNS])
        less = f" (less {number(self.margin, 2)} for loads)" if self.margin else ""
        return f"{self.block}, {axis} {shown}{', ...' if len(runs) > MOST_RUNS else ''}{less}"


@dataclass(frozen=True, eq=False)
class InfeasibilityProof:
    """Multipliers with eta_C = 0 whose bound D is above 0: no trajectory satisfies all constraints.

    Attributes
    ----------
    bound : Bound
        Its kind is "numerical" if it holds for trajectories of the ``sizes`` only: that proves no infeasibility.
    multipliers : Multipliers
        The verified ray.
    conflict : tuple of Conflict
        The conflicting blocks of constraints.
    sizes : str
        Of a numerical bound: the largest absolute values, in words, of components without bounds.
    """

    bound: Bound
    multipliers: Multipliers
    conflict: tuple[Conflict, ...]
    sizes: str = ""


def prove_infeasible(problem: OptimalControlProblem, ray: Multipliers) -> InfeasibilityProof | None:
    """Return the proof of infeasibility by a Farkas ray, whose eta_C is set to 0; None if it proves nothing.

    A bound that rounding of ends and offsets explains proves nothing: with other last digits, there are trajectories.
    """
    abnormal, problem = replace(ray, eta_C=0.0, weights=None), at_frequencies(problem, ray.frequencies)
    bound = _bound(problem, abnormal)
    if bound.kind != RIGOROUS:  # rounding errors of components that play no part may be all that stands in the way
        rounded = _without_rounding(problem, abnormal)
        of_rounded = _bound(problem, rounded)
        if of_rounded.kind == RIGOROUS and of_rounded.value > 0:
            abnormal, bound = rounded, of_rounded
    rest = _point_nearest_zero(problem)
    given = np.abs(rest.x) + (0.0 if problem.origin is None else np.abs(problem.origin))  # as the user counts states
    terms = np.abs(abnormal.eta) * (given[1:] + problem.equations.successor_sizes(given, rest.u))
    if bound.value <= STATE_ROUNDING * float(terms.sum()):
        return None

    def needs(rest: Multipliers) -> bool:
        return _bound(problem, rest, bound.multiple if np.isfinite(bound.multiple) else None).value <= 0

    named = (_bounds_in_conflict(problem, abnormal), *(find(problem, abnormal, needs) for find in NEEDED_BLOCKS))
    sizes = "" if bound.kind == RIGOROUS else _sizes_in_words(problem, bound.multiple)
    return InfeasibilityProof(bound, abnormal, tuple(block for found in named for block in found), sizes)


def _without_rounding(problem: OptimalControlProblem, ray: Multipliers) -> Multipliers:
    """Return the ray with zeros in place of multipliers that are negligible in the sizes of the data."""
    x, u = stated_sizes(problem)
    sizes = {"eta": x, "mu": x, "nu": u}
    weighted = {name: np.abs(getattr(ray, name)) * size for name, size in sizes.items()}
    least = TRIVIALITY * max(float(weights.max()) for weights in weighted.values())
    return replace(ray, **{name: np.where(part > least, getattr(ray, name), 0.0) for name, part in weighted.items()})


def _sizes_in_words(problem: OptimalControlProblem, multiple: float) -> str:
    """Return the limits of the components without bounds up to which a numerical ray holds."""
    names, sizes = [*problem.state_names, *problem.control_names], np.concatenate(stated_sizes(problem))
    unbounded = np.flatnonzero(np.isinf(np.concatenate(problem.signal_bounds)).any(axis=0))
    limits = [f"|{names[i]}| <= {multiple * sizes[i]:.1e}" for i in unbounded]
    return ", ".join(limits[:MOST_RUNS]) + (", ..." if len(limits) > MOST_RUNS else "")


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
    slope = -extremal_at(problem, _point_nearest_zero(problem), ray).in_z[0, : problem.state_dim].astype(np.float64)
    return InfeasibilityCertificate(start.lower, slope, bound.value)


def _point_nearest_zero(problem: OptimalControlProblem) -> Trajectory:
    """Return the point nearest to zero within the bounds, at every time."""
    return Trajectory(*split_signals(np.clip(0.0, *problem.signal_bounds), problem.state_dim))


def _bound(problem: OptimalControlProblem, ray: Multipliers, multiple: float | None = None) -> Bound:
    return farkas_bound(extremal_at(problem, _point_nearest_zero(problem), ray), stated_sizes(problem), multiple)


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


def _bands_in_conflict(problem: OptimalControlProblem, ray: Multipliers, needs: Needs) -> Iterator[Conflict]:
    """Name the stop bands without whose multipliers the ray proves nothing."""
    for signal, names, field in (("state", problem.state_names, "rho_x"), ("control", problem.control_names, "rho_u")):
        prices: ComplexArray = getattr(ray, field)
        for i, name in enumerate(names):
            rest = prices.copy()
            rest[:, i] = 0.0
            if prices[:, i].any() and needs(replace(ray, **{field: rest})):
                yield Conflict(f"{signal} stop band on {name}", 1.0, _largest_indices(np.abs(prices[:, i])))


def _terms_in_conflict(problem: OptimalControlProblem, ray: Multipliers, needs: Needs) -> Iterator[Conflict]:
    """Name the terms other than joint rows without whose multipliers the ray proves nothing."""
    for term in problem.terms:
        weights = ray.stage.get(term.name)
        if term.kind.is_rows or weights is None or not weights.any():
            continue
        rest = {name: on_term for name, on_term in ray.stage.items() if name != term.name}
        if needs(replace(ray, stage=rest)):
            positions = term.map.positions
            grouped = len(weights) == len(positions)
            acting = _largest_indices(np.abs(weights).sum(1)) if grouped else range(len(positions))
            yield Conflict(term.name, 1.0, tuple(sorted({int(positions[i]) for i in acting})))


NEEDED_BLOCKS = _bands_in_conflict, _terms_in_conflict


def _largest_indices(weights: Array) -> tuple[int, ...]:
    return tuple(int(t) for t in np.flatnonzero(weights > SMALL_TIME * weights.max()))


TOUCHING = 1e-6  # distance, relative to sizes, of active constraints and of kinks: the judge accepts such violations
DIRECTION_ROUNDING = 256 * sys.float_info.epsilon  # of the terms of a constraint at its time, along a direction
FAR = 2.0**400  # a length of directions at which offsets, references and limits are rounding errors


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
        Violation of constraints along the direction, relative to its size; of an unbounded one, relative to the terms
        of the constraint at its time.
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
    z, change, stacked_sizes = stack_signals(x, u), stack_signals(along.x, along.u), np.concatenate(sizes)
    at_point, natural = (problem.quadratic.slope_magnitudes(at).max(0) for at in (z, 0 * z + stacked_sizes))
    scales.append(float(np.maximum(at_point, SCALE_FLOOR * natural) @ np.abs(change).sum(0)))
    (lower, upper), near = problem.signal_bounds, TOUCHING * (stacked_sizes + np.abs(z))
    left = np.maximum(np.where(upper - z <= near, change, 0.0), np.where(z - lower <= near, -change, 0.0))
    residuals.append(float((left / stacked_sizes).max()))
    for term in problem.terms:
        values = term.map.values(x, u)
        change = term.map.values(along.x, along.u) - term.map.values(0 * along.x, 0 * along.u)
        size = float((term.map.sizes(x, u) + np.abs(change)).max())
        left = term.penalty.leaving(values, change, TOUCHING * size)
        residuals.append(left / (max(float(np.abs(change).max()), size) or 1.0))  # zero: a row that limits nothing
        slopes.append(term.penalty.slope(values, change, TOUCHING * size))
        scales.append(abs(slopes[-1]))
    # the cost falls by more than rounding of a satisfied condition, and than the violation of constraints can explain
    slope, residual = sum(slopes), max(residuals)
    gradients = zip(problem.quadratic.gradient(x, u), sizes, strict=True)
    steepest = float(sum((np.abs(part) * size).sum() for part, size in gradients))  # of changes by the sizes
    needed = max(CONDITION_TOLERANCE * sum(scales), residual * steepest)
    if residual > CONDITION_TOLERANCE or not slope < -needed or slope == 0:
        return None
    return Direction(along.x, along.u, slope, residual)


def unbounded_direction(problem: OptimalControlProblem, along: Trajectory) -> Direction | None:
    """Return the direction if every multiple of it is feasible and the cost decreases without bound, else None.

    Signs hold exactly; all else up to DIRECTION_ROUNDING of its own terms at its own time. The direction is taken at a
    length at which offsets, references and limits are rounding errors, so that the origin does not matter.
    """
    along = _normalised_direction(problem, along, stated_sizes(problem))
    signals, (lower, upper) = (along.x, along.u), problem.signal_bounds
    z = stack_signals(*signals)
    if (np.isfinite(upper) & (z > 0)).any() or (np.isfinite(lower) & (z < 0)).any():
        return None
    equations, cost = problem.equations, problem.quadratic
    x, u = (FAR * to_long_double(signal) for signal in signals)
    rest = np.zeros_like(x), np.zeros_like(u)
    moved = equations.successors(x, u) - equations.successors(*rest)
    residuals = [_relative_to(x[1:] - moved, np.abs(x[1:]) + equations.successor_sizes(x, u))]
    for signal, stop in ((x[: problem.state_samples], problem.state_stop), (u, problem.control_stop)):
        terms = np.abs(signal).sum(0) * np.ones(stop.shape)
        residuals.append(_relative_to(np.abs(np.fft.rfft(signal, axis=0)[stop]), terms[stop]))
    changes = [one - other for one, other in zip(cost.gradient(x, u), cost.gradient(*rest), strict=True)]
    residuals.append(_relative_to(stack_signals(*changes), cost.slope_magnitudes(FAR * z)))
    # where the quadratic cost does not bend, its slope is that at the references
    linear = cost.gradient(rest[0] + cost.x_ref, rest[1] + cost.u_ref)
    slopes, scales = _quadratic_slope(Trajectory(x, u), linear)
    for term in problem.terms:
        change, everywhere = term.map.values(x, u) - term.map.values(*rest), term.semi_infinite
        left, price = term.penalty.unbounded(change)
        sizes = np.broadcast_to(term.map.sizes(x, u), change.shape)
        residuals.append(_relative_to(left, sizes if left.shape == sizes.shape else sizes.sum(1, keepdims=True)))
        if everywhere is not None and term.hard and everywhere.map.signal(*signals).any():
            return None  # the spectrum of a signal that is not zero has isolated zeros
        slopes.append(price)
        scales.append(price)
    slope, residual = float(sum(slopes)), max(residuals)
    if residual > DIRECTION_ROUNDING or not slope < -DIRECTION_ROUNDING * sum(scales):
        return None
    return Direction(along.x, along.u, slope / FAR, residual)


def _relative_to(violation: Array, terms: Array) -> float:
    """Return the largest violation relative to its terms; infinite where there are none."""
    size = np.abs(violation)
    return float(np.divide(size, terms, out=np.where(size > 0, np.inf, 0.0), where=terms > 0).max(initial=0.0))


def _normalised_direction(problem: OptimalControlProblem, along: Trajectory, sizes: tuple[Array, Array]) -> Trajectory:
    """Return the direction with a largest entry of 1 in these sizes."""
    problem.require(along)
    largest = float(np.abs(stack_signals(along.x, along.u) / np.concatenate(sizes)).max())
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
