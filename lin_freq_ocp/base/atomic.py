"""Files are written beside and renamed: under a name stands the whole of the new one, or the old one as it was.

Files that grow while they are written are locked instead.
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
    """Yield a stream; what is written to it takes the place of the file when all of it is on the disk.

    If anything fails before, the file stays as it was, or absent. A link keeps pointing to the file that is replaced.
    What is no regular file, such as a pipe, has nothing to lose, and is written to as it is.

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
    """Replace a file by these bytes; see ``open_replacement``."""
    with open_replacement(path) as stream:
        stream.write(content)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Replace a file by this text, in UTF-8 with its line ends as they are; see ``open_replacement``."""
    write_bytes(path, text.encode())


def write_each(contents: Mapping[Path, bytes]) -> None:
    """Replace every file by its bytes; ProblemError names all that could not be written, after all were tried."""
    failed = list[ProblemError]()
    for path, content in contents.items():
        try:
            write_bytes(path, content)
        except ProblemError as error:
            failed.append(error)
    if failed:
        fields = ", ".join(one.field for one in failed)
        reasons = ", ".join(dict.fromkeys(one.got for one in failed))
        others = f"The other {len(contents) - len(failed)} of {len(contents)} files are written."
        raise ProblemError(fields, reasons, "files that can be written", others)


@contextmanager
def lock_file(stream: BinaryIO | TextIO, wait: bool = True) -> Generator[bool]:
    """Lock an open file; yield whether it is locked, False if another process has it and we do not wait.

    The system unlocks it when this process ends, however it ends. Where files cannot be locked (Windows, some network
    disks), all have it.
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
        fcntl.flock(stream, fcntl.LOCK_UN)  # also where a forked process has the file


@contextmanager
def report_write_errors(path: Path) -> Generator[None]:
    """Turn failures to write into a ProblemError with the path as its field."""
    try:
        yield
    except OSError as error:
        raise ProblemError(str(path), reason(error), "a file that can be written") from None


def reason(error: Exception) -> str:
    """Return what the system says of a failure to read or write."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
