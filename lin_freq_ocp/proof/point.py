"""The section POINT of a proof: controls near the optimal ones, whose trajectory is strictly inside all limits.

The optimum z* is on its limits, and misses them by rounding. Let z' be optimal for limits tightened by a share of
their sizes. Then (1 - s) z* + s z' satisfies the same equations and is strictly inside for any s > 0, as the margin to
every limit is concave along the way. Its cost is convex, so above the optimal one by s (J(z') - J(z*)) at most. A few
roundings are enough for s.

The rounding errors of controls grow with the free motion, and no equation moves them back at a free end. With a
feedback, u_t = the given control + K_t (the exact x_t - the given one), rounded, each control removes the errors of the
earlier ones: K_t is that of the linear-quadratic regulator whose weights are 1 for deviations as large as the signals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from flint import arb_mat, ctx

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.certificate.peaks import proven_peak
from lin_freq_ocp.certificate.sizes import trajectory_sizes
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.proof.dual import growth, precision
from lin_freq_ocp.proof.statement import line, rows
from lin_freq_ocp.solving.families import Options
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged
from lin_freq_ocp.transform.limits import Limit, of_source, replace_bounds

SHARES = (1e-3, 1e-5, 1e-7, 1e-9)  # of the sizes, by which limits are tightened; the first that leaves a solution
MOST = 0.25  # of the width of bounds, by which each may be moved

LEAST_GROWTH = 20.0  # of rounding errors in bits below which they need no feedback; units of states may make 10

MARGINS = (2.0**-46, 2.0**-40, 2.0**-34, 2.0**-27, 2.0**-20)  # distances to limits relative to sizes, tried in turn
LEVEL_MARGINS = 4  # from the largest value of a soft mask up to its level, unless the proven peak is lower


@dataclass(frozen=True, eq=False)
class InteriorPoint:
    """Controls from an initial state, with the mode at every time and the levels of masks over all frequencies."""

    start: Array  # x_0, (n,)
    controls: Array  # (T, m)
    modes: list[int]
    levels: list[float]

    def lines(self) -> Iterator[str]:
        """Yield the section POINT."""
        yield line(section="point", x=self.start, levels=np.array(self.levels))
        for t, (u, mode) in enumerate(zip(rows(self.controls), self.modes, strict=True)):
            yield line(t=t, u=u, mode=mode)


def points(
    problem: OptimalControlProblem, outcome: Outcome, at: Trajectory, margins: Sequence[float] = MARGINS
) -> Iterator[tuple[InteriorPoint, Trajectory]]:
    """Yield points of growing distance to all limits, with their trajectories; none if no point is strictly inside."""
    inner = None
    for margin in margins:
        if inner is None and least_distance(problem, at) < margin:
            inner = interior_trajectory(outcome, problem, at)
            if inner is None:
                return
        share = 0.0 if inner is None else share_of_way(problem, at, inner, margin)
        if share < 1:
            found = at if inner is None else interpolate(at, inner, share)
            found = add_feedback(problem, found) if needs_feedback(problem) else found
            levels = list[float]()
            for term in problem.terms:
                if term.semi_infinite is not None:
                    peak = proven_peak(term.semi_infinite, term.semi_infinite.map.signal(found.x, found.u))
                    above = min(peak.found * (1 + LEVEL_MARGINS * margin), peak.ratio * (1 + margin))
                    levels.append(1.0 if term.hard else max(1.0, above))
            start, u = problem.state_tube.project(found.x)[0], problem.control_tube.project(found.u)
            yield InteriorPoint(start, u, [0] * problem.horizon, levels), found


def interpolate(at: Trajectory, inner: Trajectory, share: float) -> Trajectory:
    """Return the trajectory at a share of the way from one to another."""
    return Trajectory(at.x + share * (inner.x - at.x), at.u + share * (inner.u - at.u))


def least_distance(problem: OptimalControlProblem, at: Trajectory) -> float:
    """Return the least distance to a limit, relative to sizes."""
    return min(
        (
            float((distance / np.where(size > 0, size, 1.0)).min(initial=np.inf))
            for distance, size in distances_to_limits(problem, at)
        ),
        default=np.inf,
    )


def distances_to_limits(problem: OptimalControlProblem, at: Trajectory) -> Iterator[tuple[Array, Array]]:
    """Yield the distances to the limits of each kind, and the sizes that their rounding errors are relative to."""
    yield from _distances_to_box(problem.state_tube, at.x)
    yield from _distances_to_box(problem.control_tube, at.u)
    for term in problem.terms:
        if not term.hard:
            continue
        if term.semi_infinite is not None:
            peak = proven_peak(term.semi_infinite, term.semi_infinite.map.signal(at.x, at.u))
            yield np.array([1 - peak.found]), np.ones(1)
            continue
        values = term.map.values(at.x, at.u)
        excess = np.where(np.isinf(term.penalty.weights), term.penalty.excess(values), -np.inf)
        lower, upper = term.penalty.hard_bounds(term.shape)
        equation = (lower == upper) if excess.shape == lower.shape else (lower == upper).all(axis=1, keepdims=True)
        yield (
            np.where(equation, np.inf, -excess).ravel(),
            np.broadcast_to(term.map.sizes(at.x, at.u).max(initial=0.0), excess.size),
        )


def _distances_to_box(box: Box, signal: Array) -> Iterator[tuple[Array, Array]]:
    size = np.broadcast_to(np.abs(signal).max(axis=0, initial=0.0), signal.shape)
    for distance in (box.upper - signal, signal - box.lower):
        yield np.where(box.fixed, np.inf, distance).ravel(), size.ravel()


def share_of_way(problem: OptimalControlProblem, at: Trajectory, inner: Trajectory, margin: float) -> float:
    """Return the least share of the way to an inner trajectory, at most 1, with this margin to all limits."""
    share = 0.0
    for (distance, size), (more, _) in zip(
        distances_to_limits(problem, at), distances_to_limits(problem, inner), strict=True
    ):
        missing = margin * size - distance
        short = missing > 0
        gained = np.maximum(more[short] - distance[short], missing[short])
        share = max(share, float((missing[short] / gained).max(initial=0.0)))
    return share


def interior_trajectory(outcome: Outcome, problem: OptimalControlProblem, at: Trajectory) -> Trajectory | None:
    """Return a trajectory strictly inside all inequalities, by the method of the outcome; None if none was found."""
    sizes, options = trajectory_sizes(problem, at), Options(outcome.method, outcome.backend or "auto")
    for share in SHARES:
        found = solve_judged(tighten(problem, share, sizes), options)
        if found.trajectory is not None and least_distance(problem, found.trajectory) > 0:
            return found.trajectory
    return None


def tighten(problem: OptimalControlProblem, share: float, sizes: tuple[Array, Array]) -> OptimalControlProblem:
    """Return the problem with hard inequalities tighter by a share of the sizes (n,), (m,)."""
    amounts = share * sizes[0], share * sizes[1]
    for field, bounds, amount in (
        ("state_set", problem.state_boxes, amounts[0]),
        ("control_set", problem.control_tube, amounts[1]),
        ("initial_state", problem.initial_box, amounts[0]),
        ("terminal_state", problem.terminal_box, amounts[0]),
    ):
        if np.isfinite(bounds.lower).any() or np.isfinite(bounds.upper).any():
            problem = problem.derived(**{field: replace_bounds(getattr(problem, field), _tighten_box(bounds, amount))})
    rows = [_tighten_rows(family, share, sizes) for family in problem.stage_rows]
    problem = problem.derived(stage_rows=rows) if rows else problem
    for limit, amount in _term_limits(problem, share, sizes):
        problem = limit.relaxed(problem, -amount)
    return problem


def _tighten_box(box: Box, amount: Array) -> Box:
    """Return a box with bounds that are tighter, but where they are equal."""
    with np.errstate(invalid="ignore"):
        moved = np.minimum(amount, MOST * (box.upper - box.lower))
    return Box(box.lower + moved, box.upper - moved)


def _tighten_rows(rows: StageRows, share: float, sizes: tuple[Array, Array]) -> StageRows:
    """Return hard rows with lower limits, but for two that make an equation."""
    if rows.penalty is not None:
        return rows
    amounts = np.broadcast_to(share * rows.sizes(*sizes), rows.e.shape).copy()
    for i, j in permutations(range(rows.rows), 2):
        opposite = (rows.C[..., i, :] == -rows.C[..., j, :]).all() and (rows.D[..., i, :] == -rows.D[..., j, :]).all()
        if opposite:
            width = rows.e[..., i] + rows.e[..., j]
            amounts[..., i] = np.minimum(amounts[..., i], MOST * np.maximum(width, 0.0))
    return StageRows(rows.C, rows.D, rows.e - amounts, rows.name)


def _term_limits(
    problem: OptimalControlProblem, share: float, sizes: tuple[Array, Array]
) -> Iterator[tuple[Limit, float]]:
    """Yield each entry of a field with hard limits beyond bounds and rows, and by how much they are to be lower."""
    steady = np.tile(sizes[0], (problem.horizon + 1, 1)), np.tile(sizes[1], (problem.horizon, 1))
    found: dict[tuple[str, int], float] = {}
    for term in problem.terms:
        if not term.hard or term.source is None or term.kind in (TermKind.STAGE_ROWS, TermKind.LINKED_ENDS):
            continue
        lower, upper = term.penalty.hard_bounds(term.shape)
        least = float(np.min(upper - lower))
        amount = min(share * float(term.map.sizes(*steady).max()), MOST * least) / float(np.max(term.per_limit))
        found[term.source] = min(found.get(term.source, np.inf), amount)
    for source, amount in found.items():
        if amount > 0:
            yield of_source(problem, source, source[0]), amount


def needs_feedback(problem: OptimalControlProblem) -> bool:
    """Whether rounding of controls grows towards a free end; removed bins of controls would leave no feedback."""
    free = not problem.state_tube.fixed[-1].all() and not problem.control_stop.any()
    return bool(free and growth(problem.linear.A, problem.horizon) > LEAST_GROWTH)


def add_feedback(problem: OptimalControlProblem, at: Trajectory) -> Trajectory:
    """Return the trajectory with controls whose exact trajectory stays near it."""
    start, fixed = problem.state_tube.project(at.x)[0], problem.control_tube.fixed
    with ctx.workprec(precision(problem.linear.A, problem.horizon)):
        x, controls = _column(start), problem.control_tube.project(at.u)
        for t, gain in enumerate(regulator_gains(problem, at)):
            A, B, d = problem.linear.at(t)
            deviation = [float(x[i, 0] - value) for i, value in enumerate(at.x[t].tolist())]
            controls[t] += np.where(fixed[t], 0.0, gain @ deviation)
            x = arb_mat(A.tolist()) * x + arb_mat(B.tolist()) * _column(controls[t]) + _column(d)
    return Trajectory(at.x, controls)


def _column(vector: Array) -> arb_mat:
    return arb_mat([[value] for value in vector.tolist()])


def regulator_gains(problem: OptimalControlProblem, at: Trajectory) -> Array:
    """Return the gains K_t, (T, m, n)."""
    of_x, of_u = (1.0 / size**2 for size in trajectory_sizes(problem, at))
    Q, R, T = np.diag(of_x), np.diag(of_u), problem.horizon
    gains, P = np.empty((T, len(of_u), len(of_x))), Q
    for t in reversed(range(T)):
        A, B, _ = problem.linear.at(t)
        gains[t] = -np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        closed = A + B @ gains[t]
        P = Q + gains[t].T @ R @ gains[t] + closed.T @ P @ closed
    return gains
