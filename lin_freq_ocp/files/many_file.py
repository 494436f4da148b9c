"""Answers to many problems in a file: JSON lines that grow while they are found, and are resumed from.

The first line says of what; a line per answer follows, each on the disk before the next begins. An incomplete last
line is ignored.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from types import TracebackType

import numpy as np

from lin_freq_ocp.base.arrays import Array, brief
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.batch.items import ERROR, Item
from lin_freq_ocp.batch.many import ManyHead
from lin_freq_ocp.files.reading import Log, parsed_json, read_text
from lin_freq_ocp.files.locations import FileTable, require_keys

KIND = "lin-freq-ocp solve_many"
HEAD_KEYS = ("kind", "schema", "version", "fingerprint", "options")
NUMBERS = ("cost", "lower_bound", "gap", "seconds")
ITEM_KEYS = ("key", "status", "proven", "message", *NUMBERS, "x", "u")
SCHEMA = 1  # version of the layout; a file with another version is refused
ANOTHER_PATH = "Give another path, or remove the file."


class ManyFile:
    """A file that gets a line per answer; ``items`` are those of the file when it was opened, without errors."""

    def __init__(self, path: str | PathLike[str], head: ManyHead):
        self._path = Path(path)
        self._log = Log(self._path)
        try:
            self.items: Mapping[str, Item] = self._begin(head)
        except BaseException:
            self._log.close()
            raise

    def _begin(self, head: ManyHead) -> dict[str, Item]:
        """Return the answers of the file, which gets its first line."""
        first = {"kind": KIND, "schema": SCHEMA, "version": version("lin-freq-ocp")}
        first |= {"fingerprint": head.fingerprint, "options": dict(head.options)}
        text = read_text(self._path)
        whole = text[: text.rfind("\n") + 1].encode()
        if not whole and not json.dumps(first)[:10].startswith(text[:10]):
            raise self._another(text)
        lines = [parsed_json(f"{self._path}, line {i}", line) for i, line in enumerate(whole.decode().splitlines(), 1)]
        if lines:
            self._require_same(lines[0], first)
        found = {line["key"]: _item(line) for line in map(self._checked, lines[1:])}
        self._log.truncate(len(whole))
        if not lines:
            self._log.write(first)
        return {key: item for key, item in found.items() if item.status != ERROR}

    def append(self, key: str, item: Item) -> None:
        """Write one answer; it is on the disk when this returns."""
        numbers = {name: getattr(item, name) for name in NUMBERS}
        arrays = {name: _listed(getattr(item, name)) for name in ("x", "u")}
        self._log.write(
            {"key": key, "status": item.status, "proven": item.proven, "message": item.message, **numbers, **arrays}
        )

    def _require_same(self, found: FileTable, first: FileTable) -> None:
        if not isinstance(found, dict) or found.get("kind") != KIND:
            raise self._another(found)
        require_keys(self._path.name, found, HEAD_KEYS)
        for key, what in (
            ("schema", "another layout"),
            ("fingerprint", "another problem"),
            ("options", "other options"),
        ):
            if found[key] != first[key]:
                raise ProblemError(str(self._path), f"a file of {what}", brief(first[key]), ANOTHER_PATH)

    def _checked(self, line: FileTable) -> FileTable:
        require_keys(self._path.name, line, ITEM_KEYS)
        return line

    def _another(self, found: object) -> ProblemError:
        return ProblemError(
            str(self._path), brief(found, 30), "a file of solve_many, or a new name", "It is left as it is."
        )

    def __enter__(self) -> ManyFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._log.close()


def _listed(values: Array | None) -> list[list[float]] | None:
    return None if values is None else values.tolist()


def _item(line: FileTable) -> Item:
    given = {name: line[name] for name in ITEM_KEYS if name not in ("key", "x", "u")}
    x, u = (None if line[name] is None else np.array(line[name], dtype=np.float64) for name in ("x", "u"))
    return Item(**given, x=x, u=u)
