"""Sweeps: one problem at every point of a grid of parameters, on as many processes or machines as there are."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, field
from functools import partial
from os import PathLike
from typing import TYPE_CHECKING, Any, get_type_hints

from lin_freq_ocp.arrays import brief
from lin_freq_ocp.comparison.sweep.fingerprint import fingerprint
from lin_freq_ocp.comparison.sweep.grid import Source, grid_points, grid_values, plain, point_key, require_picklable
from lin_freq_ocp.comparison.sweep.point import Row, solve_point
from lin_freq_ocp.comparison.sweep.tasks import finished
from lin_freq_ocp.errors import ProblemError, suggestion
from lin_freq_ocp.solve import require_options

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lin_freq_ocp.interchange.runs.sweep_file import SweepFile

MEASURED = tuple(name for name in get_type_hints(Row) if name != "parameters")
"""Columns beside the parameters: status, proven, cost, ..."""


@dataclass(frozen=True)
class SweepHead:
    """What makes two sweeps the same one: the name of what is swept, its fingerprint, parameters and options."""

    problem: str
    fingerprint: str
    names: tuple[str, ...]
    options: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Sweep:
    """The points of a grid that are finished.

    Attributes
    ----------
    problem : str
        Name of the problem, or of the function that builds it.
    grid : dict
        The values of each parameter, as JSON has them.
    rows : tuple of dict
        One per finished point, in the order of the grid, the last parameter fastest: "parameters", "status", "proven",
        "cost", "lower_bound", "gap", "pmp", "global", "method", "backend", "seconds" and "message", as in ``Result``
        and ``Certificate``; None where there is nothing. A point that could not be solved has the status "error".
    options : dict
        What solve was given.
    interrupted : bool
        Whether Ctrl-C ended it before all points were finished.

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
    """

    problem: str
    grid: Mapping[str, tuple[Any, ...]]
    rows: tuple[Row, ...] = field(repr=False)
    options: Mapping[str, Any]
    interrupted: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the swept parameters."""
        return tuple(self.grid)

    @property
    def size(self) -> int:
        """Return the number of points of the grid, be they finished or not."""
        size = 1
        for values in self.grid.values():
            size *= len(values)
        return size

    @property
    def complete(self) -> bool:
        """Whether every point is finished."""
        return len(self.rows) == self.size

    @property
    def proven(self) -> bool:
        """Whether every point is finished and its status is proven: optimal, infeasible or unbounded."""
        return self.complete and all(row["proven"] for row in self.rows)

    def table(self) -> list[dict[str, Any]]:
        """Return a flat dict per row, parameters first; ``pandas.DataFrame`` takes it as it is."""
        return [row["parameters"] | {name: row[name] for name in MEASURED} for row in self.rows]

    def column(self, name: str) -> list[Any]:
        """Return one parameter or one key of the rows, an entry per row.

        Raises
        ------
        ProblemError
            If there is none of that name.
        """
        known = (*self.names, *MEASURED)
        if name not in known:
            raise ProblemError("column", repr(name), f"one of {', '.join(known)}", suggestion(name, known))
        return [row[name] for row in self.table()]

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write the table, one line per row; what is absent is empty."""
        from lin_freq_ocp.interchange.runs.sweep_file import save_sweep_csv

        save_sweep_csv(path, self)

    def plot(self) -> Figure:
        """Return the cost and what is infeasible against the first parameter that is a number."""
        from lin_freq_ocp.report.figures.sweep import sweep_figure

        return sweep_figure(self)


def sweep(
    problem: Source,
    grid: Mapping[str, Sequence[Any]],
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
        Default: one after another, in this process. It is not shut down. Points lost with a worker are given out again.
    path : path, optional
        A file that gets a line per point as soon as it is finished. If it is there already, its points are not solved
        again, except those with the status "error"; the grid may have other values than before.
    method, backend, time_limit, tolerance
        As for ``solve``, for each point.
    progress : callable, optional
        Called with the number of finished points and that of all of them, at first and after each point.

    Returns
    -------
    Sweep
        After Ctrl-C: with what is finished until then, and ``interrupted``.

    Raises
    ------
    ProblemError
        If the grid has a name that the problem does not know, something cannot be sent to other processes, or the file
        belongs to another sweep. A single point that is no problem is a row with the status "error" instead.
    UnsupportedError
        If the method or backend does not exist.
    """
    require_options(method, backend, time_limit, tolerance)
    options = {"method": method, "backend": backend, "time_limit": time_limit, "tolerance": tolerance}
    values = grid_values(problem, grid)
    _require_executor(executor, problem, values)
    points, shown = grid_points(values), {name: tuple(map(plain, given)) for name, given in values.items()}
    head = SweepHead(_name(problem), fingerprint(problem), tuple(values), options)
    rows, interrupted = dict[str, Row](), False
    with _recorded(path, head, shown) as record:
        known = {} if record is None else {point_key(row["parameters"]): row for row in record.rows}
        rows.update({key: known[key] for key in points if key in known})
        missing = {key: point for key, point in points.items() if key not in rows}
        try:
            _tell(progress, len(rows), len(points))
            with closing(finished(partial(solve_point, problem, options), missing, executor)) as results:
                for key, row in results:
                    if record is not None:
                        record.append(row)
                    rows[key] = row
                    _tell(progress, len(rows), len(points))
        except KeyboardInterrupt:
            interrupted = True
    return Sweep(head.problem, shown, tuple(rows[key] for key in points if key in rows), options, interrupted)


def _recorded(
    path: str | PathLike[str] | None, head: SweepHead, grid: Mapping[str, Sequence[Any]]
) -> AbstractContextManager[SweepFile | None]:
    if path is None:
        return nullcontext()
    from lin_freq_ocp.interchange.runs.sweep_file import SweepFile

    return SweepFile(path, head, grid)


def _require_executor(executor: Any, problem: Source, grid: Mapping[str, Any]) -> None:
    if executor is None:
        return
    if not isinstance(executor, Executor):
        advice = "Of a Dask client: client.get_executor()."
        raise ProblemError("executor", brief(executor), "a concurrent.futures.Executor, or None", advice)
    require_picklable(problem, grid)


def _tell(progress: Callable[[int, int], None] | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done, total)


def _name(problem: Any) -> str:
    """Return the name of a problem, or of the function that builds it."""
    if isinstance(problem, partial):
        return _name(problem.func)
    return str(getattr(problem, "name", None) or getattr(problem, "__name__", None) or "problem")
