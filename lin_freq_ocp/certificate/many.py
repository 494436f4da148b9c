"""The judge of a batch: trajectories of one problem from many initial states, certified at once.

The bound is that of ``bound.py``, computed on arrays with the trajectories as first axis. Conditions are those of
``Certificate.proven_within``, with scales without their floors: a trajectory that passes here passes there. Callers
judge the others one by one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, times_vectors, to_long_double
from lin_freq_ocp.certificate.bound import box_minimum, unit_rounding
from lin_freq_ocp.certificate.hamiltonian import diagonal_curvature
from lin_freq_ocp.certificate.reach import Pair, constant_radii
from lin_freq_ocp.certificate.tolerances import ARITHMETIC_ROUNDING, CONDITION_TOLERANCE, GAP_TOLERANCE, RADIUS_MARGIN
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.trajectory import Extremals


@dataclass(frozen=True, eq=False)
class Verdicts:
    """Costs, rigorous lower bounds, gaps relative to the cost's terms, and whether each is proven optimal, all (N,)."""

    costs: Array
    bounds: Array
    gaps: Array
    proven: Mask


def batch_judge_takes(problem: OptimalControlProblem) -> bool:
    """Whether ``judge_batch`` takes a problem: time-invariant, quadratic, boxes, stop bands of controls, rows at times.

    Rows at times are joint rows and soft sets of half-spaces, the same terms for every initial state.
    """
    cost, dynamics = problem.quadratic, problem.linear
    constant = not dynamics.time_varying and all(part.ndim == 2 for part in (cost.Q, cost.R, cost.S))
    if not constant or problem.cost.has_formulas or problem.state_stop.any() or not problem.ends[0].fixed.all():
        return False
    of_start = problem.hard_state_sets or bool(problem.initial_state.members) or bool(problem.met_ends[0][1].any())
    return not of_start and all(term.repeated(1, problem.horizon + 1) is not None for term in problem.terms)


def judge_batch(problem: OptimalControlProblem, starts: Array, extremals: Extremals) -> Verdicts:
    """Judge trajectories from initial states (N, n) of a problem that differs in the initial state only."""
    with np.errstate(over="ignore", invalid="ignore"):
        terms = _price_terms(problem, extremals)
        slopes, sizes, signal = _slopes(problem, extremals, terms)
        unit, cost, signals = unit_rounding(problem), problem.quadratic, (extremals.x, extremals.u)
        x, u, dynamics = to_long_double(extremals.x), to_long_double(extremals.u), problem.linear
        moved = _times(x[:, :-1], dynamics.A.T) + _times(u, dynamics.B.T) + dynamics.offset
        exact_residual = x[:, 1:] - moved
        residual = exact_residual.astype(np.float64)
        lower, upper = (np.repeat(bound[None], len(starts), axis=0) for bound in problem.state_tube.bounds)
        lower[:, 0] = upper[:, 0] = starts
        tubes = (lower, upper), problem.control_tube.bounds
        # curvatures that l_t has at least, (T+1, n) and (m,); the cost is convex
        n, stage, last = problem.state_dim, diagonal_curvature(cost.stage_hessians()[0]), diagonal_curvature(cost.P)
        if stage is None or last is None:
            stage, last = np.zeros(n + problem.control_dim), np.zeros(n)
        curvatures = np.vstack([np.broadcast_to(stage[:n], (problem.horizon, n)), last]), stage[n:]
        certain, summed = np.zeros((2, len(starts)))
        minima_over = _reachable_states(problem, extremals, residual, tubes, curvatures[0]), tubes[1]
        references = np.abs(cost.x_ref), np.abs(cost.u_ref)
        for values, slope, size, curvature, (lower, upper), reference in zip(
            signals, slopes, sizes, curvatures, minima_over, references, strict=True
        ):
            error = unit * size + ARITHMETIC_ROUNDING * np.abs(slope)
            low, high = lower - values, upper - values
            minimum = np.minimum(*box_minimum(np.stack([slope - error, slope + error]), curvature, low, high))
            certain -= minimum.sum((1, 2))
            summed += (size * (np.abs(values) + reference)).sum((1, 2))
        # their terms may cancel
        products = [part.sum((1, 2)).astype(np.float64) for part in (extremals.eta * exact_residual, signal * u)]
        costs, scale = _costs(problem, extremals)
        summed += (np.abs(extremals.eta) * np.abs(problem.linear.offset)).sum((1, 2))
        worth = sum(map(np.abs, products))
        for values, normal, tube in zip(signals, (extremals.mu, extremals.nu), tubes, strict=True):
            worth = worth + (np.abs(normal) * _violation(values, tube)).sum((1, 2))
        for term in terms:
            products.append(-term.gaps)
            costs, scale = costs + term.costs, scale + np.abs(term.costs)
            summed += term.gap_terms
            worth += term.worth
        others = scale + sum(map(np.abs, products)) + np.abs(certain)
        bounds = costs + sum(products) - certain - unit * summed - ARITHMETIC_ROUNDING * others
        gaps = np.divide(costs - bounds, scale, out=np.full(len(scale), np.inf), where=scale > 0)
        lower, upper = problem.state_boxes.lower[0], problem.state_boxes.upper[0]
        inside = ((lower <= starts) & (starts <= upper)).all(1)
        proven = (np.abs(gaps) <= GAP_TOLERANCE) & (worth <= GAP_TOLERANCE * scale) & inside
        for term in terms:
            proven &= term.satisfied
        return Verdicts(costs, bounds, gaps, proven & _feasible(problem, extremals, residual, tubes))


@dataclass(frozen=True, eq=False)
class _PricedTerms:
    """A term h(L(x, u)) along N trajectories: sums over its groups, (N,), and what it adds to the slopes of l_t.

    As in ``hamiltonian.PricedTerm``: ``gaps`` are h(v) + h*(lambda+) - <lambda+, v>, ``gap_terms`` the absolute values
    of their terms; ``worth`` is |lambda+| times the violation, and ``satisfied`` says whether hard limits hold.
    """

    costs: Array
    gaps: Array
    gap_terms: Array
    worth: Array
    satisfied: Mask
    pulled: Pair  # in x (N, T+1, n) and u (N, T, m)
    pulled_sizes: Pair


def _price_terms(problem: OptimalControlProblem, extremals: Extremals) -> list[_PricedTerms]:
    """Return the terms of a problem, evaluated as of a single trajectory: all trajectories one after another."""
    if not problem.terms:
        return []
    count, samples, n = extremals.x.shape
    controls = np.concatenate([extremals.u, np.zeros((count, 1, extremals.u.shape[2]))], axis=1)
    x, u = extremals.x.reshape(-1, n), controls.reshape(count * samples, -1)
    in_long, shapes = (to_long_double(x), to_long_double(u)), (x.shape, u.shape)

    def by_trajectory(pulled: Pair) -> Pair:
        return pulled[0].reshape(count, samples, -1), pulled[1].reshape(count, samples, -1)[:, :-1]

    def over_groups(values: Array) -> Array:
        return values.reshape(count, -1).sum(1).astype(np.float64)

    priced = list[_PricedTerms]()
    for given in problem.terms:
        term = given.repeated(count, samples)
        assert term is not None  # the judge takes the problem
        penalty, dim = term.penalty, term.shape[1]
        multipliers = extremals.stage.get(term.name)
        multipliers = np.zeros(term.shape) if multipliers is None else multipliers.reshape(-1, dim)
        weights = penalty.subgradient(to_long_double(multipliers), 1.0)
        values, sizes = term.map.values(*in_long), term.map.sizes(x, u)
        gap, limits = penalty.gap(values, weights, 1.0), np.broadcast_to(penalty.sizes(), values.shape)
        violation = penalty.violation(values) if term.hard else np.zeros((len(values), 1))
        largest = sizes.reshape(count, -1, dim).max(1)
        beyond = violation.reshape(count, -1, violation.shape[1]).max(1)
        priced.append(
            _PricedTerms(
                costs=over_groups(penalty.cost(values)),
                gaps=over_groups(gap),
                gap_terms=over_groups(np.abs(weights) * (sizes + limits)) + over_groups(np.abs(gap)),
                worth=over_groups(np.abs(weights) * violation),
                satisfied=(beyond <= CONDITION_TOLERANCE * largest).all(1),
                pulled=by_trajectory(term.map.pull_back(weights, shapes)),
                pulled_sizes=by_trajectory(term.map.pulled_sizes(weights, shapes)),
            )
        )
    return priced


def _reachable_states(
    problem: OptimalControlProblem, extremals: Extremals, residual: Array, tubes: tuple[Pair, Pair], curvature: Array
) -> Pair:
    """Return bounds of all states, (N, T+1, n): the stated ones; absent ones of l_t without curvature are implied.

    A feasible trajectory differs from the given one by what controls within their bounds, its residual and its first
    state move, at most.
    """
    (lower, upper), (least, most) = tubes
    absent = (np.isinf(lower) | np.isinf(upper)) & (curvature <= 0)
    if not absent.any() or not np.isfinite(least).all() or not np.isfinite(most).all():
        return lower, upper
    reach = np.maximum(np.abs(most - extremals.u), np.abs(extremals.u - least)).max(1)
    moved = np.abs(residual).max(1) + (RADIUS_MARGIN - 1) * np.abs(extremals.x).max(1)
    apart = np.abs(extremals.x[:, 0] - lower[:, 0])
    radii = constant_radii(problem.linear, apart.T, np.hstack([reach, moved]).T, problem.horizon)
    radius = RADIUS_MARGIN * np.moveaxis(radii, 2, 0) + (RADIUS_MARGIN - 1) * np.abs(extremals.x)
    low, high = np.maximum(lower, extremals.x - radius), np.minimum(upper, extremals.x + radius)
    return np.where(absent, low, lower), np.where(absent, high, upper)


def _slopes(
    problem: OptimalControlProblem, extremals: Extremals, terms: list[_PricedTerms]
) -> tuple[Pair, Pair, Array]:
    """Return the slopes of l_t in x and u, the sums of the absolute values of their terms, and rho_u over time.

    The last is in extended precision.
    """
    cost, dynamics, (count, T, m) = problem.quadratic, problem.linear, extremals.u.shape
    x, u, eta = to_long_double(extremals.x), to_long_double(extremals.u), to_long_double(extremals.eta)
    rho_u = np.where(problem.control_stop, extremals.rho_u, 0.0)  # a free bin has no price
    spectra = to_long_double(rho_u).swapaxes(0, 1).reshape(-1, count * m)
    signal = time_signal(spectra, T).reshape(T, count, m).swapaxes(0, 1)
    a, b = x - cost.x_ref, u - cost.u_ref
    inner, last = a[:, :-1], (a[:, -1] @ cost.P + cost.p)[:, None]
    in_x = np.concatenate([_times(inner, cost.Q) + _times(b, cost.S.T) + cost.q, last], axis=1)
    in_u = _times(b, cost.R) + _times(inner, cost.S) + cost.r + signal - _times(eta, dynamics.B)
    in_x[:, :-1] -= _times(eta, dynamics.A)
    in_x[:, 1:] += eta
    plain, sizes = cost.magnitudes(), dynamics.magnitudes()
    a, b = np.abs(a).astype(np.float64), np.abs(b).astype(np.float64)
    eta, inner, last = np.abs(extremals.eta), a[:, :-1], (a[:, -1] @ plain.P + plain.p)[:, None]
    terms_x = np.concatenate([_times(inner, plain.Q) + _times(b, plain.S.T) + plain.q, last], axis=1)
    terms_x[:, :-1] += _times(eta, sizes.A)
    terms_x[:, 1:] += eta
    terms_u = _times(b, plain.R) + _times(inner, plain.S) + plain.r + _times(eta, sizes.B)
    terms_u += np.abs(rho_u).sum(1, keepdims=True)
    for term in terms:
        in_x += term.pulled[0]
        in_u += term.pulled[1]
        terms_x += term.pulled_sizes[0]
        terms_u += term.pulled_sizes[1]
    return (in_x.astype(np.float64), in_u.astype(np.float64)), (terms_x, terms_u), signal


def _times(signals: Array, matrix: Array) -> Array:
    """Return signals (N, T, k) times a matrix (k, columns)."""
    count, T, size = signals.shape
    return times_vectors(matrix.T, signals.reshape(-1, size)).reshape(count, T, -1)


def _costs(problem: OptimalControlProblem, extremals: Extremals) -> tuple[Array, Array]:
    """Return the costs and the sums of the absolute values of their terms, both (N,)."""
    cost, x, u = problem.quadratic, extremals.x, extremals.u
    a, b = x - cost.x_ref, u - cost.u_ref
    of_x = 0.5 * _times(a[:, :-1], cost.Q) + _times(b, cost.S.T)
    squares = 0.5 * (b * _times(b, cost.R)).sum(2) + (a[:, :-1] * of_x).sum(2)
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
