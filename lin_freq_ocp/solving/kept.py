"""What solves of one problem between other ends and with other references share: everything that is set up once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, known_entries
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.absorbed_cost import AbsorbedCost, absorbed_cost
from lin_freq_ocp.methods.candidate import Candidate, require_convex
from lin_freq_ocp.methods.spectral import SpectralSolution, SpectralSolver, row_form
from lin_freq_ocp.methods.spectral.recovery import Together
from lin_freq_ocp.methods.spectral.reductions import RowForm, SoftBins, soft_bins
from lin_freq_ocp.methods.structured.solver import Prepared
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


@dataclass(frozen=True, eq=False)
class SpectralForm:
    """A problem as the Fourier-domain method takes it: soft bins removed, polyhedral sets as joint rows."""

    bins: SoftBins
    rows: RowForm
    absorbed: AbsorbedCost | None

    @property
    def problem(self) -> OptimalControlProblem:
        """Return the problem that is solved."""
        return self.rows.problem if self.absorbed is None else self.absorbed.problem

    @property
    def changed(self) -> bool:
        """Whether that is not the given problem."""
        return bool(self.bins.terms or self.rows.polyhedra or self.absorbed)

    def given(self, candidate: Candidate) -> Candidate:
        """Return a candidate of the problem that is solved as one of the given problem."""
        if not self.changed:
            return candidate
        candidate = candidate if self.absorbed is None else self.absorbed.candidate(candidate)
        found = {name: getattr(candidate, name) for name in ("multipliers", "ray")}
        given = {name: one and self.bins.multipliers(self.rows.multipliers(one)) for name, one in found.items()}
        return replace(candidate, **given)


def spectral_form(problem: OptimalControlProblem) -> SpectralForm:
    """Return a problem in the form that the Fourier-domain method takes."""
    require_convex(problem)
    bins = soft_bins(problem)
    rows = row_form(bins.problem)
    return SpectralForm(bins, rows, absorbed_cost(rows.problem))


class Kept:
    """A problem, its Fourier-domain solver with the last solution, and its stages; each is made when it is needed."""

    def __init__(self, problem: OptimalControlProblem):
        self.problem = problem
        self._form: SpectralForm | None = None
        self._solver: SpectralSolver | None = None
        self._refusal: UnsupportedError | None = None
        self._last: SpectralSolution | None = None
        self.prepared = Prepared()

    def spectral(
        self, problem: OptimalControlProblem, change: Change, tolerance: float | None, time_limit: float | None
    ) -> Candidate:
        """Solve the changed problem in the Fourier domain, from the last solution; UnsupportedError as from scratch."""
        if not self._takes(problem, change):
            form = spectral_form(problem)
            return form.given(SpectralSolver(form.problem).solve(tolerance=tolerance, time_limit=time_limit))
        form, solver = self._spectral_solver()
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
        return form.given(found)

    def _takes(self, problem: OptimalControlProblem, change: Change) -> bool:
        """Whether the kept solver takes a changed problem: its new sets are boxes, and the same values are fixed."""
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
        return not (change.bounds and any(spectral_form(one).rows.polyhedra for one in (problem, old)))

    def together(self, initial_states: Array) -> Together | None:
        """Solve from initial states (N, n) at once, where the Fourier-domain method can."""
        try:
            form, solver = self._spectral_solver()
        except UnsupportedError:
            return None
        return None if form.changed else solver.solve_together(initial_states)

    def _spectral_solver(self) -> tuple[SpectralForm, SpectralSolver]:
        if self._refusal is not None:
            raise self._refusal
        if self._form is None or self._solver is None:
            self._form = spectral_form(self.problem)
            try:
                self._solver = SpectralSolver(self._form.problem)
            except UnsupportedError as error:
                self._refusal = error
                raise
        return self._form, self._solver


class SearchCache(ABC):
    """What a search leaves for that of the next step of a control loop.

    ``solved`` is the number of relaxations that the last search has solved.
    """

    solved: int

    @abstractmethod
    def begins(self, base: OptimalControlProblem | None) -> None:
        """Say from which problem the next differs in its start alone; None if in more."""
