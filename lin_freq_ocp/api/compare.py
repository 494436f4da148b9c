"""compare() as users call it, and the comparison that it returns."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, final

from lin_freq_ocp.api.result import Result, present_as
from lin_freq_ocp.api.solve import solve
from lin_freq_ocp.base.activity import activity, report_progress
from lin_freq_ocp.base.phrases import html_table
from lin_freq_ocp.comparison.compare import ComparisonOutcome, compare_methods
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.method import Report

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@final
class Comparison(ComparisonOutcome):
    """The classical solution, filtered versions of it, and the solution with the frequency constraint.

    Attributes
    ----------
    classical, constrained : Result
        Without and with the frequency constraints. The other fields are those of ``ComparisonOutcome``.

    Methods
    -------
    plot()
        A figure of controls, spectra and states.
    save(folder)
        Write an HTML report.

    Examples
    --------
    >>> comparison = lfo.compare(lfo.library.double_integrator(), ["clipped"])
    >>> [filtered.name for filtered in comparison.filtered]
    ['clipped']
    """

    classical: Result  # of ``solve``, as the other
    constrained: Result

    def __repr__(self) -> str:
        filters = ", ".join(filtered.name for filtered in self.filtered) or "none"
        return f"Comparison(classical={self.classical!r}, constrained={self.constrained!r}, filters {filters})"

    def _repr_html_(self) -> str:
        return html_table(str(self.problem), self.rows)

    def plot(self) -> Figure:
        """Return the four panels of the paper's Figure 3: controls, their spectra, two phase portraits."""
        from lin_freq_ocp.pages.figures.figures import comparison_figure  # Matplotlib is slow to import

        return comparison_figure(self)

    @activity("drawing the report")
    def save(self, folder: str | Path) -> Path:
        """Write a self-contained HTML page and its figures into a folder; return the page's path."""
        from lin_freq_ocp.pages.report.page import save_report  # Matplotlib is slow to import

        return save_report(self, folder)


def compare(
    problem: OptimalControlProblem,
    filters: Sequence[str] | None = None,
    backend: str = "auto",
    time_limit: float | None = None,
    start: object = None,
    progress: Report | None = None,
) -> Comparison:
    """Compare filtering a classical optimal control with solving under the frequency constraint.

    Parameters
    ----------
    problem : OptimalControlProblem
        The problem with its frequency constraints.
    filters : sequence of str, optional
        Some of "brickwall", "butterworth", "zero_phase", "moving_average", "clipped". For a bound on the residual
        vibration of controls, the input shapers "ZV", "ZVD", "EI", "MZV",
        "2HUMP_EI", "3HUMP_EI". Default: all filters that apply, and the first three shapers.
    backend : str
        As for ``solve``.
    time_limit : float, optional
        Seconds for all solves together; the classical problem gets half of them. Default: 30 s if the solver searches
        over mode sequences, no limit otherwise.
    start : Trajectory, (T, m) or (T,) integers, optional
        Start of both searches, as for ``solve``.
    progress : callable, optional
        Of both searches, as for ``solve``.

    Returns
    -------
    Comparison

    Raises
    ------
    ProblemError
        If a filter is unknown, or an input shaper does not apply; the message says why.
    SolveError
        If the problem has no solution even without its frequency constraints, or none was found in time.

    Examples
    --------
    >>> comparison = lfo.compare(lfo.library.double_integrator(), ["clipped"])
    >>> comparison.classical.cost <= comparison.constrained.cost
    True
    """
    search = partial(solve, progress=progress)
    with report_progress(progress, "comparing", str):
        return present_as(Comparison, compare_methods(problem, search, filters, backend, time_limit, start))
