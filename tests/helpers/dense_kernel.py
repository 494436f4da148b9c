"""The step of the condensed method by NumPy, as kernel.c computes it: here the gradients of all rows are a matrix."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr_delete, solve_triangular

from lin_freq_ocp.methods import (
    GRADIENT_DEPENDENCE,
    INFEASIBLE,
    LIMIT,
    ROW_TOLERANCE,
    SOLVED,
    CondensedTables,
    ControlWindows,
)

STUCK_VIOLATION = 100  # a dependent row that is violated by this many tolerances contradicts the active ones
FACETS, RAISED = 16, 100  # of a polygon; tolerances by which a past raises a level
ROW_CORRECTIONS = 3  # of rounding in active rows, before another row enters


class DenseKernel:
    """Goldfarb and Idnani's dual method with limits, one row after the other; kernel.c says the same without a matrix.

    minimise 1/2 |xi|^2 + prices   over   lower <= y = y_0 + M xi <= upper.

    xi = -M'lambda at all times. lambda_i > 0 belongs to the upper bound, lambda_i < 0 to the lower one; prices of soft
    rows limit it. The multipliers of a step are the start of the next.
    """

    def __init__(self, tables: CondensedTables):
        self.tables = tables
        (T, n, m), r = tables.loop.shape, tables.unknowns
        self.gradients = tables.row_values(tables.V, np.zeros((r, n)), np.zeros(r))
        self._of_states = tables.row_values(tables.W[:, :n], np.eye(n), np.zeros(n))
        self._lengths = np.linalg.norm(self.gradients, axis=1)
        self.take(tables)
        self.plan, self.control, self.changes, self._most_changes = np.zeros(T * m), np.zeros(m), 0, 0
        self.unknowns = np.zeros(r)  # xi of the last step
        self._forget()

    def take(self, tables: CondensedTables) -> None:
        """Take other references, offsets, ends and bounds of the same problem; the multipliers stay."""
        self.tables, (T, n, _) = tables, tables.loop.shape
        constant = tables.row_values(tables.W[:, n:], np.zeros((1, n)), np.ones(1))
        self.of_start = np.hstack([self._of_states, constant])
        self._size = np.repeat(tables.sizes, T + 1)
        self.lower, self.upper = (side.ravel() for side in tables.bounds)
        self._low, self._up = (side.ravel() for side in tables.limits)

    def _forget(self) -> None:
        """Begin without multipliers."""
        self.ray: np.ndarray | None = None  # multipliers of rows whose gradients cancel, after INFEASIBLE
        rows, r = self.gradients.shape
        self._flag = np.zeros(rows, dtype=int)  # 0 inactive, +-2 active at its upper, lower bound, +-1 beyond it
        self._lambda, self._active = np.zeros(rows), list[int]()
        self._Q, self._R = np.zeros((r, 0)), np.zeros((0, 0))

    @property
    def multipliers(self) -> np.ndarray:
        """Return the multipliers of the rows, (families, T+1)."""
        return self._lambda.reshape(len(self.tables.families), self.tables.loop.shape[0] + 1).copy()

    def step(self, x: np.ndarray, most_changes: int | None = None) -> int:
        """Solve from an initial state, (n,), with so many changes at most; return SOLVED, LIMIT or INFEASIBLE.

        A state that is not finite is INFEASIBLE.
        """
        self.ray = None
        if not np.isfinite(x).all():
            return INFEASIBLE
        self._most_changes = self.tables.most_changes if most_changes is None else most_changes
        start, self.changes, corrections = np.append(x, 1.0), 0, 0
        y_0, xi = self.of_start @ start, -self.gradients.T @ self._lambda
        if not 0.5 * xi @ xi + self._lambda @ self._distance(y_0 + self.gradients @ xi) >= 0:  # worse than none
            self._forget()
            xi[:] = 0.0
        status, rounded = LIMIT, np.zeros(len(y_0), dtype=bool)
        while status == LIMIT and self.changes <= self._most_changes:
            y = y_0 + self.gradients @ xi
            missed = self._distance(y)[self._active]
            if corrections < ROW_CORRECTIONS and (np.abs(missed) > ROW_TOLERANCE / 4 * self._size[self._active]).any():
                corrections += 1
                xi = self._correct(xi, missed)
                continue
            violation = np.where(rounded, 0.0, self._violations(y) / self._size)
            row = int(np.argmax(violation)) if len(violation) else -1
            if row < 0 or violation[row] <= ROW_TOLERANCE:
                status = SOLVED
                break
            corrections, before = 0, self.changes
            found = self._enter(row, float(y[row]), xi)
            if found is not None:
                xi = found
            elif violation[row] > STUCK_VIOLATION * ROW_TOLERANCE:
                status = INFEASIBLE
                break
            rounded[row] = found is None
            if found is not None and self.changes > before:
                rounded[:] = False
        if status != INFEASIBLE:
            self.ray = None
        if status == SOLVED:
            self.plan = self.tables.W @ start + self.tables.V @ xi
        self.unknowns, self.control = xi, self.plan[: len(self.control)] + self.tables.loop.K @ x  # u_0
        return status

    def _distance(self, y: np.ndarray) -> np.ndarray:
        """Return y less the bounds that the flags of the rows name; 0 for inactive rows."""
        bound = np.where(self._flag > 0, self.upper, self.lower)
        return np.where(self._flag == 0, 0.0, y - bound)

    def _violations(self, y: np.ndarray) -> np.ndarray:
        """Return by how much rows violate what their flags say: their bounds, or that they are beyond one."""
        outside = np.maximum(y - self.upper, self.lower - y)
        beyond = np.where(self._flag > 0, self.upper - y, y - self.lower)
        return np.where(self._flag == 0, outside, np.where(np.abs(self._flag) == 1, beyond, 0.0))

    def _limit(self, row: int, side: int) -> float:
        return float((self._up if side > 0 else self._low)[row])

    def _first_block(self, rate: np.ndarray, step: float) -> tuple[int | None, float, int]:
        """Return the first active multiplier that ends on the way rate * step, the step to there, and its new flag."""
        blocking, rest = None, 0
        for j, row in enumerate(self._active):
            side = int(np.sign(self._flag[row]))
            value, speed = side * self._lambda[row], side * rate[j]
            way = value / -speed if speed < 0 else (self._limit(row, side) - value) / speed if speed > 0 else np.inf
            if max(way, 0.0) < step:
                blocking, step, rest = j, max(way, 0.0), 0 if speed < 0 else side
        return blocking, step, rest

    def _drop(self, j: int, rest: int) -> None:
        """Remove an active row; its multiplier stays at the limit that ``rest`` names, or is zero."""
        row = self._active.pop(j)
        self._flag[row], self._lambda[row] = rest, rest * self._limit(row, rest) if rest else 0.0
        Q, R = qr_delete(self._Q, self._R, j, which="col")
        count = len(self._active)
        self._Q, self._R = Q[:, :count], R[:count]
        self.changes += 1

    def _correct(self, xi: np.ndarray, missed: np.ndarray) -> np.ndarray:
        """Move the multipliers until the active rows are at their bounds; rows whose multiplier ends leave."""
        while len(missed):
            along = -solve_triangular(self._R, missed, trans="T")
            rate = -solve_triangular(self._R, along)
            blocking, step, rest = self._first_block(rate, 1.0)
            xi = xi + step * self._Q @ along
            self._lambda[self._active] += step * rate
            if blocking is None:
                return xi
            missed = np.delete((1 - step) * missed, blocking)
            self._drop(blocking, rest)
        return xi

    def _enter(self, row: int, y: float, xi: np.ndarray) -> np.ndarray | None:
        """Bring a violated row to its bound and return xi, or None if the active rows prevent that."""
        flag = int(self._flag[row])
        side = flag or (1 if y > self.upper[row] else -1)
        bound, limit = (self.upper if side > 0 else self.lower)[row], self._limit(row, side)
        sigma, moved, gradient = -flag or side, 0.0, self.gradients[row]
        while self.changes <= self._most_changes:
            along = self._Q.T @ gradient
            z = gradient - self._Q @ along
            again = self._Q.T @ z
            z, along = z - self._Q @ again, along + again
            rho = float(np.linalg.norm(z))
            independent = rho > GRADIENT_DEPENDENCE * self._lengths[row] and len(self._active) < len(xi)
            rate = -sigma * solve_triangular(self._R, along) if len(along) else along
            full = abs(y - bound) / rho**2 if independent else np.inf
            blocking, step, rest = self._first_block(rate, min(full, limit - moved))
            if not np.isfinite(step):
                self.ray = np.zeros((len(self.tables.families), self.tables.loop.shape[0] + 1))
                self.ray.flat[self._active], self.ray.flat[row] = rate, sigma
                return None
            self._lambda[self._active] += step * rate
            self._lambda[row] += sigma * step
            moved += step
            if independent:
                xi = xi - sigma * step * z
                y -= sigma * step * rho**2
            if blocking is not None:
                self._drop(blocking, rest)
                continue
            if step < full:  # its multiplier has reached its other end
                self._flag[row] = 0 if flag else side
                self._lambda[row] = 0.0 if flag else side * limit
            else:
                self._flag[row] = 2 * side
                self._active.append(row)
                self._Q, self._R = np.column_stack([self._Q, z / rho]), _append_column(self._R, along, rho)
            self.changes += 1
            break
        return xi


def _append_column(R: NDArray[np.floating], column: np.ndarray, corner: float) -> np.ndarray:
    """Return [[R, column], [0, corner]]."""
    larger = np.zeros((len(R) + 1, len(R) + 1))
    larger[:-1, :-1], larger[:-1, -1], larger[-1, -1] = R, column, corner
    return larger


class WindowedDenseKernel(DenseKernel):
    """The same with windows of the applied controls: every facet of every window is a row, made anew at each step."""

    def __init__(self, tables: CondensedTables, windows: ControlWindows):
        super().__init__(tables)
        (T, n, m), r = tables.loop.shape, tables.unknowns
        self._windows, self._stage = windows, (self.gradients, self.of_start, self._size, self._low, self._up)
        self._bounds = self.lower, self.upper
        self._of_unknowns = self._controls_of(tables.V, np.zeros((r, n)), np.zeros(r))
        self._of_x = self._controls_of(tables.W, np.eye(n + 1, n), np.eye(n + 1)[-1])
        self._rest, self.controls, self.applied = np.zeros((T, m)), np.zeros((T, m)), np.zeros((0, m))

    def _controls_of(self, v: np.ndarray, x_0: np.ndarray, data: np.ndarray) -> np.ndarray:
        """Return the controls of plans v (T m, k), (T, m, k)."""
        return np.moveaxis(self.tables.loop.simulate(x_0, self.tables.loop.plans(v), data)[1], 1, 2)

    def step(self, x: np.ndarray, most_changes: int | None = None) -> int:
        """Solve from an initial state, (n,), from no multipliers; ``controls`` (T, m) is the plan."""
        on_u, past, level = (np.concatenate(part) for part in zip(*self._rows(), strict=True))
        gradients, of_start, size, low, up = self._stage
        rows, none = len(level), np.full(len(level), np.inf)
        of_x = np.tensordot(on_u, self._of_x, 2)
        of_x[:, -1] += past
        self.gradients = np.vstack([gradients, np.tensordot(on_u, self._of_unknowns, 2)])
        self.of_start, self._size = np.vstack([of_start, of_x]), np.append(size, np.ones(rows))
        self._low, self._up = np.append(low, none), np.append(up, none)
        self.lower, self.upper = np.append(self._bounds[0], -none), np.append(self._bounds[1], level)
        self._lengths = np.linalg.norm(self.gradients, axis=1)
        self._forget()
        status = super().step(x, most_changes)
        self.controls = self._of_x @ np.append(x, 1.0) + self._of_unknowns @ self.unknowns
        return status

    def apply(self, u: np.ndarray) -> None:
        """Go on to the next step with the control that acts, (m,)."""
        self._rest = np.vstack([self.controls[1:], self.controls[-1:]])
        self.applied = np.vstack([self.applied, u])

    def _rows(self):
        """Yield coefficients of the plan (rows, T, m), values of the past and levels of the facets of each window."""
        now, (T, m) = len(self.applied), self._rest.shape
        turns = np.exp(-2j * np.pi * np.arange(FACETS) / FACETS)
        for one in self._windows.sets:
            samples, L = np.concatenate([one.past, self.applied[:, one.component]]), len(one.taper)
            waves = one.taper * np.exp(-1j * np.outer(one.frequencies, np.arange(L))) / one.levels[:, None]
            for begin in [*range(one.begin, now + T, one.hop), now + T - 1]:
                if begin + L <= now:
                    continue
                past, on_u = np.zeros(len(waves), dtype=complex), np.zeros((len(waves), T, m), dtype=complex)
                for t, wave in enumerate(waves.T, start=begin):
                    if t < now:
                        past += wave * samples[len(one.past) + t]
                    else:
                        on_u[:, min(t - now, T - 1), one.component] += wave
                known = past + np.tensordot(on_u, self._rest, 2)
                facets = np.cos(np.pi / FACETS)
                of_rest = (known[:, None] * turns).real.max(axis=1)
                raised = (of_rest > facets * (1 + RAISED * ROW_TOLERANCE)) & (begin < now + T - 1)
                level = np.where(raised, of_rest, facets)
                for turn in turns:
                    yield (turn * on_u).real, (turn * past).real, level
