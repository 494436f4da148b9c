"""Derivatives of long problems: solves with K as problems of the package's own class.

Each bin that is removed is a dense row of K, and thousands of them take hours to factor. But the solution of
K (z, y) = (c, b) is the optimum, with its multipliers, of a problem that the methods for linear dynamics solve:

    minimise  1/2 z'H z - <c, z>   subject to   M z = b,

with the same matrices and stop bands, with fixed values where a bound is active, and without other bounds. One set-up
serves all right-hand sides. An answer is refined: the residual c - H z - M'y, b - M z, formed in extended precision, is
the next right-hand side, and the corrections tell the error. The data of the problem give the exact optimum on its
active bounds, weights the adjoint (p, q), a change of the data the derivative along it. Random right-hand sides tell
whether the rows are independent: dependent rows have no solution.

Each residual is added to the random right-hand side, whose solution is then subtracted. Otherwise p may be zero, where
constraints determine the weighted sum, and methods find no units for an answer that is rounding alone.

At a kink, the derivative on one side is the optimum of such a problem with the weak bounds as inequalities.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask, split_signals, stack_signals
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.hamiltonian import cost_curvatures, extremal_within
from lin_freq_ocp.derivatives.data import Values, Variables
from lin_freq_ocp.derivatives.derivatives import (
    DEPENDENT_ROWS,
    NO_REACH,
    SEEN,
    UNSETTLED,
    WEAK,
    Derivative,
    ExistenceFields,
    Reach,
    Side,
    SolutionDerivatives,
    reach,
    require_multipliers,
)
from lin_freq_ocp.derivatives.equations import ChangedSignals, changed_signals, level_signal
from lin_freq_ocp.derivatives.exact_point import FORWARD, POINT_STEPS, SAFETY
from lin_freq_ocp.derivatives.kkt import KKT_REFINEMENTS, MOST_SOLVE_ERROR
from lin_freq_ocp.methods.candidate import Candidate, zero_multipliers
from lin_freq_ocp.methods.correction import deviation_units
from lin_freq_ocp.methods.long_problems import LONGEST_FACTOR, is_long, solve_long, with_sides
from lin_freq_ocp.methods.spectral.solver import SpectralSolver
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.active_rows import EPSILON
from lin_freq_ocp.program.linear_program import dense_rows

SLOW_FACTOR = 5e-3  # seconds of a factorisation, estimated, above which adjoint problems are faster
Sides = tuple[Array, Array, Array]  # slopes c and values of fixed components (T+1, n+m), offsets of dynamics (T, n)


@dataclass(frozen=True, eq=False)
class LongSolution:
    """States and controls z (T+1, n+m) with multipliers, and the errors of both, estimated, in units of order 1."""

    z: Array
    multipliers: Multipliers
    error: tuple[float, float] = (np.inf, np.inf)

    def plus(self, other: LongSolution, factor: float) -> LongSolution:
        """Return this point and a multiple of another one."""
        y, dy = self.multipliers, other.multipliers
        sums = {name: getattr(y, name) + factor * getattr(dy, name) for name in ("eta", "mu", "nu", "rho_u", "rho_x")}
        return LongSolution(self.z + factor * other.z, Multipliers(1.0, **sums))

    @property
    def trajectory(self) -> Trajectory:
        """Return the states and controls."""
        return Trajectory(*split_signals(self.z, self.multipliers.eta.shape[1]))

    @property
    def side(self) -> Side:
        """Return states, controls and multipliers as a derivative."""
        x, u = split_signals(self.z, self.multipliers.eta.shape[1])
        return Side(x, u, self.multipliers)

    @property
    def normals(self) -> Array:
        """Return the multipliers of bounds, (T+1, n+m)."""
        return stack_signals(self.multipliers.mu, self.multipliers.nu)


class LongKKT:
    """K of a problem with stop bands whose components ``held`` (T+1, n+m) have fixed values.

    Units of z and of slopes are (n+m,). ``random`` is the solution for a random right-hand side; None if there is none.
    """

    def __init__(self, problem: OptimalControlProblem, units: Array, slope_units: Array, held: Mask):
        self.problem, self.n, self.held = problem, problem.state_dim, held
        self.units, self.slope_units = (slope_units, units, units[: self.n]), slope_units
        drawn = np.random.default_rng(0).standard_normal((2, *held.shape))
        drawn[:, -1, self.n :] = 0.0  # there is no u_T
        drawn[0, :, : self.n] = 0.0  # slopes in x move z by far more than its units
        curvatures = cost_curvatures(problem.quadratic, problem.horizon)
        assert curvatures is not None  # the cost is convex
        self._drawn: Sides = drawn[0] * curvatures * units, drawn[1] * units, np.zeros((problem.horizon, self.n))
        zero = 0 * drawn[0], 0 * drawn[1], self._drawn[2]
        self._plain, base, self._solver = self._with_sides(zero), self._with_sides(self._drawn), None
        with suppress(UnsupportedError):
            self._solver = SpectralSolver(base)
        found = answer_of(solve_long(base, solver=self._solver))
        exact = found is not None and self._amount(self._residual(self._drawn, found), rows=True) <= MOST_SOLVE_ERROR
        self.random, self._noise = found if exact else None, np.full(2, np.inf)

    def sizes(self, point: LongSolution) -> tuple[float, float]:
        """Return the largest values of z and of y, in units of order 1."""
        of_eta = np.abs(point.multipliers.eta / self.slope_units[: self.n]).max()
        of_bounds = np.abs(point.normals / self.slope_units).max()
        return float(np.abs(point.z / self.units[1]).max()), float(max(of_eta, of_bounds))

    def solve(self, right: Sides) -> LongSolution | None:
        """Return the solution for a right-hand side; None if no method finds any.

        Its error is the last correction, times the part of the correction before that it was. Without a second one, it
        is the largest second correction of other right-hand sides, relative to their sizes, with a factor of safety.
        """
        point = LongSolution(np.zeros(self.held.shape), zero_multipliers(self.problem, 1.0))
        left, first, before = (right[0], np.where(self.held, right[1], 0.0), right[2]), np.inf, np.inf
        for _ in range(KKT_REFINEMENTS):
            if (amount := self._amount(left)) == 0:
                return replace(point, error=(0.0, 0.0))
            step = self._step(left, amount)
            if step is None:
                break
            correction = amount * np.array(self.sizes(step))
            if correction.max() > 0.5 * before:  # rounding, or nothing that converges
                break
            if before < np.inf:
                error = correction * (correction.max() / before)
                self._noise = np.fmax(correction / first, np.where(self._noise < np.inf, self._noise, 0.0))
            else:
                error, first = SAFETY * amount * self._noise, amount
            point, before = self._without_bins(point.plus(step, amount)), float(correction.max())
            sizes = np.array(self.sizes(point))
            error = np.maximum(error, EPSILON * sizes)
            point = replace(point, error=(float(error[0]), float(error[1])))
            if (error <= np.maximum(FORWARD * sizes, EPSILON * sizes.max())).all():
                break
            left = self._residual(right, point)
        return point if before < np.inf else None

    def _without_bins(self, point: LongSolution) -> LongSolution:
        """Return a point without what rounding leaves in removed bins: what this changes is seen by its residual."""
        bins = (np.fft.rfft(signal, axis=0) for signal in split_signals(point.z, self.n)[::-1])
        return replace(point, z=point.z - level_signal(self.problem, *bins))

    def _step(self, left: Sides, amount: float) -> LongSolution | None:
        """Return the solution for a right-hand side of this size, over its size; None if no method finds any."""
        share = 0.0 if self.random is None else 1.0
        c, values, offset = (part / amount + share * drawn for part, drawn in zip(left, self._drawn, strict=True))
        found = answer_of(solve_long(self._with_sides((c, values, offset)), solver=self._solver))
        return found if found is None or self.random is None else found.plus(self.random, -1.0)

    def _amount(self, sides: Sides, rows: bool = False) -> float:
        """Return the size of a right-hand side, or of its part of rows, in units of order 1."""
        return max(float(np.abs(part / unit).max()) for part, unit in [*zip(sides, self.units, strict=True)][rows:])

    def _residual(self, right: Sides, point: LongSolution) -> Sides:
        """Return what a point leaves of a right-hand side."""
        at = extremal_within(self._plain, point.trajectory, point.multipliers, self._plain.signal_bounds)
        of_z = right[0] - at.slopes - point.normals
        values = np.where(self.held, right[1] - point.z, 0.0)
        return of_z.astype(np.float64), values, (right[2] - at.residual).astype(np.float64)

    def _with_sides(self, right: Sides) -> OptimalControlProblem:
        """Return the problem whose optimum is the solution for a right-hand side."""
        lower, upper = (np.where(self.held, right[1], side) for side in (-np.inf, np.inf))
        return adjoint_problem(self.problem, right[0], (lower, upper), right[2])


def derivatives_of(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers
) -> SolutionDerivatives:
    """Return the derivatives of an optimum: by its equations, or by adjoint problems where these are too many.

    Raises
    ------
    UnsupportedError
        If an optimum of this kind of problem has no derivatives.
    """
    _ = problem.equations  # raises UnsupportedError if there are modes
    if multipliers.eta_C != 1:
        raise UnsupportedError(f"derivatives: got eta_C = {multipliers.eta_C:g}; only normal multipliers have any.")
    at_points = [term.name for term in problem.terms if term.semi_infinite is not None]
    if at_points:
        raise UnsupportedError(
            f"derivatives: '{at_points[0]}' holds at every frequency, and its peaks move with the data; expected "
            "limits at bins. The derivatives of the cost, result.sensitivities, exist."
        )
    seconds = dense_rows(problem).factorisation_seconds
    if seconds > LONGEST_FACTOR and problem.terms:
        raise UnsupportedError(
            f"derivatives: got '{problem.terms[0].name}' beside so many rows of bins that one factor takes about "
            f"{seconds:.2g} s; expected {LONGEST_FACTOR:g} s at most, or bounds, ends and stop bands alone, whose "
            "derivatives come from adjoint problems. Those of the cost, result.sensitivities, exist."
        )
    found = None
    if is_long(problem, SLOW_FACTOR):
        try:
            found = AdjointDerivatives(problem, trajectory, multipliers)
        except UnsupportedError:
            if is_long(problem):
                raise
    if found is None or (found.reason and not is_long(problem)):  # a factor names the rows that depend on each other
        return SolutionDerivatives(problem, trajectory, multipliers)
    return found


@dataclass(frozen=True, eq=False)
class LongPoint:
    """An optimum of H z + M'y = c, M z = b within bounds, (T+1, n+m), its K, and the bounds that are active.

    ``active`` are those with a multiplier that are no equations, ``above`` upper bounds where the nearer bound counts,
    ``weak`` those with multiplier and slack zero. ``settled``: no sign is wrong.
    """

    kkt: LongKKT
    at: LongSolution
    active: Mask
    above: Mask
    weak: Mask
    settled: bool


def settle(
    problem: OptimalControlProblem,
    sizes: tuple[Array, Array],
    right: Sides,
    bounds: tuple[Array, Array],
    at: LongSolution,
) -> LongPoint:
    """Return the exact optimum near an answer: bounds are exchanged until no sign is wrong. Sizes: of z, of slopes."""
    (units, slope_units), (lower, upper), free = sizes, bounds, bounds[0] < bounds[1]
    price, above = at.normals / slope_units, at.normals > 0
    active = free & ((price > (upper - at.z) / units) | (-price > (at.z - lower) / units))
    weak, settled = ~free & free, False
    kkt = LongKKT(problem, units, slope_units, ~free | active)
    for _ in range(POINT_STEPS):
        exact = kkt.solve((right[0], np.where(above, upper, lower), right[2]))
        if exact is None or exact.error[0] == np.inf:  # nothing is known of what is near a bound
            break
        at = exact
        of_z, of_y = (np.maximum(FORWARD, SAFETY * last) for last in exact.error)
        price, over, under = np.where(above, 1, -1) * at.normals / slope_units, upper - at.z, at.z - lower
        room, error = np.where(active, price, np.minimum(over, under) / units), np.where(active, of_y, of_z)
        weak, wrong = free & (np.abs(room) <= error), free & (room < -error)
        settled = not wrong.any()
        if settled:
            break
        above, active = np.where(wrong & ~active, over < under, above), active ^ wrong
        kkt = LongKKT(problem, units, slope_units, ~free | active)
    return LongPoint(kkt, at, active, np.where(active, above, upper - at.z <= at.z - lower), weak, settled)


class AdjointDerivatives(SolutionDerivatives):
    """The derivatives of the optimum of a long problem with bounds, ends and stop bands.

    Bounds are exchanged until no sign is wrong, as for ``SolutionDerivatives``; arrays are those of z_t = (x_t, u_t).
    """

    def __init__(self, problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers):
        self.problem, cost, n, bounds = problem, problem.quadratic, problem.state_dim, problem.signal_bounds
        free, curvatures = bounds[0] < bounds[1], cost_curvatures(cost, problem.horizon)
        units = np.concatenate(deviation_units(problem, trajectory))
        flat = free if curvatures is None else free & (curvatures <= 0)
        if curvatures is None or flat[:, n:].any() or flat[0].any():
            got = "a cost that is not strictly convex in the controls and in a free initial state"
            raise UnsupportedError(f"derivatives: got {got}; expected one, as many bins are removed.")
        slope_units = float((curvatures * units**2).max()) / units
        self._sizes, kkt_of = (units, slope_units), partial(LongKKT, problem, units, slope_units)
        slope = stack_signals(*cost.gradient(*split_signals(np.zeros(free.shape), n)))
        offset = np.broadcast_to(problem.linear.offset, (problem.horizon, n))
        answer = LongSolution(stack_signals(trajectory.x, trajectory.u), multipliers)
        point = settle(problem, self._sizes, (-slope, slope, offset), bounds, answer)
        weak, held = point.weak, point.kkt.held
        every = kkt_of(held | weak) if (weak & ~held).any() else point.kkt
        self.reason = "" if point.settled else UNSETTLED
        if point.settled and every.random is None:  # weak rows depend on the active rows, or on each other
            self.reason = DEPENDENT_ROWS
        self._point, self._weak, self._bounds = point.at, weak, bounds
        self._above, self._active = point.above, point.active & ~weak
        self._kkt = kkt_of(held & ~weak) if (weak & held).any() else point.kkt
        self._signals = Variables.at(problem, point.at.trajectory, point.at.multipliers)

    def _adjoint(self, of_x: Array, of_u: Array, multipliers: Multipliers | None) -> tuple[Variables, ExistenceFields]:
        zbar = stack_signals(of_x, of_u)
        right, levels = (zbar, 0 * zbar, 0 * of_x[1:]), 0 * zbar
        if multipliers is not None:
            require_multipliers(self.problem, multipliers)
            levels = level_signal(self.problem, multipliers.rho_u, multipliers.rho_x)
            right = zbar, stack_signals(multipliers.mu, multipliers.nu), multipliers.eta
        found, gap = self._solve(right, levels)
        seen = np.argwhere(self._weak & (np.abs(gap) > SEEN * max(self._kkt.sizes(found))))
        return Variables.along(found.trajectory, found.multipliers), self._existence_of(found, seen)

    def _step_along(self, given: Values, cost: float) -> Derivative:
        changed = changed_signals(self.problem, self._signals, given)
        right = -changed.of_z, np.where(self._above, changed.upper, changed.lower), changed.offset
        found, gap = self._solve(right, changed.levels)
        violation = np.where(self._weak & (not self.reason), gap, 0.0)
        size = max(*self._kkt.sizes(found), float(np.abs(violation).max()))
        meets = np.abs(violation) > SEEN * size
        side, existence = found.side, self._existence_of(found, np.argwhere(meets))
        if self.reason:
            return Derivative(*existence, cost, None, None)
        if self._weak.any() or not changed.affine:
            below, above = (
                self._one_sided(sign * size, right, changed.levels) if (sign * violation > SEEN * size).any() else side
                for sign in (-1.0, 1.0)
            )
            return Derivative(*existence, cost, below, above)
        return Derivative(*existence, cost, side, side, *(self._reach(changed, found) if existence[0] else NO_REACH))

    def _solve(self, right: Sides, levels: Array) -> tuple[LongSolution, Array]:
        """Return the solution of K for removed bins with levels, and what it leaves outside of bounds, (T+1, n+m)."""
        found = self._kkt.solve(shift_sides(self.problem, right, levels))
        if found is None:
            raise UnsupportedError("derivatives: no method solves the adjoint problem.")
        found = replace(found, z=found.z + levels)
        return found, np.where(self._above, 1, -1) * (found.z - right[1]) / self._kkt.units[1]

    def _one_sided(self, size: float, right: Sides, levels: Array) -> Side | None:
        """Return the derivative on the side of a signed size, the optimum with weak rows as inequalities, or None."""
        of_z, values, offset = (part / size for part in shift_sides(self.problem, right, levels))
        held, problem = self._kkt.held, self.problem
        bounds = (
            np.where(held | (self._weak & (self._above == is_upper)), values, absent)
            for is_upper, absent in ((False, -np.inf), (True, np.inf))
        )
        lower, upper = bounds
        answer = answer_of(solve_long(adjoint_problem(problem, of_z, (lower, upper), offset)))
        if answer is None:
            return None
        point = settle(problem, self._sizes, (of_z, values, offset), (lower, upper), answer)
        none = LongSolution(levels, zero_multipliers(problem, 1.0))
        return none.plus(point.at, size).side if point.settled else None

    def _reach(self, changed: ChangedSignals, found: LongSolution) -> Reach:
        """Return the steps up to which slacks and multipliers stay above zero, and the bounds there."""
        at, (lower, upper), slope_units = self._point, self._bounds, self._kkt.slope_units
        sign, units, inside = np.where(self._above, 1, -1), self._kkt.units[1], (lower < upper) & ~self._active
        masks = inside, inside, self._active  # upper bounds, lower ones, those with a multiplier
        rooms = (upper - at.z) / units, (at.z - lower) / units, sign * at.normals / slope_units
        rates = (changed.upper - found.z) / units, (found.z - changed.lower) / units, sign * found.normals / slope_units
        slack, rate = (
            np.concatenate([part[mask] for part, mask in zip(parts, masks, strict=True)]) for parts in (rooms, rates)
        )
        places, first = np.concatenate([np.argwhere(mask) for mask in masks]), int(np.count_nonzero(inside))

        def name_row(k: int) -> str:
            t, i = places[k].tolist()
            return self._name_bound(t, i, k < first or (k >= 2 * first and bool(self._above[t, i])))

        return reach(slack, rate, name_row)

    def _existence_of(self, found: LongSolution, seen: Indices) -> ExistenceFields:
        """Return whether a derivative exists where a solution of K moves these weak rows, (rows, 2)."""
        sizes = np.array(self._kkt.sizes(found))
        error = float((found.error / np.maximum(sizes, SEEN * sizes.max())).max()) if sizes.any() else 0.0
        rows, reason = tuple(self._name_bound(t, i, bool(self._above[t, i])) for t, i in seen.tolist()), self.reason
        if not reason and error > MOST_SOLVE_ERROR:
            reason = f"the active rows are nearly dependent: the relative error of the solve is {error:.0e}"
        if not reason and rows:
            reason = f"{WEAK}: {plural(len(rows), 'row')}"
        return not reason, rows, reason, error

    def _name_bound(self, t: int, i: int, above: bool) -> str:
        """Return the name of a bound with its time and component."""
        n, side = self.problem.state_dim, "upper" if above else "lower"
        signal, component = ("state set", i) if i < n else ("control set", i - n)
        return f"{signal}, t = {t}, component {component}, {side}"


def shift_sides(problem: OptimalControlProblem, right: Sides, by: Array) -> Sides:
    """Return a right-hand side for z less a signal (T+1, n+m)."""
    if not by.any():
        return right
    x, u = split_signals(by, problem.state_dim)
    motion = x[1:] - replace(problem.linear, offset=0 * problem.linear.offset).successors(x, u)
    return right[0] - problem.quadratic.bend(by), right[1] - by, right[2] - motion


def adjoint_problem(
    problem: OptimalControlProblem, of_z: Array, bounds: tuple[Array, Array], offset: Array
) -> OptimalControlProblem:
    """Return the problem with the cost 1/2 z'H z - <of_z, z>, other bounds (T+1, n+m), and another offset (T, n)."""
    of_x, of_u = split_signals(-of_z, problem.state_dim)
    cost = problem.quadratic
    cost = replace(cost, q=of_x[:-1], r=of_u, p=of_x[-1], x_ref=0 * cost.x_ref, u_ref=0 * cost.u_ref)
    return with_sides(problem, *bounds, offset, cost)


def answer_of(found: Candidate | None) -> LongSolution | None:
    """Return the optimum that a method claims; None if it has none."""
    if found is None or found.status != Status.OPTIMAL or found.trajectory is None or found.multipliers is None:
        return None
    return LongSolution(stack_signals(found.trajectory.x, found.trajectory.u), found.multipliers)
