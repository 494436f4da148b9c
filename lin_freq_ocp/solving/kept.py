"""What solves of one problem between other ends and with other references share: everything that is set up once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, known_entries
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.candidate import Candidate, SolveOptions, require_convex
from lin_freq_ocp.methods.condensed.plans import UNLIMITED, Budget, CondensedSolver, Plan, PlanBatch
from lin_freq_ocp.methods.convex.sparse_program import ProgramCache
from lin_freq_ocp.methods.spectral import REDUCTIONS, SpectralSolution, SpectralSolver
from lin_freq_ocp.methods.structured.solver import Prepared
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reductions import Chain, reduce_problem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import SetOrSets

CONDENSED_SOLVES = 3
"""The solve from which the condensed method is tried: its set-up takes as long as some ten solves of the Fourier-domain
method, so that a problem that is solved twice does not need it."""


@dataclass(frozen=True, eq=False)
class Change:
    """Other ends, references and bounds ("state_set", "control_set") than those of a problem; None keeps its own."""

    initial_state: ConvexSet | ArrayLike | None = None
    terminal_state: ConvexSet | ArrayLike | None = None
    references: Mapping[str, ArrayLike] | None = None
    bounds: Mapping[str, SetOrSets] | None = None

    @property
    def starts_elsewhere(self) -> bool:
        """Whether no more changes than the initial state."""
        return self.terminal_state is None and self.references is None and not self.bounds

    def of(self, problem: OptimalControlProblem) -> OptimalControlProblem:
        """Return the changed problem."""
        if self.bounds:
            problem = replace(problem, **known_entries("bounds", self.bounds, ("state_set", "control_set")))
        if self.references is not None:
            problem = problem.with_references(self.references)
        if self.initial_state is None and self.terminal_state is None:
            return problem
        return problem.with_ends(self.initial_state, self.terminal_state)


def spectral_problem(problem: OptimalControlProblem) -> Chain:
    """Return the problem that the Fourier-domain method takes in place of a given one, and the way back."""
    require_convex(problem)
    return reduce_problem(problem, REDUCTIONS)


def solve_spectral(problem: OptimalControlProblem, options: SolveOptions) -> Candidate:
    """Solve a problem in the Fourier domain from scratch; UnsupportedError if it is outside the class of the method."""
    reduced = spectral_problem(problem)
    solver = SpectralSolver(reduced.problem)
    return reduced.recover(solver.solve(tolerance=options.tolerance, time_limit=options.time_limit))


class Kept:
    """A problem, its Fourier-domain solver with the last solution, and its stages; each is made when it is needed."""

    def __init__(self, problem: OptimalControlProblem):
        self.problem = problem
        self._reduced: Chain | None = None
        self._solver: SpectralSolver | None = None
        self._refusal: UnsupportedError | None = None
        self._last: SpectralSolution | None = None
        self._condensed: CondensedSolver | None = None
        self._solves, self._refused_condensed = 0, ""
        self.prepared = Prepared()
        self.programs = ProgramCache()

    def spectral(self, problem: OptimalControlProblem, change: Change, options: SolveOptions) -> Candidate:
        """Solve the changed problem in the Fourier domain, from the last solution; UnsupportedError as from scratch."""
        if not self._takes(problem, change):
            return solve_spectral(problem, options)
        reduced, solver = self._spectral_solver()
        found = solver.solve(
            change.initial_state,
            change.terminal_state,
            change.references,
            change.bounds,
            warm_start=self._last,
            tolerance=options.tolerance,
            time_limit=options.time_limit,
        )
        if found.status == "optimal":
            self._last = found
        return reduced.recover(found)

    def condensed(self, problem: OptimalControlProblem, change: Change) -> Candidate | None:
        """Solve the changed problem in few unknowns, from the multipliers of the last solve.

        None where the method does not take it, ends without an answer, or does not pay yet.
        """
        self._solves += 1
        condensed = (
            self._condensed_solver() if self._solves >= CONDENSED_SOLVES and self._takes(problem, change) else None
        )
        if condensed is None:
            return None
        reduced, solver = self._spectral_solver()
        changes = change.initial_state, change.terminal_state, change.references, change.bounds
        changed, lti = solver.changed_problem(*changes)
        started = now()
        plan = condensed.plan(changed.initial_box.lower, lti)
        if plan is None:
            return None
        seconds = {"setup": condensed.setup_seconds, "solve": now() - started}
        return reduced.recover(replace(plan.candidate(changed), seconds=seconds))

    def prepare(self) -> None:
        """Set up the condensed method now, to be tried from the first solve on."""
        self._solves = CONDENSED_SOLVES
        self._condensed_solver()

    @property
    def plans(self) -> bool:
        """Whether the condensed method is set up for the problem, and not for a reduced one."""
        return self._condensed is not None and self._reduced is not None and not self._reduced.inverses

    @property
    def no_plans(self) -> str:
        """Return why the condensed method has no plans for the problem."""
        return self._refused_condensed or "method 'condensed': it would plan for a reduced problem, in other unknowns."

    def plan(self, start: Array, budget: Budget = UNLIMITED) -> Plan | None:
        """Return the condensed method's plan from another initial state, (n,), without a certificate.

        None where the method has not been set up, or ends without an answer.
        """
        if self._condensed is None or self._solver is None or not self.plans:
            return None
        return self._condensed.plan(start, self._solver.lti, budget)

    def _takes(self, problem: OptimalControlProblem, change: Change) -> bool:
        """Whether the kept solver takes a changed problem: new sets are boxes, none is rows, equal values are fixed."""
        old = self.problem
        ends = (
            (change.initial_state, problem.initial_state, old.initial_state),
            (change.terminal_state, problem.terminal_state, old.terminal_state),
        )
        fixed = list(zip(problem.ends, old.ends, strict=True))
        if change.bounds:
            fixed += [(problem.state_tube, old.state_tube), (problem.control_tube, old.control_tube)]
        if any(given is not None and (mine.members or others.members) for given, mine, others in ends):
            return False
        if not all(np.array_equal(mine.fixed, others.fixed) for mine, others in fixed):
            return False
        if not change.bounds:
            return True
        return all(len(spectral_problem(one).problem.stage_rows) == len(one.stage_rows) for one in (problem, old))

    def plan_batch(self, starts: Array) -> PlanBatch | None:
        """Return the condensed method's plans from initial states (N, n), without certificates; None as ``plan``."""
        condensed = self._condensed_solver()
        if condensed is None or self._reduced is None or self._solver is None or self._reduced.inverses:
            return None
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
        if self._refusal is not None:
            raise self._refusal
        if self._reduced is None or self._solver is None:
            self._reduced = spectral_problem(self.problem)
            try:
                self._solver = SpectralSolver(self._reduced.problem)
            except UnsupportedError as error:
                self._refusal = error
                raise
        return self._reduced, self._solver


class SearchCache(ABC):
    """What a search leaves for that of the next step of a control loop.

    ``solved`` is the number of relaxations that the last search has solved.
    """

    solved: int

    @abstractmethod
    def begins(self, base: OptimalControlProblem | None) -> None:
        """Say from which problem the next differs in its start alone; None if in more."""
