"""Solver state reused when a problem is solved again with other boundary conditions, references or bounds."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.rays import InfeasibilityCertificate
from lin_freq_ocp.methods.candidate import Candidate, SolveOptions
from lin_freq_ocp.methods.condensed.plans import UNLIMITED, Budget, CondensedSolver, Plan
from lin_freq_ocp.methods.convex.sparse_program import ProgramCache
from lin_freq_ocp.methods.spectral.reductions import REDUCTIONS
from lin_freq_ocp.methods.spectral.solver import SpectralSolution, SpectralSolver
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.transform.reductions import Chain, Change, reduce_problem
from lin_freq_ocp.transform.reformulations import Translation

if TYPE_CHECKING:
    from lin_freq_ocp.methods.structured.solver import StageCache

KEPT_RAYS = 8  # of infeasible problems, each tried on the next initial states
CONDENSED_SOLVES = 3
"""The solve from which the condensed method is tried: its set-up takes as long as some ten solves of the Fourier-domain
method, so that a problem that is solved twice does not need it."""


def solve_spectral(problem: OptimalControlProblem, options: SolveOptions) -> Candidate:
    """Solve a problem in the Fourier domain from scratch; UnsupportedError if it is outside the class of the method."""
    reduced = reduce_problem(problem, REDUCTIONS)
    solver = SpectralSolver(reduced.problem)
    return reduced.recover(solver.solve(tolerance=options.tolerance, time_limit=options.time_limit))


class SolverCache:
    """A problem whose states are counted from an origin, and the solver state that its solves share.

    The Fourier-domain solver and the condensed method are set up when first needed. Without ``programs``, those of the
    sparse program are its own.
    """

    def __init__(self, translation: Translation, programs: ProgramCache | None = None):
        self.translation, self.problem, self.origin = translation, translation.problem, translation.origin
        self.exclusions = deque[InfeasibilityCertificate](maxlen=KEPT_RAYS)
        self._reduced: Chain | None = None
        self._solver: SpectralSolver | None = None
        self._refusal: UnsupportedError | None = None
        self._last: SpectralSolution | None = None
        self._condensed: CondensedSolver | None = None
        self._solves, self._refused_condensed = 0, ""
        self.programs = programs or ProgramCache()

    @cached_property
    def stage_cache(self) -> StageCache:
        """Return the solver state of the structured method, whose modules few problems need."""
        from lin_freq_ocp.methods.structured.solver import StageCache

        return StageCache()

    def solve(self, problem: OptimalControlProblem, change: Change, options: SolveOptions) -> Candidate:
        """Solve the changed problem in the Fourier domain, from the last solution; UnsupportedError as from scratch.

        The solver refuses changes of its structure, such as other fixed components: these problems need a new one.
        """
        if self._changes_rows(problem, change):
            return solve_spectral(problem, options)
        reduced, solver = self._spectral_solver()
        try:
            solution = solver.solve_changed(change, self._last, options.tolerance, options.time_limit)
        except (ProblemError, UnsupportedError):
            return solve_spectral(problem, options)
        if solution.status == Status.OPTIMAL:
            self._last = solution
        return reduced.recover(solution)

    def condensed(self, problem: OptimalControlProblem, change: Change) -> Candidate | None:
        """Solve the changed problem in few unknowns, from the multipliers of the last solve.

        None where the method does not take it, ends without an answer, or does not pay yet.
        """
        self._solves += 1
        if (self._condensed is None and self._solves < CONDENSED_SOLVES) or self._changes_rows(problem, change):
            return None
        condensed = self._condensed_solver()
        if condensed is None:
            return None
        reduced, solver = self._spectral_solver()
        try:
            changed, lti = solver.changed_problem(change, None if reduced.links else problem)
        except (ProblemError, UnsupportedError):
            return None
        started = now()
        answer = condensed.plan(changed.initial_box.lower, lti)
        if answer is None:
            return None
        seconds = {"setup": condensed.setup_seconds, "solve": now() - started}
        return reduced.recover(replace(answer.candidate(changed), seconds=seconds))

    def prepare(self) -> None:
        """Set up the condensed method now, if it is not, to be tried from the first solve on."""
        self._solves = CONDENSED_SOLVES
        self._condensed_solver()

    @property
    def plans(self) -> bool:
        """Whether the condensed method is set up for the problem, and not for a reduced one."""
        return self._condensed is not None and self._reduced is not None and not self._reduced.links

    @property
    def no_plans(self) -> str:
        """Return why the condensed method has no plans for the problem."""
        return self._refused_condensed or "method 'condensed': it would plan for a reduced problem, in other unknowns."

    def plan(self, start: Array, budget: Budget = UNLIMITED) -> Plan | None:
        """Return the condensed method's plan from another initial state, (n,), without a certificate.

        None where the method has not been set up, or ends without a plan.
        """
        if self._condensed is None or self._solver is None or not self.plans:
            return None
        plan = self._condensed.plan(start, self._solver.lti, budget)
        return plan if plan is not None and plan.eta_C else None

    def _changes_rows(self, problem: OptimalControlProblem, change: Change) -> bool:
        """Whether a changed set is one that a reduction turns into rows, which the solver keeps as they were.

        Rows on x_T become rows of the step before, in which disturbances act.
        """
        old = self.problem
        if change.disturbance is not None and reduce_problem(old, REDUCTIONS).links:
            return True
        ends = (
            (change.initial_state, problem.initial_state, old.initial_state),
            (change.terminal_state, problem.terminal_state, old.terminal_state),
        )
        if any(changed is not None and (new.members or before.members) for changed, new, before in ends):
            return True
        if not change.bounds:
            return False
        reduced = ((given, reduce_problem(given, REDUCTIONS).problem) for given in (problem, old))
        return any(len(given.stage_rows) != len(in_rows.stage_rows) for given, in_rows in reduced)

    def plan_batch(self, starts: Array) -> tuple[dict[int, Plan], bool]:
        """Return the condensed method's plans from initial states (N, n) by number; see ``CondensedSolver``."""
        condensed = self._condensed_solver()
        if condensed is None or self._solver is None or not self.plans:
            return {}, False
        return condensed.plan_batch(starts, self._solver.lti)

    def _condensed_solver(self) -> CondensedSolver | None:
        """Return the condensed method in the units of the Fourier-domain method; None if it refuses the problem."""
        if self._refused_condensed:
            return None
        try:
            _, solver = self._spectral_solver()
            if self._condensed is None or self._condensed.units is not solver.units:
                self._condensed = CondensedSolver(solver.lti, solver.units)
        except UnsupportedError as error:
            self._refused_condensed = str(error)
        return self._condensed

    def _spectral_solver(self) -> tuple[Chain, SpectralSolver]:
        """Return the solver with its reductions; a refusal is remembered, as is the solver."""
        if self._refusal is not None:
            raise self._refusal
        if self._reduced is None or self._solver is None:
            self._reduced, self._solver = self._set_up()
        return self._reduced, self._solver

    @one_blas_thread
    def _set_up(self) -> tuple[Chain, SpectralSolver]:
        reduced = reduce_problem(self.problem, REDUCTIONS)
        try:
            return reduced, SpectralSolver(reduced.problem)
        except UnsupportedError as error:
            self._refusal = error
            raise


class SearchCache(ABC):
    """The state of a search over modes that the next step of a control loop reuses.

    ``solved`` is the number of relaxations that the searches of the last step solved, ``levels`` holds the cost below
    which the last of them was, if there was one.
    """

    solved: int
    levels: tuple[float, ...]

    @abstractmethod
    def set_base(self, base: OptimalControlProblem | None) -> None:
        """Set the problem from which the next one differs in its initial state alone; None without one."""
