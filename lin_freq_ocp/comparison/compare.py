"""The classical solution, what filters make of it, and the constrained solution, side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from lin_freq_ocp.analysis.measures import Measures, measure
from lin_freq_ocp.analysis.sensitivities import bin_prices
from lin_freq_ocp.arrays import Array
from lin_freq_ocp.certificate.modes.smooth import Kink, kinks
from lin_freq_ocp.comparison.filters import (
    FILTERS,
    can_be_filtered,
    filtered,
    has_frequency_constraint,
    require_filters,
)
from lin_freq_ocp.comparison.replay import Replay, replay
from lin_freq_ocp.comparison.trajectories import (
    CLASSICAL,
    CONSTRAINED,
    MeasuredTrajectory,
    measured_solution,
    solution_label,
)
from lin_freq_ocp.errors import ProblemError, SolveError
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.solving.families import family_of
from lin_freq_ocp.solving.outcome import Outcome

PREFERRED_FILTER = "brickwall"

Solve = Callable[..., Outcome]
"""``lfo.solve``: a problem, and the keywords method, backend, time_limit and throw."""


@dataclass(frozen=True, eq=False)
class Filtered:
    """One filter's control and what it does: name, description in words, and its replay."""

    name: str
    description: str
    replay: Replay

    @property
    def label(self) -> str:
        """Return the name for readers."""
        return self.name.replace("_", " ")


@dataclass(frozen=True, eq=False)
class ComparisonOutcome:
    """Filtering afterwards against solving with the frequency constraint.

    Attributes
    ----------
    problem : OptimalControlProblem
    classical : Outcome
        Solved without any frequency constraint.
    constrained : Outcome
        Solved with it; may be infeasible, which is then the finding.
    classical_measures, constrained_measures : Measures or None
        All measured on the problem with its frequency constraints.
    filtered : tuple of Filtered
        In the order asked for.
    """

    problem: OptimalControlProblem
    classical: Outcome
    constrained: Outcome
    classical_measures: Measures
    constrained_measures: Measures | None
    filtered: tuple[Filtered, ...]

    @property
    def replay_is_meaningful(self) -> bool:
        """Whether open-loop replays show more than amplified rounding errors."""
        return all(one.replay.meaningful for one in self.filtered)

    @cached_property
    def trajectories(self) -> tuple[MeasuredTrajectory, ...]:
        """Return the classical trajectory, one per filter, and the constrained one, which is the last.

        Without a frequency constraint all of these are one trajectory, which is returned alone.
        """
        problem, result = self.problem, self.constrained
        if not has_frequency_constraint(problem):
            return (measured_solution(solution_label(result), problem, result, self.constrained_measures),)
        return (
            measured_solution(CLASSICAL, problem, self.classical, self.classical_measures),
            *(self.replayed(one) for one in (self.filtered if can_be_filtered(problem) else ())),
            measured_solution(CONSTRAINED, problem, result, self.constrained_measures),
        )

    def replayed(self, one: Filtered) -> MeasuredTrajectory:
        """Return the replay of one filter."""
        made = one.replay
        return MeasuredTrajectory(
            one.label, self.problem, made.trajectory, made.measures, made.meaningful, bool(made.stopped)
        )

    def shown_filter(self, name: str | None = None) -> Filtered | None:
        """Return the filter of that name; by default the brick wall, or the first; None if nothing is filtered."""
        if not can_be_filtered(self.problem) or (name is None and not self.filtered):
            return None
        by_name = {one.name: one for one in self.filtered}
        if name is None:
            return by_name.get(PREFERRED_FILTER, self.filtered[0])
        if name not in by_name:
            expected = f"one of {', '.join(by_name) or 'none: nothing was filtered'}"
            raise ProblemError("filter_name", repr(name), expected)
        return by_name[name]

    @property
    def kinks(self) -> tuple[Kink, ...]:
        """Return the kinks along the constrained trajectory, as judged; none without multipliers."""
        result = self.constrained
        borders = None if result.certificate is None else result.certificate.borders
        if borders is None or result.trajectory is None or result.multipliers is None:
            return ()
        return kinks(result.problem, result.trajectory, result.multipliers, borders)

    @property
    def prices(self) -> tuple[Array, Array] | None:
        """Return |d J* / d bin| of controls and states; None without multipliers or without removed bins."""
        multipliers, problem = self.constrained.multipliers, self.problem
        banded = problem.control_band.any() or problem.state_band.any()
        return bin_prices(problem, multipliers) if multipliers is not None and banded else None

    @property
    def rows(self) -> list[tuple[str, str, Measures | None]]:
        """Return of every trajectory its name, where it is from, and what was measured."""
        return [
            ("classical", self.classical.status, self.classical_measures),
            *((one.name, _replayed(one.replay), one.replay.measures) for one in self.filtered),
            ("constrained", self.constrained.status, self.constrained_measures),
        ]

    def __str__(self) -> str:
        rows = self.rows
        width = max(len(name) for name, _, _ in rows)
        return "\n".join(
            [
                str(self.problem),
                *(f"{name:{width}}  {', '.join([how, *figures_of(found)])}" for name, how, found in rows),
            ]
        )


def _replayed(made: Replay) -> str:
    return "replayed" if made.meaningful else made.stopped or "not replayed: that would amplify rounding errors"


def figures_of(found: Measures | None) -> list[str]:
    """Return the measures of a trajectory in words, one text for each."""
    if found is None:
        return []
    figures = {
        "end missed by": found.terminal_error,
        "controls out of bounds by": found.control_violation,
        "states by": found.state_violation,
        "energy in control bands": found.stopband_energy,
        "in state bands": found.state_stopband_energy,
    }
    cost = [] if found.cost is None else [f"cost {found.cost:.6g}"]
    return cost + [f"{what} {value:.2g}" for what, value in figures.items() if value is not None]


def compared(
    problem: OptimalControlProblem, solve: Solve, filters: Sequence[str] | None, backend: str, time_limit: float | None
) -> ComparisonOutcome:
    """Return the parts of a comparison, whose two problems ``solve`` solves; see ``lfo.compare``."""
    require_problem(problem)
    names = list(FILTERS) if filters is None else list(filters)
    require_filters(names)
    free = replace(problem, control_spectrum=None, state_spectrum=None, output_spectrum=None)
    classical = solve(free, method=_method_without_bound(free), backend=backend, time_limit=time_limit)
    constrained = solve(problem, backend=backend, time_limit=time_limit, throw=False)
    plan = classical.trajectory
    if plan is None:
        raise SolveError("The classical problem was solved without a trajectory.", classical)
    entries: list[Filtered] = []
    for name in names:
        control = filtered(name, problem, plan.u)
        entries.append(Filtered(name, control.description, replay(problem, control.u, plan)))
    return ComparisonOutcome(
        problem=problem,
        classical=classical,
        constrained=constrained,
        classical_measures=measure(problem, plan),
        constrained_measures=None if constrained.trajectory is None else measure(problem, constrained.trajectory),
        filtered=tuple(entries),
    )


def _method_without_bound(problem: OptimalControlProblem) -> str:
    """Return the method for a plan that is only to be filtered: how far it is from the global optimum is not asked."""
    return "nonsmooth" if "nonsmooth" in family_of(problem).shorthands else "auto"
