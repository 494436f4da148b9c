"""What a value is, in one short text: equal for equal problems, and different for all others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from hashlib import sha256
from typing import Any

import numpy as np

LENGTH = 16
"""Hexadecimal digits: 64 bits, so that collisions are not expected."""


def fingerprint(value: Any) -> str:
    """Return a text that tells values apart, the same in every process.

    Arrays count by their numbers, dataclasses by their fields (but those without ``compare``), mappings and sequences
    by their entries, a ``functools.partial`` by its function and arguments, and functions by module and name: not by
    their code.
    """
    return sha256(_described(value).encode()).hexdigest()[:LENGTH]


def _described(value: Any) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, complex, str, bytes)):
        return repr(value)
    if isinstance(value, np.ndarray):
        content = np.ascontiguousarray(value)
        return f"array({content.dtype.str}, {content.shape}, {sha256(content.tobytes()).hexdigest()})"
    if isinstance(value, Mapping):
        entries = sorted(f"{_described(key)}: {_described(entry)}" for key, entry in value.items())
        return f"{{{', '.join(entries)}}}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_described, value))}]"
    if isinstance(value, partial):
        return f"partial({_described(value.func)}, {_described(value.args)}, {_described(value.keywords)})"
    if is_dataclass(value) and not isinstance(value, type):
        entries = (f"{one.name}={_described(getattr(value, one.name))}" for one in fields(value) if one.compare)
        return f"{_named(type(value))}({', '.join(entries)})"
    if hasattr(value, "__qualname__"):
        return _named(value)
    return f"{_named(type(value))}({_described(getattr(value, '__dict__', {}))})"


def _named(value: Any) -> str:
    return f"{getattr(value, '__module__', '')}.{value.__qualname__}"
