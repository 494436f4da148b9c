"""The exchange: a small QP over the working rows, signals by FFT, new rows, until no row is violated.

docs/spectral.md, 7 and 8. Every round corrects the residuals of the true signals (section 6): its fixed point has true
slacks in spite of errors of the small QP.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.spectral.model import Lti
from lin_freq_ocp.methods.spectral.qp import BorderedQp, Stop, bounded_qp
from lin_freq_ocp.methods.spectral.rows import Rows, Violations, WorkingSet, bounded_rows
from lin_freq_ocp.methods.spectral.shortcuts import (
    LOCAL_ROWS,
    WholeHorizon,
    cheaper_problem,
    exchange_values,
    neighbourhood_of,
)
from lin_freq_ocp.methods.spectral.structure import (
    RAY_TOLERANCE,
    Data,
    Ray,
    Signals,
    Structure,
    equation_ray,
    regularised_ray,
    row_ray,
)

INFEASIBLE = "no trajectory satisfies all constraints"
MOST_ROUNDS = 60  # of an exchange; 1 to 12 are usual
QP_SECONDS = 1e-10  # measured time of a small QP over the cube of its rows
LARGE_QP = 1000  # rows of a small QP that takes 0.1 s: it is not begun if less time is left
LOCAL_ROUNDS = 6  # small QPs with further rows nearby, before all signals are evaluated
KEEP_ALL_AFTER = 30  # rounds after which no row is dropped: the exchange is then finite
STALLED_ROUNDS = 3  # rounds that neither halve the violation nor, above FINE_VIOLATION, add a row
RAY_ROUNDS = 8  # rounds between Farkas rays; one is also computed if the small QP is not accurate
LONGER_STEPS = 0.03  # factor on the proximal weight of compliant unknowns
LEAST_SIZE = 1e-4  # components that should be zero hold rounding: they are not measured more finely than this
VIOLATION_TOLERANCE = 1e-12  # relative violation of a bound at which it stops; rounding of the signals is near 1e-15
FINE_VIOLATION = 1e-9  # ... above which a round that adds a row improves, even if it does not halve the violation
ACCEPTED_VIOLATION = 1e-7  # ... that is accepted where it no longer improves
NEARLY_FEASIBLE = 1e-3  # ... below which longer steps are taken along directions without cost
EQUATION_TOLERANCE = 1e-9  # residual of the bordered system's equations, relative to the largest signal
EQUATION_CONFLICT = 1e-7  # ... from which the dependent equations are tested for infeasibility
SLOPE_TOLERANCE = 1e-10  # slope left in the bordering unknowns, relative to its terms
ACCEPTED_SLOPE = 1e-7  # ... that is accepted where it no longer improves
SLACK_TOLERANCE = 1e-9  # <multipliers, slacks> left, relative to the cost
ACCEPTED_SLACK = 1e-7  # ... that is accepted where it no longer improves
GAIN_TOLERANCE = 1e-15  # possible decrease of the cost along the bordering unknowns, relative to it
DECREASE_TOLERANCE = 1e-9  # ... by moves as large as the point: flat directions promise any gain by rounding
SMALL_COST = 1e-6  # least cost that decreases are relative to, as a part of that of states and controls of order 1
DIVERGING_WEIGHT = 1e6  # weight of a row from which the rows are tested for infeasibility
UNBOUNDED_SIZE = 1e10  # size of a bordering unknown at which the cost has no lower bound
ACCEPTED_RAY = 1e-5  # stationarity of a ray that is accepted if the exchange no longer improves


def deadline(seconds: float | None, interrupted: Callable[[], bool]) -> Stop:
    """Return a function that returns the reason to stop if the next step needs so many seconds, or None."""
    end = np.inf if seconds is None else now() + seconds

    def stop(needed: float = 0.0) -> str | None:
        if interrupted():
            return "interrupted"
        return "time limit" if now() + needed > end else None

    return stop


@dataclass(eq=False)
class ExchangeOutcome:
    """The result of an exchange: the last trajectory, and its multipliers of equations and rows."""

    status: str  # of a Candidate
    message: str
    signals: Signals
    zeta: Array
    working: WorkingSet
    rounds: int  # small QPs that were solved
    ray: Ray | None  # if infeasible


class Exchange:
    """One solve: theta, zeta and the working rows with their weights, their signals, and the rules of a round."""

    def __init__(self, data: Data, first: Rows | None, tolerance: float, stop: Stop):
        self.data, self.kkt = data, data.structure.kkt
        self.tolerance, self.stop, self.rounds = tolerance, stop, 0
        self.theta, self.zeta = np.zeros(self.kkt.size), np.zeros(len(data.e))
        self.working, self.violations = WorkingSet(self.kkt, data.lti), Violations(data.lti)
        self.whole = data.structure.whole_horizon(self.violations.rows)
        self.first = None if first is None else bounded_rows(first, data.lti)
        if self.first is not None and self.whole is None:
            self.working.add(self.first.t, self.first.f, self.first.sign)
            if self.first.weights is not None:
                self.working.weights = np.minimum(self.first.weights, self.working.prices)
        self.proximal = data.lti.curvature_unit if data.lti.has_limits else self.kkt.least_proximal
        self.ray: Ray | None = None
        # progress so far: the least violation and slope, the largest theta, and rounds without progress
        self.best, self.flattest, self.farthest, self.stalled = np.inf, np.inf, 0.0, 0
        self._evaluate()

    def run(self) -> ExchangeOutcome:
        """Exchange until optimal, evaluating all signals MOST_ROUNDS times at most."""
        added = len(self.working)
        for count in range(1, MOST_ROUNDS + 1):
            rows = len(self.working)
            reason = self.stop(QP_SECONDS * rows**3) if rows > LARGE_QP else None
            if reason is not None:
                return self._outcome("limit", reason)
            # the small QP, and the signals of its weights
            self.rounds += 1
            diverging = self.working.weights.max(initial=0.0) > DIVERGING_WEIGHT * self.data.lti.cost_level
            self._step(want_ray=diverging or count % RAY_ROUNDS == 0)
            # stop?
            if self.ray is not None:
                return self._outcome("infeasible", INFEASIBLE)
            if self._optimal(added):
                return self._outcome("optimal")
            if self.violations.worst < self.tolerance and np.abs(self.theta).max(initial=0.0) > UNBOUNDED_SIZE:
                return self._outcome("unbounded", "the cost has no lower bound")
            reason = self.stop()
            if reason is not None:
                return self._outcome("limit", reason)
            # drop rows without multiplier, add violated ones
            entering = self.violations.entering(self.tolerance)
            present = self.working.present.copy()
            if count <= KEEP_ALL_AFTER:
                self.working.keep(self.working.weights > 0)
            self.working.add(*entering)
            added = int(np.count_nonzero(self.working.present & ~present))  # rows that return at once are not new
        if self._accurate():
            return self._outcome("optimal")
        return self._outcome("numerical_error", f"not converged after {self.rounds} rounds")

    def _step(self, want_ray: bool) -> None:
        """Correct theta, zeta and weights by the residuals of the signals, in one of three ways; then the signals.

        If the horizon is short, the small QP runs over all bounded values (_whole_step). Else it runs over the working
        rows, with theta and zeta eliminated (_stiff_step), or kept if compliant (_compliant_step).
        """
        working, kkt = self.working, self.kkt
        answer = None if want_ray or self.whole is None else self._whole_step(self.whole)
        if answer is None:
            answer = self._compliant_step(want_ray) if kkt.compliant else self._stiff_step(want_ray)
        step, weights, self.ray = answer
        if self.ray is not None:
            return
        working.weights = weights
        self.theta = self.theta + step[: kkt.size]
        self.zeta = self.zeta + step[kkt.size :]
        self._evaluate()
        if self.relative_residual > EQUATION_CONFLICT:
            self.ray = equation_ray(self.data, self.residual)

    def _whole_step(self, whole: WholeHorizon) -> tuple[Array, Array, None] | None:
        """Return the step of (theta, zeta) and weights from rounds on all values; None if a small QP was inaccurate."""
        working = self.working
        # the values without working rows
        step = self.kkt.inverse @ self.defects
        base = np.append(self.violations.values(self.signals.y), self.signals.last) + step @ whole.coupling
        if len(working):
            indices, mu = whole.flat_indices(working.t, working.f), working.sign * working.weights
            step, base = step + whole.through[:, indices] @ mu, base + whole.response(indices, mu)
        start, self.first = whole.duals(self.first or working.rows()), None
        duals = exchange_values(whole, self.violations, start, base, self.tolerance, self.stop)
        rows = whole.rows_of(duals)
        self.rounds += max(0, duals.rounds - 1)
        if not duals.accurate:
            working.add(rows.t, rows.f, rows.sign)
            return None
        working.replace(rows, whole.coupling[:, duals.indices] * duals.sign)
        return step - whole.through[:, duals.indices] @ (duals.sign * duals.weights), duals.weights, None

    def _stiff_step(self, want_ray: bool) -> tuple[Array, Array, Ray | None]:
        """Return the step of (theta, zeta), weights and a ray if one is found, with theta and zeta eliminated.

        Rows near the working rows that the step violates enter at once; then the step is computed again.
        """
        near, working, guess = None, self.working, self.working.weights
        for _ in range(LOCAL_ROUNDS):
            step, new, ray = self._eliminated_step(guess, want_ray)
            converged = ray is not None or self.violations.worst < self.tolerance or self.stop() is not None
            if converged or not 0 < len(working) <= LOCAL_ROWS:
                break
            near = near or neighbourhood_of(self.kkt, self.violations, working)
            if near is None or not working.add(*near.entering(self.signals.y, working, step, new, self.tolerance)):
                break
            guess = np.append(new, np.zeros(len(working) - len(new)))
        else:
            step, new, ray = self._eliminated_step(guess, want_ray)
        return step, new, ray

    def _eliminated_step(self, guess: Array, want_ray: bool) -> tuple[Array, Array, Ray | None]:
        """Return the same for the present working rows: docs/spectral.md, (4). An inaccurate QP leads to a ray."""
        working, inverse = self.working, self.kkt.inverse
        step = inverse @ self.defects
        if not len(working):
            return step, working.weights, None
        through, S = working.eliminated(inverse)
        delta = self.slack - working.coupling.T @ step - S @ working.weights
        diagonal_bound = self.data.lti.diagonal_bound[working.f] * working.inner
        new, accurate = bounded_qp(S, delta, guess, working.prices, diagonal_bound, working.free_response(), self.stop)
        combine = (want_ray or not accurate) and self.stop() is None
        ray = row_ray(self.data, working, S, delta, through, combine, self._ray_tolerance, self.stop)
        if ray is None and combine:
            ray = regularised_ray(self.data, working, self._ray_tolerance, self.stop)
        return step - through @ (new - working.weights), new, ray

    def _compliant_step(self, want_ray: bool) -> tuple[Array, Array, Ray | None]:
        """Return the same for compliant bordering unknowns, which stay in the small QP, with a proximal term."""
        working, kkt = self.working, self.kkt
        K = kkt.proximal_matrix(self.proximal)
        if not len(working):
            inverse = kkt.inverse if self.proximal == kkt.least_proximal else kkt.inverse_of(K)
            return inverse @ self.defects, working.weights, None
        at = self.slack, working.weights, working.prices
        qp = BorderedQp(kkt.size, K, working.coupling, working.gram, self.defects, *at)
        step, new, accurate = qp.solve(self.stop)
        if not (want_ray or not accurate) or self.stop():
            return step, new, None
        return step, new, regularised_ray(self.data, working, self._ray_tolerance, self.stop)

    @property
    def _ray_tolerance(self) -> float:
        """Return the stationarity of rays: the exchange may stall because the rows conflict."""
        return ACCEPTED_RAY if self.stalled >= STALLED_ROUNDS else RAY_TOLERANCE

    def _evaluate(self) -> None:
        """Set the signals, by FFT, and what follows: violations, slacks, the residual of E, the slope in theta."""
        for name in ("signals", "cost"):  # large: freed before the next are made
            self.__dict__.pop(name, None)
        self.signals = self.data.signals(self.theta, self.zeta, self.working)
        self.residual = self.data.residual(self.theta, self.signals)
        saturated = self.working.saturated
        self.violations.set_saturated(self.working.t[saturated], self.working.f[saturated])
        self.violations.measure_values(self.violations.values(self.signals.y), self.signals.last)
        on_rows = self.working.coupling[: self.kkt.size] @ self.working.weights
        self.slope = self.data.h_theta + self.kkt.H @ self.theta + self.kkt.E.T @ self.zeta + on_rows
        self.defects = np.concatenate([-self.slope, self.residual])  # right-hand side of the bordered system
        largest = max(1.0, float(np.abs(self.signals.y).max()))
        self.relative_residual = float(np.abs(self.residual).max(initial=0.0)) / largest

    @property
    def slack(self) -> Array:
        """Slacks of the working rows, limit - G y, (count,)."""
        return self.working.slacks(self.signals.y, self.signals.last)

    def _optimal(self, added: int) -> bool:
        """Whether this point is optimal, or as close as rounding allows; else allow longer steps."""
        kkt, worst, slope = self.kkt, self.violations.worst, self._relative_slope()
        level = worst < NEARLY_FEASIBLE and slope < SLOPE_TOLERANCE  # the cost hardly decreases along theta
        if level and kkt.size:
            gain = abs(float(self.slope @ kkt.inverse[: kkt.size, : kkt.size] @ self.slope))
            level = gain <= GAIN_TOLERANCE * self._cost_size() or self._cannot_decrease()
        if kkt.compliant and worst < NEARLY_FEASIBLE and not level:  # longer steps
            self.proximal = max(self.proximal * LONGER_STEPS, kkt.least_proximal)
        self._note_progress(added, slope)
        if self.stalled >= STALLED_ROUNDS:
            return self._accurate()
        return worst < self.tolerance and level and self._complementary(SLACK_TOLERANCE)

    def _note_progress(self, added: int, slope: float) -> None:
        """Count the rounds in which nothing improves: no violation, no slope, no new row, no longer theta."""
        kkt, worst, far = self.kkt, self.violations.worst, float(np.abs(self.theta).max(initial=0.0))
        moves = kkt.compliant and not self._cannot_decrease() and (slope < self.flattest / 2 or far > 2 * self.farthest)
        improving = worst < self.best / 2 or (added and worst >= FINE_VIOLATION) or moves
        self.stalled = 0 if improving else self.stalled + 1
        self.best, self.flattest = min(self.best, worst), min(self.flattest, slope)
        self.farthest = max(self.farthest, far)

    def _accurate(self) -> bool:
        """Whether a point that no longer improves is accepted."""
        flat = self._relative_slope() < ACCEPTED_SLOPE or self._cannot_decrease()
        return self.violations.worst < ACCEPTED_VIOLATION and flat and self._complementary(ACCEPTED_SLACK)

    def _complementary(self, allowed: float) -> bool:
        """Whether the equations hold, and all rows with a multiplier hold with equality."""
        slack = float(self.working.weights @ np.maximum(0.0, self.slack))
        return self.relative_residual < EQUATION_TOLERANCE and slack <= allowed * self._cost_size()

    def _cannot_decrease(self) -> bool:
        """Whether moves of the bordering unknowns as large as the point, and as 1, hardly decrease the cost."""
        decrease = float(np.abs(self.slope) @ (1 + np.abs(self.theta)))
        return decrease <= DECREASE_TOLERANCE * max(abs(self.cost), SMALL_COST * self.data.lti.cost_level)

    def _relative_slope(self) -> float:
        """Return the largest derivative in theta, relative to the absolute sum of its terms."""
        kkt, working = self.kkt, self.working
        terms = np.abs(self.data.h_theta) + np.abs(working.coupling[: kkt.size]) @ working.weights
        terms += np.abs(kkt.H) @ np.abs(self.theta) + np.abs(kkt.E.T) @ np.abs(self.zeta)
        least = LEAST_SIZE * self.data.lti.curvature_unit
        return float(np.abs(self.slope).max(initial=0.0)) / max(float(terms.max(initial=0.0)), least)

    @cached_property
    def cost(self) -> float:
        """Cost of this point, without prices."""
        lti, at = self.data.lti, self.signals
        last = 0.5 * at.last @ lti.P @ at.last + lti.p @ at.last
        linear = 0.0 if lti.linear is None else float(np.einsum("it,it->", lti.linear, at.y))
        return float(0.5 * np.einsum("it,it->", lti.M @ at.y, at.y) + linear + last) + lti.constant

    def _cost_size(self) -> float:
        """Return the size of the cost: differences in cost are relative to it."""
        return max(self.data.lti.cost_level, abs(self.cost))

    def _outcome(self, status: str, message: str = "") -> ExchangeOutcome:
        self.violations.violation = np.zeros((0, 0))  # large; it is measured again before the next use
        return ExchangeOutcome(status, message, self.signals, self.zeta, self.working, self.rounds, self.ray)


def first_working_set(lti: Lti, stop: Stop, structures: dict[int, Structure]) -> Rows | None:
    """Return a guess of the active rows from a cheaper problem, or None; ``structures`` caches theirs by horizon."""
    cheaper = cheaper_problem(lti)
    if cheaper is None:
        return None
    coarse, tolerance, rows_of = cheaper
    try:
        if coarse.horizon not in structures:
            structures[coarse.horizon] = Structure(coarse)
        guess = first_working_set(coarse, stop, structures)
        outcome = Exchange(Data(structures[coarse.horizon], coarse), guess, tolerance, stop).run()
    except (UnsupportedError, np.linalg.LinAlgError):
        return None
    return rows_of(outcome.working.rows().active()) if outcome.status == "optimal" else None
