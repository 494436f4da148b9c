"""Correction of a point: one Newton step on the optimality conditions of its active rows, in deviations from it.

M z = b are the equations and the active rows, g and H the slope and the Hessian of the cost at the point:

    [H M'] [dz]       [g + M'y]
    [M 0 ] [dy]  =  - [M z - b]

Differences such as M z - b are formed once, in extended precision. All that follows has the size of the correction,
wherever the origin is. The units are those of deviations: of a control its own size, of a state what controls move in
a few steps. They condition the matrix, and nothing else depends on them.

Rounding of z + dz leaves r = M (z + dz) - b. A further solve with [0; -r] leads to a trajectory that satisfies every
row, and prices r: the optimal cost is at most that of the corrected point plus the price.

Where rounded data let more rows meet than can hold, the step has no active rows to rest on. Deviations are optimised
once more, in the unit of what is left: iterative refinement of programs (Gleixner, Steffy and Wolter 2016). There, rows
that hold and rows that do not are apart by order one, and the optimal point is the trajectory that gives the price.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, stack_signals
from lin_freq_ocp.base.errors import NumericalError, UnsupportedError
from lin_freq_ocp.methods.long_problems import LONGEST_FACTOR
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.active_rows import EPSILON, ZERO_GAP, ActiveSystem, solve_active
from lin_freq_ocp.program.backends.base import DEFAULT_TOLERANCE, Claim, backend
from lin_freq_ocp.program.linear_program import LinearProgram, dense_rows
from lin_freq_ocp.program.program import Program, Scaling
from lin_freq_ocp.program.units import scale_rows_and_cost
from lin_freq_ocp.transform.reformulations import at_frequencies
from lin_freq_ocp.transform.simulation import simulate
from lin_freq_ocp.transform.sizes import stated_sizes

FAR_ROW = 1e6  # of a solve in the unit of what another leaves: farther bounds play no part, and would cost it digits
CONTRACTION = 0.1  # part of the residual, or of the unit, that the solve which prices it may leave, also in far rows
RESTING_CONTROL = 1e-6  # unit of a control that rests, relative to its size in the data
MOVED_STEPS = 4  # steps per state in which controls move the states by their units
ROW_ULPS = 64.0  # rounding errors of its own terms that a row may miss where equations depend on each other
DATA_ROUNDING = 4 * EPSILON  # of the terms of a row


@dataclass(frozen=True, eq=False)
class Correction:
    """A corrected point with its multipliers; its bounds on states and controls hold exactly.

    Attributes
    ----------
    price : float
        The change of cost to a trajectory nearby that satisfies every constraint; inf if none is known.
    data_rounding : float
        The change of the optimal cost if rows and the Hessian change by DATA_ROUNDING of their terms at random.
    """

    trajectory: Trajectory
    multipliers: Multipliers
    price: float
    data_rounding: float


def corrections(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers
) -> Iterator[Correction]:
    """Yield the corrected points of a linear problem; none if the active rows determine none.

    The first is that of the active rows of the point. These may be wrong: the next is that of the active rows of the
    optimal deviations, which one more solve finds. Where rounded data let more rows meet than can hold, which of them
    are active is hidden in what that solve leaves. The last is the answer of a solve in the unit of what is left.
    UnsupportedError if the program does not fit into memory, or would take too long.
    """
    for k, (deviations, z, y) in enumerate(deviations_from(problem, trajectory, multipliers)):
        yield from filter(None, [deviations.correct(z, y)])
        if k > 0:
            yield from deviations.refinements(z)


def deviations_from(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers
) -> Iterator[tuple[DeviationProgram, Array, Array]]:
    """Yield the program of the deviations from a point, with that point and its duals, then the optimal ones.

    UnsupportedError as for ``corrections``.
    """
    if (needed := dense_rows(problem).factorisation_seconds) > LONGEST_FACTOR:
        raise UnsupportedError(f"a correction needs about {needed:.2g} s for one factorisation.")
    problem = at_frequencies(problem, multipliers.frequencies)
    trajectory = _within_bounds(problem, trajectory.x, trajectory.u)
    linear = _program_at(problem, trajectory)
    columns = linear.column_units(*deviation_units(problem, trajectory))
    scaling = scale_rows_and_cost(linear, columns, columns)
    deviations = DeviationProgram(linear, trajectory, scaling, linear.sparse.scaled(scaling), multipliers.frequencies)
    yield deviations, np.zeros(linear.variables), scaling.scaled_dual(linear.duals(multipliers))
    solution = backend("clarabel")(deviations.program, DEFAULT_TOLERANCE, None)
    if solution.claim is Claim.SOLVED and solution.z is not None and solution.y is not None:
        yield deviations, solution.z, solution.y


def trajectory_at_rest(problem: OptimalControlProblem, near: Trajectory) -> Trajectory | None:
    """Return the trajectory with controls and first state at their references; None if it diverges.

    Interior points approach it to the root of their tolerance only. Variables without a cost are those of ``near``.
    """
    cost = problem.quadratic
    priced, of_x = (np.diagonal(part, axis1=-2, axis2=-1) > 0 for part in (cost.R, cost.Q))
    if problem.response is not None:  # outputs follow from the controls: products with them cost, too
        priced = priced | cost.S.any(axis=-2)
    u = np.where(priced, cost.u_ref, near.u)
    return simulate_from(problem, u, np.where(np.atleast_2d(of_x)[0], np.atleast_2d(cost.x_ref)[0], near.x[0]))


def simulate_from(problem: OptimalControlProblem, u: Array, start: Array) -> Trajectory | None:
    """Return the trajectory of controls from the allowed state nearest to ``start``; None if it diverges."""
    # x_0 of a response follows from the controls, too
    first = None if problem.response is not None else problem.state_tube.at(0).project(start)
    try:
        return simulate(problem, u, first)
    except NumericalError:
        return None


@dataclass(frozen=True, eq=False)
class DeviationProgram:
    """The program of the deviations from a trajectory, in their units."""

    linear: LinearProgram
    trajectory: Trajectory
    scaling: Scaling
    program: Program
    frequencies: Mapping[str, Array]

    def correct(self, z: Array, y: Array) -> Correction | None:
        """Return the correction of a point, whose duals tell the active rows; None if they determine none."""
        solution = solve_active(self.program, z, y)
        if solution is None or not np.isfinite(self.scaling.dual(solution[1])).all():  # in the units of the problem
            return None
        z, y, system = solution
        corrected, after = self._around(z)
        system = replace(system, program=after.sparse.scaled(self.scaling))
        return self._correction(corrected, y, _repair_price(system, self._terms(corrected)))

    def refinements(self, z: Array) -> Iterator[Correction]:
        """Yield answers of solves in the unit of what a point violates.

        In the second, each row may miss ROW_ULPS rounding errors of its terms: equations that depend on each other
        contradict each other by rounding. The largest of these is the unit if it is larger.
        """
        trajectory, linear = self._around(z)
        left = linear.sparse.scaled(self.scaling).outside(np.zeros(len(z)))
        if left <= EPSILON**2:  # no digit that a correction has
            return
        for width in np.outer((0.0, ROW_ULPS * EPSILON), self._terms(trajectory) * self.program.alone):
            unit = max(left, float(width.max(initial=0.0)))  # rows wider than FAR_ROW would be left out
            scaling = Scaling(unit * self.scaling.columns, self.scaling.rows / unit, self.scaling.cost / unit)
            refined = DeviationProgram(linear, trajectory, scaling, linear.sparse.scaled(scaling), self.frequencies)
            program = refined.program.relax_limits(width / unit)
            solution = backend("clarabel")(program.without_bounds_beyond(FAR_ROW) or program, DEFAULT_TOLERANCE, None)
            if solution.claim is Claim.SOLVED and solution.z is not None and solution.y is not None:
                corrected, near = refined._around(solution.z)
                after, point = near.sparse.scaled(scaling).relax_limits(width / unit), linear.point(corrected.extended)
                slacks = np.concatenate([np.zeros(0), *(rows.origin for rows in near.of_terms)])
                point[linear.signals :] -= 2 * np.spacing(slacks)  # larger slacks satisfy rows, at their price
                rest = solution.z - scaling.scaled_primal(point)
                price = _price(after, rest) if after.outside(rest) <= CONTRACTION else np.inf
                yield refined._correction(corrected, solution.y, price)

    def _terms(self, trajectory: Trajectory) -> Array:
        """Return the sums of the absolute terms of each row; digits of x are those of the user's coordinates."""
        x, origin = np.abs(trajectory.x), self.linear.problem.origin
        sizes = np.append(x if origin is None else x + np.abs(origin), np.abs(trajectory.u))
        return self.scaling.rows * (abs(self.linear.sparse.A[:, : self.linear.signals]) @ sizes)

    def _correction(self, trajectory: Trajectory, y: Array, price: float) -> Correction:
        """Return a correction with these duals, whose price is in the units of the program."""
        multipliers = replace(self.linear.multipliers(self.scaling.dual(y), 1.0), frequencies=self.frequencies)
        rounding = self.linear.problem.quadratic.products(stack_signals(trajectory.x, trajectory.u))
        rounding += float(np.linalg.norm(y * self._terms(trajectory))) / self.scaling.cost
        return Correction(trajectory, multipliers, price / self.scaling.cost, DATA_ROUNDING * rounding)

    def _around(self, z: Array) -> tuple[Trajectory, LinearProgram]:
        """Return the trajectory of z within its bounds, and the program of the deviations from it."""
        problem, change = self.linear.problem, self.linear.direction(self.scaling.primal(z))
        origin = 0.0 if problem.origin is None else problem.origin  # digits of x are those of the user's coordinates
        x, u = (self.trajectory.x + change.x + origin) - origin, self.trajectory.u + change.u
        least = EPSILON * self.linear.split_signals(self.scaling.columns)[1]
        trajectory = _within_bounds(problem, x, np.where(np.abs(u) <= least, 0.0, u))
        linear = _program_at(problem, trajectory)
        linear.share_matrices(self.linear)
        return trajectory, linear


def _program_at(problem: OptimalControlProblem, trajectory: Trajectory) -> LinearProgram:
    """Return the program of the deviations from a trajectory, and of slacks from its least ones."""
    at = trajectory.extended
    slacks = [term.penalty.least_slacks(term.map.values(at.x, at.u)) for term in problem.terms]
    return LinearProgram(problem, at, slacks)


def _price(program: Program, change: Array) -> float:
    """Return by how much a change of z can change the cost."""
    return abs(float(program.q @ change)) + 0.5 * float(change @ (program.P @ change))


def _repair_price(system: ActiveSystem, terms: Array) -> float:
    """Return the price of a change that satisfies all rows of the program; inf if the system gives none.

    Rows that depend on each other may miss ROW_ULPS rounding errors of their terms.
    """
    program, residual = system.program, system.residual(np.zeros(len(system.program.q)))
    change, left = system.change(residual)
    holds = left <= CONTRACTION or bool((np.abs(residual) <= ROW_ULPS * EPSILON * system.gaps(terms)).all())
    others = program.alone & ~system.active.above & ~system.active.below
    return _price(program, change) if holds and program.outside(change, others) <= ZERO_GAP else np.inf


def _within_bounds(problem: OptimalControlProblem, x: Array, u: Array) -> Trajectory:
    """Return the nearest states and controls within their bounds."""
    return Trajectory(problem.state_tube.project(x), problem.control_tube.project(u))


def deviation_units(problem: OptimalControlProblem, trajectory: Trajectory) -> tuple[Array, Array]:
    """Return the units of states, (n,), what controls of their units move in some steps, and of controls, (m,)."""
    x, of_u = trajectory.x, np.maximum(np.abs(trajectory.u).max(0), RESTING_CONTROL * stated_sizes(problem)[1])
    responses, reach = np.zeros((problem.state_dim, problem.control_dim)), np.zeros(problem.state_dim)
    if problem.response is None:
        for t in range(min(problem.horizon, MOVED_STEPS * problem.state_dim)):
            A, B, _ = problem.linear.at(t)
            responses = np.hstack([A @ responses, B * of_u])
            reach = np.maximum(reach, np.abs(responses).max(1))
    reach = np.where((reach > 0) & np.isfinite(reach), reach, np.ptp(x, axis=0))
    size = np.abs(x).max(0)
    return np.where(reach > 0, reach, np.where(size > 0, size, 1.0)), of_u
