"""The problem of a command: a library problem or a file, with its settings."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from lin_freq_ocp import library
from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.batch.grid import require_parameters
from lin_freq_ocp.files.reading import FileTable, FileValue, merge_tables, naming_file
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.transform.limits import CUTOFFS, NUMBER_WORDS, changed_fields


def build(problem: str, settings: Sequence[str]) -> OptimalControlProblem:
    """Return the library problem of that name, or the problem in that file, with the settings applied."""
    source = read_source(problem, settings)
    if isinstance(source, ProblemFile):
        return source.problem
    try:
        return source()
    except ProblemError:
        raise
    except (TypeError, ValueError, ArithmeticError, LookupError, AttributeError) as error:  # parameters of a wrong type
        values = brief(source.keywords)
        raise ProblemError("--set", values, f"parameters that {problem} can use", f"({error})") from None


def read_source(problem: str, settings: Sequence[str]) -> ProblemFile | partial[OptimalControlProblem]:
    """Return a problem as a function of its parameters, with the settings applied."""
    values = parse_settings(settings)
    if is_file(problem):
        return ProblemFile.read(problem, values)
    function = library.by_name(problem)
    require_parameters(function, values, "--set ")
    return partial(function, **values)


@dataclass(frozen=True)
class ProblemFile:
    """A problem file as a function of its keys; keys within tables are written with dots, ``control_set.upper``.

    ``cutoff`` (rad/sample) and ``cutoff_hz`` put a low pass of all controls in place of the file's
    ``control_spectrum``. Keys such as ``rows.0`` set a number of its limits, as in ``lfo.sweep``.
    """

    path: Path = field(compare=False)  # read again for every point; not compared when a sweep is resumed
    settings: FileTable  # these take precedence over the file
    problem: OptimalControlProblem  # read first, so that an invalid file does not become a sweep of errors

    @classmethod
    def read(cls, path: str, settings: FileTable) -> ProblemFile:
        """Read the file with these settings."""
        with naming_file(Path(path)):
            require_keys_of_file(settings)
        return cls(Path(path), settings, read_with_settings(path, settings))

    @property
    def name(self) -> str:
        """Return the name of the problem, or of the file."""
        return self.problem.name or self.path.stem

    def __call__(self, **parameters: FileValue) -> OptimalControlProblem:
        """Return the problem with these values, which take precedence over the settings."""
        replaced = SPECTRA if any(key in SPECTRA for key in parameters) else ()
        tables = {key: value for key, value in self.settings.items() if key not in replaced}
        for key, value in parameters.items():
            tables = merge_tables(tables, _nested_tables(key, value))
        return read_with_settings(self.path, tables)


SEVERAL = re.compile(r"[^\s,:\[{\"']+((\s*,\s*[^\s,:]+)+|:[^\s,:]+:\d+)")  # 1,2,3 or 1:2:11, which are no TOML
SPECTRA = ("control_spectrum", *CUTOFFS)  # each of these sets the frequency constraints of the controls


def require_keys_of_file(keys: Iterable[str], option: str = "") -> None:
    """Raise ProblemError unless all are keys of problem files or cut-offs, and at most one sets the spectrum."""
    from lin_freq_ocp.files.problem_tables import PROBLEM  # library problems need no records of files

    file_keys = (*PROBLEM.required, *PROBLEM.optional, *CUTOFFS)
    for key in keys:
        first = key.partition(".")[0]
        if first not in (*file_keys, *NUMBER_WORDS):
            known = f"one of {', '.join(file_keys)}"
            advice = suggestion(first, file_keys) or "Those of tables are written with dots, such as control_set.upper."
            raise ProblemError(f"{option}{key}", "an unknown key", known, advice)
    spectra = [key for key in SPECTRA if key in keys]
    if len(spectra) > 1:
        raise ProblemError(f"{option}{spectra[1]}", f"{spectra[0]}, too", "one of them", "Both set the same field.")


def read_with_settings(path: str | Path, settings: FileTable) -> OptimalControlProblem:
    """Return the problem of a file: settings replace its keys, a cut-off its spectrum, and then numbers its limits."""
    from lin_freq_ocp.files.problem_file import leaves, read_problem  # slow to import
    from lin_freq_ocp.uncertainty.protocol import RobustProblem, robust

    tables = {key: value for key, value in settings.items() if key not in (*CUTOFFS, *NUMBER_WORDS)}
    for key in CUTOFFS:
        if key in settings:
            low_pass = {"kind": "low_pass", key: settings[key]}
            tables["control_spectrum"] = None if settings[key] is None else [low_pass]
    problem = read_problem(path, tables)
    values = leaves({word: settings[word] for word in NUMBER_WORDS if word in settings})
    if values and isinstance(problem, RobustProblem):
        given = replace(problem.given, **changed_fields(problem.given, values))
        return robust(given, problem.uncertainty, problem.end)
    return replace(problem, **changed_fields(problem, values)) if values else problem


def is_file(problem: str) -> bool:
    """Whether this argument names a file instead of a library problem."""
    path = Path(problem)  # no library problem has a suffix or a folder in its name
    return problem not in library.PROBLEMS and bool(path.suffix or path.parent.name or path.is_file())


def parse_settings(settings: Sequence[str]) -> FileTable:
    """Return KEY=VALUE settings as nested tables; dotted keys name entries of tables."""
    result: FileTable = {}
    for setting in settings:
        try:
            table = _without_none(tomllib.loads(setting))
            result = merge_tables(result, table)
        except (ValueError, RecursionError) as error:  # also numbers of thousands of digits, and deep nesting
            advice = f"Text needs quotes within quotes: --set 'name=\"text\"'. ({error})"
            key, _, given = map(str.strip, setting.partition("="))
            if SEVERAL.fullmatch(given):
                advice = f"For several values: sweep --grid '{key}={given if ':' in given else f'[{given}]'}'."
            raise ProblemError("--set", brief(setting), "KEY=VALUE with a TOML value", advice) from None
        if not table:
            raise ProblemError("--set", brief(setting), "KEY=VALUE with a TOML value")
    return result


def _without_none(table: FileTable) -> FileTable:
    """Return the table with None for the text "none": TOML has no null."""
    return {
        key: None if value == "none" else _without_none(value) if isinstance(value, dict) else value
        for key, value in table.items()
    }


def require_writable(option: str, file: Path, problem: str) -> None:
    """Raise ProblemError unless the file can be written: a mistyped name is reported before the solve."""
    if file.is_dir():
        raise ProblemError(f"{option} {file}", "a folder", "a file to write")
    if not file.absolute().parent.is_dir():
        raise ProblemError(f"{option} {file}", "a file in a folder that does not exist", "a file in an existing folder")
    if file.exists() and Path(problem).exists() and file.samefile(problem):
        raise ProblemError(f"{option} {file}", "the problem's own file", "another file")


def require_folder(folder: Path) -> None:
    """Raise ProblemError unless the folder exists or can be created."""
    for path in (folder, *folder.absolute().parents):
        if path.exists():
            if not path.is_dir():
                raise ProblemError(f"--out {folder}", f"{path}, a file", "a folder")
            return


def _nested_tables(key: str, value: FileValue) -> FileTable:
    first, _, rest = key.partition(".")
    return {first: _nested_tables(rest, value) if rest else value}
