"""Where a fault stands: constructors know their argument, the reader knows the table and the file it came from."""

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
def placed(place: str, *own: str) -> Generator[None]:
    """Let a ProblemError that names a field of ``own`` ("Box.lower") name the one at ``place`` ("state_set.lower")."""
    try:
        yield
    except ProblemError as error:
        raise ProblemError(_field(error.field, place, own), error.got, error.expected, error.advice) from None


def _field(field: str, place: str, own: tuple[str, ...]) -> str:
    for name in (place, *own):
        rest = field.removeprefix(name)
        if rest != field and rest[:1] in ("", ".", "["):
            return place + rest
    return f"{place}.{field}"
