"""solve_many(), Solver and sweep() as users call them: one problem again and again, or at every point of a grid."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import partial
from os import PathLike
from typing import TYPE_CHECKING, final

from numpy.typing import ArrayLike

from lin_freq_ocp.api.result import Result, shown_as
from lin_freq_ocp.api.solve import count_text, report_progress, result_of
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.batch.grid import Source
from lin_freq_ocp.batch.many import ManyOutcome, References, run_many
from lin_freq_ocp.batch.repeated import Repeated
from lin_freq_ocp.batch.sweep import SweepOutcome, run_sweep
from lin_freq_ocp.files.batch_files import ManyFile, SweepFile, read_sweep, save_sweep_csv
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.solving.method import Method
from lin_freq_ocp.solving.solver_cache import Change

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Solver:
    """One problem, solved again from other initial states, to other ends or with other references.

    What does not depend on them is set up once, and kept: the bins, kernels and last working set of the Fourier-domain
    method, the stages of the structured method. An answer is what ``lfo.solve`` would find, with its certificate.

    Parameters
    ----------
    problem : OptimalControlProblem
    method : str or Method
        As for ``lfo.solve``; "spectral", "structured" and "auto" of linear dynamics are set up once, others each time.
    tolerance : float, optional
        As for ``lfo.solve``.

    Raises
    ------
    UnsupportedError
        If the method does not exist or is not for these dynamics.

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
        self._repeated = Repeated(problem, method, tolerance)

    @property
    def problem(self) -> OptimalControlProblem:
        """Return the problem with its own ends and references."""
        return self._repeated.problem

    def solve(
        self,
        initial_state: ArrayLike | ConvexSet | None = None,
        terminal_state: ArrayLike | ConvexSet | None = None,
        references: Mapping[str, ArrayLike] | None = None,
        time_limit: float | None = None,
        throw: bool = True,
    ) -> Result:
        """Solve, with other ends and references than the problem's own where given, and judge the answer.

        Parameters
        ----------
        initial_state, terminal_state : (n,) or set, optional
        references : mapping, optional
            "x_ref" and "u_ref", as in QuadraticCost.
        time_limit, throw
            As for ``lfo.solve``. ``result.seconds`` has "solve" and "certify" apart.

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
        outcome = self._repeated.solve(Change(initial_state, terminal_state, references), time_limit)
        return result_of(outcome, throw, time_limit)


@final
class Solutions(ManyOutcome):
    """The answers to many problems that differ in initial state and references, with the fields of ``ManyOutcome``.

    ``solutions[i]`` is the full result of one of them, with multipliers and certificate: it is solved once more.

    Methods
    -------
    controls, states, costs, gaps, statuses, messages
        Arrays over all problems, and how each ended.
    proven
        Whether all are solved, and proven.

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
        return result_of(self.again.solve(change), throw=False)


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
    """Solve one problem from many initial states, or for many references, and judge every answer.

    What they share is set up once, and each begins with the answer of one near it. Where the Fourier-domain method
    applies, signals, multipliers and the judge's bound are computed for many at once: an answer counts as optimal if
    its cost is within 1e-6 of a rigorous bound and no constraint is broken; ``solutions[i]`` says the rest.

    Parameters
    ----------
    problem : OptimalControlProblem
    initial_states : (N, n), or a sequence of (n,), optional
        An entry of a sequence that is no state is an answer of its own, with the status "error".
    references : mapping, or a sequence of N mappings, optional
        "x_ref" and "u_ref", as in QuadraticCost: for all, or one for each.
    executor : concurrent.futures.Executor, optional
        Where to solve: a ``ProcessPoolExecutor``, or ``distributed.Client(...).get_executor()`` for a Dask cluster.
        Default: in this process. It is not shut down. What is lost with a worker is repeated.
    path : path, optional
        A file that gets a line per answer. If it exists already, its answers are not computed again, but for errors.
    method : str or Method
        As for ``solve``.
    time_limit : float, optional
        Seconds, for each.
    progress : callable, optional
        Called with the numbers of finished and of all problems. Default: a line on a terminal or in a notebook.

    Returns
    -------
    Solutions
        After Ctrl-C: what was found until then, and ``interrupted``.

    Raises
    ------
    ProblemError
        If an array has a wrong shape, nothing is a state, or the file belongs to something else.
    UnsupportedError
        If the method does not exist or is not for these dynamics.

    Examples
    --------
    >>> solutions = lfo.solve_many(lfo.library.pendulum(), [[-0.15, 0.1, 0, 0], [-0.14, 0.1, 0, 0]])
    >>> solutions.statuses, solutions.costs.round()
    (('optimal', 'optimal'), array([3199., 3281.]))
    """

    def on_terminal(done: int, count: int) -> None:
        print(f"\r{count_text(done, count)}", end="\n" if done == count else "", file=sys.stderr, flush=True)

    record = (lambda head: nullcontext()) if path is None else partial(ManyFile, path)
    with report_progress(progress or (on_terminal if sys.stderr.isatty() else None), count_text) as report:
        found = run_many(problem, initial_states, references, executor, method, time_limit, record, report)
    return shown_as(Solutions, found)


@final
class Sweep(SweepOutcome):
    """The finished points of a grid, with the fields of ``SweepOutcome``.

    Methods
    -------
    column(name)
        The values of one figure at every point.
    table()
        All points as flat rows, for pandas.DataFrame.
    plot()
        A figure of the costs.
    to_csv(path)
        Write the points as a table.

    Examples
    --------
    >>> found = lfo.sweep(lfo.library.double_integrator, {"horizon": [60, 80]})
    >>> found.complete, len(found.table())
    (True, 2)
    """

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write the table, one line per row; absent values are empty."""
        save_sweep_csv(path, self)

    def plot(self) -> Figure:
        """Return a figure of cost and infeasible points over the first parameter that is a number."""
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
    """Solve a problem at every point of a grid, and judge every answer.

    Parameters
    ----------
    problem : OptimalControlProblem or callable
        A function that builds one from keywords, such as ``lfo.library.pendulum`` or a ``functools.partial`` of it, is
        quicker to send to other machines than a large problem.
    grid : mapping of str to sequence
        Values of each parameter. Of a function: its keywords. Of a problem: its fields, "cutoff" (rad/sample) or
        "cutoff_hz" for a low pass in place of its ``control_spectrum`` (a cut-off of None is no frequency constraint),
        and the numbers that its live page moves, by their keys: "bound.0" for the symmetric bound of the first control,
        "rows.0" for the limit of the first joint rows, "level.control_spectrum.0" for decibels of a mask.
    executor : concurrent.futures.Executor, optional
        Where to solve: a ``ProcessPoolExecutor``, or ``distributed.Client(...).get_executor()`` for a Dask cluster.
        Default: one after another, in this process. It is not shut down. Points lost with a worker are repeated.
    path : path, optional
        A file that gets a line per point as soon as it is finished. If it exists already, its points are not solved
        again, except those with the status "error"; the grid may have other values than before.
    method, backend, time_limit, tolerance
        As for ``solve``, for each point.
    progress : callable, optional
        Called with the number of finished points and the number of all points, at first and after each point. Default:
        a line in a notebook.

    Returns
    -------
    Sweep
        After Ctrl-C: the points that are finished until then, and ``interrupted``.

    Raises
    ------
    ProblemError
        If the grid has a name that the problem does not know, something cannot be sent to other processes, or the file
        belongs to another sweep. A single point that is no problem is a row with the status "error" instead.
    UnsupportedError
        If the method or backend does not exist.
    MissingExtraError
        If the package of the backend is not installed.

    Examples
    --------
    >>> found = lfo.sweep(lfo.library.double_integrator, {"cutoff_hz": [None, 3.0]})
    >>> [str(status) for status in found.column("status")]
    ['optimal', 'optimal']
    """
    options = {"method": method, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    record = (lambda head: nullcontext()) if path is None else partial(SweepFile, path)
    with report_progress(progress, count_text) as report:
        return shown_as(Sweep, run_sweep(problem, grid, options, executor, record, report))


def load_sweep(path: str | PathLike[str]) -> Sweep:
    """Read the file that ``lfo.sweep`` wrote, whether or not the sweep is complete; its grid is the last grid.

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
        If it is no such file, or damaged.

    Examples
    --------
    >>> found = lfo.sweep(lfo.library.double_integrator, {"horizon": [60]}, path="sweep.jsonl")
    >>> len(lfo.load_sweep("sweep.jsonl").table())
    1
    """
    return shown_as(Sweep, read_sweep(path))
