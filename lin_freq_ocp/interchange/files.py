"""Files are opened here; whatever goes wrong on the way is a ProblemError that names the file."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.npyio import NpzFile

from lin_freq_ocp.errors import ProblemError

DAMAGED = (
    OSError,
    ValueError,
    EOFError,
    KeyError,
    SyntaxError,
    RuntimeError,
    MemoryError,
    zipfile.BadZipFile,
    zlib.error,
)
"""What numpy and zipfile raise for files that are damaged, encrypted, or hold Python objects instead of numbers."""


def read_text(path: Path) -> str:
    """Return the text of a UTF-8 file.

    Raises
    ------
    ProblemError
        If there is no such file, it cannot be read, or it is not text; the field is the path.
    """
    try:
        return read_bytes(path).decode("utf-8-sig")  # some editors on Windows put a byte-order mark first
    except UnicodeDecodeError as error:
        raise ProblemError(
            str(path), f"byte {error.start} that is not UTF-8", "a text file", "Save it with the encoding UTF-8."
        ) from None


def read_bytes(path: Path) -> bytes:
    """Return what a file holds.

    Raises
    ------
    ProblemError
        If there is no such file, or it cannot be read; the field is the path.
    """
    require_file(str(path), path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise ProblemError(str(path), _reason(error), "a file that can be read") from None


@contextmanager
def opened_npz(field: str, path: Path) -> Generator[NpzFile]:
    """Open an .npz of plain numbers and text; nothing in it is executed (``allow_pickle=False``).

    Raises
    ------
    ProblemError
        With this field, here or while its arrays are taken out, if it is not such a file.
    """
    require_file(field, path)
    try:
        with path.open("rb") as stream:
            archive = np.load(stream, allow_pickle=False)
            if not isinstance(archive, NpzFile):
                raise ProblemError(
                    field, f"a single array in {path.name}", "an .npz file", "Write it with numpy.savez."
                )
            with archive:
                yield archive
    except ProblemError:
        raise
    except DAMAGED as error:
        reason = _reason(error).partition(". ")[0]  # what follows is advice to trust the file
        raise ProblemError(field, f"{path.name}, unreadable ({reason})", "an .npz file of plain arrays") from None


def write_npz(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays under their names to exactly this path."""
    with writing(path), path.open("wb") as stream:
        np.savez(stream, **arrays)


@contextmanager
def writing(path: Path) -> Generator[None]:
    """Turn failures to write into a ProblemError with the path as its field."""
    try:
        yield
    except OSError as error:
        raise ProblemError(str(path), _reason(error), "a file that can be written") from None


def require_file(field: str, path: Path) -> None:
    """Raise ProblemError unless there is a regular file; a pipe or a device would never end."""
    try:
        found = "no such file" if not path.exists() else "a directory" if path.is_dir() else "not a regular file"
        if path.is_file():
            return
    except (OSError, ValueError) as error:
        found = _reason(error)
    raise ProblemError(field, f"{found} ({path})", "an existing file")


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
