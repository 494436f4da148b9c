"""Atomic writing: a temporary file in the same folder is renamed when it is complete, so that no file is half written.

Files that grow over time are locked instead.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, TextIO

from lin_freq_ocp.base.errors import ProblemError


@contextmanager
def open_replacement(path: str | os.PathLike[str]) -> Generator[BinaryIO]:
    """Yield a stream whose content replaces the file when all of it is on the disk.

    If anything fails before, the file stays unchanged, or absent. A link keeps pointing to the replaced file. A pipe or
    another file that is not regular is written directly.

    Raises
    ------
    ProblemError
        If it cannot be written there; the field is the path.
    """
    path = Path(path)
    with report_write_errors(path):
        try:
            target = Path(os.path.realpath(path))
        except ValueError as error:  # a character that no file name can have
            raise ProblemError(repr(str(path)), reason(error), "the name of a file") from None
        if target.exists() and not target.is_file():
            with target.open("wb") as stream:
                yield stream
            return
        temporary = target.with_name(f".{secrets.token_hex(8)}.tmp")
        try:
            with temporary.open("xb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            if target.exists():
                shutil.copymode(target, temporary)
            os.replace(temporary, target)
        except BaseException:  # also after Ctrl-C
            temporary.unlink(missing_ok=True)
            raise


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Replace a file by these bytes; see ``open_replacement``."""
    with open_replacement(path) as stream:
        stream.write(content)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Replace a file by this text, in UTF-8 with its line ends as they are; see ``open_replacement``."""
    write_bytes(path, text.encode())


def write_each(contents: Mapping[Path, bytes]) -> None:
    """Replace every file by its bytes; after trying all, ProblemError names those that could not be written."""
    errors = list[ProblemError]()
    for path, content in contents.items():
        try:
            write_bytes(path, content)
        except ProblemError as error:
            errors.append(error)
    if errors:
        fields = ", ".join(error.field for error in errors)
        reasons = ", ".join(dict.fromkeys(error.got for error in errors))
        others = f"The other {len(contents) - len(errors)} of {len(contents)} files are written."
        raise ProblemError(fields, reasons, "files that can be written", others)


@contextmanager
def lock_file(stream: BinaryIO | TextIO, wait: bool = True) -> Generator[bool]:
    """Lock an open file; yield whether it is locked: False if another process has the lock and we do not wait.

    The system releases the lock when this process ends for any reason. On systems without locks (Windows, some network
    disks) every process gets it.
    """
    try:
        import fcntl

        fcntl.flock(stream, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        yield False
        return
    except (ImportError, OSError):
        yield True
        return
    try:
        yield True
    finally:
        fcntl.flock(stream, fcntl.LOCK_UN)  # a forked process may have the file open


@contextmanager
def report_write_errors(path: Path) -> Generator[None]:
    """Raise a ProblemError with the path as its field if writing fails."""
    try:
        yield
    except OSError as error:
        raise ProblemError(str(path), reason(error), "a file that can be written") from None


def reason(error: Exception) -> str:
    """Return the message of the system for a failure to read or write."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
