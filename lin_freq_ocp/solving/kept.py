"""What solves of one problem between other ends and with other references share: everything that is set up once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from numpy.typing import ArrayLike

from lin_freq_ocp.arrays import Array, known_entries
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.methods.spectral import SpectralSolution, SpectralSolver, row_form
from lin_freq_ocp.methods.spectral.algorithm.together import Together
from lin_freq_ocp.methods.spectral.model.row_form import RowForm
from lin_freq_ocp.methods.structured.prepared import Prepared
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import SetOrSets


@dataclass(frozen=True, eq=False)
class Change:
    """Other ends, references and bounds ("state_set", "control_set") than those of a problem; None keeps its own."""

    initial_state: ConvexSet | ArrayLike | None = None
    terminal_state: ConvexSet | ArrayLike | None = None
    references: Mapping[str, ArrayLike] | None = None
    bounds: Mapping[str, SetOrSets] | None = None

    def of(self, problem: OptimalControlProblem) -> OptimalControlProblem:
        """Return the changed problem."""
        if self.bounds:
            problem = replace(problem, **known_entries("bounds", self.bounds, ("state_set", "control_set")))
        if self.references is not None:
            problem = problem.with_references(self.references)
        if self.initial_state is None and self.terminal_state is None:
            return problem
        return problem.with_ends(self.initial_state, self.terminal_state)


class Kept:
    """A problem, its Fourier-domain solver with the last solution, and its stages; each is made when it is needed."""

    def __init__(self, problem: OptimalControlProblem):
        self.problem = problem
        self._rows: RowForm | None = None
        self._solver: SpectralSolver | None = None
        self._refusal: UnsupportedError | None = None
        self._last: SpectralSolution | None = None
        self.prepared = Prepared()

    def spectral(
        self, problem: OptimalControlProblem, change: Change, tolerance: float | None, time_limit: float | None
    ) -> Candidate:
        """Solve the changed problem in the Fourier domain, from the last solution; UnsupportedError as from scratch."""
        ends = (
            (change.initial_state, problem.initial_state, self.problem.initial_state),
            (change.terminal_state, problem.terminal_state, self.problem.terminal_state),
        )
        sets = any(given is not None and (new.members or old.members) for given, new, old in ends)
        if sets or (change.bounds and (row_form(problem).polyhedra or row_form(self.problem).polyhedra)):
            rows = row_form(problem)
            return in_given_form(rows, SpectralSolver(rows.problem).solve(tolerance=tolerance, time_limit=time_limit))
        rows, solver = self._spectral_solver()
        found = solver.solve(
            change.initial_state,
            change.terminal_state,
            change.references,
            change.bounds,
            warm_start=self._last,
            tolerance=tolerance,
            time_limit=time_limit,
        )
        if found.status == "optimal":
            self._last = found
        return in_given_form(rows, found)

    def together(self, initial_states: Array) -> Together | None:
        """Solve from initial states (N, n) at once, where the Fourier-domain method can."""
        try:
            rows, solver = self._spectral_solver()
        except UnsupportedError:
            return None
        return None if rows.polyhedra else solver.solve_together(initial_states)

    def _spectral_solver(self) -> tuple[RowForm, SpectralSolver]:
        if self._refusal is not None:
            raise self._refusal
        if self._rows is None or self._solver is None:
            self._rows = row_form(self.problem)
            try:
                self._solver = SpectralSolver(self._rows.problem)
            except UnsupportedError as error:
                self._refusal = error
                raise
        return self._rows, self._solver


def in_given_form(rows: RowForm, candidate: Candidate) -> Candidate:
    """Return a candidate for the problem in rows as one for the given problem."""
    if not rows.polyhedra:
        return candidate
    found = {name: getattr(candidate, name) for name in ("multipliers", "ray")}
    return replace(candidate, **{name: one and rows.multipliers(one) for name, one in found.items()})
