"""What saves time in the exchange; the method is complete without it (docs/spectral.md, 7 and 11).

On short horizons, the effect of each bounded value on all others is computed once (WholeHorizon in ``structure``), and
the exchange runs on these values (exchange_values). On long ones, kernels give the values near the working rows
(Neighbourhood). The signals of all bins verify the result of either. The first working set of a long horizon is that
of a cheaper problem.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.methods.spectral.kkt import BorderedSystem
from lin_freq_ocp.methods.spectral.model import Lti
from lin_freq_ocp.methods.spectral.qp import RowQp, Stop, bounded_qp
from lin_freq_ocp.methods.spectral.rows import Rows, Violations, WorkingSet, entering_violation
from lin_freq_ocp.methods.spectral.structure import WholeHorizon

LOCAL_ROWS = 300  # working rows beyond which the small QP costs more than the signals of all samples
NEIGHBOURHOOD_HORIZON = 10_000  # horizon from which kernels cost less than FFTs
NEIGHBOURHOOD_WINDOW = 24  # samples on each side of a working row
MOST_NEIGHBOURS = 20_000  # of a neighbourhood; with more, FFTs are cheaper
MODEL_ROUNDS = 12  # rounds on couplings, after which the true signals are evaluated
GUESSED_HORIZON = 600  # horizon from which a first guess costs less than the rounds that it saves
HOLD_FACTOR = 8  # samples of a control that are equal in the coarse problem
SPREAD = 2  # further samples on each side of an active coarse control
DECAY_EXPONENT = 40.0  # the ends do not affect each other where the slowest mode decays by exp(-DECAY_EXPONENT)
ON_CIRCLE = 1e-6  # |log |lambda|| up to which a mode does not decay: it has no decay time
LEAST_SHORTENING = 2  # least ratio of the horizons; HOLD_FACTOR if samples may be held instead
HOLD_GROWTH = 4.0  # largest growth of the fastest mode over held samples
LARGEST_SHORTENING = 10  # largest ratio of the horizons
SHORT_TOLERANCE, HOLD_TOLERANCE = 1e-6, 1e-4  # violations at which the cheaper problems of the first set stop


def neighbourhood_of(kkt: BorderedSystem, violations: Violations, working: WorkingSet) -> Neighbourhood | None:
    """Return the samples around the working rows; None if these are absent, many or soft, or the horizon is short."""
    T, inner = violations.lti.horizon, working.inner
    if T < NEIGHBOURHOOD_HORIZON or violations.lti.soft:
        return None
    window = np.arange(-NEIGHBOURHOOD_WINDOW, NEIGHBOURHOOD_WINDOW + 1)
    times = (working.t[inner, None] + window).clip(0, T - 1)
    keys = np.unique((working.f[inner, None] * T + times).ravel())
    return Neighbourhood(kkt, violations, keys % T, keys // T) if 0 < len(keys) <= MOST_NEIGHBOURS else None


class Neighbourhood:
    """Rows F_f y_t, t < T, with both their bounds, in the order of f, then t."""

    def __init__(self, kkt: BorderedSystem, violations: Violations, t: Indices, f: Indices):
        lti = violations.lti
        lower, upper = lti.bounds.at(t, f, -1.0), lti.bounds.at(t, f, 1.0)
        free = (np.isfinite(lower) | np.isfinite(upper)) & ~lti.is_fixed(t, f)
        t, f = t[free], f[free]
        self._kkt, self.t, self.f = kkt, t, f
        self._lower, self._upper, self._scale = lower[free], upper[free], violations.scale[f]
        self._is_state = ~lti.F[f, lti.state_dim :].any(1)
        self._coupling = kkt.coupling(t, f)

    def entering(
        self, y: Array, working: WorkingSet, step: Array, weights: Array, tolerance: float
    ) -> tuple[Indices, Indices, Array]:
        """Return (t, f, sign) of the rows to add: a bordering step with new weights violates these."""
        kkt, inner = self._kkt, working.inner
        values = kkt.lti.row_values(y, self.t, self.f) + step @ self._coupling
        change = working.sign * (weights - working.weights)
        acting = np.flatnonzero(inner & (change != 0))
        values -= kkt.kernels.gram(self.t, self.f, working.t[acting], working.f[acting]) @ change[acting]
        above, below = values - self._upper, self._lower - values
        violation = np.maximum(above, below) / self._scale
        # violated peaks of states, and violated or nearly active samples of the others
        worst = float(violation.max(initial=0.0))
        entering = violation > np.where(self._is_state, tolerance, entering_violation(worst, tolerance))
        if self._is_state.any():
            follows = (np.diff(self.t) == 1) & (np.diff(self.f) == 0)
            before, after = (np.where(follows, side, -np.inf) for side in (violation[:-1], violation[1:]))
            peaks = (violation >= np.append(-np.inf, before)) & (violation >= np.append(after, -np.inf))
            entering &= ~self._is_state | peaks
        chosen = np.flatnonzero(entering & (not worst <= tolerance))
        return self.t[chosen], self.f[chosen], np.where(above[chosen] >= below[chosen], 1.0, -1.0)


def exchange_values(
    whole: WholeHorizon, violations: Violations, start: Rows, base: Array, tolerance: float, stop: Stop
) -> tuple[Rows, int, bool]:
    """Exchange until no value violates its bound by more than the tolerance, for MODEL_ROUNDS at most.

    ``base`` (values,) are those without multipliers, v_0. Return the rows with their weights, the number of small QPs,
    and whether the last of them is accurate.
    """
    index, sign, weights = whole.distinct(start)
    lti, solved, rounds, present = violations.lti, start, 0, np.zeros(len(base), dtype=bool)
    n = lti.state_dim
    for count in range(1, MODEL_ROUNDS + 1):
        values, saturated = base, index[:0]
        if len(index):
            t, f = whole.t[index], whole.f[index]
            delta = sign * (lti.bounds.at(t, f, sign) - base[index])
            price, diagonal_bound = lti.price_of(t, f, sign), lti.diagonal_bound[f] * (t < lti.horizon)
            S = whole.gram(index) * sign * sign[:, None]
            qp = RowQp(S, delta, price, diagonal_bound, whole.free_response[index])
            weights, accurate = bounded_qp(qp, weights, stop)
            solved, rounds = Rows(t, f, sign, weights), count
            if not accurate:
                return solved, rounds, False
            values = base - whole.response(index, sign * weights)
            saturated = index[weights >= price]
        parts = values[:-n].reshape(len(whole.rows), -1), values[-n:]
        if violations.measure_values(*parts, whole.t[saturated], whole.f[saturated]) < tolerance or stop():
            break
        active = weights > 0
        index, sign, weights = index[active], sign[active], weights[active]
        present[:] = False
        present[index] = True
        entering, side = violations.entering_values(tolerance)
        new = ~present[entering]
        added = np.count_nonzero(new)
        if not added or len(index) + added > LOCAL_ROWS:
            break
        index, sign = np.concatenate([index, entering[new]]), np.concatenate([sign, side[new]])
        weights = np.concatenate([weights, np.zeros(added)])
    return solved, rounds, True


def cheaper_problem(lti: Lti) -> tuple[Lti, float, Callable[[Rows], Rows]] | None:
    """Return a problem with a similar set of active rows, its tolerance, and the map of its rows to rows of ``lti``.

    It has a coarser control, or a shorter horizon; None if neither saves time.
    """
    if lti.horizon < GUESSED_HORIZON or lti.response is not None or not lti.has_limits:
        return None
    shorter = _shortened_horizon(lti)
    growth = np.abs(np.linalg.eigvals(lti.A)).max() ** HOLD_FACTOR  # over the samples of a zero-order hold
    if shorter * HOLD_FACTOR > lti.horizon and growth <= HOLD_GROWTH:
        return _hold_samples(lti), HOLD_TOLERANCE, lambda rows: _refine_rows(lti, rows)
    if shorter * LEAST_SHORTENING > lti.horizon:
        return None
    moved = lti.horizon - shorter  # of the rows near the end
    return (
        _shorten(lti, shorter),
        SHORT_TOLERANCE,
        lambda rows: Rows(np.where(rows.t < shorter // 2, rows.t, rows.t + moved), rows.f, rows.sign),
    )


def _shortened_horizon(lti: Lti) -> int:
    """Return the horizon at which the ends do not affect each other; the given horizon if there is none."""
    rate = np.abs(np.log(np.abs(np.linalg.eigvals(lti.A)) + 1e-300))
    rate = rate[rate > ON_CIRCLE]
    decay_time = int(DECAY_EXPONENT / rate.min()) if len(rate) else lti.horizon
    return max(2 * decay_time, lti.horizon // LARGEST_SHORTENING)


def _shorten(lti: Lti, T: int) -> Lti:
    """Return the problem without its middle; bands keep their frequencies."""
    times = np.append(np.arange(T // 2), np.arange(lti.horizon - (T - T // 2), lti.horizon))
    bins = np.round(np.arange(T // 2 + 1) * (lti.horizon / T)).astype(int).clip(0, lti.horizon // 2)
    return _without_equations(lti, T, lti.passed[:, bins], lambda signal: signal[:, times])


def _hold_samples(lti: Lti) -> Lti:
    """Return the problem with a zero-order hold of HOLD_FACTOR samples on the control."""
    T, n = lti.horizon // HOLD_FACTOR, lti.state_dim
    A, B = np.eye(n), np.zeros_like(lti.B)
    offset = None if lti.offset is None else np.zeros((n, T))
    for j in range(HOLD_FACTOR):
        A, B = lti.A @ A, lti.A @ B + lti.B
        if offset is not None and lti.offset is not None:
            offset = lti.A @ offset + lti.offset[:, j : HOLD_FACTOR * T : HOLD_FACTOR]
    coarse = _without_equations(lti, T, lti.passed[:, : T // 2 + 1], lambda v: v[:, : HOLD_FACTOR * T : HOLD_FACTOR])
    linear = None if lti.linear is None else lti.linear[:, : HOLD_FACTOR * T].reshape(len(lti.M), T, HOLD_FACTOR).sum(2)
    prices = coarse.prices.map(lambda price: HOLD_FACTOR * price)
    return replace(coarse, A=A, B=B, M=lti.M * HOLD_FACTOR, linear=linear, offset=offset, prices=prices)


def _without_equations(lti: Lti, T: int, passed: Mask, sample: Callable[[Array], Array]) -> Lti:
    """Return the problem at another horizon, without state bands and without values fixed by bounds."""
    bounds = lti.bounds.map(sample)
    fixed = bounds.lower == bounds.upper
    return replace(
        lti,
        horizon=T,
        passed=passed,
        state_stop=np.zeros(((T + 1) // 2 + 1, lti.state_dim), dtype=bool),
        bounds=replace(
            bounds, lower=np.where(fixed, -np.inf, bounds.lower), upper=np.where(fixed, np.inf, bounds.upper)
        ),
        linear=None if lti.linear is None else sample(lti.linear),
        offset=None if lti.offset is None else sample(lti.offset),
        prices=lti.prices.map(sample),
    )


def _refine_rows(lti: Lti, coarse: Rows) -> Rows:
    """Return rows of the coarse problem as rows of ``lti``: controls with their neighbours, states once, and x_T."""
    (t, f, sign, _), n, T = coarse, lti.state_dim, lti.horizon
    last = t == T // HOLD_FACTOR
    states = ~last & ~lti.F[f, n:].any(1)
    controls = ~last & ~states
    around = np.arange(-SPREAD, HOLD_FACTOR + SPREAD)
    many = (t[controls, None] * HOLD_FACTOR + around).clip(0, T - 1).ravel()
    times = np.concatenate([np.full(int(last.sum()), T), t[states] * HOLD_FACTOR, many])
    rows = np.concatenate([f[last], f[states], np.repeat(f[controls], len(around))])
    signs = np.concatenate([sign[last], sign[states], np.repeat(sign[controls], len(around))])
    _, unique = np.unique((times * len(lti.F) + rows) * 2 + (signs > 0), return_index=True)
    return Rows(times[unique], rows[unique], signs[unique])
