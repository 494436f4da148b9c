"""The problem file: a problem in TOML, with large arrays in an .npz beside it.

The TOML file has ``{npz = "data.npz", key = "A"}`` in place of a large array.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from os import PathLike
from pathlib import Path, PureWindowsPath

import numpy as np
import tomli_w
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.atomic import write_bytes, writing
from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.files.files import npz_bytes, opened_npz, read_text, require_file
from lin_freq_ocp.files.locations import FileTable, FileValue, naming, require_keys
from lin_freq_ocp.files.problem_file.tables import PROBLEM, problem_from_tables
from lin_freq_ocp.problem.dynamics.frequency_response import read_response
from lin_freq_ocp.problem.ocp import OptimalControlProblem

ARRAYS_SUFFIX = ".problem.npz"  # of the arrays of cart.toml: cart.npz may be a solution
MOST_BYTES = 2**22  # of a problem file: they take some 4 s to parse; larger arrays belong into an .npz
INLINE_LIMIT = 400  # most numbers of one field that are written into the text itself
_ROW = re.compile(r"\[\n((?:\s+[-+.\w]+,\n)+)\s*\]")


def read_problem(path: str | PathLike[str], overrides: Mapping[str, FileValue] | None = None) -> OptimalControlProblem:
    """Read a problem from a TOML file.

    Nothing is executed, and nothing outside the file's folder is read.

    Parameters
    ----------
    path : path
        The file.
    overrides : mapping, optional
        Values that take precedence over the file's, as nested tables: ``{"horizon": 100, "cost": {"R": 2.0}}``.

    Returns
    -------
    OptimalControlProblem

    Raises
    ------
    ProblemError
        If it is no such file or describes no problem; the field is the file and the location in it,
        ``"cart.toml: dynamics.A"``.

    Examples
    --------
    >>> lfo.write_problem(lfo.library.double_integrator(), "problem.toml")
    >>> lfo.read_problem("problem.toml", {"horizon": 60}).horizon
    60
    """
    path = Path(path)
    tables = read_tables(path)
    with naming(path):
        try:
            return problem_from_tables(_resolved(_merged(tables, overrides or {}), path.parent))
        except ProblemError:
            raise
        except RecursionError:
            raise ProblemError("tables", "nested too deeply", "tables as the documentation has them") from None
        except (ValueError, OverflowError, MemoryError) as error:  # sizes no array can have, integers no float can
            raise ProblemError("values", f"what no array can hold ({error})", "smaller numbers and sizes") from None


def read_tables(path: Path) -> FileTable:
    """Return the tables of a TOML file; ProblemError if it is no such file."""
    require_file(str(path), path)
    if (size := path.stat().st_size) > MOST_BYTES:
        advice = 'Put large arrays into an .npz beside it, as {npz = "data.npz", key = "A"}; write_problem does so.'
        raise ProblemError(str(path), f"{size} bytes", f"a TOML file of at most {MOST_BYTES} bytes", advice)
    text = read_text(path)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # not only TOMLDecodeError: also numbers of thousands of digits
        raise ProblemError(f"{path.name}: TOML syntax", f"{error}", "a TOML file") from None


def write_problem(problem: OptimalControlProblem, path: str | PathLike[str]) -> None:
    """Write a problem to a TOML file, from which ``read_problem`` makes the same problem, to the last bit.

    Arrays of more than ``INLINE_LIMIT`` numbers go to an .npz beside it (``cart.problem.npz`` for ``cart.toml``).
    Files of these names are replaced.

    Parameters
    ----------
    problem : OptimalControlProblem
        A continuous model is written as sampled, zero terms of the cost are left out, one set per time becomes one
        array of bounds.
    path : path
        The file.

    Returns
    -------
    None

    Raises
    ------
    ProblemError
        If it cannot be written there, or problem files do not know the class of a set, cost or constraint.

    Examples
    --------
    >>> lfo.write_problem(lfo.library.double_integrator(), "problem.toml")
    >>> lfo.read_problem("problem.toml").name
    'double_integrator'
    """
    path = Path(path)
    for name, content in problem_files(problem, path.name).items():
        write_bytes(path.parent / name, content)


def template() -> str:
    """Return the text of a complete problem file, a cart with a speed limit and a low pass; comments explain it."""
    return files("lin_freq_ocp.files").joinpath("template.toml").read_text(encoding="utf-8")


def init_problem_file(path: str | PathLike[str]) -> None:
    """Write the template to a new file; ProblemError if there is a file already, or none can be written there."""
    path = Path(path)
    with writing(path):
        try:
            stream = path.open("x", encoding="utf-8", newline="\n")
        except FileExistsError:
            raise ProblemError(str(path), "a file that exists already", "a new name", "It is left as it is.") from None
        try:
            with stream:
                stream.write(template())
        except OSError:
            path.unlink()  # half a file would be in the way of the next attempt
            raise


def problem_files(problem: OptimalControlProblem, name: str) -> dict[str, bytes]:
    """Return the contents of the files of ``write_problem``, by their names, the arrays first."""
    arrays: dict[str, ArrayLike] = {}
    beside = Path(name).stem + ARRAYS_SUFFIX
    text = _ROW.sub(_on_one_line, tomli_w.dumps(_stored(PROBLEM.write("", problem), beside, arrays)))
    return ({beside: npz_bytes(arrays)} if arrays else {}) | {name: text.encode()}


def _resolved(value: FileValue, folder: Path, field: str = "") -> FileValue:
    """Return the tables with every reference replaced by its array; only files inside ``folder`` are read."""
    if isinstance(value, Mapping):
        if "npz" in value:
            return _referenced(field, value, folder)
        if set(value) == {"csv"}:
            return read_response(_inside(f"{field}.csv", value["csv"], folder))
        return {key: _resolved(entry, folder, f"{field}.{key}".lstrip(".")) for key, entry in value.items()}
    if isinstance(value, list) and any(isinstance(entry, Mapping) for entry in value):
        return [_resolved(entry, folder, f"{field}[{i}]") for i, entry in enumerate(value)]
    return value


def _stored(value: FileValue, npz_name: str, arrays: dict[str, ArrayLike], field: str = "") -> FileValue:
    """Return the tables with arrays as lists; large arrays go to ``arrays``, and are replaced by references."""
    if isinstance(value, Mapping):
        return {key: _stored(entry, npz_name, arrays, f"{field}.{key}".lstrip(".")) for key, entry in value.items()}
    if isinstance(value, list):
        return [_stored(entry, npz_name, arrays, f"{field}[{i}]") for i, entry in enumerate(value)]
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


def _merged(table: Mapping[str, FileValue], overrides: Mapping[str, FileValue]) -> FileTable:
    """Return the table with the overrides; None removes a key."""
    merged = dict(table)
    for key, value in overrides.items():
        if isinstance(value, Mapping):
            old = merged.get(key)
            merged[key] = _merged(old if isinstance(old, Mapping) else {}, value)
        else:
            merged[key] = value
    return {key: value for key, value in merged.items() if value is not None}


def _on_one_line(row: re.Match[str]) -> str:
    """Put a row of numbers on one line; strings have no line breaks, but escapes."""
    return "[" + " ".join(row[1].split()).removesuffix(",") + "]"
