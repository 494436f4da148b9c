"""Keys of tables: required and known ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from lin_freq_ocp.arrays import brief
from lin_freq_ocp.errors import ProblemError, suggestion


def require_keys(location: str, table: Any, required: Iterable[str] = (), optional: Iterable[str] = ()) -> None:
    """Raise ProblemError unless ``table``, at this location of the file ("" at the top), is a table with these keys."""
    if not isinstance(table, Mapping):
        raise ProblemError(location, brief(table), "a table")
    required = tuple(required)
    known = (*required, *optional)
    for key in table:
        if key not in known:
            raise ProblemError(
                joined(location, key), "an unknown key", f"one of {', '.join(known)}", suggestion(key, known)
            )
    for key in required:
        if key not in table:
            raise ProblemError(joined(location, key), "nothing", "this key")


def joined(location: str, key: str) -> str:
    """Return the location of a key of a table."""
    return f"{location}.{key}" if location else key
