"""The classical solution, what filters make of it, and the constrained solution, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from lin_freq_ocp.analysis.measures import Measures, measure
from lin_freq_ocp.comparison.filters import FILTERS, filtered, require_filters
from lin_freq_ocp.comparison.replay import Replay, replay
from lin_freq_ocp.errors import SolveError
from lin_freq_ocp.html import html_table
from lin_freq_ocp.problem.dynamics.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.result import Result
from lin_freq_ocp.solve import solve

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Filtered:
    """One filter's control and what it does: name, description in words, and its replay."""

    name: str
    description: str
    replay: Replay


@dataclass(frozen=True, eq=False)
class Comparison:
    """Filtering afterwards against solving with the frequency constraint.

    Attributes
    ----------
    problem : OptimalControlProblem
    classical : Result
        Solved without any frequency constraint.
    constrained : Result
        Solved with it; may be infeasible, which is then the finding.
    classical_measures, constrained_measures : Measures or None
        All measured on the problem with its frequency constraints.
    filtered : tuple of Filtered
        In the order asked for.

    Methods
    -------
    plot()
        The four panels of the comparison.
    save(folder)
        Write the HTML report.
    """

    problem: OptimalControlProblem
    classical: Result
    constrained: Result
    classical_measures: Measures
    constrained_measures: Measures | None
    filtered: tuple[Filtered, ...]

    @property
    def replay_is_meaningful(self) -> bool:
        """Whether open-loop replays show more than amplified rounding errors."""
        return all(one.replay.meaningful for one in self.filtered)

    @property
    def _rows(self) -> list[tuple[str, str, Measures | None]]:
        """Return of every trajectory its name, where it is from, and what was measured."""
        return [
            ("classical", self.classical.status, self.classical_measures),
            *((one.name, _replayed(one.replay), one.replay.measures) for one in self.filtered),
            ("constrained", self.constrained.status, self.constrained_measures),
        ]

    def __str__(self) -> str:
        rows = self._rows
        width = max(len(name) for name, _, _ in rows)
        return "\n".join(
            [str(self.problem), *(f"{name:{width}}  {', '.join([how, *_figures(found)])}" for name, how, found in rows)]
        )

    def __repr__(self) -> str:
        filters = ", ".join(one.name for one in self.filtered) or "none"
        return f"Comparison(classical={self.classical!r}, constrained={self.constrained!r}, filters {filters})"

    def _repr_html_(self) -> str:
        rows = [(name, ", ".join([how, *_figures(found)])) for name, how, found in self._rows]
        return html_table(str(self.problem), rows)

    def plot(self) -> Figure:
        """Return the four panels of the paper's Figure 3: controls, their spectra, two phase portraits."""
        from lin_freq_ocp.report.figures.figures import comparison_figure

        return comparison_figure(self)

    def save(self, folder: str | Path) -> Path:
        """Write a self-contained HTML page and its figures into a folder; return the page's path."""
        from lin_freq_ocp.report.page import save_report

        return save_report(self, folder)


def _replayed(made: Replay) -> str:
    return "replayed" if made.meaningful else made.stopped or "not replayed: that would amplify rounding errors"


def _figures(found: Measures | None) -> list[str]:
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


def compare(
    problem: OptimalControlProblem,
    filters: Sequence[str] | None = None,
    backend: str = "auto",
    time_limit: float | None = None,
) -> Comparison:
    """Compare filtering a classical optimal control with solving under the frequency constraint.

    Parameters
    ----------
    problem : OptimalControlProblem
        With its frequency constraints.
    filters : sequence of str, optional
        Some of "brickwall", "butterworth", "zero_phase", "moving_average", "clipped"; default all.
    backend, time_limit
        As for ``solve``.

    Raises
    ------
    ProblemError
        If there is no filter of a name.
    SolveError
        If the problem has no solution even without its frequency constraints.
    """
    require_problem(problem)
    names = list(FILTERS) if filters is None else list(filters)
    require_filters(names)
    free = replace(problem, control_spectrum=None, state_spectrum=None, output_spectrum=None)
    classical = solve(free, _method_without_bound(free), backend, time_limit)
    constrained = solve(problem, backend=backend, time_limit=time_limit, throw=False)
    plan = classical.trajectory
    if plan is None:
        raise SolveError("The classical problem was solved without a trajectory.", classical)
    entries: list[Filtered] = []
    for name in names:
        control = filtered(name, problem, plan.u)
        entries.append(Filtered(name, control.description, replay(problem, control.u, plan)))
    return Comparison(
        problem=problem,
        classical=classical,
        constrained=constrained,
        classical_measures=measure(problem, plan),
        constrained_measures=None if constrained.trajectory is None else measure(problem, constrained.trajectory),
        filtered=tuple(entries),
    )


def _method_without_bound(problem: OptimalControlProblem) -> str:
    """Return the method for a plan that is only to be filtered: how far it is from the global optimum is not asked."""
    return "nonsmooth" if isinstance(problem.dynamics, PiecewiseSmoothDynamics) else "auto"
