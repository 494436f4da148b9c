"""Keys of tables: the required ones are there, and no others than the known ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from lin_freq_ocp.arrays import brief
from lin_freq_ocp.errors import ProblemError, suggestion


def require_keys(place: str, table: Any, required: Iterable[str] = (), optional: Iterable[str] = ()) -> None:
    """Raise ProblemError unless ``table`` is a table with these keys; ``place`` is where it stands ("" at the top)."""
    if not isinstance(table, Mapping):
        raise ProblemError(place, brief(table), "a table")
    required = tuple(required)
    known = (*required, *optional)
    for key in table:
        if key not in known:
            raise ProblemError(
                _joined(place, key), "an unknown key", f"one of {', '.join(known)}", suggestion(key, known)
            )
    for key in required:
        if key not in table:
            raise ProblemError(_joined(place, key), "nothing", "this key")


def _joined(place: str, key: str) -> str:
    return f"{place}.{key}" if place else key
