"""Correction of a point: one Newton step on the optimality conditions of its active rows, in deviations from it.

M z = b are the equations and the active rows, g and H the slope and the Hessian of the cost at the point:

    [H M'] [dz]       [g + M'y]
    [M 0 ] [dy]  =  - [M z - b]

Differences such as M z - b are formed once, in extended precision. All that follows has the size of the correction,
wherever the origin is. The units are those of deviations: of a control its own size, of a state what controls move in
a few steps. They condition the matrix, and nothing else depends on them.

Rounding of z + dz leaves r = M (z + dz) - b. A further solve with [0; -r] leads to a trajectory that satisfies every
row, and prices r: the optimal cost is at most that of the corrected point plus the price.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

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

CONTRACTION = 0.1  # part of the residual that the solve which prices it may leave
RESTING_CONTROL = 1e-6  # unit of a control that rests, relative to its size in the data
MOVED_STEPS = 4  # steps per state in which controls move the states by their units
ROW_ULPS = 64.0  # rounding errors of its own terms that a row may miss where equations depend on each other
DATA_ROUNDING = 4 * EPSILON  # of the terms of a row
SIGN_VECTORS = 3  # random signs of the rounding of rows


@dataclass(frozen=True, eq=False)
class Correction:
    """A corrected point with its multipliers; its bounds on states and controls hold exactly.

    Attributes
    ----------
    price : float
        The change of cost to a trajectory nearby that satisfies every constraint; inf if none is known.
    """

    trajectory: Trajectory
    multipliers: Multipliers
    price: float
    _system: ActiveSystem
    _terms: Array  # sums of the absolute terms of each row
    _cost: float  # factor of the cost in the units of the system
    _hessian_rounding: float

    @cached_property
    def data_rounding(self) -> float:
        """The change of the optimal cost if active rows and the Hessian change by DATA_ROUNDING of their terms."""
        rng, size = np.random.default_rng(0), self._system.gaps(DATA_ROUNDING * self._terms)
        changes = (self._system.change(size * rng.choice([-1.0, 1.0], len(size))) for _ in range(SIGN_VECTORS))
        return max(_price(self._system, change) for change, _ in changes) / self._cost + self._hessian_rounding


def corrections(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers
) -> Iterator[Correction]:
    """Yield the corrected points of a linear problem; none if the active rows determine none.

    The first is that of the active rows of the point. These may be wrong: the next is that of the active rows of the
    optimal deviations, which one more solve finds. UnsupportedError if the program does not fit into memory, or would
    take too long.
    """
    for deviations, z, y in deviations_from(problem, trajectory, multipliers):
        yield from filter(None, [deviations.correct(z, y)])


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
    linear = LinearProgram(problem, trajectory.extended)
    columns = linear.column_units(*deviation_units(problem, trajectory))
    scaling = scale_rows_and_cost(linear, columns, columns)
    deviations = DeviationProgram(linear, trajectory, scaling, linear.sparse.scaled(scaling), multipliers.frequencies)
    yield deviations, scaling.scaled_primal(linear.point(trajectory)), scaling.scaled_dual(linear.duals(multipliers))
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
        linear, scaling, problem = self.linear, self.scaling, self.linear.problem
        if (solution := solve_active(self.program, z, y)) is None:
            return None
        z, y, system = solution
        duals = scaling.dual(y)
        if not np.isfinite(duals).all():  # too large for the units of the problem
            return None
        change, (_, of_u) = linear.direction(scaling.primal(z)), linear.split_signals(scaling.columns)
        origin = 0.0 if problem.origin is None else problem.origin  # digits of x are those of the user's coordinates
        x, u = (self.trajectory.x + change.x + origin) - origin, self.trajectory.u + change.u
        corrected = _within_bounds(problem, x, np.where(np.abs(u) <= EPSILON * of_u, 0.0, u))
        after = LinearProgram(problem, corrected.extended)
        after.share_matrices(linear)
        point = after.point(corrected)
        system = replace(system, program=after.sparse.scaled(scaling))
        sizes = np.abs(corrected.x) + np.abs(origin), np.abs(corrected.u), np.abs(point[linear.signals :])
        sizes = np.concatenate([part.ravel() for part in sizes])
        terms = scaling.rows * (abs(linear.sparse.A) @ sizes)
        return Correction(
            corrected,
            replace(linear.multipliers(duals, 1.0), frequencies=self.frequencies),
            _repair_price(system, scaling.scaled_primal(point), terms) / scaling.cost,
            system,
            terms,
            scaling.cost,
            DATA_ROUNDING * problem.quadratic.products(stack_signals(corrected.x, corrected.u)),
        )


def _price(system: ActiveSystem, change: Array) -> float:
    """Return by how much a change of z can change the cost."""
    program = system.program
    return abs(float(program.q @ change)) + 0.5 * float(change @ (program.P @ change))


def _repair_price(system: ActiveSystem, z: Array, terms: Array) -> float:
    """Return the price of a change that satisfies all rows of the program; inf if the system gives none.

    Equations that depend on each other contradict each other by rounding, which is no more than ROW_ULPS rounding
    errors of the terms of each row.
    """
    residual, rounding = system.residual(z), ROW_ULPS * EPSILON * system.gaps(terms)
    change, left = system.change(residual)
    holds = left <= CONTRACTION or bool((np.abs(residual) <= rounding).all())
    if not holds and rounding.any():
        change = system.nearest_change(residual, rounding)
        holds = bool((np.abs(residual - system.M @ change) <= rounding).all())
    program, values = system.program, system.program.A @ (z + change)
    others = program.alone & ~system.active.above & ~system.active.below
    outside = np.maximum(values - program.upper, program.lower - values)[others]
    holds &= max(outside.max(initial=0.0), program.outside_cones(values - program.lower)) <= ZERO_GAP
    return _price(system, change) if holds else np.inf


def _within_bounds(problem: OptimalControlProblem, x: Array, u: Array) -> Trajectory:
    """Return the nearest states and controls within their bounds."""
    return Trajectory(problem.state_tube.project(x), problem.control_tube.project(u))


def deviation_units(problem: OptimalControlProblem, trajectory: Trajectory) -> tuple[Array, Array]:
    """Return the units of states, (n,), what controls of their units move in some steps, and of controls, (m,)."""
    x, of_u = trajectory.x, np.maximum(np.abs(trajectory.u).max(0), RESTING_CONTROL * stated_sizes(problem)[1])
    responses, reach = np.zeros((problem.state_dim, problem.control_dim)), np.zeros(problem.state_dim)
    if problem.response is None:
        steps = min(problem.horizon, MOVED_STEPS * problem.state_dim)
        for t in range(steps):
            A, B, _ = problem.linear.at(t)
            responses = np.hstack([A @ responses, B * of_u])
            reach = np.maximum(reach, np.abs(responses).max(1))
    reach = np.where((reach > 0) & np.isfinite(reach), reach, np.ptp(x, axis=0))
    size = np.abs(x).max(0)
    return np.where(reach > 0, reach, np.where(size > 0, size, 1.0)), of_u
