"""Files from anyone: only regular files are read, and what an archive unpacks to is limited before it is unpacked."""

from __future__ import annotations

import codecs
import struct
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

from lin_freq_ocp.base.atomic import reason
from lin_freq_ocp.base.errors import ProblemError

FileValue = Any  # a value of a TOML, JSON, .npz or .mat file: of unknown type until it is checked

MOST_ENTRIES = 10_000  # files in an archive
MOST_BYTES = 2**34  # unpacked size of an archive: 16 GiB, more than any answer of this package
# Above 256 MiB, a compression of more than 1 to 100 is refused; zeros reach 1 to 1000.
LARGE, MOST_COMPRESSED = 2**28, 100
COMPRESSED = 15  # type of a compressed element of a .mat file
PIECE = 2**22  # bytes unpacked at once


def require_file(field: str, path: Path) -> None:
    """Raise ProblemError unless there is a regular file; a pipe or a device would never end."""
    try:
        got = "no such file" if not path.exists() else "a directory" if path.is_dir() else "not a regular file"
        if path.is_file():
            return
    except (OSError, ValueError) as error:
        got = reason(error)
    raise ProblemError(field, f"{got} ({path})", "an existing file")


def read_bytes(path: Path) -> bytes:
    """Return the content of a file; the field of a ProblemError is the path."""
    require_file(str(path), path)
    try:
        return path.read_bytes()
    except (OSError, MemoryError) as error:
        raise ProblemError(str(path), reason(error), "a file that can be read") from None


def require_modest(field: str, entries: int, unpacked: int, packed: int) -> None:
    """Raise ProblemError for an archive with too many entries, or too many bytes by its own account when unpacked."""
    if entries > MOST_ENTRIES:
        raise ProblemError(field, f"{entries} entries", f"an archive of at most {MOST_ENTRIES}")
    if unpacked > MOST_BYTES or unpacked > max(LARGE, MOST_COMPRESSED * packed):
        got = f"{packed} bytes that unpack to {unpacked} or more"
        expected = f"at most {MOST_BYTES}, and above {LARGE} at most {MOST_COMPRESSED} times their packed size"
        raise ProblemError(field, got, expected, "If you trust it, save it again without compression.")


def decode_text(content: bytes) -> str:
    """Return the text of a file in UTF-8, or in UTF-16 with its mark, as Windows writes it; else UnicodeDecodeError."""
    marked = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return content.decode("utf-16" if marked else "utf-8-sig")  # some editors put a mark before UTF-8, too


def mat_variables(field: str, content: bytes, command: str) -> dict[str, FileValue]:
    """Return the variables of a .mat file of version 5 or 7, by their names; ``command`` of MATLAB writes one."""
    from scipy.io import loadmat  # slow to import

    expected, advice = "a .mat file of version 5 or 7", f"In MATLAB: {command}."
    if content.startswith(b"MATLAB 7.3"):  # another format, which scipy does not read
        raise ProblemError(field, "a .mat file of version 7.3", expected, advice)
    try:
        _require_modest_mat(field, content)
        stream: FileValue = BytesIO(content)  # stubs of scipy know names of files only
        variables = loadmat(stream, spmatrix=False)
    except ProblemError:
        raise
    except Exception as error:  # loadmat raises errors of many kinds for damaged files
        raise ProblemError(field, f"{error}", expected, advice) from None
    return {name: value for name, value in variables.items() if not name.startswith("__")}


def _require_modest_mat(field: str, content: bytes) -> None:
    """Raise ProblemError if compressed variables of a file of version 5 or 7 unpack to too much.

    Unlike a zip archive it does not declare sizes: its variables are unpacked piece by piece, and not kept.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    offset, entries, unpacked = 128, 0, 0
    while order is not None and offset + 8 <= len(content):
        kind, size = struct.unpack_from(f"{order}II", content, offset)
        offset += 8
        entries, unpacked = entries + 1, unpacked + size
        if kind == COMPRESSED:
            unpacker, rest = zlib.decompressobj(), content[offset : offset + size]
            while rest and not unpacker.eof:
                unpacked += len(unpacker.decompress(rest, PIECE))
                rest = unpacker.unconsumed_tail
                require_modest(field, entries, unpacked, len(content))
        require_modest(field, entries, 0, len(content))
        offset += size
