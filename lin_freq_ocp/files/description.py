"""A problem before it is solved, as plain data: its facts, signals and parameters."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.phrases import split_unit
from lin_freq_ocp.batch.grid import CUTOFFS
from lin_freq_ocp.files.locations import FileTable, FileValue
from lin_freq_ocp.files.problem_tables import PROBLEM
from lin_freq_ocp.files.problem_file import read_tables
from lin_freq_ocp.files.summary import finite, head
from lin_freq_ocp.problem.description import problem_facts
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box

SECTION = re.compile(r"^(\w[\w ]*)\n-+\n", re.MULTILINE)  # a heading of a numpydoc docstring
ARRAY_REFERENCE = {"npz", "key"}  # keys of a table that stands for an array in another file
# Keys that are not in a file.
MEANINGS = {
    "cutoff": "low pass of all controls [rad/sample], in place of control_spectrum",
    "cutoff_hz": "low pass of all controls [Hz], in place of control_spectrum",
}


@dataclass(frozen=True)
class Parameter:
    """What ``--set`` can change: a keyword of a function, or a key of a file, within tables written with dots."""

    name: str
    default: FileValue  # without settings; None if there is none
    value: FileValue  # with the settings
    about: str = ""  # its documentation


def description_summary(problem: OptimalControlProblem, about: str, parameters: list[Parameter]) -> FileTable:
    """Return the JSON object of ``lin-freq-ocp show --json``."""
    states, bounds = problem.state_boxes, (problem.initial_box, problem.terminal_box)
    return finite(
        {
            **head(problem),
            "about": about or None,
            "facts": [{"what": what, "words": words} for what, words in problem_facts(problem, problem.gap)],
            "states": [
                _signal(name, states, i) | {"initial": _pair(bounds[0], i), "terminal": _pair(bounds[1], i)}
                for i, name in enumerate(problem.state_names)
            ],
            "controls": [_signal(name, problem.control_tube, j) for j, name in enumerate(problem.control_names)],
            "parameters": [asdict(parameter) for parameter in parameters],
        }
    )


def parameters_of_function(function: Callable[..., object], settings: Mapping[str, FileValue]) -> list[Parameter]:
    """Return the keywords of a function with their defaults and documentation."""
    about = _documented(inspect.getdoc(function) or "")
    return [
        Parameter(name, given.default, settings.get(name, given.default), about.get(name, ""))
        for name, given in inspect.signature(function).parameters.items()
    ]


def about_function(function: Callable[..., object]) -> str:
    """Return the text of a docstring before its first section, one line for each paragraph."""
    text = SECTION.split(inspect.getdoc(function) or "", maxsplit=1)[0]
    return "\n".join(" ".join(part.split()) for part in text.strip().split("\n\n"))


def parameters_of_file(path: Path, settings: Mapping[str, FileValue]) -> list[Parameter]:
    """Return the keys of a problem file with their values, and those that it could have without a value."""
    tables, given = read_tables(path), _leaves(settings)
    defaults = {key: value for key, value in _leaves(tables).items() if key != "schema"}
    known = (*PROBLEM.optional, *CUTOFFS)
    absent = [key for key in known if key not in tables and not isinstance(settings.get(key), dict)]
    keys = dict.fromkeys([*defaults, *absent, *given])
    return [Parameter(key, defaults.get(key), given.get(key, defaults.get(key)), MEANINGS.get(key, "")) for key in keys]


def _leaves(tables: Mapping[str, FileValue], within: str = "") -> FileTable:
    """Return every value of nested tables under its key with dots; a list of tables is one value."""
    leaves: FileTable = {}
    for key, value in tables.items():
        if isinstance(value, Mapping) and set(value) != ARRAY_REFERENCE and value:
            leaves |= _leaves(value, f"{within}{key}.")
        else:
            leaves[within + key] = value
    return leaves


def _documented(docstring: str) -> dict[str, str]:
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


def _signal(name: str, bounds: Box, i: int) -> FileTable:
    plain_name, unit = split_unit(name)
    return {
        "name": plain_name,
        "unit": unit or None,
        "lower": _over_time(bounds.lower[:, i]),
        "upper": _over_time(bounds.upper[:, i]),
    }


def _over_time(bounds: Array) -> float | list[float]:
    """Return a bound, or one per time if it depends on time."""
    return bounds.tolist() if (bounds != bounds[0]).any() else float(bounds[0])


def _pair(end: Box, i: int) -> list[float]:
    return [float(end.lower[i]), float(end.upper[i])]
