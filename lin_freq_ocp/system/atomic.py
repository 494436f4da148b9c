"""Files are written beside and renamed: under a name stands the whole of the new one, or the old one as it was."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from lin_freq_ocp.errors import ProblemError


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Generator[BinaryIO]:
    """Yield a stream; what is written to it takes the place of the file when all of it is on the disk.

    If anything fails before, the file stays as it was, or absent. A link keeps pointing to the file that is replaced.
    What is no regular file, such as a pipe, has nothing to lose, and is written to as it is.

    Raises
    ------
    ProblemError
        If it cannot be written there; the field is the path.
    """
    path = Path(path)
    with writing(path):
        target = _target(path)
        if target.exists() and not target.is_file():
            with target.open("wb") as stream:
                yield stream
            return
        beside = target.with_name(f".{secrets.token_hex(8)}.tmp")
        try:
            with beside.open("xb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            if target.exists():
                shutil.copymode(target, beside)
            os.replace(beside, target)
        except BaseException:  # Ctrl-C, too, leaves nothing behind
            beside.unlink(missing_ok=True)
            raise


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Replace a file by these bytes; see ``replacing``."""
    with replacing(path) as stream:
        stream.write(content)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Replace a file by this text, in UTF-8 with its line ends as they are; see ``replacing``."""
    write_bytes(path, text.encode())


@contextmanager
def writing(path: Path) -> Generator[None]:
    """Turn failures to write into a ProblemError with the path as its field."""
    try:
        yield
    except OSError as error:
        raise ProblemError(str(path), reason(error), "a file that can be written") from None


def reason(error: Exception) -> str:
    """Return what the system says of a failure to read or write."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


def _target(path: Path) -> Path:
    try:
        return Path(os.path.realpath(path))
    except ValueError as error:  # a character that no file name can have
        raise ProblemError(repr(str(path)), reason(error), "the name of a file") from None
