"""One solve of a convex program in some units: what a backend returned, measured in the units of its own answer."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import LEAST_SECONDS, now
from lin_freq_ocp.methods.candidate import SOLVED_TOLERANCE, Candidate
from lin_freq_ocp.methods.convex.polish import nearest_recession, polish_point
from lin_freq_ocp.program.backends.base import Claim, Solution, Solver
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Program, Residuals, Scaling
from lin_freq_ocp.program.units import point_scaling, point_sizes

ACCURATE_ANSWER = 1e-8  # relative residuals up to which an answer of Clarabel is not improved by other units
DIVERGED_SIZE = 1e100  # size, in expected units, of a diverged point
FAR_BOUND = 1e4  # size, in expected units, from which bounds are left out at first, as they disturb solvers
UNBOUNDED_TOLERANCE = 1e-6  # residual of a direction of descent, scaled to slope -1


@dataclass(frozen=True, eq=False)
class Attempt:
    """What one solve in some units ended with; a point z with duals y is in the program's own units."""

    candidate: Candidate
    scaling: Scaling
    error: float = np.inf  # its largest residual, of a point in units of its own size
    z: Array | None = None
    y: Array | None = None
    late: bool = False  # whether the time limit ended it

    @property
    def ended(self) -> bool:
        """Whether nothing more is to be tried."""
        return self.candidate.interrupted or self.late


@dataclass(frozen=True, eq=False)
class ScaledSolver:
    """A program with a solver and its limits, to be solved in several units."""

    linear: LinearProgram
    solver: Solver
    tolerance: float | None  # asked by the user
    asked: float  # of the solver
    end: float  # by clock.now
    target: float  # residuals at which an answer is not improved

    @property
    def left(self) -> float | None:
        """The seconds that are left, or None for no limit."""
        return None if self.end == np.inf else max(self.end - now(), LEAST_SECONDS)

    @property
    def over(self) -> bool:
        """Whether there is no time left."""
        return now() >= self.end

    def attempt(self, scaling: Scaling, tolerance: float | None = None) -> Attempt:
        """Solve in the given units, and measure."""
        program = self.linear.sparse.scaled(scaling)
        near = program.without_bounds_beyond(FAR_BOUND)
        if near is None:
            return self._solve(program, scaling, tolerance)
        attempt = self._solve(near, scaling, tolerance)
        if attempt.ended or attempt.candidate.status in ("optimal", "infeasible") or self.over:
            return attempt
        complete = self._solve(program, scaling, tolerance)
        return complete if attempt.candidate.status == "unbounded" else better_of(attempt, complete)

    def solve_with_all_bounds(self, scaling: Scaling) -> Attempt:
        """Solve in the given units with all bounds, and measure."""
        return self._solve(self.linear.sparse.scaled(scaling), scaling, None)

    def solve_without_far_bounds(self, scaling: Scaling) -> Attempt | None:
        """Solve without far bounds, and measure with all; None if no bound is far, or the program is then unbounded."""
        near = self.linear.sparse.scaled(scaling).without_bounds_beyond(FAR_BOUND)
        attempt = None if near is None else self._solve(near, scaling, None)
        return None if attempt is None or attempt.candidate.status == "unbounded" else attempt

    def recover(self, scaling: Scaling, program: Program, solution: Solution) -> Attempt:
        """Return the trajectory and multipliers of a solver's answer, which is in the units of ``scaling``."""
        z, y, claim = solution.z, solution.y, solution.claim
        late = claim is Claim.TIME_LIMIT
        status, interrupted = "limit" if late else "numerical_error", claim is Claim.INTERRUPTED
        failed = Candidate(status, message=solution.message, interrupted=interrupted)
        with np.errstate(over="ignore"):
            finite = y is None or bool(np.isfinite(scaling.dual(y)).all())
        if not finite:  # too large for the units of the problem
            return Attempt(failed, scaling)
        if claim is Claim.INFEASIBLE:
            ray = None if y is None else self.linear.multipliers(scaling.dual(y), 0.0)
            error = np.inf if y is None else program.infeasibility_residual(y)
            return Attempt(Candidate("infeasible", ray=ray, message=solution.message), scaling, error)
        if claim is Claim.UNBOUNDED:
            ray = None if z is None or program.descent_ray_residual(z) == np.inf else nearest_recession(program, z)
            error = np.inf if ray is None else program.descent_ray_residual(ray)
            if ray is None or error > UNBOUNDED_TOLERANCE:
                return Attempt(Candidate("numerical_error", message=solution.message), scaling)
            along = self.linear.direction(scaling.primal(ray))
            return Attempt(Candidate("unbounded", message=solution.message, descent=along), scaling, error)
        if z is None or y is None:
            return Attempt(failed, scaling, late=late)
        if not program.P.nnz and not program.q.any():
            y = np.zeros_like(y)  # nothing to minimise: multipliers of zero are exact, the solver's are rounding
        point, duals = scaling.primal(z), scaling.dual(y)
        residuals = Residuals(np.inf, np.inf, np.inf)
        if (np.abs(point) < DIVERGED_SIZE * scaling.columns).all():  # in the units of the point
            own = point_scaling(self.linear, point, scaling.columns)
            at, sizes = own.scaled_primal(point), own.scaled_primal(point_sizes(self.linear, point))
            residuals = self.linear.sparse.scaled(own).residuals(at, own.scaled_dual(duals), sizes)
        if late or claim in (Claim.LIMIT, Claim.INTERRUPTED):
            status = "limit"
        else:
            status = "optimal" if residuals.worst <= max(SOLVED_TOLERANCE, self.tolerance or 0.0) else "numerical_error"
        candidate = Candidate(
            status,
            self.linear.trajectory(point),
            self.linear.multipliers(duals, 1.0),
            None,
            residuals,
            solution.message,
            interrupted=interrupted,
        )
        if not np.isfinite(residuals.worst):
            point, duals = None, None
        return Attempt(candidate, scaling, residuals.worst, point, duals, late)

    def _solve(self, program: Program, scaling: Scaling, tolerance: float | None) -> Attempt:
        solution = self.solver(program, tolerance or self.asked, self.left)
        attempt = self.recover(scaling, program, solution)
        if attempt.z is None or attempt.ended or attempt.error <= self.target or program.cones or self.over:
            return attempt
        assert solution.z is not None
        assert solution.y is not None
        better = polish_point(program, solution.z, solution.y)
        if better is None:
            return attempt
        claimed = replace(solution, claim=Claim.SOLVED, z=better[0], y=better[1])
        return better_of(attempt, self.recover(scaling, program, claimed))


def better_of(one: Attempt, other: Attempt) -> Attempt:
    """Return the better of two attempts; the first if the later was cut short."""
    if other.ended:
        return replace(one, candidate=replace(one.candidate, interrupted=other.candidate.interrupted))
    return other if other.error < one.error else one
