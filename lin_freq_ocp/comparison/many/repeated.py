"""One problem solved again and again with other ends and references."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from lin_freq_ocp.certificate.conflict import Exclusion, exclusion
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.starts import start_of
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.every_frequency import solved_by
from lin_freq_ocp.solving.families import chosen, saved_options
from lin_freq_ocp.solving.kept import Change, Kept, KeptTree
from lin_freq_ocp.solving.linear import LinearAuto, Spectral
from lin_freq_ocp.solving.method import Method, Request
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import require_options
from lin_freq_ocp.status import Status

KEPT_RAYS = 8  # of infeasible problems, each tried on the next initial states


class Repeated:
    """A problem with its method, and what earlier solves of it left."""

    def __init__(self, problem: OptimalControlProblem, method: str | Method = "auto", tolerance: float | None = None):
        require_problem(problem)
        require_options(method, tolerance=tolerance)
        self.problem, self.name = problem, method
        self.method = chosen(problem, method, {"tolerance": tolerance})
        self._exclusions = deque[Exclusion](maxlen=KEPT_RAYS)
        self.kept = Kept(problem) if isinstance(problem.dynamics.standard_form, LinearDynamics) else None

    @property
    def spectral(self) -> bool:
        """Whether the Fourier-domain method comes first, with its own tolerance."""
        method = self.method
        if not isinstance(method, (Spectral, LinearAuto)) or method.tolerance is not None:
            return False
        return isinstance(method, Spectral) or method.backend == "auto"

    def excluded(self, change: Change) -> bool:
        """Whether a ray of an infeasible problem before excludes the changed initial state."""
        if not self._exclusions or change.terminal_state is not None or change.references is not None or change.bounds:
            return False
        start = change.of(self.problem).initial_box
        return bool(start.fixed.all()) and any(one.excludes(start.lower) for one in self._exclusions)

    def keep(self, outcome: Outcome) -> None:
        """Keep the ray of an infeasible problem that differs from this one in its initial state alone."""
        if outcome.status == Status.INFEASIBLE and outcome.ray is not None:
            found = exclusion(outcome.problem, outcome.ray)
            if found is not None:
                self._exclusions.appendleft(found)

    def solve(
        self,
        change: Change,
        time_limit: float | None = None,
        start: Trajectory | None = None,
        tree: KeptTree | None = None,
    ) -> Outcome:
        """Solve the changed problem, from a start and a tree if the method takes them, and judge the answer."""
        require_options(self.name, time_limit)
        problem = change.of(self.problem)
        again = None if self.kept is None else (self.kept, change)
        if self.kept is not None and start is not None:
            self.kept.prepared.near = start
        begin = start_of(problem, start) if start is not None and self.method.takes_start else None
        limit = np.inf if time_limit is None else time_limit
        if tree is not None:
            tree.begins(self.problem if change.starts_elsewhere else None)
        request = Request(limit, start=begin, again=again, tree=tree)
        outcome = solved_by(self.method, problem, request, getattr(self.method, "tolerance", None))
        return replace(outcome, options=saved_options(problem, self.name, self.method) | {"time_limit": time_limit})
