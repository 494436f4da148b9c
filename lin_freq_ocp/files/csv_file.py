"""Trajectories as tables in CSV: written with all digits, read from any table with the columns of a problem."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.atomic import write_text
from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.files.reading import read_text
from lin_freq_ocp.files.locations import naming
from lin_freq_ocp.files.signals import require_clock, trajectory_from_signals
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

STEP, SECONDS = "t", "time [s]"  # columns that count the steps and the seconds; either may be missing
FORMULAS = ("=", "+", "-", "@", "'")  # how a cell begins that a spreadsheet evaluates, and what keeps it from that


def read_csv(path: str | PathLike[str], problem: OptimalControlProblem) -> Trajectory:
    """Read a trajectory from a table: a header, then one row for each time 0 .. T.

    Columns are found by the problem's names of states and controls, with or without their units, in any order. Other
    columns are left out. The controls at time T have no effect, and are not read. A table that has, apart
    from the clock, controls only is replayed from the problem's initial state; it may end at time T-1.

    Parameters
    ----------
    path : path
        Text in UTF-8, separated by commas, with decimal points.
    problem : OptimalControlProblem
        Its names, horizon and sampling time; "t" is checked to count steps, "time [s]" to count seconds.

    Returns
    -------
    Trajectory

    Raises
    ------
    ProblemError
        If the table does not fit: the field names file, line and column.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator())
    >>> result.to_csv("run.csv")
    >>> bool((lfo.read_csv("run.csv", result.problem).x == result.trajectory.x).all())
    True
    """
    path = Path(path)
    text = read_text(path)
    with naming(path):
        table = _parsed(text)
        states = [table.find(name, problem.state_names) for name in problem.state_names]
        controls = [table.find(name, problem.control_names) for name in problem.control_names]
        known = {*states, *controls, table.find(STEP), table.find(SECONDS)}
        _require(table, problem.control_names, controls)
        replay = all(column is None for column in states)
        if not replay:
            _require(table, problem.state_names, states)
        elif others := [brief(name) for i, name in enumerate(table.head) if i not in known]:
            expected = f"columns for the states, {', '.join(map(repr, problem.state_names))}, or none but controls"
            raise ProblemError("columns", ", ".join(others), expected, suggestion(table.head[0], problem.state_names))
        T = problem.horizon
        if len(table.rows) != T + 1 and not (replay and len(table.rows) == T):
            also = f", or {T}" if replay else ""
            raise ProblemError("rows", f"{len(table.rows)}", f"{T + 1}{also}: one per time, below the header")
        _require_clocks(table, problem.sampling_time)
        x = None if replay else table.numbers(states, T + 1)
        return trajectory_from_signals(problem, x, table.numbers(controls, T))


def save_csv(path: str | PathLike[str], problem: OptimalControlProblem, trajectory: Trajectory) -> None:
    """Write a trajectory with all digits, one row per time.

    Columns: t, the time in seconds if the problem has a sampling time, states, controls (empty at t = T).
    """
    problem.require(trajectory)
    step, text = problem.sampling_time, io.StringIO()
    clock = [] if step is None else [SECONDS]
    controls = [*trajectory.u.tolist(), [""] * problem.control_dim]
    table = csv.writer(text)
    table.writerow([STEP, *clock, *map(header, (*problem.state_names, *problem.control_names))])
    for t, (x, u) in enumerate(zip(trajectory.x.tolist(), controls, strict=True)):
        table.writerow([t, *([] if step is None else [t * step]), *x, *u])
    write_text(path, text.getvalue())


def header(name: str) -> str:
    """Return a name as the head of a column: behind an apostrophe, if a spreadsheet would take it for a formula.

    A name that begins with an apostrophe gets another, so that no two names get the same head.
    """
    return f"'{name}" if name.lstrip()[:1] in FORMULAS else name


@dataclass(frozen=True)
class _Table:
    """A header, and rows of cells with their lines in the file."""

    head: list[str]
    lines: list[int]
    rows: list[list[str]]

    def find(self, name: str, among: Sequence[str] = ()) -> int | None:
        """Return the column of a name; or, where the problem has no other such name, of the name without its unit."""
        short = name.split(" [")[0]
        alone = sum(other.split(" [")[0] == short for other in among) == 1
        for wanted in map(str.strip, (header(name), name, header(short), short) if alone else (header(name), name)):
            if wanted in self.head:
                if self.head.count(wanted) > 1:
                    raise ProblemError(f"column {wanted!r}", f"{self.head.count(wanted)} of them", "one")
                return self.head.index(wanted)
        return None

    def numbers(self, columns: Sequence[int | None], count: int) -> list[list[float]]:
        """Return the first ``count`` rows of these columns."""
        found = [column for column in columns if column is not None]
        return [[self._number(row, column) for column in found] for row in range(count)]

    def _number(self, row: int, column: int) -> float:
        cell = self.rows[row][column]
        try:
            number = float(cell)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            location = f"line {self.lines[row]}, column {self.head[column]!r}"
            raise ProblemError(location, brief(cell) if cell else "an empty cell", "a finite number")
        return number


def _parsed(text: str) -> _Table:
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, skipinitialspace=True)
    lines: list[int] = []
    rows: list[list[str]] = []
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                rows.append([cell.strip() for cell in cells])
                lines.append(reader.line_num)
    except csv.Error as error:
        raise ProblemError(f"line {reader.line_num}", f"{error}", "comma-separated values") from None
    if not rows:
        raise ProblemError("header", "an empty file", "the names of the columns")
    for line, cells in zip(lines, rows, strict=True):
        if len(cells) != len(rows[0]):
            raise ProblemError(f"line {line}", f"{len(cells)} cells", f"{len(rows[0])}, as many as the header has")
    return _Table(rows[0], lines[1:], rows[1:])


def _require(table: _Table, names: Sequence[str], columns: Sequence[int | None]) -> None:
    for name, column in zip(names, columns, strict=True):
        if column is None:
            got = f"none (there is {', '.join(map(brief, table.head))})"
            advice = suggestion(name, table.head)
            if len(table.head) == 1 and any(mark in table.head[0] for mark in ";\t"):
                advice = "Separate columns by commas, and write numbers with decimal points."
            raise ProblemError(f"column {name!r}", got, "a column of this name", advice)


def _require_clocks(table: _Table, sampling_time: float | None) -> None:
    for name, period in ((STEP, 1.0), (SECONDS, sampling_time)):
        column = table.find(name)
        if column is not None and period is not None:
            times = [row[0] for row in table.numbers([column], len(table.rows))]
            require_clock(f"column {name!r}", np.array(times), period, [f"line {line}" for line in table.lines])
