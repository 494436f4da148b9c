"""How the problems of the steps are solved: by one solver that is set up once, or each on its own."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.errors import ProblemError, UnsupportedError
from lin_freq_ocp.loop.window import Preview, with_preview
from lin_freq_ocp.methods.spectral import SpectralSolver
from lin_freq_ocp.methods.spectral.solver import SpectralSolution
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.families import chosen
from lin_freq_ocp.solving.judging import judged
from lin_freq_ocp.solving.linear import LinearAuto, Spectral
from lin_freq_ocp.solving.method import Method
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged
from lin_freq_ocp.status import Status


class StepSolver:
    """Solves one problem from many states, each with what is known of its horizon.

    The Fourier-domain method is set up once where it applies; its answers are judged like any other, and what it does
    not solve goes to the method that was asked for.
    """

    def __init__(self, problem: OptimalControlProblem, method: str | Method, time_limit: float | None):
        self._method, self._limit = method, time_limit
        found = chosen(problem, method, {})
        self._takes_start = found.takes_start
        self._only_spectral = isinstance(found, Spectral)
        self._tolerance = found.tolerance if isinstance(found, (Spectral, LinearAuto)) else None
        self._solver = _set_up(problem) if isinstance(found, (Spectral, LinearAuto)) else None
        self._last: SpectralSolution | None = None

    def solve(
        self, problem: OptimalControlProblem, state: Array, preview: Preview, start: Trajectory | None
    ) -> Outcome:
        """Return the judged answer from a state (n,); ``start`` is the plan of the step before, one step later."""
        if self._solver is not None and preview.disturbance is None:
            outcome = self._resolved(problem, state, preview)
            if outcome is not None and (outcome.status in (Status.OPTIMAL, Status.INFEASIBLE) or self._only_spectral):
                return outcome
        given = with_preview(problem, preview).with_ends(state)
        return solve_judged(given, self._method, self._limit, start=start if self._takes_start else None)

    def _resolved(self, problem: OptimalControlProblem, state: Array, preview: Preview) -> Outcome | None:
        assert self._solver is not None
        changed = with_preview(problem, preview)
        bounds = {field: getattr(changed, field) for field in preview.bounds or {}}
        try:
            solution = self._solver.solve(
                state,
                references=preview.references,
                bounds=bounds or None,
                warm_start=self._last,
                tolerance=self._tolerance,
                time_limit=self._limit,
            )
        except (ProblemError, UnsupportedError):  # other components are fixed than at set-up
            return None
        self._last = solution if solution.active is not None else None
        assert solution.problem is not None
        return judged(solution.problem, solution, "spectral", None, self._tolerance)


def _set_up(problem: OptimalControlProblem) -> SpectralSolver | None:
    try:
        fixed = problem if problem.initial_box.fixed.all() else problem.with_ends(np.zeros(problem.state_dim))
        solver = SpectralSolver(fixed)
    except UnsupportedError:
        return None
    return solver if solver.problem is fixed else None  # polyhedra have become rows
