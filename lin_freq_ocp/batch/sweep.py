"""Sweeps: one problem at every point of a grid of parameters, on one process or many, here or on other machines.

Any process can build, solve and judge a point; its row is plain data. Each row is recorded when it is finished, and
rows of an earlier run are not computed again.
"""

from __future__ import annotations

import math
import threading
import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypedDict, cast, get_type_hints

from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import BandWarning, LinFreqOCPError, ProblemError, suggestion
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.batch.grid import (
    Parameters,
    Source,
    fingerprint,
    grid_points,
    grid_values,
    plain,
    plain_parameters,
    problem_at,
    require_executor,
)
from lin_freq_ocp.batch.tasks import ERROR, OpenRecord, Work, finish_run, finish_tasks
from lin_freq_ocp.solving.families import Options
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged

INTERRUPTED_POINT = "interrupted"  # status of a point whose solve was stopped by Ctrl-C; no sweep keeps it

Row = TypedDict(
    "Row",
    {
        "parameters": Parameters,  # as JSON has them
        "status": str,  # of Result, or "error"
        "proven": bool,  # the status: by the maximum principle, the gap, or a ray
        "cost": float | None,  # like the gap, only of a point that satisfies every constraint
        "lower_bound": float | None,
        "bound": str | None,  # "rigorous" or "numerical", of the cost or of infeasibility
        "gap": float | None,
        "pmp": str | None,
        "global": bool | None,
        "method": str | None,
        "backend": str | None,
        "seconds": float | None,  # wall time for building, solving and judging
        "message": str | None,  # how it ended, a bad description, or a band that removes nothing or everything
    },
)

_BUILD_LOCK = threading.Lock()  # warnings are caught for a whole process: its threads build one after another

MEASURED = tuple(name for name in get_type_hints(Row) if name != "parameters")  # the columns after the parameters


@dataclass(frozen=True, eq=False)
class SweepOutcome:
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
    """

    problem: str
    grid: Mapping[str, tuple[object, ...]]
    rows: tuple[Row, ...] = field(repr=False)
    options: Mapping[str, object]
    interrupted: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the swept parameters."""
        return tuple(self.grid)

    @property
    def size(self) -> int:
        """Return the number of points of the grid, be they finished or not."""
        return math.prod(map(len, self.grid.values()))

    @property
    def complete(self) -> bool:
        """Whether every point is finished."""
        return len(self.rows) == self.size

    @property
    def proven(self) -> bool:
        """Whether every point is finished and its status is proven: optimal, infeasible or unbounded."""
        return self.complete and all(row["proven"] for row in self.rows)

    def table(self) -> list[dict[str, object]]:
        """Return a flat dict per row, parameters first; ``pandas.DataFrame`` takes the list."""
        return [row["parameters"] | {name: row[name] for name in MEASURED} for row in self.rows]

    def column(self, name: str) -> list[object]:
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


def run_sweep(
    problem: Source,
    grid: Mapping[str, Sequence[object]],
    options: Mapping[str, Any],
    executor: Executor | None,
    open_record: OpenRecord[Row],
    progress: Callable[[int, int], None] | None,
) -> SweepOutcome:
    """Return the finished points of a grid, all of them unless it was interrupted; see ``lfo.sweep``."""
    stated = Options(**options)
    values = grid_values(problem, grid)
    require_executor(executor, problem, values)
    points, shown = grid_points(values), {name: tuple(map(plain, given)) for name, given in values.items()}
    work = Work(partial(solve_point, problem, stated), failed_point, lambda row: row["status"] == INTERRUPTED_POINT)

    def solve_missing(recorded: Mapping[str, Row]) -> Generator[Mapping[str, Row]]:
        missing = {key: point for key, point in points.items() if key not in recorded}
        with closing(finish_tasks(work, missing, executor)) as results:
            for key, row in results:
                yield {key: row}

    rows, interrupted = finish_run(
        list(points), solve_missing, open_record(sweep_head(problem, shown, options)), progress
    )
    found = tuple(rows[key] for key in points if key in rows)
    return SweepOutcome(name_of(problem), shown, found, options, interrupted)


def name_of(source: Source) -> str:
    """Return the name of a problem, or of the function that builds it."""
    named: object = source
    while isinstance(named, partial):
        named = named.func
    return str(getattr(named, "name", None) or getattr(named, "__name__", None) or "problem")


def sweep_head(
    source: Source, grid: Mapping[str, Sequence[object]], options: Mapping[str, object]
) -> dict[str, object]:
    """Return the data that identify a sweep, and its grid."""
    return {
        "problem": name_of(source),
        "fingerprint": fingerprint(source),
        "names": sorted(grid),
        "options": dict(options),
        "grid": {name: list(values) for name, values in grid.items()},
    }


def solve_point(source: Source, options: Options, parameters: Parameters, attempt: int = 0) -> Row:
    """Return the row of one point; errors are in the row.

    ``attempt`` counts how often the point was lost before: a scheduler that keeps answers must not take it for the
    same task.
    """
    started, bands = now(), list[str]()
    try:
        with collect_band_warnings(bands):
            problem = problem_at(source, parameters)
        result = solve_judged(problem, options)
    except LinFreqOCPError as error:
        return failed_point(parameters, str(error), now() - started)
    except Exception as error:  # a function that builds problems may raise anything: the others are solved
        return failed_point(parameters, f"{type(error).__name__}: {error}", now() - started)
    return row_of(result, parameters, now() - started, bands)


def row_of(result: Outcome, parameters: Parameters, seconds: float, notes: Sequence[str] = ()) -> Row:
    """Return the row of a point that was solved, with notes on it."""
    row = failed_point(parameters, None, seconds)
    certificate, messages = result.certificate, [result.message] if result.message else []
    row["status"] = INTERRUPTED_POINT if result.interrupted else result.status
    row["lower_bound"], row["bound"] = _finite_or_none(result.lower_bound), result.bound
    row["method"], row["backend"] = result.method, result.backend
    if certificate is not None:
        row["pmp"], row["global"] = certificate.pmp, certificate.globally_optimal
        row["proven"] = (certificate.pmp == "satisfied" and certificate.normal is True) or certificate.globally_optimal
    if result.status in (Status.INFEASIBLE, Status.UNBOUNDED):
        row["proven"] = result.dual
    if result.primal:
        row["cost"], row["gap"] = _finite_or_none(result.cost), _finite_or_none(result.gap)
    elif result.cost is not None:  # it may be lower than that of every solution
        messages.append(f"the point found, with cost {result.cost:.6g}, breaks constraints")
    row["message"] = "; ".join([*messages, *notes]) or None
    return row


@contextmanager
def collect_band_warnings(messages: list[str]) -> Generator[None]:
    """Collect the warnings on frequency bands, which belong to the point; other warnings are issued again."""
    with _BUILD_LOCK, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", BandWarning)
        yield
    for warning in caught:
        if issubclass(warning.category, BandWarning):
            messages.append(str(warning.message))
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)


def _finite_or_none(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def failed_point(parameters: Parameters, message: str | None, seconds: float | None = None) -> Row:
    """Return the row of a point that was not solved, and why."""
    row: dict[str, object] = {"parameters": plain_parameters(parameters), **dict.fromkeys(MEASURED)}
    return cast("Row", row | {"status": ERROR, "proven": False, "seconds": seconds, "message": message})
