"""The exchange: a small QP over the working rows, signals by FFT, new rows, until no row is violated.

docs/spectral.md, 7 and 8. A round is a Newton step from the true signals of (theta, zeta, l_0), for the change of
(theta, zeta) and new weights l of the working rows:

    K change + C (l - l_0) = defects = (-slope, residual),      slack_0 - C'change + S_W (l - l_0) >= 0,  l >= 0

So its fixed point has true slacks, whatever errors S, K and the small QP have. Exchange.run is the loop, Iterate
measures the signals and tests for optimality, Stalling decides when rounding ends it.
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
from lin_freq_ocp.methods.spectral.shortcuts import LOCAL_ROWS, cheaper_problem, exchange_values, neighbourhood_of
from lin_freq_ocp.methods.spectral.structure import (
    RAY_TOLERANCE,
    Data,
    Ray,
    Signals,
    Structure,
    WholeHorizon,
    eliminate,
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


ExchangeStep = tuple[Array, Array, Ray | None]
"""The answer of a small QP: the change of (theta, zeta), the new weights of the working rows, and perhaps a ray."""


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
    """One solve. Its state is the iterate ``at``, and the working rows with their weights.

    A round replaces ``at``, and changes ``working``, ``violations`` (those of ``at``), ``proximal`` and ``stalling``;
    ``rounds`` counts the small QPs.
    """

    def __init__(self, data: Data, first: Rows | None, tolerance: float, stop: Stop):
        self.data, self.kkt, self.tolerance, self.stop = data, data.structure.kkt, tolerance, stop
        self.working, self.violations = WorkingSet(self.kkt, data.lti), Violations(data.lti)
        self.whole = data.structure.whole_horizon(self.violations.rows)
        self.first = None if first is None else bounded_rows(first, data.lti)
        if self.first is not None and self.whole is None:
            self.working.add(self.first.t, self.first.f, self.first.sign)
            if self.first.weights is not None:
                self.working.weights = np.minimum(self.first.weights, self.working.prices)
        self.proximal = data.lti.curvature_unit if data.lti.has_limits else self.kkt.least_proximal
        self.stalling, self.rounds = Stalling(), 0
        self.at = Iterate(data, np.zeros(self.kkt.size), np.zeros(len(data.e)), self.working, self.violations)

    def run(self) -> ExchangeOutcome:
        """Exchange until optimal, evaluating all signals MOST_ROUNDS times at most."""
        working, kkt, stalling, added = self.working, self.kkt, self.stalling, len(self.working)

        def outcome(status: str, message: str = "", ray: Ray | None = None) -> ExchangeOutcome:
            return ExchangeOutcome(status, message, self.at.signals, self.at.zeta, working, self.rounds, ray)

        for count in range(1, MOST_ROUNDS + 1):
            reason = self.stop(QP_SECONDS * len(working) ** 3) if len(working) > LARGE_QP else None
            if reason is not None:
                return outcome("limit", reason)
            # the small QP, and the signals of its weights
            self.rounds += 1
            change, weights, ray = self._step(count)
            if ray is None:
                working.weights = weights
                theta, zeta = self.at.theta + change[: kkt.size], self.at.zeta + change[kkt.size :]
                del self.at  # its signals are large: freed before the next are made
                self.at = Iterate(self.data, theta, zeta, working, self.violations)
                if self.at.relative_residual > EQUATION_CONFLICT:
                    ray = equation_ray(self.data, self.at.residual)
            # stop?
            if ray is not None:
                return outcome("infeasible", INFEASIBLE, ray)
            stalling.note(self.at, added)
            if self.at.accurate() if stalling.rounds >= STALLED_ROUNDS else self.at.optimal(self.tolerance):
                return outcome("optimal")
            if self.at.worst < self.tolerance and np.abs(self.at.theta).max(initial=0.0) > UNBOUNDED_SIZE:
                return outcome("unbounded", "the cost has no lower bound")
            reason = self.stop()
            if reason is not None:
                return outcome("limit", reason)
            if kkt.compliant and self.at.worst < NEARLY_FEASIBLE and not self.at.level:  # longer steps
                self.proximal = max(self.proximal * LONGER_STEPS, kkt.least_proximal)
            # drop rows without multiplier, add violated ones
            entering = self.violations.entering(self.tolerance)
            present = working.present.copy()
            if count <= KEEP_ALL_AFTER:
                working.keep(working.weights > 0)
            working.add(*entering)
            added = int(np.count_nonzero(working.present & ~present))  # rows that return at once are not new
        if self.at.accurate():
            return outcome("optimal")
        return outcome("numerical_error", f"not converged after {self.rounds} rounds")

    def _step(self, count: int) -> ExchangeStep:
        """Return the step of round ``count``, from the residuals of the signals: docs/spectral.md, 6.

        A first reader may take it for ``_eliminated_step``. If the horizon is short, the small QP runs over all bounded
        values (_whole_step). If theta is compliant, it stays in the small QP (_compliant_step). Each of these may add
        rows to the working set, or replace its rows.
        """
        diverging = self.working.weights.max(initial=0.0) > DIVERGING_WEIGHT * self.data.lti.cost_level
        want_ray = diverging or count % RAY_ROUNDS == 0
        if self.whole is not None and not want_ray:
            first = None if count > 1 else self.first
            step = self._whole_step(self.whole, first or self.working.rows())
            if step is not None:
                return step
        return self._compliant_step(want_ray) if self.kkt.compliant else self._stiff_step(want_ray)

    def _eliminated_step(self, guess: Array, want_ray: bool) -> ExchangeStep:
        """Return the step for the present working rows, with theta and zeta eliminated: docs/spectral.md, (4).

        In theta and zeta it is K^{-1} (defects - C (l - l_0)), for weights l_0 before it. The slacks then change to
        slack_0 - C'step + S_W (l - l_0) = S l + delta. An inaccurate QP leads to a search for a ray.
        """
        working, inverse, defects = self.working, self.kkt.inverse, self.at.defects
        if not len(working):
            return inverse @ defects, working.weights, None
        eliminated = eliminate(working, inverse, defects, self.at.slack, working.weights)
        new, accurate = bounded_qp(eliminated.rows, guess, self.stop)
        combine = (want_ray or not accurate) and self.stop() is None
        tolerance = self.stalling.ray_tolerance
        ray = row_ray(self.data, working, eliminated, combine, tolerance, self.stop)
        if ray is None and combine:
            ray = regularised_ray(self.data, working, tolerance, self.stop)
        return eliminated.step - eliminated.through @ (new - working.weights), new, ray

    # A first reader may go on with Iterate. These steps save time, or digits of compliant unknowns.

    def _whole_step(self, whole: WholeHorizon, start: Rows) -> ExchangeStep | None:
        """Return the step of rounds on all values, whose rows become the working rows; None if a QP was inaccurate."""
        working, at = self.working, self.at
        # the values without working rows
        change = self.kkt.inverse @ at.defects
        base = np.append(self.violations.values(at.signals.y), at.signals.last) + change @ whole.coupling
        if len(working):
            indices, mu = whole.flat_indices(working.t, working.f), working.sign * working.weights
            change, base = change + whole.through[:, indices] @ mu, base + whole.response(indices, mu)
        rows, count, accurate = exchange_values(whole, self.violations, start, base, self.tolerance, self.stop)
        self.rounds += max(0, count - 1)
        if not accurate:
            working.add(rows.t, rows.f, rows.sign)
            return None
        indices = whole.flat_indices(rows.t, rows.f)
        working.replace(rows, whole.coupling[:, indices] * rows.sign)
        return change - whole.through[:, indices] @ (rows.sign * working.weights), working.weights, None

    def _stiff_step(self, want_ray: bool) -> ExchangeStep:
        """Return the eliminated step; on long horizons, rows near the working rows that it violates enter before."""
        near, working, guess = None, self.working, self.working.weights
        for _ in range(LOCAL_ROUNDS):
            change, new, ray = self._eliminated_step(guess, want_ray)
            converged = ray is not None or self.at.worst < self.tolerance or self.stop() is not None
            if converged or not 0 < len(working) <= LOCAL_ROWS:
                return change, new, ray
            near = near or neighbourhood_of(self.kkt, self.violations, working)
            if near is None or not working.add(*near.entering(self.at.signals.y, working, change, new, self.tolerance)):
                return change, new, ray
            guess = np.append(new, np.zeros(len(working) - len(new)))
        return self._eliminated_step(guess, want_ray)

    def _compliant_step(self, want_ray: bool) -> ExchangeStep:
        """Return the step for compliant bordering unknowns, which stay in the small QP, with a proximal term."""
        working, kkt, at = self.working, self.kkt, self.at
        K = kkt.proximal_matrix(self.proximal)
        if not len(working):
            inverse = kkt.inverse if self.proximal == kkt.least_proximal else kkt.inverse_of(K)
            return inverse @ at.defects, working.weights, None
        before = at.slack, working.weights, working.prices
        qp = BorderedQp(kkt.size, K, working.coupling, working.gram, at.defects, *before)
        change, new, accurate = qp.solve(self.stop)
        if not (want_ray or not accurate) or self.stop():
            return change, new, None
        return change, new, regularised_ray(self.data, working, self.stalling.ray_tolerance, self.stop)


class Iterate:
    """The signals of theta, zeta and the weights of the working rows, by FFT, and what they leave to be done.

    ``worst`` is the largest violation, ``residual`` that of the equations, ``slope`` (size,) the gradient of the
    Lagrangian in theta; ``defects`` = (-slope, residual) is the right-hand side of the bordered system. Its gradient in
    all v_k is zero by construction (docs/spectral.md, 8).
    """

    def __init__(self, data: Data, theta: Array, zeta: Array, working: WorkingSet, violations: Violations):
        kkt = data.structure.kkt
        self.data, self.kkt, self.theta, self.zeta, self.working = data, kkt, theta, zeta, working
        self.signals = data.signals(theta, zeta, working)
        self.residual = data.residual(theta, self.signals)
        values, saturated = violations.values(self.signals.y), working.weights >= working.prices
        rows = working.t[saturated], working.f[saturated]
        self.worst = violations.measure_values(values, self.signals.last, *rows)
        on_rows = working.coupling[: kkt.size] @ working.weights
        self.slope = data.h_theta + kkt.H @ theta + kkt.E.T @ zeta + on_rows
        self.defects = np.concatenate([-self.slope, self.residual])
        largest = max(1.0, float(np.abs(self.signals.y).max()))
        self.relative_residual = float(np.abs(self.residual).max(initial=0.0)) / largest

    @property
    def slack(self) -> Array:
        """Slacks of the present working rows, limit - G y, (count,)."""
        return self.working.slacks(self.signals.y, self.signals.last)

    def optimal(self, tolerance: float) -> bool:
        """Whether all optimality conditions hold."""
        return self.worst < tolerance and self.level and self._complementary(SLACK_TOLERANCE)

    def accurate(self) -> bool:
        """Whether a point that no longer improves is accepted: they hold as closely as rounding allows."""
        flat = self.relative_slope < ACCEPTED_SLOPE or self.cannot_decrease
        return self.worst < ACCEPTED_VIOLATION and flat and self._complementary(ACCEPTED_SLACK)

    @cached_property
    def level(self) -> bool:
        """Whether the cost hardly decreases along theta."""
        if self.worst >= NEARLY_FEASIBLE or self.relative_slope >= SLOPE_TOLERANCE:
            return False
        size = self.kkt.size
        gain = abs(float(self.slope @ self.kkt.inverse[:size, :size] @ self.slope))
        return gain <= GAIN_TOLERANCE * self._cost_size or self.cannot_decrease

    def _complementary(self, allowed: float) -> bool:
        """Whether the equations hold, and all rows with a multiplier hold with equality."""
        slack = float(self.working.weights @ np.maximum(0.0, self.slack))
        return self.relative_residual < EQUATION_TOLERANCE and slack <= allowed * self._cost_size

    @cached_property
    def cannot_decrease(self) -> bool:
        """Whether moves of the bordering unknowns as large as the point, and as 1, hardly decrease the cost."""
        decrease = float(np.abs(self.slope) @ (1 + np.abs(self.theta)))
        return decrease <= DECREASE_TOLERANCE * max(abs(self.cost), SMALL_COST * self.data.lti.cost_level)

    @cached_property
    def relative_slope(self) -> float:
        """The largest derivative in theta, relative to the absolute sum of its terms."""
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

    @property
    def _cost_size(self) -> float:
        """The size of the cost: differences in cost are relative to it."""
        return max(self.data.lti.cost_level, abs(self.cost))


@dataclass(eq=False)
class Stalling:
    """Counts the rounds in which nothing improves: no violation, no slope, no new row, no longer theta."""

    rounds: int = 0
    violation: float = np.inf  # the least so far
    slope: float = np.inf  # the least relative one
    theta: float = 0.0  # the largest

    def note(self, at: Iterate, added: int) -> None:
        """Note a point, and the number of rows that were added before it."""
        far = float(np.abs(at.theta).max(initial=0.0))
        nearer = at.relative_slope < self.slope / 2 or far > 2 * self.theta
        moves = at.kkt.compliant and not at.cannot_decrease and nearer
        improving = at.worst < self.violation / 2 or (added and at.worst >= FINE_VIOLATION) or moves
        self.rounds = 0 if improving else self.rounds + 1
        self.violation, self.slope = min(self.violation, at.worst), min(self.slope, at.relative_slope)
        self.theta = max(self.theta, far)

    @property
    def ray_tolerance(self) -> float:
        """Stationarity of rays: the exchange may stall because the rows conflict."""
        return ACCEPTED_RAY if self.rounds >= STALLED_ROUNDS else RAY_TOLERANCE


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
