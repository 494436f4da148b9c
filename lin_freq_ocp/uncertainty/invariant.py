"""Ends from which a plan continues for ever, whatever the loads: a maximal set of rows around a steady state.

X_f = {z : (c + K'd)'A_K^i (z - xs) <= r - c'xs - d'us - M_{T+i}, all rows, i = 0 .. i*}, where row i* + 1 follows from
the rows before; then all later ones do (Kolmanovsky and Gilbert, 1998). A linear program for each row decides it:
neither projections nor vertices are needed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import number
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.linked_ends import Periodic
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.solving.solve import solve_judged
from lin_freq_ocp.uncertainty.error_loop import EPS, OPERATIONS, ErrorLoop

INVARIANT_END = "invariant end"  # of the added rows
FIELD = "end='invariant'"
LATEST_ROWS = 500  # i*: a slower loop has no end in few rows
DISTANCE = 1e-6  # of a range, by which the steady state is inside; any above zero, so that finitely many rows suffice
STAGE_COST = "Q", "R", "S", "q", "r", "x_ref", "u_ref"


def invariant_end(problem: OptimalControlProblem, loop: ErrorLoop) -> StageRows:
    """Return the rows of X_f at x_T, as joint rows on x_{T-1} and u_{T-1}."""
    dynamics, n, T = problem.linear, problem.state_dim, problem.horizon
    sets, box = problem.stage_sets, problem.terminal_box
    if not (loop.loads.anew and loop.constant and loop.start is None and sets.constant):
        expected = "dynamics, limits and a bounded set of loads that are the same at all times, and start=None"
        raise UnsupportedError(f"{FIELD}: got another problem or other loads; expected {expected}.")
    if np.isfinite([box.lower, box.upper]).any() or problem.terminal_state.members or dynamics.offset.ndim == 2:
        got = f"an end, or offsets over time, with {FIELD}"
        raise ProblemError("terminal_state", got, "a free end, a constant offset")
    rows, limits, bounds = lasting_rows(problem, problem.state_boxes.at(-1))
    C, D = rows[:, :n], rows[:, n:]
    least = replace(loop, forever=True).margins(C, D)[0]
    with np.errstate(invalid="ignore"):
        room = limits + bounds.support(-rows)
    inside = DISTANCE * np.where(np.isfinite(room), room, np.abs(limits) + least)
    xs, us = steady_state(problem, C, D, limits - inside, least)
    R, size = loop.rows(C, D)
    slack, rounding = limits - C @ xs - D @ us, size @ loop.rounding
    F, g, effect, margin = np.zeros((0, n)), np.zeros(0), R, loop.margins(C, D)[T]
    for _ in range(LATEST_ROWS):
        new = slack - margin
        before = len(g)
        for row, limit in zip(effect, new, strict=True):
            if not _is_implied(F, g, row, float(limit)):
                F, g = np.vstack([F, row]), np.append(g, limit)
        if len(g) == before:
            break
        # the effect of the load T + i + 1 steps before joins the margin
        ago = effect @ np.linalg.matrix_power(loop.A, T) @ loop.E
        margin = margin + loop.loads.contribution(ago, slice(0, 1)) + rounding
        effect = effect @ loop.A
    else:
        raise ProblemError(FIELD, f"more than {LATEST_ROWS} steps until the rows repeat", "a faster gain")
    for k in reversed(range(len(g))):  # rows that later ones imply
        others = np.arange(len(g)) != k
        if _is_implied(F[others], g[others], F[k], float(g[k])):
            F, g = F[others], g[others]
    A, B, d = dynamics.at(0)
    e = np.full((T, len(g)), np.inf)
    e[-1] = g + F @ (xs - d)
    return StageRows(F @ A, F @ B, e, name=INVARIANT_END)


def lasting_rows(problem: OptimalControlProblem, last: Box | None = None) -> tuple[Array, Array, Box]:
    """Return rows and limits around the sets of (x, u) of all times, and their bounds; within the ``last`` states."""
    around, n = problem.stage_sets.around(), problem.state_dim
    lower, upper = around.lower.copy(), around.upper.copy()
    if last is not None:
        lower[:n], upper[:n] = np.maximum(lower[:n], last.lower), np.minimum(upper[:n], last.upper)
    rows = np.vstack([np.eye(len(lower)), -np.eye(len(lower)), around.matrix])
    limits = np.concatenate([upper, -lower, around.limits])
    return rows[np.isfinite(limits)], limits[np.isfinite(limits)], Box(lower, upper)


def steady_state(
    problem: OptimalControlProblem, C: Array, D: Array, limits: Array, margins: Array
) -> tuple[Array, Array]:
    """Return the steady state and control that cost least, with C x + D u <= limits - margins."""
    (A, B, d), cost, n = problem.linear.at(0), problem.quadratic, problem.state_dim
    parts = {name: (getattr(cost, name), 2 if name in "QRS" else 1) for name in STAGE_COST}
    last = {name: part[-1] if part.ndim > constant else part for name, (part, constant) in parts.items()}
    rows, plant = StageRows(C, D, limits - margins), LinearDynamics(A, B, d)
    still = OptimalControlProblem(plant, 1, QuadraticCost(**last), terminal_state=Periodic(), stage_rows=rows)
    found = solve_judged(still)
    if found.trajectory is not None and found.status.solved:
        return found.trajectory.x[0], found.trajectory.u[0]
    from scipy.optimize import linprog  # slow to import

    equal, shared = np.hstack([np.eye(n) - A, -B, np.zeros((n, 1))]), np.hstack([C, D, margins[:, None]])
    most = linprog(-np.eye(shared.shape[1])[-1], shared, limits, equal, d, (None, None), method="highs")
    largest = 0.0 if most.x is None else float(most.x[-1])
    share = f"at most {number(largest, 2)}" if largest > 0 else "none"
    got = "no steady state within the limits that the loads leave"
    raise ProblemError(FIELD, got, "smaller loads or wider limits", f"There is one for {share} of these loads.")


def _is_implied(F: Array, g: Array, row: Array, limit: float) -> bool:
    """Whether row'y <= limit is proven for all y with F y <= g, where limits are above zero; it depends on no units.

    With extents |y| <= e of the set, row'y <= Y g + R e for any weights Y >= 0 and R >= |row - Y F|.
    """
    seen = F.any(axis=0)
    if not row.any() or row[~seen].any():
        return not row.any()
    sides = np.vstack([np.eye(seen.sum()), -np.eye(seen.sum())])
    value, rest = _dual_bounds(F[:, seen], g, np.vstack([row[seen], sides]))
    if not np.isfinite(value).all():
        return False
    largest, mixed = (part[1:].reshape(2, seen.sum(), *part.shape[1:]).max(axis=0) for part in (value, rest))
    if np.abs(np.linalg.eigvals(mixed)).max() >= 0.5:
        return False
    extents = np.linalg.solve(np.eye(len(mixed)) - mixed, largest)  # |y| <= largest + mixed |y|
    return bool(value[0] + rest[0] @ extents <= limit)


def _dual_bounds(F: Array, g: Array, rows: Array) -> tuple[Array, Array]:
    """Return Y g, infinite without a bound, and R >= |rows - Y F|, both with rounding, of weights Y >= 0."""
    from scipy.optimize import linprog  # slow to import

    relative, Y = F / g[:, None], np.full((len(rows), len(g)), np.inf)
    relative = relative / (scale := np.abs(relative).max(axis=0))
    for weights, row in zip(Y, rows / scale, strict=True):
        size = np.abs(row).max()
        found = linprog(-row / size, relative, np.ones(len(g)), bounds=(None, None), method="highs")
        if found.x is not None:
            weights[:] = np.maximum(-found.ineqlin.marginals, 0.0) * size / g
    with np.errstate(invalid="ignore"):
        rounding = EPS * (len(g) + OPERATIONS)
        rest = np.abs(rows - Y @ F) + rounding * (np.abs(rows) + Y @ np.abs(F))
    return (1 + rounding) * Y @ g, rest
