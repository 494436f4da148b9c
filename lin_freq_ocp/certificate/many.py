"""The judge of a batch: trajectories of one problem from many initial states, certified at once.

The bound is that of ``bound.py``, computed on arrays with the trajectories as first axis. Conditions are those of
``Certificate.proven_within``, with scales without their floors: a trajectory that passes here passes there. Callers
judge the others one by one.
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


def batch_judge_takes(problem: OptimalControlProblem) -> bool:
    """Whether ``judge_batch`` takes a problem: time-invariant, quadratic, only boxes and stop bands of controls."""
    cost, dynamics = problem.quadratic, problem.linear
    constant = not dynamics.time_varying and all(part.ndim == 2 for part in (cost.Q, cost.R, cost.S))
    return constant and not problem.terms and not problem.state_stop.any() and bool(problem.ends[0].fixed.all())


def judge_batch(problem: OptimalControlProblem, starts: Array, extremals: Extremals) -> Verdicts:
    """Judge trajectories from initial states (N, n) of a problem that differs in the initial state only."""
    with np.errstate(over="ignore", invalid="ignore"):
        slopes, sizes, signal = _slopes(problem, extremals)
        unit, cost, signals = unit_rounding(problem), problem.quadratic, (extremals.x, extremals.u)
        certain, summed = np.zeros((2, len(starts)))
        references = np.abs(cost.x_ref), np.abs(cost.u_ref)
        lower, upper = (np.repeat(bound[None], len(starts), axis=0) for bound in problem.state_tube.bounds)
        lower[:, 0] = upper[:, 0] = starts
        tubes = (lower, upper), problem.control_tube.bounds
        # curvatures that l_t has at least, (T+1, n) and (m,); the cost is convex
        n, stage, last = problem.state_dim, diagonal_curvature(cost.stage_hessians()[0]), diagonal_curvature(cost.P)
        if stage is None or last is None:
            stage, last = np.zeros(n + problem.control_dim), np.zeros(n)
        curvatures = np.vstack([np.broadcast_to(stage[:n], (problem.horizon, n)), last]), stage[n:]
        for values, slope, size, curvature, (lower, upper), reference in zip(
            signals, slopes, sizes, curvatures, tubes, references, strict=True
        ):
            error = unit * size + ARITHMETIC_ROUNDING * np.abs(slope)
            low, high = lower - values, upper - values
            minimum = np.minimum(*box_minimum(np.stack([slope - error, slope + error]), curvature, low, high))
            certain += (ARITHMETIC_ROUNDING * np.abs(slope * values) - minimum).sum((1, 2))
            summed += (size * (np.abs(values) + reference)).sum((1, 2))
        x, u, dynamics = to_long_double(extremals.x), to_long_double(extremals.u), problem.linear
        residual = (x[:, 1:] - x[:, :-1] @ dynamics.A.T - u @ dynamics.B.T - dynamics.offset).astype(np.float64)
        products = [(extremals.eta * residual).sum((1, 2)), (signal * extremals.u).sum((1, 2))]
        costs, scale = _costs(problem, extremals)
        summed += (np.abs(extremals.eta) * np.abs(problem.linear.offset)).sum((1, 2))
        others = scale + sum(map(np.abs, products)) + np.abs(certain)
        bounds = costs + products[0] + products[1] - certain - unit * summed - ARITHMETIC_ROUNDING * others
        worth = sum(map(np.abs, products))
        for values, normal, tube in zip(signals, (extremals.mu, extremals.nu), tubes, strict=True):
            worth = worth + (np.abs(normal) * _violation(values, tube)).sum((1, 2))
        gaps = np.divide(costs - bounds, scale, out=np.full(len(scale), np.inf), where=scale > 0)
        lower, upper = problem.state_boxes.lower[0], problem.state_boxes.upper[0]
        inside = ((lower <= starts) & (starts <= upper)).all(1)
        proven = (np.abs(gaps) <= GAP_TOLERANCE) & (worth <= GAP_TOLERANCE * scale) & inside
        return Verdicts(costs, bounds, gaps, proven & _feasible(problem, extremals, residual, tubes))


def _slopes(
    problem: OptimalControlProblem, extremals: Extremals
) -> tuple[tuple[Array, Array], tuple[Array, Array], Array]:
    """Return the slopes of l_t in x and u, the sums of the absolute values of their terms, and rho_u over time."""
    cost, dynamics, (count, T, m) = problem.quadratic, problem.linear, extremals.u.shape
    x, u, eta = to_long_double(extremals.x), to_long_double(extremals.u), to_long_double(extremals.eta)
    spectra = to_long_double(extremals.rho_u).swapaxes(0, 1).reshape(-1, count * m)
    signal = time_signal(spectra, T).reshape(T, count, m).swapaxes(0, 1)
    a, b = x - cost.x_ref, u - cost.u_ref
    in_x = np.concatenate([a[:, :-1] @ cost.Q + b @ cost.S.T + cost.q, (a[:, -1] @ cost.P + cost.p)[:, None]], axis=1)
    in_u = b @ cost.R + a[:, :-1] @ cost.S + cost.r + signal - eta @ dynamics.B
    in_x[:, :-1] -= eta @ dynamics.A
    in_x[:, 1:] += eta
    plain, sizes = cost.magnitudes(), dynamics.magnitudes()
    a, b = np.abs(extremals.x) + np.abs(cost.x_ref), np.abs(extremals.u) + np.abs(cost.u_ref)
    eta = np.abs(extremals.eta)
    last = (a[:, -1] @ plain.P + plain.p)[:, None]
    terms_x = np.concatenate([a[:, :-1] @ plain.Q + b @ plain.S.T + plain.q, last], axis=1)
    terms_x[:, :-1] += eta @ sizes.A
    terms_x[:, 1:] += eta
    terms_u = b @ plain.R + a[:, :-1] @ plain.S + plain.r + eta @ sizes.B
    terms_u += np.abs(extremals.rho_u).sum(1, keepdims=True)
    return (in_x.astype(np.float64), in_u.astype(np.float64)), (terms_x, terms_u), signal.astype(np.float64)


def _costs(problem: OptimalControlProblem, extremals: Extremals) -> tuple[Array, Array]:
    """Return the costs and the sums of the absolute values of their terms, both (N,)."""
    cost, x, u = problem.quadratic, extremals.x, extremals.u
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
    extremals: Extremals,
    residual: Array,
    tubes: tuple[tuple[Array, Array], tuple[Array, Array]],
) -> Mask:
    """Return which trajectories satisfy dynamics, bounds and stop bands, relative to the sizes of the components."""
    x, u, sizes = np.abs(extremals.x), np.abs(extremals.u), problem.linear.magnitudes()
    moved = np.maximum(x.max(1), (u @ sizes.B.T + sizes.offset).max(1))
    checks = [(np.abs(residual).max(1), moved)]
    for values, tube in zip((extremals.x, extremals.u), tubes, strict=True):
        checks.append((_violation(values, tube).max(1), np.abs(values).max(1)))
    spectra = np.abs(np.fft.rfft(extremals.u, axis=1)) * problem.control_stop
    checks.append((spectra.max(1), np.linalg.norm(extremals.u, axis=1)))
    return np.all([(error <= CONDITION_TOLERANCE * scale).all(1) for error, scale in checks], axis=0)
