"""The matrices in a .mat file of version 5 or 7 ("MAT-File Format", The MathWorks).

``scipy.io.loadmat`` reads more kinds of variables, but a damaged file can end the process there (scipy 1.17: any data
type that does not exist). Here every tag is checked.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Generator
from typing import Any

import numpy as np
from numpy.typing import NDArray

HEADER, COMPRESSED, MATRIX = 128, 15, 14
"""Bytes before the first element; types of elements that hold others."""

NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of elements that hold numbers, as numpy calls them."""

CLASSES = {1: "a cell array", 2: "a struct", 3: "an object", 4: "text", 5: "a sparse matrix"}
"""What a variable can be that is no full matrix (those have 6 to 15)."""

COMPLEX = 0x800
"""The flag of a variable with an imaginary part."""


class MatError(ValueError):
    """A file that is not of this format; the message says how it is not."""


def matrices(data: bytes) -> dict[str, NDArray[Any] | str]:
    """Return the variables of a file by name: real full matrices as arrays, of others what they are.

    Raises
    ------
    MatError
        If it is not a file of this format, or a damaged one.
    """
    orders = {b"IM": "<", b"MI": ">"}
    order = orders.get(data[HEADER - 2 : HEADER])
    if order is None:
        raise MatError("no file of version 5 or 7")
    version = struct.unpack_from(order + "H", data, HEADER - 4)[0]
    if version != 0x0100:
        raise MatError(f"version {version >> 8 if version != 0x0200 else '7.3'}")
    found: dict[str, NDArray[Any] | str] = {}
    try:
        for kind, content in _elements(data[HEADER:], order):
            inside = _elements(zlib.decompress(content), order) if kind == COMPRESSED else [(kind, content)]
            for own_kind, own_content in inside:
                if own_kind == MATRIX:
                    name, value = _variable(own_content, order)
                    found[name] = value
    except (zlib.error, ValueError, OverflowError) as error:
        raise MatError(f"damaged: {error}") from None
    return found


def _elements(data: bytes, order: str) -> Generator[tuple[int, bytes]]:
    """Yield type and content of each element; all but compressed ones are padded to multiples of eight bytes."""
    at = 0
    while at < len(data):
        if at + 8 > len(data):
            raise MatError("it ends within a tag")
        kind, size = struct.unpack_from(order + "II", data, at)
        begin = at + 8
        at = begin + size + (0 if kind == COMPRESSED else -size % 8)
        if kind >> 16:  # a small element: its size stands in the type, its content in place of the size
            kind, size, begin, at = kind & 0xFFFF, kind >> 16, begin - 4, begin
        if begin + size > len(data):
            raise MatError("it ends within a variable")
        yield kind, data[begin : begin + size]


def _variable(data: bytes, order: str) -> tuple[str, NDArray[Any] | str]:
    parts = list(_elements(data, order))
    if len(parts) < 3:
        raise MatError("a variable without name")
    flags = int(_numbers(*parts[0], order)[0]) if parts[0][1] else 0
    shape = [int(size) for size in _numbers(*parts[1], order)]
    name, what = parts[2][1].decode("ascii"), CLASSES.get(flags & 0xFF)
    if what is not None or flags & COMPLEX:
        return name, what or "a complex matrix"
    if not 6 <= flags & 0xFF <= 15:
        return name, "of an unknown class"
    if len(parts) != 4 or min(shape, default=-1) < 0:
        raise MatError(f"{name} has no content")
    return name, _numbers(*parts[3], order).reshape(shape, order="F")


def _numbers(kind: int, content: bytes, order: str) -> NDArray[Any]:
    if kind not in NUMBERS:
        raise MatError(f"numbers of type {kind}")
    return np.frombuffer(content, dtype=order + NUMBERS[kind])
