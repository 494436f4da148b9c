"""One solve of a convex program in given units; the answer of the backend is measured in units of its own size."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now, seconds_left
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.methods.candidate import SOLVED_TOLERANCE, Candidate
from lin_freq_ocp.program.backends.base import Claim, Solution, Solver
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Program, Residuals, Scaling
from lin_freq_ocp.program.units import point_scaling, point_sizes

ACCURATE_ANSWER = 1e-8  # relative residuals up to which an answer of Clarabel is not improved by other units
DIVERGED_SIZE = 1e100  # size, in expected units, of a diverged point
FAR_BOUND = 1e4  # size, in expected units, from which bounds disturb solvers and are left out at first


@dataclass(frozen=True, eq=False)
class ScaledAnswer:
    """The answer of a solver in given units; a point z with duals y is in the units of the program."""

    candidate: Candidate
    scaling: Scaling
    error: float = np.inf  # the largest residual; that of a point in units of its own size
    z: Array | None = None
    y: Array | None = None
    late: bool = False  # whether the time limit ended it

    @property
    def ended(self) -> bool:
        """Whether the solve was the last: interrupted, or at the time limit."""
        return self.candidate.interrupted or self.late


@dataclass(frozen=True, eq=False)
class ScaledSolver:
    """A program with a solver and its limits, which is solved in one system of units after another."""

    linear: LinearProgram
    solver: Solver
    tolerance: float | None  # that the user asks for
    solver_tolerance: float
    end: float  # by clock.now
    target: float  # residuals from which an answer is not improved

    @property
    def over(self) -> bool:
        """Whether there is no time left."""
        return now() >= self.end

    def attempt(self, scaling: Scaling) -> ScaledAnswer:
        """Solve in the given units, at first without far bounds."""
        program = self.linear.sparse.scaled(scaling)
        near = program.without_bounds_beyond(FAR_BOUND)
        attempt = self._solve(near or program, scaling)
        final = attempt.ended or attempt.candidate.status in (Status.OPTIMAL, Status.INFEASIBLE) or self.over
        if near is None or final:
            return attempt
        complete = self._solve(program, scaling)
        return complete if attempt.candidate.status == Status.UNBOUNDED else better_of(attempt, complete)

    def solve_with_all_bounds(self, scaling: Scaling) -> ScaledAnswer:
        """Solve in the given units with all bounds."""
        return self._solve(self.linear.sparse.scaled(scaling), scaling)

    def solve_without_far_bounds(self, scaling: Scaling) -> ScaledAnswer | None:
        """Solve without far bounds; None if no bound is far, or if the program is unbounded without them."""
        near = self.linear.sparse.scaled(scaling).without_bounds_beyond(FAR_BOUND)
        attempt = None if near is None else self._solve(near, scaling)
        return None if attempt is None or attempt.candidate.status == Status.UNBOUNDED else attempt

    def recover(self, scaling: Scaling, program: Program, solution: Solution) -> ScaledAnswer:
        """Return a solver's answer, which is in the units of ``scaling``, as a measured trajectory with multipliers."""
        z, y, claim = solution.z, solution.y, solution.claim
        late = claim is Claim.TIME_LIMIT
        interrupted = claim is Claim.INTERRUPTED
        unsolved = Status.LIMIT if late else Status.NUMERICAL_ERROR
        failed = Candidate(unsolved, message=solution.message, interrupted=interrupted)
        with np.errstate(over="ignore"):
            finite = y is None or bool(np.isfinite(scaling.dual(y)).all())
        if not finite:  # too large for the units of the problem
            return ScaledAnswer(failed, scaling)
        if claim is Claim.INFEASIBLE:
            ray = None if y is None else self.linear.multipliers(scaling.dual(y), 0.0)
            error = np.inf if y is None else program.infeasibility_residual(y)
            return ScaledAnswer(Candidate(Status.INFEASIBLE, ray=ray, message=solution.message), scaling, error)
        if claim is Claim.UNBOUNDED:
            along = None if z is None else self.linear.direction(scaling.primal(z))  # which the judge projects
            return ScaledAnswer(Candidate(Status.UNBOUNDED, message=solution.message, descent=along), scaling, 0.0)
        if z is None or y is None:
            return ScaledAnswer(failed, scaling, late=late)
        if not program.P.nnz and not program.q.any():
            y = np.zeros_like(y)  # without a cost, multipliers of zero are exact, and the solver's are rounding errors
        point, duals = scaling.primal(z), scaling.dual(y)
        residuals = Residuals(np.inf, np.inf, np.inf)
        if (np.abs(point) < DIVERGED_SIZE * scaling.columns).all():  # in the units of the point
            units = point_scaling(self.linear, point, scaling.columns)
            scaled, sizes = units.scaled_primal(point), units.scaled_primal(point_sizes(self.linear, point))
            with np.errstate(over="ignore", invalid="ignore"):  # residuals that are not finite are no small ones
                residuals = self.linear.sparse.scaled(units).residuals(scaled, units.scaled_dual(duals), sizes)
        if late or claim in (Claim.LIMIT, Claim.INTERRUPTED):
            status = Status.LIMIT
        else:
            solved = residuals.worst <= max(SOLVED_TOLERANCE, self.tolerance or 0.0)
            status = Status.OPTIMAL if solved else Status.NUMERICAL_ERROR
        found = self.linear.trajectory(point), self.linear.multipliers(duals, 1.0)
        candidate = Candidate(status, *found, None, residuals, solution.message, interrupted=interrupted)
        if not np.isfinite(residuals.worst):
            point, duals = None, None
        return ScaledAnswer(candidate, scaling, residuals.worst, point, duals, late)

    def _solve(self, program: Program, scaling: Scaling) -> ScaledAnswer:
        solution = self.solver(program, self.solver_tolerance, seconds_left(self.end))
        return self.recover(scaling, program, solution)


def better_of(first: ScaledAnswer, second: ScaledAnswer) -> ScaledAnswer:
    """Return the attempt with the smaller residuals; the first if the second was cut short."""
    if second.ended:
        return replace(first, candidate=replace(first.candidate, interrupted=second.candidate.interrupted))
    return second if second.error < first.error else first
