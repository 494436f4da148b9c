"""The forms of dynamics with levels and with a cost by formulas; problems with modes in the standard forms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, stack_signals
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.problem.dynamics.base import Dynamics, require_form, unique_names
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.affine_mode import ModeArrays
from lin_freq_ocp.problem.hybrid.formula_modes import formula_pieces
from lin_freq_ocp.problem.hybrid.levels import SwitchedDynamics
from lin_freq_ocp.problem.hybrid.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.hybrid.piecewise_smooth import PiecewiseSmoothDynamics, SmoothMode, affine_formulas
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.simulation import INFINITE
from lin_freq_ocp.transform.sizes import stated_sizes

STATE, CONTROL = "mu", "nu"  # the fields of Multipliers that are normals to boxes; other families are names of terms
OUTWARD = 1e-12  # sums are rounded outwards by this part of their largest terms, far above their rounding errors


class ModesWithCost(PiecewiseSmoothDynamics, words="dynamics with a cost or path constraints by formulas"):
    """The form of dynamics with a cost by formulas: smooth modes, each with its formula of the cost."""


def form_of_linear(dynamics: Dynamics, levels: ConvexSet | None, stage: Formula | None) -> Dynamics:
    """Return linear dynamics with a mode for each of the levels, or else as one smooth mode with a stage cost."""
    linear = require_form(dynamics, LinearDynamics)
    if levels is not None:
        return SwitchedDynamics(linear, levels)
    times = max(linear.A.shape[:-2], linear.B.shape[:-2])
    rows = np.concatenate([np.broadcast_to(M, (*times, *M.shape[-2:])) for M in (linear.A, linear.B)], axis=-1)
    f = affine_formulas(rows, linear.offset, (linear.state_dim, linear.control_dim))
    return _with_cost(linear, [SmoothMode(f)], stage)


def form_of_smooth(dynamics: Dynamics, levels: ConvexSet | None, stage: Formula | None) -> Dynamics:
    """Return piecewise-smooth dynamics with a stage cost; levels are refused."""
    if levels is not None:
        return form_of_others(dynamics, levels, stage)
    return _with_cost(dynamics, require_form(dynamics, PiecewiseSmoothDynamics).modes, stage)


def form_of_others(dynamics: Dynamics, levels: ConvexSet | None, stage: Formula | None) -> Dynamics:
    """Refuse levels, and a cost or path constraints by formulas."""
    if levels is not None:
        advice = "Write the levels into the regions of the modes, or take duty_cycles=True."
        raise ProblemError("control_set", f"levels with {dynamics.words}", "LinearDynamics", advice)
    raise UnsupportedError(f"dynamics: got {dynamics.words}; expected one of LinearDynamics, PiecewiseSmoothDynamics.")


def _with_cost(dynamics: Dynamics, modes: Sequence[SmoothMode], stage: Formula | None) -> ModesWithCost:
    """Return the modes with a stage cost, a mode for each piece of it."""
    if stage is not None:
        pieces = [(mode, piece) for mode in modes for piece in formula_pieces([stage], region=mode.region)]
        names = unique_names([", ".join(filter(None, (mode.name, piece.name))) for mode, piece in pieces])
        modes = [
            SmoothMode(mode.f, piece.region, mode.domain, name, piece.formulas)
            for (mode, piece), name in zip(pieces, names, strict=True)
        ]
    labels = dynamics.sampling_time, dynamics.state_names, dynamics.control_names
    return ModesWithCost(modes, dynamics.state_dim, dynamics.control_dim, *labels)


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


@dataclass(frozen=True, eq=False)
class Normal:
    """An active bound or row of a stage.

    Attributes
    ----------
    family : str
        STATE, CONTROL, or the name of a term.
    location : (int, int)
        Index of its multiplier in the array of the family.
    sign : float
        1, or -1 for a lower bound, whose multiplier is negative.
    column : (n + m,)
        The contribution of a multiplier of ``sign`` to the normal (in x, in u).
    fixed : bool
        Whether it belongs to a fixed component, which has normals of both signs.
    """

    family: str
    location: tuple[int, int]
    sign: float
    column: Array
    fixed: bool = False

    def value(self, multipliers: Multipliers) -> float:
        """Return the multiplier of the column, >= 0; that of a fixed component counts for both signs."""
        families = {STATE: multipliers.mu, CONTROL: multipliers.nu}
        array = families.get(self.family, multipliers.stage.get(self.family))
        return 0.0 if array is None else max(self.sign * float(array[self.location]), 0.0)


def active_normals(
    problem: OptimalControlProblem, trajectory: Trajectory, sizes: Array, share: float
) -> list[list[Normal]]:
    """Return the active bounds of x_t and u_t and the active hard rows of t alone, for t = 0 .. T.

    Active is what is nearer than a share of its size: of bounds, of ``sizes``, (n + m,) or (T+1, n + m), of rows, of
    their largest terms. Balls, cones and soft sets are left out.
    """
    n, z = problem.state_dim, stack_signals(trajectory.x, trajectory.u)
    near, unit, found = share * np.broadcast_to(sizes, z.shape), np.eye(z.shape[1]), [list[Normal]() for _ in z]
    signals, tubes = (trajectory.x, trajectory.u), (problem.state_tube, problem.control_tube)
    for family, first, signal, tube in zip((STATE, CONTROL), (0, n), signals, tubes, strict=True):
        within = near[: len(signal), first : first + signal.shape[1]]
        for sign, active in ((1.0, tube.upper - signal <= within), (-1.0, signal - tube.lower <= within)):
            for t, k in np.argwhere(active):
                column, fixed = sign * unit[first + k], bool(tube.fixed[t, k])
                found[t].append(Normal(family, (int(t), int(k)), sign, column, fixed))
    for term in problem.terms:
        rows = term.polyhedron(n, problem.control_dim)
        if rows is None:
            continue
        largest = term.map.sizes(trajectory.x, trajectory.u).max(axis=0)
        distance = term.penalty.bounds(term.shape)[1] - term.map.values(trajectory.x, trajectory.u)
        for group, row in np.argwhere(distance <= share * np.where(largest > 0, largest, 1.0)):
            column = rows.matrix(int(group))[row]
            found[rows.times[group]].append(Normal(term.name, (int(group), int(row)), 1.0, column))
    return found
