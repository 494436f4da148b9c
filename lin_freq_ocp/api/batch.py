"""Solver, solve_many() and sweep(): one problem with other ends and references, or at every point of a grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.api.result import Result, present_as
from lin_freq_ocp.api.solve import result_of
from lin_freq_ocp.base.activity import activity, report_progress
from lin_freq_ocp.base.arrays import to_shape
from lin_freq_ocp.base.errors import ProblemError, SolveError
from lin_freq_ocp.base.phrases import MOST_TABLE_ROWS, count_all, html_table, number, plural, settings
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.batch.grid import Source
from lin_freq_ocp.batch.many import ManyOutcome, References, run_many
from lin_freq_ocp.batch.sweep import SweepOutcome, run_sweep
from lin_freq_ocp.files.batch_files import ManyFile, SweepFile, read_sweep, save_sweep_csv
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.solving.method import Method
from lin_freq_ocp.solving.resolver import Resolver
from lin_freq_ocp.transform.reductions import Change

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lin_freq_ocp.derivatives.recursion import Gradients


class Solver:
    """A solver for one problem with other initial states, terminal states and references.

    Data that do not depend on these are computed once and cached: the bins, kernels and last working set of the
    Fourier-domain method, the stages of the structured method. Answers and certificates are those of ``lfo.solve``.

    Parameters
    ----------
    problem : OptimalControlProblem
    method : str or Method
        As for ``lfo.solve``. For linear dynamics, "spectral", "structured" and "auto" are set up once; other methods
        are set up for each solve.
    tolerance : float, optional
        As for ``lfo.solve``.

    Raises
    ------
    UnsupportedError
        If the method does not exist or does not take these dynamics.

    References
    ----------
    docs/spectral.md and docs/structured.md, "Repeated solves".

    Examples
    --------
    >>> solver = lfo.Solver(lfo.library.pendulum())
    >>> solver.solve(initial_state=[-0.14, 0.1, 0, 0]).status
    'optimal'
    """

    def __init__(self, problem: OptimalControlProblem, method: str | Method = "auto", tolerance: float | None = None):
        self._resolver = Resolver(problem, method, tolerance)

    @property
    def problem(self) -> OptimalControlProblem:
        """Return the problem with its original ends and references."""
        return self._resolver.problem

    def solve(
        self,
        initial_state: ArrayLike | ConvexSet | None = None,
        terminal_state: ArrayLike | ConvexSet | None = None,
        references: Mapping[str, ArrayLike] | None = None,
        time_limit: float | None = None,
        throw: bool = True,
    ) -> Result:
        """Solve with the given ends and references, the problem's own in place of missing ones; certify the answer.

        Parameters
        ----------
        initial_state, terminal_state : (n,) or set, optional
        references : mapping, optional
            "x_ref" and "u_ref", and the linear costs "q" and "r", as in QuadraticCost.
        time_limit, throw
            As for ``lfo.solve``. ``result.seconds`` lists "solve" and "certify" separately.

        Returns
        -------
        Result

        Raises
        ------
        ProblemError
            If an end or a reference does not fit the problem.
        SolveError
            As for ``lfo.solve``.
        """
        outcome = self._resolver.solve(Change(initial_state, terminal_state, references), time_limit)
        return result_of(outcome, throw, time_limit)


@final
class Solutions(ManyOutcome):
    """The answers to many problems that differ in initial state and references, with the fields of ``ManyOutcome``.

    ``solutions[i]`` solves problem i once more and returns its full result, with multipliers and certificate.

    Methods
    -------
    controls, states, costs, gaps, statuses, messages
        Arrays and tuples over all problems.
    proven
        Whether every problem is solved and its status proven.

    Examples
    --------
    >>> solutions = lfo.solve_many(lfo.library.double_integrator(), [[0, 0], [0.1, 0]])
    >>> solutions.controls.shape, solutions.proven
    ((2, 200, 1), True)
    """

    def __getitem__(self, i: int) -> Result:
        change = self.changes[i]
        if isinstance(change, ProblemError):
            raise change
        return result_of(self.resolver.solve(change), throw=False)

    def vjp(self, x: ArrayLike | None = None, u: ArrayLike | None = None) -> Gradients:
        """Return the derivatives of sum(x * states) + sum(u * controls) by every datum, and which exist.

        Problems with constant matrices and bounds on controls alone are solved at once; others one by one.

        Parameters
        ----------
        x : (N, T+1, n), u : (N, T, m), optional
            Weights; zero if absent.

        Returns
        -------
        Gradients
            Initial states and references have a derivative for each problem; the others are summed.

        Raises
        ------
        ProblemError
            If weights have the wrong shape.
        SolveError
            If a problem is not solved.

        Examples
        --------
        >>> solutions = lfo.solve_many(lfo.library.double_integrator(), [[0, 0], [0.1, 0]])
        >>> solutions.vjp(u=[[[1.0]] * 200] * 2).exists.all()
        True
        """
        from lin_freq_ocp.derivatives.recursion import gradients_of  # other uses need none of it

        answers = self.states, self.controls
        of_x, of_u = (
            np.zeros(answer.shape) if given is None else to_shape(name, given, answer.shape)
            for name, given, answer in zip("xu", (x, u), answers, strict=True)
        )
        changes = [change for change in self.changes if isinstance(change, Change)]
        for i, status in enumerate(self.statuses):
            if status != Status.OPTIMAL:
                raise SolveError(f"Only optima have derivatives; problem {i} ended as '{status}'.")
        references = [change.references or {} for change in changes]
        return gradients_of(self.problem, references, answers, (of_x, of_u), lambda i: self[i].derivatives)

    @property
    def facts(self) -> list[tuple[str, str]]:
        """Return how all ended, how many are proven, the largest gap and the time of all solves, in words."""
        facts = [("status", count_all(self.statuses) + (", interrupted" if self.interrupted else ""))]
        facts.append(("proven", f"{sum(item.proven for item in self.items)} of {len(self)}"))
        gaps = self.gaps
        if np.isfinite(gaps).any():
            worst = int(np.nanargmax(gaps))
            facts.append(("gap", f"at most {number(gaps[worst], 2)}, of solutions[{worst}]"))
        seconds = sum(item.seconds or 0.0 for item in self.items)
        return [*facts, ("time", f"{seconds:.3g} s for all solves")]

    def __str__(self) -> str:
        return "\n".join([self._title, *(f"{term:9} {text}" for term, text in self.facts)])

    def __repr__(self) -> str:
        return f"Solutions({self.facts[0][1]})"

    def _repr_html_(self) -> str:
        return html_table(self._title, self.facts)

    @property
    def _title(self) -> str:
        return f"{self.problem}: {plural(len(self), 'problem')}"


def solve_many(
    problem: OptimalControlProblem,
    initial_states: ArrayLike | Sequence[ArrayLike] | None = None,
    references: References | Sequence[References] | None = None,
    executor: Executor | None = None,
    path: str | PathLike[str] | None = None,
    method: str | Method = "auto",
    time_limit: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Solutions:
    """Solve one problem from many initial states, or for many references, and certify every answer.

    Shared data are computed once, and each solve starts from the answer of a nearby problem. The Fourier-domain method
    computes signals, multipliers and lower bounds of many problems at once: an answer is optimal if its cost is within
    1e-6 of a rigorous bound and it satisfies every constraint; ``solutions[i]`` has the full certificate.

    Parameters
    ----------
    problem : OptimalControlProblem
    initial_states : (N, n), or a sequence of (n,), optional
        An entry of a sequence that is not a state gets an answer with the status "error".
    references : mapping, or a sequence of N mappings, optional
        "x_ref", "u_ref", "q" and "r", as in QuadraticCost: one mapping for all problems, or one for each.
    executor : concurrent.futures.Executor, optional
        Where to solve: a ``ProcessPoolExecutor``, or ``distributed.Client(...).get_executor()`` for a Dask cluster.
        Default: in this process. It is not shut down. Problems lost with a worker are solved again.
    path : path, optional
        A file that gets a line per answer. If the file exists, only its errors and the missing answers are computed.
    method : str or Method
        As for ``solve``.
    time_limit : float, optional
        Seconds for each problem.
    progress : callable, optional
        Called with the numbers of finished and of all problems. Default: a line on a terminal or in a notebook.

    Returns
    -------
    Solutions
        After Ctrl-C: the answers until then, with ``interrupted`` set.

    Raises
    ------
    ProblemError
        If an array has a wrong shape, no entry is a state, or the file belongs to another batch.
    UnsupportedError
        If the method does not exist or does not take these dynamics.

    Examples
    --------
    >>> solutions = lfo.solve_many(lfo.library.pendulum(), [[-0.15, 0.1, 0, 0], [-0.14, 0.1, 0, 0]])
    >>> solutions.statuses, solutions.costs.round()
    (('optimal', 'optimal'), array([3199., 3281.]))
    """
    record = (lambda head: nullcontext()) if path is None else partial(ManyFile, problem, path)
    with report_progress(progress, "solving many problems", "{} of {} solved".format) as report:
        outcome = run_many(problem, initial_states, references, executor, method, time_limit, record, report)
    return present_as(Solutions, outcome)


@final
class Sweep(SweepOutcome):
    """The finished points of a grid, with the fields of ``SweepOutcome``.

    Methods
    -------
    column(name)
        The values of one parameter or one result at every point.
    table()
        All points as flat rows, for pandas.DataFrame.
    plot()
        A figure of the costs.
    save(folder)
        Write an HTML page with the figure and all points.
    to_csv(path)
        Write the points as a table.

    Examples
    --------
    >>> costs = lfo.sweep(lfo.library.double_integrator, {"horizon": [60, 80]})
    >>> costs.complete, len(costs.table())
    (True, 2)
    """

    @property
    def points(self) -> list[tuple[str, str]]:
        """Return the parameters of every finished point, and its status, cost and gap, in words."""
        points = list[tuple[str, str]]()
        for row in self.rows:
            status = str(row["status"]).replace("_", " ") + ("" if row["proven"] else ", not proven")
            cost = [] if row["cost"] is None else [f"cost {number(row['cost'], 6)}", f"gap {number(row['gap'], 2)}"]
            points.append((settings(row["parameters"]), ", ".join([status, *cost, *filter(None, [row["message"]])])))
        return points

    def __str__(self) -> str:
        shown, hidden = self.points[:MOST_TABLE_ROWS], len(self.rows) - MOST_TABLE_ROWS
        width = max((len(parameters) for parameters, _ in shown), default=0)
        lines = [f"{parameters:{width}}  {text}" for parameters, text in shown]
        return "\n".join([self._title, *lines, *([f"... {hidden} more"] if hidden > 0 else [])])

    def _repr_html_(self) -> str:
        return html_table(self._title, self.points)

    @property
    def _title(self) -> str:
        return f"{self.problem}: {len(self.rows)} of {plural(self.size, 'point')}"

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write the table, one line per row; a missing value is an empty cell."""
        save_sweep_csv(path, self)

    @activity("drawing the page")
    def save(self, folder: str | PathLike[str]) -> Path:
        """Write a self-contained HTML page and its figure into a folder; return the page's path."""
        from lin_freq_ocp.pages.report.page import save_sweep_report  # Matplotlib is slow to import

        proven = sum(row["proven"] for row in self.rows)
        return save_sweep_report(self, f"{self._title}, {proven} of them proven", Path(folder))

    def plot(self) -> Figure:
        """Return a figure of costs and infeasible points over the first parameter whose values are numbers."""
        from lin_freq_ocp.pages.figures.sweep import sweep_figure  # Matplotlib is slow to import

        return sweep_figure(self)


def sweep(
    problem: Source,
    grid: Mapping[str, Sequence[object]],
    executor: Executor | None = None,
    path: str | PathLike[str] | None = None,
    method: str = "auto",
    backend: str = "auto",
    time_limit: float | None = None,
    tolerance: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Solve a problem at every point of a grid, and certify every answer.

    Parameters
    ----------
    problem : OptimalControlProblem or callable
        A problem, or a function that builds one from keywords, such as ``lfo.library.pendulum`` or a
        ``functools.partial`` of it. A function is quicker to send to other machines than a large problem.
    grid : mapping of str to sequence
        Values of each parameter. A function has its keywords as parameters. A problem has its fields; "cutoff"
        (rad/sample) or "cutoff_hz", a low pass in place of its ``control_spectrum`` (None for no frequency constraint);
        and the numbers that its live page moves, by their keys: "bound.0" for the symmetric bound of the first control,
        "rows.0" for the limit of the first joint rows, "level.control_spectrum.0" for decibels of a mask.
    executor : concurrent.futures.Executor, optional
        Where to solve: a ``ProcessPoolExecutor``, or ``distributed.Client(...).get_executor()`` for a Dask cluster.
        Default: one after another, in this process. It is not shut down. Points lost with a worker are solved again.
    path : path, optional
        A file that gets a line for each finished point. If the file exists, its points are not solved again, except
        those with the status "error"; the grid may have other values than before.
    method, backend, time_limit, tolerance
        As for ``solve``, for each point.
    progress : callable, optional
        Called with the numbers of finished and of all points, before the first point and after each. Default: a line
        on a terminal or in a notebook.

    Returns
    -------
    Sweep
        After Ctrl-C: the points that were finished, with ``interrupted`` set.

    Raises
    ------
    ProblemError
        If the problem has no parameter of a name in the grid, a value cannot be sent to other processes, or the file
        belongs to another sweep. A point whose values make no valid problem is a row with the status "error" instead.
    UnsupportedError
        If the method or backend does not exist.
    MissingExtraError
        If the package of the backend is not installed.

    Examples
    --------
    >>> costs = lfo.sweep(lfo.library.double_integrator, {"cutoff_hz": [None, 3.0]})
    >>> [str(status) for status in costs.column("status")]
    ['optimal', 'optimal']
    """
    options = {"method": method, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    record = (lambda head: nullcontext()) if path is None else partial(SweepFile, path)
    with report_progress(progress, "sweeping", "{} of {} solved".format) as report:
        return present_as(Sweep, run_sweep(problem, grid, options, executor, record, report))


def load_sweep(path: str | PathLike[str]) -> Sweep:
    """Read the file of a sweep, complete or not; the grid is that of the last run.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    Sweep

    Raises
    ------
    ProblemError
        If the file is not the file of a sweep, or is damaged.

    Examples
    --------
    >>> costs = lfo.sweep(lfo.library.double_integrator, {"horizon": [60]}, path="sweep.jsonl")
    >>> len(lfo.load_sweep("sweep.jsonl").table())
    1
    """
    return present_as(Sweep, read_sweep(path))
