"""compare() as users call it, and the comparison that it returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, final

from lin_freq_ocp.api.result import Result, shown_as
from lin_freq_ocp.api.solve import solve
from lin_freq_ocp.base.phrases import html_table
from lin_freq_ocp.comparison.compare import ComparisonOutcome, compare_methods
from lin_freq_ocp.problem.ocp import OptimalControlProblem

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@final
@dataclass(frozen=True, eq=False)
class Comparison(ComparisonOutcome):
    """Filtering afterwards against solving with the frequency constraint.

    Attributes
    ----------
    classical, constrained : Result
        Without and with the frequency constraints; the rest as in ``ComparisonOutcome``.

    Methods
    -------
    plot()
        The four panels of the comparison.
    save(folder)
        Write the HTML report.

    Examples
    --------
    >>> comparison = lfo.compare(lfo.library.double_integrator(), ["clipped"])
    >>> [filtered.name for filtered in comparison.filtered]
    ['clipped']
    """

    classical: Result
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
) -> Comparison:
    """Compare filtering a classical optimal control with solving under the frequency constraint.

    Parameters
    ----------
    problem : OptimalControlProblem
        With its frequency constraints.
    filters : sequence of str, optional
        Some of "brickwall", "butterworth", "zero_phase", "moving_average", "clipped"; of a bound on the residual
        vibration of controls, the input shapers "ZV", "ZVD", "EI". Default: all that apply.
    backend : str
        As for ``solve``.
    time_limit : float, optional
        Seconds for all solves together, of which the classical problem gets half. Default: 30 s where modes are
        searched, none otherwise.
    start : Trajectory, (T, m) or (T,) integers, optional
        Where both searches begin, as for ``solve``.

    Returns
    -------
    Comparison

    Raises
    ------
    ProblemError
        If there is no filter of a name, or input shapers do not apply, saying why.
    SolveError
        If the problem has no solution even without its frequency constraints, or none was found in time.

    Examples
    --------
    >>> comparison = lfo.compare(lfo.library.double_integrator(), ["clipped"])
    >>> comparison.classical.cost <= comparison.constrained.cost
    True
    """
    return shown_as(Comparison, compare_methods(problem, solve, filters, backend, time_limit, start))
