"""Large arrays are stored in an .npz beside the problem file, which has ``{npz = "data.npz", key = "A"}`` instead."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PureWindowsPath

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.arrays import brief
from lin_freq_ocp.errors import ProblemError, suggestion
from lin_freq_ocp.interchange.files import opened_npz
from lin_freq_ocp.interchange.locations import FileValue, require_keys

INLINE_LIMIT = 400  # most numbers of one field that are written into the text itself


def resolved(value: FileValue, folder: Path, field: str = "") -> FileValue:
    """Return the tables with every reference replaced by its array; only files inside ``folder`` are read."""
    if isinstance(value, Mapping):
        if "npz" in value:
            return _referenced(field, value, folder)
        return {key: resolved(entry, folder, f"{field}.{key}".lstrip(".")) for key, entry in value.items()}
    if isinstance(value, list) and any(isinstance(entry, Mapping) for entry in value):
        return [resolved(entry, folder, f"{field}[{i}]") for i, entry in enumerate(value)]
    return value


def stored(value: FileValue, npz_name: str, arrays: dict[str, ArrayLike], field: str = "") -> FileValue:
    """Return the tables with arrays as lists; large arrays go to ``arrays``, and are replaced by references."""
    if isinstance(value, Mapping):
        return {key: stored(entry, npz_name, arrays, f"{field}.{key}".lstrip(".")) for key, entry in value.items()}
    if isinstance(value, list):
        return [stored(entry, npz_name, arrays, f"{field}[{i}]") for i, entry in enumerate(value)]
    if not isinstance(value, np.ndarray):
        return value
    if value.size <= INLINE_LIMIT:
        return value.tolist()
    arrays[field] = value
    return {"npz": npz_name, "key": field}


def _referenced(field: str, reference: Mapping[str, FileValue], folder: Path) -> FileValue:
    require_keys(field, reference, required=("npz", "key"))
    path, key = _inside(f"{field}.npz", reference["npz"], folder), reference["key"]
    with opened_npz(f"{field}.npz", path) as arrays:
        if key not in arrays.files:
            expected = f"the name of an array in {path.name}: {', '.join(arrays.files)}"
            raise ProblemError(f"{field}.key", brief(key), expected, suggestion(key, arrays.files))
        array = arrays[key]
    if array.dtype.kind not in "iuf":
        raise ProblemError(field, f"{array.dtype} in {path.name}", "an array of real numbers")
    return array


def _inside(field: str, name: FileValue, folder: Path) -> Path:
    """Return the path of a named file, links followed, if it lies in the folder or below."""
    expected = "the name of a file in the folder of the problem file, or below"
    if not isinstance(name, str):
        raise ProblemError(field, brief(name), expected)
    as_written = PureWindowsPath(name)  # knows both separators and drives: a file means the same everywhere
    if as_written.anchor or ".." in as_written.parts:
        raise ProblemError(field, brief(name), expected)
    try:
        target = (folder / name).resolve()
    except (OSError, RuntimeError, ValueError) as error:  # a loop of links, or a character no file name can have
        raise ProblemError(field, f"{brief(name)} ({error})", expected) from None
    if not target.is_relative_to(folder.resolve()):
        raise ProblemError(field, f"{brief(name)}, a link to another folder", expected)
    return target
