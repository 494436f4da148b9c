"""Many trajectories of one problem from many initial states at once: which of them are proven to be optimal.

The bound is that of ``bound.py``, by arrays with the trajectories first. Conditions are those of ``Certificate.
proven_within``, with scales without their floors: what passes here passes there, and what does not is for the judge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Mask, to_long_double
from lin_freq_ocp.certificate.bound import box_minimum, diagonal_curvature, unit_rounding
from lin_freq_ocp.certificate.tolerances import ARITHMETIC_ROUNDING, CONDITION_TOLERANCE, GAP_TOLERANCE
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import time_signal


@dataclass(frozen=True, eq=False)
class Extremals:
    """Trajectories (N, T+1, n), (N, T, m) with eta (N, T, n), mu, nu as x and u, and rho_u (N, bins, m)."""

    x: Array
    u: Array
    eta: Array
    mu: Array
    nu: Array
    rho_u: ComplexArray


@dataclass(frozen=True, eq=False)
class Verdicts:
    """Costs, rigorous lower bounds, gaps relative to the cost's terms, and whether each is proven optimal, all (N,)."""

    costs: Array
    bounds: Array
    gaps: Array
    proven: Mask


def judged_together(problem: OptimalControlProblem) -> bool:
    """Whether ``verdicts`` takes a problem: time-invariant, quadratic cost, boxes and stop bands of controls only."""
    cost, dynamics = problem.quadratic, problem.linear
    constant = not dynamics.time_varying and all(part.ndim == 2 for part in (cost.Q, cost.R, cost.S))
    return constant and not problem.terms and not problem.state_stop.any() and bool(problem.ends[0].fixed.all())


def verdicts(problem: OptimalControlProblem, starts: Array, given: Extremals) -> Verdicts:
    """Judge trajectories from initial states (N, n), of a problem that is otherwise the same."""
    with np.errstate(over="ignore", invalid="ignore"):
        slopes, sizes, signal = _slopes(problem, given)
        unit = unit_rounding(problem)
        certain = np.zeros(len(starts))
        summed = np.zeros(len(starts))
        cost = problem.quadratic
        references = np.abs(cost.x_ref), np.abs(cost.u_ref)
        tubes = _tubes(problem, starts)
        for values, slope, size, curvature, (lower, upper), reference in zip(
            (given.x, given.u), slopes, sizes, _curvatures(problem), tubes, references, strict=True
        ):
            error = unit * size + ARITHMETIC_ROUNDING * np.abs(slope)
            low, high = lower - values, upper - values
            minimum = np.minimum(*box_minimum(np.stack([slope - error, slope + error]), curvature, low, high))
            certain += (ARITHMETIC_ROUNDING * np.abs(slope * values) - minimum).sum((1, 2))
            summed += (size * (np.abs(values) + reference)).sum((1, 2))
        x, u, dynamics = to_long_double(given.x), to_long_double(given.u), problem.linear
        residual = (x[:, 1:] - x[:, :-1] @ dynamics.A.T - u @ dynamics.B.T - dynamics.offset).astype(np.float64)
        products = [(given.eta * residual).sum((1, 2)), (signal * given.u).sum((1, 2))]
        costs, scale = _costs(problem, given)
        summed += (np.abs(given.eta) * np.abs(problem.linear.offset)).sum((1, 2))
        others = scale + sum(map(np.abs, products)) + np.abs(certain)
        bounds = costs + products[0] + products[1] - certain - unit * summed - ARITHMETIC_ROUNDING * others
        in_x = np.abs(given.mu) * _violation(given.x, tubes[0])
        of_bounds = in_x.sum((1, 2)) + (np.abs(given.nu) * _violation(given.u, tubes[1])).sum((1, 2))
        worth = sum(map(np.abs, products)) + of_bounds
        gaps = np.divide(costs - bounds, scale, out=np.full(len(scale), np.inf), where=scale > 0)
        lower, upper = problem.state_boxes.lower[0], problem.state_boxes.upper[0]
        inside = ((lower <= starts) & (starts <= upper)).all(1)
        proven = (np.abs(gaps) <= GAP_TOLERANCE) & (worth <= GAP_TOLERANCE * scale) & inside
        return Verdicts(costs, bounds, gaps, proven & _feasible(problem, given, residual, tubes))


def _slopes(problem: OptimalControlProblem, given: Extremals) -> tuple[tuple[Array, Array], tuple[Array, Array], Array]:
    """Return the slopes of l_t in x and u, the sums of the absolute values of their terms, and rho_u over time."""
    cost, dynamics, (count, T, m) = problem.quadratic, problem.linear, given.u.shape
    x, u, eta = to_long_double(given.x), to_long_double(given.u), to_long_double(given.eta)
    spectra = to_long_double(given.rho_u).swapaxes(0, 1).reshape(-1, count * m)
    signal = time_signal(spectra, T).reshape(T, count, m).swapaxes(0, 1)
    a, b = x - cost.x_ref, u - cost.u_ref
    in_x = np.concatenate([a[:, :-1] @ cost.Q + b @ cost.S.T + cost.q, (a[:, -1] @ cost.P + cost.p)[:, None]], axis=1)
    in_u = b @ cost.R + a[:, :-1] @ cost.S + cost.r + signal - eta @ dynamics.B
    in_x[:, :-1] -= eta @ dynamics.A
    in_x[:, 1:] += eta
    plain, sizes = cost.magnitudes(), dynamics.magnitudes()
    a, b, eta = np.abs(given.x) + np.abs(cost.x_ref), np.abs(given.u) + np.abs(cost.u_ref), np.abs(given.eta)
    last = (a[:, -1] @ plain.P + plain.p)[:, None]
    terms_x = np.concatenate([a[:, :-1] @ plain.Q + b @ plain.S.T + plain.q, last], axis=1)
    terms_x[:, :-1] += eta @ sizes.A
    terms_x[:, 1:] += eta
    terms_u = b @ plain.R + a[:, :-1] @ plain.S + plain.r + eta @ sizes.B + np.abs(given.rho_u).sum(1, keepdims=True)
    return (in_x.astype(np.float64), in_u.astype(np.float64)), (terms_x, terms_u), signal.astype(np.float64)


def _curvatures(problem: OptimalControlProblem) -> tuple[Array, Array]:
    """Return curvatures that l_t has at least, (T+1, n) and (m,); the cost is convex."""
    n, T = problem.state_dim, problem.horizon
    stage, last = diagonal_curvature(problem.quadratic.stage_hessians()[0]), diagonal_curvature(problem.quadratic.P)
    if stage is None or last is None:
        stage, last = np.zeros(n + problem.control_dim), np.zeros(n)
    return np.vstack([np.broadcast_to(stage[:n], (T, n)), last]), stage[n:]


def _tubes(problem: OptimalControlProblem, starts: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return the bounds of the states, (N, T+1, n), and of the controls, (T, m)."""
    tube, count = problem.state_tube, len(starts)
    lower, upper = (np.repeat(bound[None], count, axis=0) for bound in tube.bounds)
    lower[:, 0] = upper[:, 0] = starts
    return (lower, upper), problem.control_tube.bounds


def _costs(problem: OptimalControlProblem, given: Extremals) -> tuple[Array, Array]:
    """Return the costs and the sums of the absolute values of their terms, both (N,)."""
    cost, x, u = problem.quadratic, given.x, given.u
    a, b = x - cost.x_ref, u - cost.u_ref
    squares = 0.5 * (b * (b @ cost.R)).sum(2) + (a[:, :-1] * (0.5 * a[:, :-1] @ cost.Q + b @ cost.S.T)).sum(2)
    last = 0.5 * (a[:, -1] * (a[:, -1] @ cost.P)).sum(1)
    linear = x[:, :-1] * cost.q, u * cost.r, x[:, -1:] * cost.p
    costs = squares.sum(1) + last + sum(part.sum((1, 2)) for part in linear)
    return costs, np.abs(squares).sum(1) + np.abs(last) + sum(np.abs(part).sum((1, 2)) for part in linear)


def _violation(values: Array, tube: tuple[Array, Array]) -> Array:
    return np.maximum(np.maximum(tube[0] - values, values - tube[1]), 0.0)


def _feasible(
    problem: OptimalControlProblem,
    given: Extremals,
    residual: Array,
    tubes: tuple[tuple[Array, Array], tuple[Array, Array]],
) -> Mask:
    """Return which trajectories satisfy dynamics, bounds and stop bands, each relative to its component's size."""
    x, u, sizes = np.abs(given.x), np.abs(given.u), problem.linear.magnitudes()
    moved = np.maximum(x.max(1), (u @ sizes.B.T + sizes.offset).max(1))
    checks = [(np.abs(residual).max(1), moved)]
    checks += [
        (_violation(one, tube).max(1), np.abs(one).max(1)) for one, tube in zip((given.x, given.u), tubes, strict=True)
    ]
    spectra = np.abs(np.fft.rfft(given.u, axis=1)) * problem.control_stop
    checks.append((spectra.max(1), np.linalg.norm(given.u, axis=1)))
    return np.all([(error <= CONDITION_TOLERANCE * scale).all(1) for error, scale in checks], axis=0)
