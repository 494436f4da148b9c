"""Lines of a proof: JSON objects whose real numbers are hexadecimal strings, exact to the last bit."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np

from lin_freq_ocp.base.arrays import Array

CHUNK = 1 << 16  # numbers turned into text at once: the text of a long signal is never whole in memory

Value = None | str | bool | int | float | Array | list[int] | list[str] | list[list[int]]


class Text(str):
    """A value that is JSON already."""


def line(**fields: Value) -> str:
    """Return a line of the file: names and integers as they are, real numbers in hexadecimal."""
    return "{" + ", ".join(f'"{name}": {encode(value)}' for name, value in fields.items()) + "}\n"


def encode(value: Value) -> str:
    """Return a value as JSON; arrays and floats are real numbers."""
    if isinstance(value, Text):
        return value
    if isinstance(value, np.ndarray):
        if value.ndim > 1:
            return "[" + ", ".join(map(encode, value)) + "]"
        return vector(value) if value.ndim else encode(float(value))
    return f'"{value.hex()}"' if isinstance(value, float) else json.dumps(value)


def vector(values: Array) -> str:
    """Return real numbers (k,) as a list; infinities are "inf" and "-inf"."""
    return '["' + '", "'.join(map(float.hex, values.tolist())) + '"]' if len(values) else "[]"


def rows(values: Array) -> Iterator[Text]:
    """Yield each row of real numbers (k, size) as a list."""
    size = values.shape[1]
    step = max(CHUNK // max(size, 1), 1)
    for begin in range(0, len(values), step):
        part = values[begin : begin + step]
        numbers = list(map(float.hex, part.ravel().tolist()))
        for k in range(len(part)):
            yield Text('["' + '", "'.join(numbers[k * size : (k + 1) * size]) + '"]' if size else "[]")


def exact(mantissa: int, exponent: int) -> str:
    """Return mantissa * 2^exponent as the text of a real number."""
    return f"{'-' if mantissa < 0 else ''}0x{abs(mantissa):x}p{exponent:+d}"
