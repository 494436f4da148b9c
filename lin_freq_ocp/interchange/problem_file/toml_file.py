"""The problem file: a problem in TOML, with large arrays in an .npz beside it."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from os import PathLike
from pathlib import Path

import tomli_w
from numpy.typing import ArrayLike

from lin_freq_ocp.atomic import write_bytes, writing
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.interchange.files import npz_bytes, read_text
from lin_freq_ocp.interchange.locations import FileTable, FileValue, naming
from lin_freq_ocp.interchange.problem_file.array_references import resolved, stored
from lin_freq_ocp.interchange.problem_file.tables import PROBLEM, problem_from_tables
from lin_freq_ocp.problem.ocp import OptimalControlProblem

# cart.toml keeps its large arrays in cart.problem.npz: cart.npz may be a solution that is saved beside it
ARRAYS_SUFFIX = ".problem.npz"

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
            return problem_from_tables(resolved(_merged(tables, overrides or {}), path.parent))
        except ProblemError:
            raise
        except RecursionError:
            raise ProblemError("tables", "nested too deeply", "tables as the documentation has them") from None
        except (ValueError, OverflowError, MemoryError) as error:  # sizes no array can have, integers no float can
            raise ProblemError("values", f"what no array can hold ({error})", "smaller numbers and sizes") from None


def read_tables(path: Path) -> FileTable:
    """Return the tables of any TOML file; ProblemError if it is not one."""
    text = read_text(path)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # not only TOMLDecodeError: also numbers of thousands of digits
        raise ProblemError(f"{path.name}: TOML syntax", f"{error}", "a TOML file") from None


def write_problem(problem: OptimalControlProblem, path: str | PathLike[str]) -> None:
    """Write a problem to a TOML file, from which ``read_problem`` makes the same one, to the last bit.

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
        If it cannot be written there.

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
    return files("lin_freq_ocp.interchange").joinpath("template.toml").read_text(encoding="utf-8")


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
    """Return the contents of what ``write_problem`` writes, by their names; the arrays come first."""
    arrays: dict[str, ArrayLike] = {}
    beside = Path(name).stem + ARRAYS_SUFFIX
    text = _ROW.sub(_on_one_line, tomli_w.dumps(stored(PROBLEM.write("", problem), beside, arrays)))
    return ({beside: npz_bytes(arrays)} if arrays else {}) | {name: text.encode()}


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
    """Put a row of numbers on one line; a line break inside a string is written as an escape, so none is hit."""
    return "[" + " ".join(row[1].split()).removesuffix(",") + "]"
