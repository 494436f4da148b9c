"""Optima with few samples between the levels of their component, and a bound on how few.

Let the cost be one of each sample alone, convex and piecewise linear with its kinks at levels, and let the rest be r
independent linear rows in u: R u = c, or between limits. Of an optimum u with more than r entries between two levels
that span the envelope, some direction z != 0 of these entries has R z = 0. Along z and -z the cost is linear as far as
the next level, so that its slope is zero: u is moved along z until an entry reaches a level, and has one fewer between
levels, the same rows and the same cost. After finitely many steps there are r at most (a vertex; Shapley and Folkman).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.reductions import Reduced
from lin_freq_ocp.transform.simulation import simulate

AT_LEVEL = 1e-6  # smallest share of a second level that is more than the error of a solver, which the judge allows
INDEPENDENT = 1e-10  # smallest relative singular value of rows of size 1 that is no rounding


@dataclass(frozen=True, eq=False)
class LevelUse:
    """How the samples of a control use their levels.

    Attributes
    ----------
    duty_cycles : tuple of (T, levels)
        For each component, the share of every sample at each level.
    fractional : int
        Samples between two levels, over all components.
    rows : int or None
        The number of independent linear rows, if the cost is a sum over single samples and all constraints are linear
        rows: some optimum has at most as many samples between levels. None for other problems.
    means : bool
        Whether samples lie between levels and the cost is quadratic in u. It then counts the means over these samples,
        whose squares are below the means of the squared levels.

    Examples
    --------
    >>> lfo.solve(lfo.library.pulse_pattern(samples=32)).level_use.rows
    8
    """

    duty_cycles: tuple[Array, ...]
    fractional: int
    rows: int | None
    means: bool = False

    def __str__(self) -> str:
        samples = sum(map(len, self.duty_cycles))
        text = f"{self.fractional} of {plural(samples, 'sample')} between levels"
        if self.means:
            text += (
                "; there the quadratic cost counts the mean over the sample, and switching between levels costs more"
            )
        if self.rows is None:
            return text
        why = f"a cost of each sample alone, {plural(self.rows, 'linear row')}"
        return f"{text}; no more than {self.rows} are needed: {why}"


def level_use(problem: OptimalControlProblem, u: Array) -> LevelUse | None:
    """Return how controls (T, m) use the levels of a problem; None without levels."""
    control_set = _set_of_levels(problem)
    if control_set is None:
        return None
    shares = control_set.shares(u)
    between = sum(int(np.count_nonzero(share.max(axis=1) < 1 - AT_LEVEL)) for share in shares)
    rows, cost = rows_of_levels(problem), problem.quadratic
    needed = None if rows is None else _rank(_of_spans(rows, _spans(control_set, u)))
    return LevelUse(tuple(shares), between, needed, between > 0 and bool(cost.R.any() or cost.S.any()))


def rows_of_levels(problem: OptimalControlProblem) -> Array | None:
    """Return R, (rows, T, m), of all constraints on u but its levels; None if some are no linear rows.

    Also None if the cost is no sum over single samples, or the initial state is free.
    """
    if _set_of_levels(problem) is None:
        return None
    inner = np.isfinite([bound[1:-1] for bound in (problem.state_tube.lower, problem.state_tube.upper)])
    try:
        _ = problem.linear
    except UnsupportedError:  # known by a frequency response, or with modes
        return None
    if not problem.quadratic.zero or 0 not in problem.fixed_ends or inner.any():
        return None
    for term in problem.terms:  # each must be linear rows, or a cost of levels
        lower, upper = term.penalty.hard_bounds(term.shape)
        rows = term.semi_infinite is None and (term.penalty.polyhedral or bool((lower == upper).all()))
        if not (rows if term.hard else term.kind == TermKind.CONTROL_SET):
            return None
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    end = problem.ends[1]
    of_end = np.zeros((n, T + 1, n))
    of_end[:, T] = np.eye(n)
    bounded = np.isfinite(end.lower) | np.isfinite(end.upper)
    parts = [(of_end[bounded], np.zeros((int(bounded.sum()), T, m)))]
    for map in (*problem.stop_band_maps, *(term.map for term in problem.terms if term.hard)):
        rows = map.rows(T, n, m)[0].toarray()
        parts.append((rows[:, : (T + 1) * n].reshape(-1, T + 1, n), rows[:, (T + 1) * n :].reshape(-1, T, m)))
    of_x, of_u = (np.concatenate(blocks) for blocks in zip(*parts, strict=True))
    return of_u + _through_states(problem, of_x)


class FewBetweenLevels(Reduced):
    """The way from any optimum to one with few samples between levels, at which its multipliers are also normals."""

    def trajectory(self, reduced: Trajectory) -> Trajectory:
        """Return an optimum with at most as many entries between levels as there are rows."""
        rows, control_set, u = rows_of_levels(self.given), _set_of_levels(self.given), reduced.u
        if rows is None or control_set is None:
            return reduced
        spans, shares, levels = _spans(control_set, u), control_set.shares(u), control_set.levels_of(u.shape[1])
        between = np.stack([share.max(axis=1) < 1 - AT_LEVEL for share in shares], axis=1)
        columns = [(share.argmax(axis=1), *np.sort(np.argpartition(-share, 1, axis=1)[:, :2]).T) for share in shares]
        nearest, lower, upper = (  # the nearest level of each entry, and those below and above it
            (np.stack([values[i] for values, i in zip(levels, chosen, strict=True)], axis=1) / spans).ravel()
            for chosen in zip(*columns, strict=True)
        )
        R, at, free = _of_spans(rows, spans), (u / spans).ravel(), np.flatnonzero(between)
        moved = np.where(between.ravel(), at, nearest)
        if len(free) <= _rank(R):
            return reduced
        if len(R):
            moved[free] += np.linalg.lstsq(R[:, free], R @ (at - moved), rcond=None)[0]
        while len(free):
            _, sizes, directions = np.linalg.svd(R[:, free], full_matrices=True)
            rank = int(np.count_nonzero(sizes > INDEPENDENT * sizes.max(initial=0.0)))
            if rank == len(free):
                break
            z = directions[rank]  # R maps it to zero
            margin = np.where(z > 0, upper[free] - moved[free], moved[free] - lower[free])
            steps = margin / np.maximum(np.abs(z), 1e-300)
            first = int(np.argmin(steps))
            moved[free] += steps[first] * z
            moved[free[first]] = upper[free[first]] if z[first] > 0 else lower[free[first]]
            free = np.delete(free, first)
        return simulate(self.given, moved.reshape(u.shape) * spans, reduced.x[0])


def few_between_levels(problem: OptimalControlProblem) -> FewBetweenLevels | None:
    """Return the same problem with the way to few samples between levels; None if its controls have none."""
    return None if _set_of_levels(problem) is None else FewBetweenLevels(problem, problem)


def _spans(control_set: ConvexSet, u: Array) -> Array:
    """Return the unit of each component, (m,): the distance of its outermost levels."""
    return np.array([np.ptp(values) for values in control_set.levels_of(u.shape[1])])


def _of_spans(rows: Array, spans: Array) -> Array:
    """Return rows on controls in units of their spans, (rows, T m), scaled to length 1 unless they are zero."""
    matrix = (rows * spans).reshape(len(rows), rows.shape[1] * rows.shape[2])
    largest = np.abs(matrix).max(axis=1, keepdims=True, initial=0.0)
    matrix = matrix / np.where(largest > 0, largest, 1.0)
    size = np.linalg.norm(matrix, axis=1, keepdims=True)
    return matrix / np.where(size > 0, size, 1.0)


def _through_states(problem: OptimalControlProblem, of_x: Array) -> Array:
    """Return rows on states, (rows, T + 1, n), as rows on controls, (rows, T, m)."""
    dynamics, T = problem.linear, problem.horizon
    A, B = (np.broadcast_to(part, (T, *part.shape[-2:])) for part in (dynamics.A, dynamics.B))
    adjoint, rows = of_x[:, T], np.zeros((len(of_x), T, problem.control_dim))
    for t in reversed(range(T)):
        rows[:, t] = adjoint @ B[t]
        adjoint = of_x[:, t] + adjoint @ A[t]
    return rows


def _rank(R: Array) -> int:
    return int(np.linalg.matrix_rank(R, rtol=INDEPENDENT)) if len(R) else 0


def _set_of_levels(problem: OptimalControlProblem) -> ConvexSet | None:
    """Return the control set if it is one set of levels of all controls for all times, else None."""
    control_set, levels = problem.control_set, list[Array]()
    if isinstance(control_set, ConvexSet):
        levels = control_set.levels_of(problem.control_dim)
    return control_set if isinstance(control_set, ConvexSet) and len(levels) and all(map(len, levels)) else None
