"""Sweeps and answers to many problems in files: JSON lines that grow during a run, and from which it is resumed.

The first line describes the run. A line per finished point or answer follows; in the file of a sweep also a line with
the grid whenever that is new. Each line is on the disk before the next begins, and an incomplete last line is ignored.
A finished sweep is also written as a table, and as a JSON object.
"""

from __future__ import annotations

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Generic, Self, TypeVar, get_type_hints

from lin_freq_ocp.base.arrays import brief, to_shape
from lin_freq_ocp.base.atomic import lock_file, report_write_errors
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.batch.grid import grid_points, point_key
from lin_freq_ocp.batch.many import Item
from lin_freq_ocp.batch.sweep import MEASURED, Row, SweepOutcome
from lin_freq_ocp.batch.tasks import ERROR
from lin_freq_ocp.files.reading import (
    FileTable,
    FileValue,
    parsed_json,
    read_bytes,
    read_text,
    require_file,
    require_keys,
)
from lin_freq_ocp.files.solution_files import write_table
from lin_freq_ocp.problem.ocp import OptimalControlProblem

SCHEMA = 1  # version of the layout; a file with another version is refused
KIND = "lin-freq-ocp sweep"
BEGINNING = json.dumps({"kind": KIND, "schema": SCHEMA})[:-1]  # of every file, also of one cut off in its first line
HEAD_KEYS = ("kind", "schema", "version", "problem", "fingerprint", "names", "options", "grid")
HEAD_KINDS = {"problem": str, "fingerprint": str, "names": list, "options": dict}
# Types of the values of a row.
ROW_KINDS = {
    key: dict if key == "parameters" else int | float | None if kind == float | None else kind
    for key, kind in get_type_hints(Row).items()
}

DIFFERENCES = (("problem", "another problem"), ("names", "other parameters"), ("options", "other options of solve"))
ANOTHER_PATH = "Give another path, or remove the file."

MANY_KIND = "lin-freq-ocp solve_many"
MANY_HEAD_KEYS = ("kind", "schema", "version", "fingerprint", "options")
MANY_DIFFERENCES = (("schema", "another layout"), ("fingerprint", "another problem"), ("options", "other options"))
ITEM_KINDS: dict[str, FileValue] = {"key": str, "status": str, "proven": bool, "message": str}
ITEM_KINDS |= dict.fromkeys(("cost", "lower_bound", "gap", "seconds"), int | float | None)
ITEM_KEYS = (*ITEM_KINDS, "x", "u")

Answer = TypeVar("Answer")


class Log(ABC, Generic[Answer]):
    """A file of JSON lines that grows, locked for this process: no other process may append to it.

    ``head`` identifies the run. A file of the same run is continued; any other file is a ProblemError. ``answers`` are
    those of the file when it was opened, by their keys, without those that ended with an error.
    """

    kind = ""

    def __init__(self, path: str | PathLike[str], head: Mapping[str, object]):
        self._path = path = Path(path)
        if path.exists():
            require_file(str(path), path)
        with report_write_errors(path), ExitStack() as stack:
            self._stream = stack.enter_context(path.open("ab"))
            if not stack.enter_context(lock_file(self._stream, wait=False)):
                advice = "Wait until it ends, or choose another folder or name."
                raise ProblemError(str(path), "a file that another run is writing", "one of its own", advice)
            self._open = stack.pop_all()
        try:
            first = {"kind": self.kind, "schema": SCHEMA, "version": version("lin-freq-ocp"), **head}
            answers, line = self._resume(first)
            self.answers: Mapping[str, Answer] = answers
            with report_write_errors(path):
                self._stream.truncate(read_bytes(path).rfind(b"\n") + 1)  # an incomplete last line is dropped
            if line:
                self._write(line)
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def _resume(self, first: FileTable) -> tuple[dict[str, Answer], FileTable]:
        """Return the answers of the file, and the line to append now, if any: in a new file ``first``."""

    @abstractmethod
    def append(self, key: str, answer: Answer) -> None:
        """Write one answer; it is on the disk when this returns."""

    def _write(self, entry: Mapping[str, object]) -> None:
        with report_write_errors(self._path):
            self._stream.write(json.dumps(entry, allow_nan=False).encode() + b"\n")
            self._stream.flush()
            os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Close the file and release its lock."""
        with report_write_errors(self._path):
            self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class SweepFile(Log[Row]):
    """A file that gets a line per point, and one with the grid whenever that is new."""

    kind = KIND

    def _resume(self, first: FileTable) -> tuple[dict[str, Row], FileTable]:
        lines, path, grid = _sweep_lines(self._path), str(self._path), first["grid"]
        rows = {point_key(row["parameters"]): row for row in _rows_of(lines) if row["status"] != ERROR}
        if not lines:
            return rows, first
        for key, difference in DIFFERENCES:
            if lines[0][key] != first[key]:
                got = f"a sweep of {difference} ({brief(lines[0][key])})"
                raise ProblemError(path, got, brief(first[key]), ANOTHER_PATH)
        if lines[0]["fingerprint"] != first["fingerprint"]:
            got = f"a sweep of another problem, also called {first['problem']}"
            raise ProblemError(path, got, f"{first['problem']}, with the same data and fixed arguments", ANOTHER_PATH)
        return rows, {} if list(_last_grid(lines).items()) == list(grid.items()) else {"grid": grid}

    def append(self, key: str, answer: Row) -> None:
        """Write the row of a point."""
        self._write(answer)


def _sweep_lines(path: Path) -> list[FileTable]:
    """Return all whole lines of a sweep's file; none, if not even the first is whole."""
    head, *others = read_text(path).split("\n")
    if not others and BEGINNING.startswith(head[: len(BEGINNING)]):
        return []
    if not head.startswith(BEGINNING):
        raise _no_sweep_error(path)
    lines = list[FileTable]()
    for number, text in enumerate([head, *others[:-1]], 1):
        line, location = parsed_json(f"{path}, line {number}", text), f"{path.name}, line {number}"
        require_keys(location, line, optional=() if not isinstance(line, dict) else line)
        if "grid" in line:
            grid = line["grid"]
            if not isinstance(grid, dict) or not grid or not all(isinstance(v, list) and v for v in grid.values()):
                raise ProblemError(f"{location}.grid", brief(grid), "a list of values for each parameter")
        elif number > 1:
            line.setdefault("bound", None)  # rows of earlier versions have none
            require_keys(location, line, ("parameters", *MEASURED))
            _require_kinds(location, line, ROW_KINDS)
        lines.append(line)
    require_keys(path.name, lines[0], HEAD_KEYS)
    _require_kinds(path.name, lines[0], HEAD_KINDS)
    return lines


def _no_sweep_error(path: Path) -> ProblemError:
    return ProblemError(str(path), "something else", "a file of a sweep, or a new name", "It is left as it is.")


def _require_kinds(location: str, line: Mapping[str, object], kinds: Mapping[str, FileValue]) -> None:
    """Raise ProblemError unless the values of a line have these types; True and False are no numbers."""
    for key, kind in kinds.items():
        value = line[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind != bool | None and kind is not bool):
            raise ProblemError(f"{location}.{key}", brief(value), "a value as this package writes it there")


def _rows_of(lines: Sequence[FileTable]) -> list[FileValue]:
    return [line for line in lines if "grid" not in line]


def _last_grid(lines: Sequence[FileTable]) -> FileTable:
    return [line["grid"] for line in lines if "grid" in line][-1]


def read_sweep(path: str | PathLike[str]) -> SweepOutcome:
    """Read the file of a sweep, complete or not, with its last grid; ProblemError if it is no such file, or damaged."""
    path = Path(path)
    lines = _sweep_lines(path)
    if not lines:
        raise _no_sweep_error(path)
    grid = {name: tuple(values) for name, values in _last_grid(lines).items()}
    rows = {point_key(row["parameters"]): row for row in _rows_of(lines)}
    kept = tuple(rows[key] for key in grid_points(grid) if key in rows)
    return SweepOutcome(lines[0]["problem"], grid, kept, lines[0]["options"])


def save_sweep_csv(path: str | PathLike[str], sweep: SweepOutcome) -> None:
    """Write a line per row, parameters first; numbers with all digits, absent values empty."""
    write_table(path, (*sweep.names, *MEASURED), (row.values() for row in sweep.table()))


def sweep_summary(sweep: SweepOutcome) -> FileTable:
    """Return a sweep as the JSON object of ``lin-freq-ocp sweep --json``."""
    return {
        "schema": SCHEMA,
        "version": version("lin-freq-ocp"),
        "problem": sweep.problem,
        "grid": {name: list(values) for name, values in sweep.grid.items()},
        "options": dict(sweep.options),
        "complete": sweep.complete,
        "interrupted": sweep.interrupted,
        "points": list(sweep.rows),
    }


class ManyFile(Log[Item]):
    """A file that gets a line per answer."""

    kind = MANY_KIND

    def __init__(self, problem: OptimalControlProblem, path: str | PathLike[str], head: Mapping[str, object]):
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        self._shapes = {"x": (T + 1, n), "u": (T, m)}
        super().__init__(path, head)

    def _resume(self, first: FileTable) -> tuple[dict[str, Item], FileTable]:
        text = read_text(self._path)
        whole = text[: text.rfind("\n") + 1]
        if not whole and not json.dumps(first)[:10].startswith(text[:10]):
            raise self._another(text)
        lines = [parsed_json(f"{self._path}, line {i}", line) for i, line in enumerate(whole.splitlines(), 1)]
        if not lines:
            return {}, first
        if not isinstance(lines[0], dict) or lines[0].get("kind") != MANY_KIND:
            raise self._another(lines[0])
        require_keys(self._path.name, lines[0], MANY_HEAD_KEYS)
        for key, difference in MANY_DIFFERENCES:
            if lines[0][key] != first[key]:
                raise ProblemError(str(self._path), f"a file of {difference}", brief(first[key]), ANOTHER_PATH)
        items = dict[str, Item]()
        for number, line in enumerate(lines[1:], 2):
            location = f"{self._path.name}, line {number}"
            require_keys(location, line, ITEM_KEYS)
            _require_kinds(location, line, ITEM_KINDS)
            for name, shape in self._shapes.items():
                line[name] = None if line[name] is None else to_shape(f"{location}.{name}", line[name], shape)
            items |= {line.pop("key"): Item(**line)}
        return {key: item for key, item in items.items() if item.status != ERROR}, {}

    def append(self, key: str, answer: Item) -> None:
        """Write one answer."""
        values = {name: getattr(answer, name) for name in ITEM_KEYS if name != "key"}
        arrays = {name: None if values[name] is None else values[name].tolist() for name in "xu"}
        self._write({"key": key} | values | arrays)

    def _another(self, content: object) -> ProblemError:
        return ProblemError(
            str(self._path), brief(content, 30), "a file of solve_many, or a new name", "It is left as it is."
        )
