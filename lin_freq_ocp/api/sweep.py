"""sweep() as users call it, and the sweep that it returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from functools import partial
from os import PathLike
from typing import TYPE_CHECKING, final

from lin_freq_ocp.api.progress import counted, reporting
from lin_freq_ocp.api.result import shown_as
from lin_freq_ocp.batch.grid import Source
from lin_freq_ocp.batch.sweep import SweepOutcome, swept
from lin_freq_ocp.files.sweep_file import SweepFile, read_sweep, save_sweep_csv

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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
        Values of each parameter. Of a function: its keywords. Of a problem: its fields, and "cutoff" (rad/sample) or
        "cutoff_hz" for a low pass in place of its ``control_spectrum``; a cut-off of None is no frequency constraint.
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
    record = (lambda head, grid: nullcontext()) if path is None else partial(SweepFile, path)
    with reporting(progress, counted) as report:
        return shown_as(Sweep, swept(problem, grid, options, executor, record, report))


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
