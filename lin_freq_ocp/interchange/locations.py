"""The location of an error: a constructor names its argument; the reader knows the table and the file."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from lin_freq_ocp.errors import ProblemError


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
