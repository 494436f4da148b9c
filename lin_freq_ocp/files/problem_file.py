"""The problem file: a problem in TOML, with large arrays in an .npz next to it, and the facts that show prints of it.

In place of a large array the TOML file has a reference, ``{npz = "data.npz", key = "A"}``; a measured response may be a
CSV file, ``{csv = "response.csv"}``. Before a problem is solved, its facts, its signals and the parameters that
``--set`` can change are available as plain data.
"""

from __future__ import annotations

import inspect
import json
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.resources import files
from os import PathLike
from pathlib import Path, PureWindowsPath

import numpy as np
import tomli_w
from numpy.typing import ArrayLike

from lin_freq_ocp.base.archives import require_file
from lin_freq_ocp.base.arrays import brief, positive_number
from lin_freq_ocp.base.atomic import report_write_errors, write_bytes
from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.base.phrases import split_unit
from lin_freq_ocp.files import reading
from lin_freq_ocp.files.problem_tables import PROBLEM, SCHEMA, problem_from_tables
from lin_freq_ocp.files.reading import FileTable, FileValue
from lin_freq_ocp.files.summary import finite, head
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.description import problem_facts
from lin_freq_ocp.problem.dynamics.frequency_response import FrequencyResponse
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.dynamics.measured import read_response
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.transform.limits import CUTOFFS

ARRAYS_SUFFIX = ".problem.npz"  # of the arrays of cart.toml: cart.npz may be a solution
MOST_BYTES = 2**22  # of a problem file: they take some 4 s to parse; larger arrays belong into an .npz
INLINE_LIMIT = 400  # most numbers of one field that are written into the text itself
_ROW = re.compile(r"\[\n((?:\s+[-+.\w]+,\n)+)\s*\]")

PLANT_HORIZON, MOST_SAMPLES = 100, 1000  # horizons of files that are made for a plant

SECTION = re.compile(r"^(\w[\w ]*)\n-+\n", re.MULTILINE)  # a heading of a numpydoc docstring
ARRAY_REFERENCE = {"npz", "key"}  # keys of a table that stands for an array in another file
# Keys that are not in a file.
MEANINGS = {
    "cutoff": "low pass of all controls [rad/sample], in place of control_spectrum",
    "cutoff_hz": "low pass of all controls [Hz], in place of control_spectrum",
}


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
    with reading.naming_file(path):
        try:
            return problem_from_tables(_resolve(reading.merge_tables(tables, overrides or {}), path.parent))
        except ProblemError:
            raise
        except RecursionError:
            raise ProblemError("tables", "nested too deeply", "tables as the documentation has them") from None
        except (ValueError, OverflowError, MemoryError) as error:  # sizes no array can have, integers no float can
            raise ProblemError("values", f"too much for an array ({error})", "smaller numbers and sizes") from None


def _resolve(value: FileValue, folder: Path, field: str = "") -> FileValue:
    """Return the tables without None, each reference replaced by its array; only files inside ``folder`` are read."""
    if isinstance(value, Mapping):
        value = {key: entry for key, entry in value.items() if entry is not None}
        if "npz" in value:
            reading.require_keys(field, value, required=("npz", "key"))
            path, key = _path_inside(f"{field}.npz", value["npz"], folder), value["key"]
            with reading.opened_npz(f"{field}.npz", path) as arrays:
                if key not in arrays.files:
                    expected = f"the name of an array in {path.name}: {', '.join(arrays.files)}"
                    raise ProblemError(f"{field}.key", brief(key), expected, suggestion(key, arrays.files))
                array = arrays[key]
            if array.dtype.kind not in "iuf":
                raise ProblemError(field, f"{array.dtype} in {path.name}", "an array of real numbers")
            return array
        if set(value) == {"csv"}:
            path = _path_inside(f"{field}.csv", value["csv"], folder)
            require_file(f"{field}.csv", path)
            return read_response(path)
        return {key: _resolve(entry, folder, f"{field}.{key}".lstrip(".")) for key, entry in value.items()}
    if isinstance(value, list) and any(isinstance(entry, Mapping) for entry in value):
        return [_resolve(entry, folder, f"{field}[{i}]") for i, entry in enumerate(value)]
    return value


def _path_inside(field: str, name: FileValue, folder: Path) -> Path:
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


def read_tables(path: Path) -> FileTable:
    """Return the tables of a TOML file; ProblemError if it is no such file."""
    require_file(str(path), path)
    if (size := path.stat().st_size) > MOST_BYTES:
        advice = 'Put large arrays into an .npz next to it, as {npz = "data.npz", key = "A"}; write_problem does so.'
        raise ProblemError(str(path), f"{size} bytes", f"a TOML file of at most {MOST_BYTES} bytes", advice)
    text = reading.read_text(path)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # not only TOMLDecodeError: also numbers of thousands of digits
        raise ProblemError(f"{path.name}: TOML syntax", f"{error}", "a TOML file") from None


def write_problem(problem: OptimalControlProblem, path: str | PathLike[str]) -> None:
    """Write a problem to a TOML file, from which ``read_problem`` makes the same problem, to the last bit.

    Arrays of more than ``INLINE_LIMIT`` numbers go to an .npz next to it (``cart.problem.npz`` for ``cart.toml``).
    Files of these names are replaced, as by other functions that save: ``lin-freq-ocp init``, which writes a file to be
    edited, refuses them.

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


def init_problem_file(
    path: str | PathLike[str],
    plant: str | PathLike[str] | None = None,
    response: str | PathLike[str] | None = None,
    sampling_time: float | None = None,
) -> None:
    """Write a new file: the template, or a problem with the plant of a .mat file or the response of a CSV file.

    ProblemError if there is a file already, none can be written there, or the plant or response cannot be read.
    """
    path = Path(path)
    if plant is not None and response is not None:
        raise ProblemError("plant, response", "both", "one of them")
    if plant is None and response is None and sampling_time is not None:
        raise ProblemError("sampling_time", brief(sampling_time), "none without a plant or a response")
    text = template()
    if plant is not None:
        text = _problem_of_plant(Path(plant), sampling_time)
    elif response is not None:
        text = _problem_of_response(Path(response), path.parent, sampling_time)
    with report_write_errors(path):
        try:
            stream = path.open("x", encoding="utf-8", newline="\n")
        except FileExistsError:
            raise ProblemError(str(path), "a file that exists already", "a new name", "It is left as it is.") from None
        try:
            with stream:
                stream.write(text)
        except OSError:
            path.unlink()  # half a file would be in the way of the next attempt
            raise


INTRODUCTION = """\
# A problem with a plant of yours: replace ends, cost and limits by what is asked of it.
# The template that `lin-freq-ocp init other.toml` writes explains every key.
"""


def _problem_of_plant(plant: Path, sampling_time: float | None) -> str:
    """Return the text of a problem with a plant that a .mat file holds."""
    dynamics = LinearDynamics.from_mat(plant, sampling_time)
    bounds, start = Box(*np.outer([-1.0, 1.0], np.ones(dynamics.control_dim))), np.ones(dynamics.state_dim)
    cost = QuadraticCost(Q=1.0, R=1.0)
    problem = OptimalControlProblem(dynamics, PLANT_HORIZON, cost, bounds, initial_state=start)
    return f"{INTRODUCTION}\n{problem_text(problem)}"


def _problem_of_response(response: Path, folder: Path, sampling_time: float | None) -> str:
    """Return the text of a problem whose dynamics are a measured response; its file is in the folder, or below."""
    hertz = read_response(response)[:, 0]
    if not response.resolve().is_relative_to(folder.resolve()):
        expected = "a file in the folder of the problem file, or below"
        raise ProblemError(str(response), "a file in another folder", expected, "Copy it there.")
    spacing = float(np.median(np.diff(hertz))) if len(hertz) > 1 else 0.0
    if spacing <= 0:
        raise ProblemError(str(response), f"the frequencies {brief(hertz.tolist())}", "at least two that increase")
    step = 0.5 / float(hertz[-1]) if sampling_time is None else positive_number("sampling_time", sampling_time)
    samples = int(np.clip(round(1 / (spacing * step)), 4, MOST_SAMPLES))  # bins as far apart as the frequencies
    outside = "zero" if hertz[0] > 0 or 0.5 / step > hertz[-1] else "refuse"
    FrequencyResponse.from_csv(response, samples, step, outside)
    table = {"csv": response.resolve().relative_to(folder.resolve()).as_posix()}
    dynamics = {"table": table, "samples": samples, "sampling_time": step, "outside": outside}
    cost, bounds = {"Q": 1.0, "R": 1e-3, "x_ref": [1.0]}, {"lower": -1.0, "upper": 1.0}
    problem = {"schema": SCHEMA, "horizon": samples, "dynamics": dynamics, "cost": cost, "control_set": bounds}
    zero = f"# The response is 0 outside the frequencies of the table, {hertz[0]:g} .. {hertz[-1]:g} Hz.\n"
    return f"{INTRODUCTION}{zero if outside == 'zero' else ''}\n{tomli_w.dumps(problem)}"


def problem_text(problem: OptimalControlProblem) -> str:
    """Return the text of a problem file with all arrays in it; ProblemError if it were too long to be read again."""
    text = problem_files(problem, "problem.toml", np.inf)["problem.toml"]
    if len(text) > MOST_BYTES:
        advice = "lfo.write_problem puts large arrays into an .npz."
        raise ProblemError("problem", f"a file of {len(text)} bytes", f"at most {MOST_BYTES}", advice)
    return text.decode()


def problem_files(problem: OptimalControlProblem, name: str, inline_limit: float | None = None) -> dict[str, bytes]:
    """Return the contents of the files of ``write_problem``, by their names, the arrays first."""
    inline_limit = INLINE_LIMIT if inline_limit is None else inline_limit
    arrays: dict[str, ArrayLike] = {}
    npz_name = Path(name).stem + ARRAYS_SUFFIX
    text = tomli_w.dumps(_store(PROBLEM.write("", problem), npz_name, arrays, inline_limit))
    # Rows of numbers on one line; strings have no line breaks, but escapes
    text = _ROW.sub(lambda row: f"[{' '.join(row[1].split()).removesuffix(',')}]", text)
    return ({npz_name: reading.npz_bytes(arrays)} if arrays else {}) | {name: text.encode()}


def _store(
    value: FileValue, npz_name: str, arrays: dict[str, ArrayLike], inline_limit: float, field: str = ""
) -> FileValue:
    """Return the tables with arrays as lists; arrays above the limit go to ``arrays``, and become references."""
    if isinstance(value, Mapping):
        return {
            key: _store(entry, npz_name, arrays, inline_limit, f"{field}.{key}".lstrip("."))
            for key, entry in value.items()
        }
    if isinstance(value, list):
        return [_store(entry, npz_name, arrays, inline_limit, f"{field}[{i}]") for i, entry in enumerate(value)]
    if not isinstance(value, np.ndarray):
        return value
    if value.size <= inline_limit:
        return value.tolist()
    arrays[field] = value
    return {"npz": npz_name, "key": field}


@dataclass(frozen=True)
class Parameter:
    """A parameter that ``--set`` changes: a keyword of a function, or a key of a file, with dots for tables."""

    name: str
    default: FileValue  # without settings; None if there is none
    value: FileValue  # with the settings
    about: str = ""  # its documentation


def description_summary(problem: OptimalControlProblem, about: str, parameters: list[Parameter]) -> FileTable:
    """Return the JSON object of ``lin-freq-ocp show --json``."""
    states, ends = problem.state_boxes, {"initial": problem.initial_box, "terminal": problem.terminal_box}
    return finite(
        {
            **head(problem),
            "about": about or None,
            "facts": [{"what": what, "words": words} for what, words in problem_facts(problem, problem.gap)],
            "states": [
                _signal_facts(name, states, i)
                | {end: [float(box.lower[i]), float(box.upper[i])] for end, box in ends.items()}
                for i, name in enumerate(problem.state_names)
            ],
            "controls": [_signal_facts(name, problem.control_tube, j) for j, name in enumerate(problem.control_names)],
            "parameters": [asdict(parameter) for parameter in parameters],
        }
    )


def _signal_facts(name: str, bounds: Box, i: int) -> FileTable:
    """Return name, unit and bounds of a signal; a bound that depends on time is a list."""
    plain_name, unit = split_unit(name)
    facts: FileTable = {"name": plain_name, "unit": unit or None}
    for side, values in (("lower", bounds.lower[:, i]), ("upper", bounds.upper[:, i])):
        facts[side] = values.tolist() if (values != values[0]).any() else float(values[0])
    return facts


def parameters_of_function(function: Callable[..., object], settings: Mapping[str, FileValue]) -> list[Parameter]:
    """Return the keywords of a function with their defaults and documentation."""
    about = _parameter_texts(inspect.getdoc(function) or "")
    return [
        Parameter(name, given.default, settings.get(name, given.default), about.get(name, ""))
        for name, given in inspect.signature(function).parameters.items()
    ]


def _parameter_texts(docstring: str) -> dict[str, str]:
    """Return the text of each name in the section Parameters of a numpydoc docstring."""
    parts = SECTION.split(docstring)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    about: dict[str, str] = {}
    names: list[str] = []
    for line in sections.get("Parameters", "").splitlines():
        if line[:1].strip():
            names = [name.strip() for name in line.partition(" : ")[0].split(",")]
        else:
            about |= {name: f"{about.get(name, '')} {line.strip()}".strip() for name in names}
    return about


def about_function(function: Callable[..., object]) -> str:
    """Return the text of a docstring before its first section, one line for each paragraph."""
    text = SECTION.split(inspect.getdoc(function) or "", maxsplit=1)[0]
    return "\n".join(" ".join(part.split()) for part in text.strip().split("\n\n"))


def parameters_of_file(path: Path, settings: Mapping[str, FileValue]) -> list[Parameter]:
    """Return the keys of a problem file with their values, and those that it could have without a value."""
    tables, given = read_tables(path), leaves(settings, toml=True)
    defaults = {key: value for key, value in leaves(tables, toml=True).items() if key != "schema"}
    known = (*PROBLEM.optional, *CUTOFFS)
    absent = [key for key in known if key not in tables and not isinstance(settings.get(key), dict)]
    keys = dict.fromkeys([*defaults, *absent, *given])
    return [Parameter(key, defaults.get(key), given.get(key, defaults.get(key)), MEANINGS.get(key, "")) for key in keys]


def leaves(tables: Mapping[str, FileValue], within: str = "", toml: bool = False) -> FileTable:
    """Return every value of nested tables under its key with dots (and quotes of TOML); lists of tables are values."""
    found: FileTable = {}
    for name, value in tables.items():
        key = json.dumps(name, ensure_ascii=False) if toml and not re.fullmatch(r"[A-Za-z0-9_-]+", name) else name
        if isinstance(value, Mapping) and set(value) != ARRAY_REFERENCE and value:
            found |= leaves(value, f"{within}{key}.", toml)
        else:
            found[within + key] = value
    return found
