"""The exchange: a small QP over the working rows, signals by FFT, new rows, until none is violated.

docs/spectral.md, sections 7 and 8. Every round corrects the defects of the true signals (section 6), so that its fixed
point has true slacks in spite of errors of the small QP. It stops at an optimum, not only at a feasible point.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.methods.spectral.algorithm.rays import Ray, equation_ray, row_ray, stiffened_ray
from lin_freq_ocp.methods.spectral.algorithm.structure import Data, Signals, Structure, equation_residual, signals
from lin_freq_ocp.methods.spectral.kkt.bordered_qp import BorderedQp
from lin_freq_ocp.methods.spectral.kkt.dual_qp import nonnegative_qp
from lin_freq_ocp.methods.spectral.model.lti import LEAST_SIZE
from lin_freq_ocp.methods.spectral.rows.neighbourhood import around
from lin_freq_ocp.methods.spectral.rows.whole_horizon import WholeHorizon, exchanged
from lin_freq_ocp.methods.spectral.rows.working_set import Rows, WorkingSet, bounded

ROUNDS = 60
"""Rounds after which an exchange ends; 1 to 12 are usual."""

QP_SECONDS = 1e-10
"""Of a small QP, measured, times the cube of its rows: it is not begun if that is more than what is left."""

LARGE_QP = 1000
"""Rows of a small QP from which its time is estimated: with fewer, it takes less than 0.1 s."""

LOCAL_ROUNDS = 6
"""Times that a step is computed again with the rows nearby that it violates, before all signals are evaluated."""

LOCAL_ROWS = 300
"""Working rows beyond which the small QP costs more than the signals."""

KEEP_ALL_AFTER = 30
"""Rounds after which no row is dropped any more: the exchange is then finite."""

EQUATION_TOLERANCE = 1e-9
"""Residual of the border's equations, relative to the largest signal."""

SLOPE_TOLERANCE = 1e-10
"""Slope left in the border variables, relative to its terms."""

STRICT_SLOPE = 1e-13
"""The same where a point that was flat enough had residuals that were not."""

ACCEPTED_SLOPE = 1e-7
"""The same where an exchange no longer improves."""

GAIN_TOLERANCE = 1e-15
"""What the cost could still fall by along border variables, were they free, relative to it (at least its level)."""

WORTH_TOLERANCE = 1e-9
"""The same by moves as large as the point: along flat directions rounding alone promises a gain without end."""

SMALL_COST = 1e-6
"""Cost, relative to that of states and controls of order 1, that is not measured more finely than this."""

SLACK_TOLERANCE = 1e-9
"""<l, slack> left, relative to the cost: rows with a multiplier hold with equality."""

ACCEPTED_SLACK = 1e-7
"""The same where an exchange no longer improves."""

FINE_VIOLATION = 1e-9
"""Relative violation above which a round that adds a row improves, even if it does not halve the violation."""

ACCEPTED_VIOLATION = 1e-7
"""Relative violation at which an exchange that no longer improves is as accurate as its rounding allows."""

STALLED_ROUNDS = 3
"""Rounds that neither halve the violation nor, above FINE_VIOLATION, add a row: it no longer improves."""

INCONSISTENT = 1e-7
"""Relative residual of the equations from which their dependent rows are asked for a proof of infeasibility."""

ASK_FOR_RAY = 8
"""Every so many rounds, and whenever the small QP is not accurate, the working rows are asked for such a proof."""

LENIENT = 1e-3
"""Relative violation from which on longer steps are taken along directions without cost."""

LONGER_STEPS = 0.03
"""Factor on the proximal weight for that."""

DIVERGING = 1e6
"""Weight of a row, in natural units, from which the rows are asked for a proof of infeasibility."""

ENDLESS = 1e10
"""Size of a border variable, in natural units, at which the cost has no lower bound."""


class Stop(Protocol):
    """Says why to stop, or None: whether the time is over, or will be in so many seconds; or Ctrl-C was pressed."""

    def __call__(self, needed: float = 0.0) -> str | None:
        """Return why to stop, if so many more seconds are needed."""
        ...


@dataclass(eq=False)
class Outcome:
    """How an exchange ended.

    Attributes
    ----------
    status : str
        "optimal", "infeasible", "unbounded", "limit" or "numerical_error".
    words : str
        Why, in words.
    signals : Signals; theta, multipliers : arrays; working : WorkingSet
        The last point, with the multipliers of equations and rows that made it.
    rounds : int
        Small QPs that were solved.
    violation : float
        Worst relative violation of a bound.
    cost : float
        J.
    ray : Ray or None
        If infeasible.
    """

    status: str
    words: str
    signals: Signals
    theta: Array
    multipliers: Array
    working: WorkingSet
    rounds: int
    violation: float
    cost: float
    ray: Ray | None = None


class Exchange:
    """One solve: the point, its working rows, and the rules of a round; ``stop`` says why to stop early, or None."""

    def __init__(self, structure: Structure, data: Data, first: Rows | None, tolerance: float, stop: Stop):
        self.structure, self.data, self.border = structure, data, structure.border
        self.working = WorkingSet(self.border)
        self.violations = structure.violations(data.lti)
        self.whole = structure.whole_horizon(self.violations.rows)
        self.first = None if first is None else bounded(first, data.lti)
        if self.first is not None and self.whole is None:
            self.working.add(self.first.t, self.first.f, self.first.sign)
            if self.first.weights is not None:
                self.working.weights = self.first.weights
        self.theta, self.multipliers = np.zeros(self.border.size), np.zeros(len(data.e))
        self.proximal, self.best, self.stalled = data.lti.curvature_unit, np.inf, 0
        self.flattest, self.farthest, self.slope_tolerance = np.inf, 0.0, SLOPE_TOLERANCE
        self.unconstrained = structure.unconstrained
        self.soft = self.border.soft
        self.ray: Ray | None = None
        self.tolerance, self.stop, self.rounds = tolerance, stop, 0
        self._evaluate()

    def run(self, rounds: int) -> Outcome:
        """Exchange until optimal, evaluating all signals so many times at most."""
        added = len(self.working)
        for count in range(1, rounds + 1):
            rows = len(self.working)
            reason = self.stop(QP_SECONDS * rows**3) if rows > LARGE_QP else None
            if reason is not None:
                return self._outcome("limit", reason)
            self.rounds += 1
            diverging = self.working.weights.max(initial=0.0) > DIVERGING * self.data.lti.cost_level
            self._step(ask=diverging or count % ASK_FOR_RAY == 0)
            if self.ray is not None:
                return self._outcome("infeasible", "no trajectory satisfies all constraints")
            if self._optimal(added):
                return self._outcome("optimal")
            if self.violations.worst < self.tolerance and np.abs(self.theta).max(initial=0.0) > ENDLESS:
                return self._outcome("unbounded", "the cost falls without end")
            reason = self.stop()
            if reason is not None:
                return self._outcome("limit", reason)
            added = self._exchange_rows(count)
        if self._accurate():
            return self._outcome("optimal")
        return self._outcome("numerical_error", f"not converged after {self.rounds} rounds")

    def _optimal(self, added: int) -> bool:
        """Whether this point is optimal, or as near to it as rounding allows; else prepare for longer steps."""
        worst, slope = self.violations.worst, self._relative_slope()
        level = worst < LENIENT and slope < self.slope_tolerance and self._gains_nothing()
        far = float(np.abs(self.theta).max(initial=0.0))
        moving = self.soft and not self._worthless() and (slope < self.flattest / 2 or far > 2 * self.farthest)
        if self.soft and worst < LENIENT and not level:
            self._shorten_proximal()
        improving = worst < self.best / 2 or (added and worst >= FINE_VIOLATION) or moving
        self.stalled = 0 if improving else self.stalled + 1
        self.best, self.flattest = min(self.best, worst), min(self.flattest, slope)
        self.farthest = max(self.farthest, far)
        if self.stalled >= STALLED_ROUNDS:
            return self._accurate()
        return worst < self.tolerance and level and self._complementary(SLACK_TOLERANCE)

    def _accurate(self) -> bool:
        """Whether a point that no longer improves is good enough; its residuals say how good."""
        flat = self._relative_slope() < ACCEPTED_SLOPE or self._worthless()
        return self.violations.worst < ACCEPTED_VIOLATION and flat and self._complementary(ACCEPTED_SLACK)

    def _shorten_proximal(self) -> None:
        """Let the next step go farther along directions of little cost."""
        self.proximal = max(self.proximal * LONGER_STEPS, self.border.least_proximal)

    def _evaluate(self) -> None:
        self.signals = signals(self.structure, self.data, self.theta, self.multipliers, self.working)
        self.residual = equation_residual(self.structure, self.data, self.theta, self.signals)
        self.violations.measure(self.signals.y, self.signals.last)
        self.values = self.working.values(self.signals.y, self.signals.last)

    def _slope(self) -> Array:
        """Return the derivative of the Lagrangian in theta."""
        on_rows = self.working.coupling[: self.border.size] @ self.working.weights
        return self.data.h + self.border.H @ self.theta + self.border.E.T @ self.multipliers + on_rows

    def _step(self, ask: bool) -> None:
        """Correct the defects of the present point, with the best weights for the working rows."""
        working, border = self.working, self.border
        right = np.concatenate([-self._slope(), self.residual])
        whole = None if ask or self.whole is None else self._whole_step(self.whole, right)
        step, new, ray = whole or (self._soft_step if self.soft else self._stiff_step)(right, ask)
        self.ray = ray
        if ray is not None:
            return
        working.weights = new
        self.theta = self.theta + step[: border.size]
        self.multipliers = self.multipliers + step[border.size :]
        self._evaluate()
        if self._relative_residual() > INCONSISTENT:
            self.ray = equation_ray(self.structure, self.data, self.residual)

    def _whole_step(self, whole: WholeHorizon, right: Array) -> tuple[Array, Array, None] | None:
        """Return the step of the border and weights after as many rounds as are needed; None if a row is in doubt."""
        working, step = self.working, self.border.inverse @ right
        base = np.append(self.violations.values(self.signals.y), self.signals.last) + step @ whole.coupling
        if len(working):
            places, mu = whole.places(working.t, working.f), working.sign * working.weights
            base += whole.response(places, mu)
            step += whole.through[:, places] @ mu
        start, self.first = whole.multiplied(self.first or Rows(*working.rows(), working.weights)), None
        found = exchanged(whole, self.violations, start, base, self.tolerance, self.unconstrained, self.stop)
        rows = Rows(whole.t[found.places], whole.f[found.places], found.sign, found.weights)
        self.rounds += max(0, found.rounds - 1)
        if not found.accurate:
            working.add(rows.t, rows.f, rows.sign)
            self.values = working.values(self.signals.y, self.signals.last)
            return None
        working.replace(rows, whole.coupling[:, found.places] * found.sign)
        return step - whole.through[:, found.places] @ (found.sign * found.weights), found.weights, None

    def _stiff_step(self, right: Array, ask: bool) -> tuple[Array, Array, Ray | None]:
        """Return the step of the border, weights and perhaps a ray, with the border eliminated.

        Rows near the working ones that the step violates enter at once, and the step is found again.
        """
        near, working, guess = None, self.working, self.working.weights
        for _ in range(LOCAL_ROUNDS):
            step, new, ray = self._eliminated_step(right, guess, ask)
            converged = ray is not None or self.violations.worst < self.tolerance or self.stop() is not None
            if converged or not 0 < len(working) <= LOCAL_ROWS:
                break
            near = near or around(self.border, self.violations, working)
            if near is None or not working.add(*near.entering(self.signals.y, working, step, new, self.tolerance)):
                break
            self.values = working.values(self.signals.y, self.signals.last)
            guess = np.append(new, np.zeros(len(working) - len(new)))
        else:
            step, new, ray = self._eliminated_step(right, guess, ask)
        return step, new, ray

    def _eliminated_step(self, right: Array, guess: Array, ask: bool) -> tuple[Array, Array, Ray | None]:
        working, inverse = self.working, self.border.inverse
        step = inverse @ right
        if not len(working):
            return step, working.weights, None
        Z = inverse @ working.coupling
        through_border = working.coupling.T @ Z
        S = (
            working.gram + (through_border + through_border.T) / 2
        )  # symmetric to the last bit: else it stalls at rounding
        d = working.limits(self.data.lti) - self.values - working.coupling.T @ step - S @ working.weights
        unconstrained = None if self.unconstrained is None else self.unconstrained[working.f] * working.inner
        new, accurate = nonnegative_qp(S, d, guess, unconstrained, self.stop)
        asked = (ask or not accurate) and self.stop() is None
        ray = row_ray(self.structure, self.data, working, S, d, Z, asked, self.stop)
        if ray is None and asked:
            ray = stiffened_ray(self.structure, self.data, working, self.stop)
        return step - Z @ (new - working.weights), new, ray

    def _soft_step(self, right: Array, ask: bool) -> tuple[Array, Array, Ray | None]:
        """Return the same for a border that hardly curves: kept in the small QP, with a proximal term."""
        working, border = self.working, self.border
        if not len(working):
            return border.inverse_with(self.proximal) @ right, working.weights, None
        K = border.proximal_matrix(self.proximal)
        slack = working.limits(self.data.lti) - self.values
        qp = BorderedQp(border.size, K, working.coupling, working.gram, right, slack, working.weights)
        step, new, accurate = qp.solve(self.stop)
        if not (ask or not accurate) or self.stop():
            return step, new, None
        return step, new, stiffened_ray(self.structure, self.data, working, self.stop)

    def _relative_residual(self) -> float:
        return float(np.abs(self.residual).max(initial=0.0)) / max(1.0, float(np.abs(self.signals.y).max()))

    def _relative_slope(self) -> float:
        """Return the largest derivative in theta, relative to the terms that it is the sum of."""
        border, working = self.border, self.working
        terms = (
            np.abs(self.data.h) + np.abs(border.H) @ np.abs(self.theta) + np.abs(border.E.T) @ np.abs(self.multipliers)
        )
        terms += np.abs(working.coupling[: border.size]) @ working.weights
        least = LEAST_SIZE * self.data.lti.curvature_unit
        return float(np.abs(self._slope()).max(initial=0.0)) / max(float(terms.max(initial=0.0)), least)

    def _worthless(self) -> bool:
        """Whether moves of the border variables as large as the point, and as 1, can hardly gain anything."""
        worth = float(np.abs(self._slope()) @ (1 + np.abs(self.theta)))
        return worth <= WORTH_TOLERANCE * max(abs(self._cost()), SMALL_COST * self.data.lti.cost_level)

    def _gains_nothing(self) -> bool:
        """Whether the cost can hardly fall along the border variables, were they free, or by such moves."""
        slope, border = self._slope(), self.border
        gain = abs(float(slope @ border.inverse[: border.size, : border.size] @ slope))
        return gain <= GAIN_TOLERANCE * self._cost_size() or self._worthless()

    def _cost(self) -> float:
        lti, at = self.data.lti, self.signals
        last = 0.5 * at.last @ lti.P @ at.last + lti.p @ at.last
        linear = 0.0 if lti.linear is None else float(np.einsum("it,it->", lti.linear, at.y))
        return float(0.5 * np.einsum("it,it->", lti.M @ at.y, at.y) + linear + last) + lti.constant

    def _cost_size(self) -> float:
        """Return what a difference in cost is small against."""
        return max(self.data.lti.cost_level, abs(self._cost()))

    def _complementary(self, allowed: float) -> bool:
        """Whether the equations hold, and all rows with a multiplier hold with equality."""
        if self._relative_residual() >= EQUATION_TOLERANCE:
            return False
        slack = self.working.weights @ np.maximum(0.0, self.working.limits(self.data.lti) - self.values)
        return bool(slack <= allowed * self._cost_size())

    def _exchange_rows(self, count: int) -> int:
        """Drop rows without multiplier, add violated ones; return how many are new."""
        entering = self.violations.entering(self.tolerance)
        if count <= KEEP_ALL_AFTER:
            self.working.keep(self.working.weights > 0)
        added = self.working.add(*entering)
        self.values = self.working.values(self.signals.y, self.signals.last)
        return added

    def _outcome(self, status: str, words: str = "") -> Outcome:
        return Outcome(
            status,
            words,
            self.signals,
            self.theta,
            self.multipliers,
            self.working,
            self.rounds,
            self.violations.worst,
            self._cost(),
            self.ray,
        )


def deadline(seconds: float | None, interrupted: Callable[[], bool]) -> Stop:
    """Return a function that says why to stop, or None."""
    end = np.inf if seconds is None else time.perf_counter() + seconds

    def stop(needed: float = 0.0) -> str | None:
        if interrupted():
            return "interrupted"
        return "time limit" if time.perf_counter() + needed > end else None

    return stop
