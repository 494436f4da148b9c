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
from typing import ClassVar, Generic, Self, TypeVar, get_type_hints

from lin_freq_ocp.base.archives import read_bytes, require_file
from lin_freq_ocp.base.arrays import brief, to_shape
from lin_freq_ocp.base.atomic import lock_file, report_write_errors
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.batch.grid import grid_points, point_key
from lin_freq_ocp.batch.many import Item
from lin_freq_ocp.batch.sweep import MEASURED, Row, SweepOutcome
from lin_freq_ocp.batch.tasks import ERROR
from lin_freq_ocp.files.reading import FileTable, FileValue, parsed_json, read_text, require_keys
from lin_freq_ocp.files.solution_files import write_table
from lin_freq_ocp.problem.ocp import OptimalControlProblem

SCHEMA = 1  # version of the layout; a file with another version is refused
Kinds = Mapping[str, FileValue]  # types of values, by their keys
ROW_KINDS: Kinds = {
    key: dict if key == "parameters" else int | float | None if kind == float | None else kind
    for key, kind in get_type_hints(Row).items()
}
ITEM_KINDS: dict[str, FileValue] = {"key": str, "status": str, "proven": bool, "message": str}
ITEM_KINDS |= dict.fromkeys(("cost", "lower_bound", "gap", "seconds"), int | float | None)
ITEM_KEYS = (*ITEM_KINDS, "x", "u")

Answer = TypeVar("Answer")


class Log(ABC, Generic[Answer]):
    """A file of JSON lines that grows, locked for this process: no other process may append to it.

    ``head`` identifies the run. A file of the same run is continued; any other file is a ProblemError. ``answers`` are
    those of the file when it was opened, by their keys, without those that ended with an error.
    """

    kind = ""  # the function of the library that writes it
    head_kinds: ClassVar[Kinds] = {}  # types of values of the first line
    differences: Mapping[str, str] = {}  # values of the first line by which runs differ, with words for it

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
            first = {"kind": f"lin-freq-ocp {self.kind}", "schema": SCHEMA, "version": version("lin-freq-ocp"), **head}
            lines = self.lines(path)
            for key, difference in self.differences.items() if lines else ():
                if lines[0][key] != first[key]:
                    got = f"a file of {difference.format(**first)} ({brief(lines[0][key])})"
                    raise ProblemError(str(path), got, brief(first[key]), "Give another path, or remove the file.")
            self.answers: Mapping[str, Answer] = self._answers(lines)
            line = self._news(lines, first) if lines else first
            with report_write_errors(path):
                self._stream.truncate(read_bytes(path).rfind(b"\n") + 1)  # an incomplete last line is dropped
            if line:
                self._write(line)
        except BaseException:
            self.close()
            raise

    @classmethod
    def lines(cls, path: Path) -> list[FileTable]:
        """Return all whole lines of a file, which are tables; none, if not even the first is whole."""
        beginning = json.dumps({"kind": f"lin-freq-ocp {cls.kind}", "schema": SCHEMA})[:-1]
        *whole, rest = read_text(path).split("\n")
        if not (whole[0].startswith(beginning) if whole else beginning.startswith(rest[: len(beginning)])):
            expected = f"a file of {cls.kind}, or a new name"
            raise ProblemError(str(path), brief((whole or [rest])[0]), expected, "It is left as it is.")
        lines = [parsed_json(f"{path}, line {number}", text) for number, text in enumerate(whole, 1)]
        for number, line in enumerate(lines, 1):
            require_keys(f"{path.name}, line {number}", line, optional=() if not isinstance(line, dict) else line)
        if lines:
            require_keys(path.name, lines[0], ("kind", "schema", "version", *cls.head_kinds))
            _require_kinds(path.name, lines[0], cls.head_kinds)
        return lines

    @abstractmethod
    def _answers(self, lines: Sequence[FileTable]) -> dict[str, Answer]:
        """Return the answers of the file by their keys, without errors."""

    def _news(self, lines: Sequence[FileTable], first: FileTable) -> FileTable:
        """Return the line that a file which is continued needs before any answer, if any."""
        return {}

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

    kind = "sweep"
    head_kinds: ClassVar[Kinds] = {"problem": str, "fingerprint": str, "names": list, "options": dict, "grid": dict}
    differences: Mapping[str, str] = {
        "problem": "another problem",
        "names": "other parameters",
        "options": "other options of solve",
        "fingerprint": "another problem, also called {problem}, with other data or fixed arguments",
    }

    @classmethod
    def lines(cls, path: Path) -> list[FileTable]:
        """Return all whole lines, checked: the first and later ones with a grid, and rows."""
        lines = super().lines(path)
        for number, line in enumerate(lines, 1):
            location = f"{path.name}, line {number}"
            if "grid" in line:
                grid = line["grid"]
                if not isinstance(grid, dict) or not grid or not all(isinstance(v, list) and v for v in grid.values()):
                    raise ProblemError(f"{location}.grid", brief(grid), "a list of values for each parameter")
            else:
                line.setdefault("bound", None)  # rows of earlier versions have none
                require_keys(location, line, ROW_KINDS)
                _require_kinds(location, line, ROW_KINDS)
        return lines

    def _answers(self, lines: Sequence[FileTable]) -> dict[str, Row]:
        return {point_key(row["parameters"]): row for row in _rows_of(lines) if row["status"] != ERROR}

    def _news(self, lines: Sequence[FileTable], first: FileTable) -> FileTable:
        grid = first["grid"]
        return {} if list(_last_grid(lines).items()) == list(grid.items()) else {"grid": grid}

    def append(self, key: str, answer: Row) -> None:
        """Write the row of a point."""
        self._write(answer)


def _require_kinds(location: str, line: Mapping[str, object], kinds: Kinds) -> None:
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
    lines = SweepFile.lines(path)
    if not lines:
        raise ProblemError(str(path), "no whole line", "a file of sweep")
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

    kind = "solve_many"
    head_kinds: ClassVar[Kinds] = {"fingerprint": str, "options": dict}
    differences: Mapping[str, str] = {"fingerprint": "another problem", "options": "other options"}

    def __init__(self, problem: OptimalControlProblem, path: str | PathLike[str], head: Mapping[str, object]):
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        self._shapes = {"x": (T + 1, n), "u": (T, m)}
        super().__init__(path, head)

    def _answers(self, lines: Sequence[FileTable]) -> dict[str, Item]:
        items = dict[str, Item]()
        for number, line in enumerate(lines[1:], 2):
            location = f"{self._path.name}, line {number}"
            require_keys(location, line, ITEM_KEYS)
            _require_kinds(location, line, ITEM_KINDS)
            for name, shape in self._shapes.items():
                line[name] = None if line[name] is None else to_shape(f"{location}.{name}", line[name], shape)
            items |= {line.pop("key"): Item(**line)}
        return {key: item for key, item in items.items() if item.status != ERROR}

    def append(self, key: str, answer: Item) -> None:
        """Write one answer."""
        values = {name: getattr(answer, name) for name in ITEM_KEYS if name != "key"}
        arrays = {name: None if values[name] is None else values[name].tolist() for name in "xu"}
        self._write({"key": key} | values | arrays)
