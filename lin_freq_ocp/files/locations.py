"""Entries of files: their type, the keys of a table, and the location that an error names."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.errors import ProblemError, suggestion

FileValue = Any  # what TOML, JSON, .npz and .mat files hold: not known before it is checked
FileTable = dict[str, FileValue]
FileArray = NDArray[FileValue]  # of any type of entries


def require_keys(location: str, table: object, required: Iterable[str] = (), optional: Iterable[str] = ()) -> None:
    """Raise ProblemError unless ``table``, at this location of the file ("" at the top), is a table with these keys."""
    if not isinstance(table, Mapping):
        raise ProblemError(location, brief(table), "a table")
    required = tuple(required)
    known = (*required, *optional)
    for key in table:
        if key not in known:
            expected = f"one of {', '.join(known)}"
            raise ProblemError(joined(location, key), "an unknown key", expected, suggestion(key, known))
    for key in required:
        if key not in table:
            raise ProblemError(joined(location, key), "nothing", "this key")


OTHER_VERSION = "A later version of this package may have written it."


def readable(given: object, schema: int) -> bool:
    """Whether a version of a layout is this, or an earlier version: what was added since is optional."""
    return type(given) is int and 1 <= given <= schema


def require_schema(given: object, schema: int) -> None:
    """Raise ProblemError unless a file has this version of its layout, or an earlier version."""
    if not readable(given, schema):
        raise ProblemError("schema", brief(given), versions(schema), OTHER_VERSION)


def versions(schema: int) -> str:
    """Return the versions of a layout that are read, in words."""
    return "1" if schema == 1 else f"a whole number from 1 to {schema}"


def joined(location: str, key: str) -> str:
    """Return the location of a key of a table."""
    return f"{location}.{key}" if location else key


@contextmanager
def naming(path: Path) -> Generator[None]:
    """Put the file's name in front of the field of every ProblemError."""
    try:
        yield
    except ProblemError as error:
        raise ProblemError(f"{path.name}: {error.field}", error.got, error.expected, error.advice) from None


@contextmanager
def located(location: str, *own: str) -> Generator[None]:
    """Replace the names ``own`` ("Box.lower") at the beginning of a ProblemError's field ("state_set.lower")."""
    try:
        yield
    except ProblemError as error:
        field = _field(error.field, location, own) if location else error.field
        raise ProblemError(field, error.got, error.expected, error.advice) from None


def _field(field: str, location: str, own: tuple[str, ...]) -> str:
    for name in (location, *own):
        rest = field.removeprefix(name)
        if rest != field and rest[:1] in ("", ".", "["):
            return location + rest
    return f"{location}.{field}"
