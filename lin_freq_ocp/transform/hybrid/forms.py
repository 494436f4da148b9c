"""Problems with modes in the standard forms that searches and the judge use."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.problem.hybrid.affine_mode import ModeArrays
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.sizes import stated_sizes

INFINITE = 1e100  # replaces infinity, so that its product with zero is zero
OUTWARD = 1e-12  # sums are rounded outwards by this part of their largest terms, far above their rounding errors


def piecewise_affine(problem: OptimalControlProblem) -> PiecewiseAffineDynamics:
    """Return the dynamics of a problem, or raise UnsupportedError unless they are piecewise affine."""
    return problem.in_form(PiecewiseAffineDynamics)


def piecewise_smooth(problem: OptimalControlProblem) -> PiecewiseSmoothDynamics:
    """Return the dynamics of a problem, or raise UnsupportedError unless they are piecewise smooth."""
    return problem.in_form(PiecewiseSmoothDynamics)


def boxes_of_steps(problem: OptimalControlProblem) -> tuple[Array, Array]:
    """Return lower and upper bounds of (x_t, u_t) in each mode, (T, modes, n + m), +-INFINITE where there are none.

    Where none is stated, hard rows and, for controls, bounds of x_{t+1} may imply one; a lower one is above the upper
    one where a mode has no point.
    """
    arrays, x, u = piecewise_affine(problem).arrays(problem.horizon), problem.state_tube, problem.control_tube
    (T, modes, n), sides = arrays.offset.shape, ((x.lower, u.lower), (x.upper, u.upper))
    stacked = (np.clip(np.hstack([of_x[:-1], of_u]), -INFINITE, INFINITE) for of_x, of_u in sides)
    low, high = (side[:, None].repeat(modes, axis=1) for side in stacked)
    stated = low.copy(), high.copy()
    for term in (*problem.terms, *problem.terms):  # twice: rows that come first gain, too
        rows = term.implied_rows(n, low.shape[2] - n)
        for group, t in enumerate(() if rows is None else rows.times):
            if rows is not None and t < T:
                low[t], high[t] = _cut_box(low[t], high[t], rows.matrix(group), rows.e[group])
    above, below = x.upper[1:, None] - arrays.offset, arrays.offset - x.lower[1:, None]
    for maps, limits in ((arrays.maps, above), (-arrays.maps, below)):
        least, most = _cut_box(low, high, maps, limits)
        low[..., n:], high[..., n:] = least[..., n:], most[..., n:]
    return np.where(stated[0] > -INFINITE, stated[0], low), np.where(stated[1] < INFINITE, stated[1], high)


def _cut_box(low: Array, high: Array, rows: Array, limits: Array) -> tuple[Array, Array]:
    """Return bounds (.., k) of the points v within bounds that satisfy rows (.., rows, k) v <= limits."""
    least = np.where(rows > 0, low[..., None, :], high[..., None, :])
    far = (np.abs(least) == INFINITE) & (rows != 0)
    terms = np.where(far, 0.0, rows * least)
    rounding = OUTWARD * (np.abs(terms).sum(axis=-1) + np.abs(limits))
    room = (limits - terms.sum(axis=-1) + rounding)[..., None] + terms  # what rows leave for each of their terms
    with np.errstate(over="ignore"):
        ends = room / np.where(rows == 0, 1.0, rows)
    known = np.isfinite(room) & (far.sum(axis=-1, keepdims=True) == far)
    most = np.where(known & (rows > 0), ends, np.inf).min(axis=-2, initial=np.inf)
    least = np.where(known & (rows < 0), ends, -np.inf).max(axis=-2, initial=-np.inf)
    return np.maximum(low, least), np.minimum(high, most)


def measured_modes(problem: OptimalControlProblem) -> ModeArrays:
    """Return the modes of a problem at all times, with the sizes of components that its data state."""
    arrays = piecewise_affine(problem).arrays(problem.horizon)
    return arrays.with_sizes(*stated_sizes(problem), problem.level_sizes)


def linear_along(problem: OptimalControlProblem, trajectory: Trajectory) -> OptimalControlProblem:
    """Return the linear problem of the modes along a trajectory; a problem without modes stays itself.

    It lacks costs by formulas, whose kinks remain boundaries of modes.
    """
    if problem.cost.has_formulas:
        problem = replace_fields(problem, dynamics=problem.form.standard_form, cost=problem.cost.without_formulas)
    problem = problem.affine_at(trajectory)
    if not problem.mode_names:
        return problem
    return problem.with_modes(measured_modes(problem).sequence(trajectory.x, trajectory.u))
