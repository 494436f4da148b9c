"""Read files safely: text, JSON, archives of arrays, and the entries of tables.

Every failure is a ProblemError whose field names the file and the location in it. A file may come from anyone: nothing
in it is executed, and no more is unpacked than its size allows.
"""

from __future__ import annotations

import json
import math
import zipfile
import zlib
from collections.abc import Generator, Iterable, Mapping
from contextlib import AbstractContextManager, contextmanager
from io import SEEK_END, BytesIO
from pathlib import Path
from typing import BinaryIO, NoReturn

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import ArrayLike, NDArray

from lin_freq_ocp.base.archives import FileValue, decode_text, read_bytes, require_file, require_modest
from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.atomic import reason
from lin_freq_ocp.base.errors import ProblemError, rename_field, suggestion

FileTable = dict[str, FileValue]
FileArray = NDArray[FileValue]  # of any type of entries

OTHER_VERSION = "A later version of this package may have written it."

NPY_MAGIC = b"\x93NUMPY"  # first bytes of an .npy, and of every entry of an .npz
# What numpy and zipfile raise for files that are damaged, encrypted, or hold Python objects instead of numbers.
DAMAGED = (
    *(OSError, ValueError, EOFError, KeyError, SyntaxError, RuntimeError, MemoryError),
    *(zipfile.BadZipFile, zlib.error),
)


def read_text(path: Path) -> str:
    """Return the text of a file in UTF-8 or UTF-16; the field of a ProblemError is the path."""
    try:
        return decode_text(read_bytes(path))
    except UnicodeDecodeError as error:
        got = f"byte {error.start} that is not {error.encoding.upper()}"
        raise ProblemError(str(path), got, "a text file", "Save it with the encoding UTF-8.") from None


def parsed_json(field: str, text: str | bytes, infinite: bool = False) -> FileValue:
    """Return the value of a JSON text; ``infinite`` allows Infinity and NaN, which Python also writes.

    ProblemError if it is no JSON, is nested too deeply for Python, or has numbers that are too large for it.
    """

    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is not JSON")

    try:
        return json.loads(text, parse_int=_parse_integer, parse_constant=None if infinite else refuse)
    except (ValueError, RecursionError) as error:
        raise ProblemError(field, f"{brief(text)} ({error})", "a JSON object") from None


def _parse_integer(digits: str) -> int:
    if not math.isfinite(float(digits)):
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


@contextmanager
def opened_npz(field: str, path: Path) -> Generator[NpzFile]:
    """Open an .npz of plain numbers and text; nothing in it is executed (``allow_pickle=False``).

    The declared sizes are checked first, and no more is ever unpacked. ProblemError with this field, here or while
    arrays are taken out, if it is not such a file, or unpacks to too much.
    """
    require_file(field, path)
    try:
        with path.open("rb") as stream:
            if stream.read(len(NPY_MAGIC)) == NPY_MAGIC:
                got = f"a single array in {path.name}"
                raise ProblemError(field, got, "an .npz file", "Write it with numpy.savez.")
            _require_modest_npz(field, stream)
            stream.seek(0)
            archive = np.load(stream, allow_pickle=False)
            with archive:
                yield archive
    except ProblemError:
        raise
    except DAMAGED as error:
        message = reason(error).partition(". ")[0]  # the rest is advice to trust the file
        raise ProblemError(field, f"{path.name}, unreadable ({message})", "an .npz file of plain arrays") from None


def _require_modest_npz(field: str, stream: BinaryIO) -> None:
    """Raise ProblemError if an archive is a bomb, or an array declares more bytes than its entry has."""
    with zipfile.ZipFile(stream) as archive:
        entries = archive.infolist()
        require_modest(field, len(entries), sum(entry.file_size for entry in entries), stream.seek(0, SEEK_END))
        for entry in entries:
            with archive.open(entry) as array:
                if array.read(len(NPY_MAGIC)) != NPY_MAGIC:
                    raise ProblemError(field, f"{entry.filename}, which is no array", "an .npz file of plain arrays")
                array.seek(0)
                first = np.lib.format.read_magic(array) == (1, 0)
                read_header = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
                shape, _, dtype = read_header(array)  # which leaves the stream after the header
                declared = math.prod(shape) * dtype.itemsize
                if declared > entry.file_size - array.tell() or min(shape, default=0) < 0:
                    raise ProblemError(field, f"{entry.filename} of shape {brief(shape)}", "as many numbers as it says")


def npz_bytes(arrays: Mapping[str, ArrayLike]) -> bytes:
    """Return the content of an .npz of these arrays, without compression."""
    stream = BytesIO()
    np.savez(stream, allow_pickle=False, **{name: np.asarray(array) for name, array in arrays.items()})
    return stream.getvalue()


def merge_tables(table: Mapping[str, FileValue], overrides: Mapping[str, FileValue]) -> FileTable:
    """Return nested tables with the overrides in place of their entries."""
    merged = dict(table)
    for key, value in overrides.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = merge_tables(merged[key], value) if both else value
    return merged


def require_keys(location: str, table: object, required: Iterable[str] = (), optional: Iterable[str] = ()) -> None:
    """Raise ProblemError unless ``table``, at this location of the file ("" at the top), is a table with these keys."""
    if not isinstance(table, Mapping):
        raise ProblemError(location, brief(table), "a table")
    required = tuple(required)
    known = (*required, *optional)
    for key in table:
        if key not in known:
            expected = f"one of {', '.join(known)}"
            raise ProblemError(join_location(location, key), "an unknown key", expected, suggestion(key, known))
    for key in required:
        if key not in table:
            raise ProblemError(join_location(location, key), "nothing", "this key")


def readable(given: object, schema: int) -> bool:
    """Whether a version of a layout is this, or an earlier version: keys added since are optional."""
    return type(given) is int and 1 <= given <= schema


def require_schema(given: object, schema: int) -> None:
    """Raise ProblemError unless a file has this version of its layout, or an earlier version."""
    if not readable(given, schema):
        raise ProblemError("schema", brief(given), versions(schema), OTHER_VERSION)


def versions(schema: int) -> str:
    """Return the versions of a layout that are read, in words."""
    return "1" if schema == 1 else f"a whole number from 1 to {schema}"


def join_location(location: str, key: str) -> str:
    """Return the location of a key of a table."""
    return f"{location}.{key}" if location else key


def naming_file(path: Path) -> AbstractContextManager[None]:
    """Put the file's name in front of the field of every ProblemError."""
    return rename_field(lambda field: f"{path.name}: {field}")


def at_location(location: str, *own: str) -> AbstractContextManager[None]:
    """Replace the names ``own`` ("Box.lower") at the beginning of a ProblemError's field ("state_set.lower")."""

    def rename(field: str) -> str:
        rests = [field.removeprefix(name) for name in (location, *own)]
        replaced = (location + rest for rest in rests if rest != field and rest[:1] in ("", ".", "["))
        return next(replaced, f"{location}.{field}") if location else field

    return rename_field(rename)
