"""Plants in files of others: frequency responses in tables, as analysers write them, and matrices of MATLAB."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lin_freq_ocp.base.archives import FileValue, decode_text, mat_variables, read_bytes
from lin_freq_ocp.base.arrays import Array, brief, real_array
from lin_freq_ocp.base.errors import ProblemError

# What a column may hold, by the words of its name; a word may have its unit attached: magnitude_db
FREQUENCY, REAL, IMAGINARY, MAGNITUDE, PHASE, COHERENCE = "frequency", "re", "im", "magnitude", "phase", "coherence"
WORDS = {
    FREQUENCY: "f freq frequency frequencies omega w angular hz khz rad/s rad/sec",
    REAL: "re real",
    IMAGINARY: "im imag imaginary",
    MAGNITUDE: "mag magnitude abs absolute gain amplitude amp modulus db |g| |h|",
    PHASE: "phase angle arg argument deg degree degrees ° rad radian radians",
    COHERENCE: "coh coherence gamma2 γ²",
}
KINDS = {word: kind for kind, words in WORDS.items() for word in words.split()}
TO_HERTZ = {"hz": 1.0, "khz": 1e3, "rad/s": 0.5 / np.pi, "rad/sec": 0.5 / np.pi}
TO_RADIANS = {"deg": np.pi / 180, "degree": np.pi / 180, "degrees": np.pi / 180, "°": np.pi / 180}
TO_RADIANS |= {"rad": 1.0, "radian": 1.0, "radians": 1.0}
WITHOUT_HEADER = (FREQUENCY, "hz"), (REAL, ""), (IMAGINARY, "")
FORMS = "'frequency [Hz],re,im' or 'frequency [Hz],magnitude [dB],phase [deg]'"
POLAR = 7.0, 720.0  # largest values of a column that may be in dB or degrees
QUESTION = "A column that reaches 7 to 720 may be in dB or degrees: say in the first line what the columns are."


def read_response(path: Path) -> Array:
    """Return the table of a file, (k, 3): frequency in Hz, real and imaginary part; (k, 4) with a coherence.

    Columns are separated by commas, semicolons, tabs or blanks; where it is not commas, numbers may have decimal
    commas. The header, which may be a comment, names the columns and their units: frequency in Hz, kHz or rad/s, real
    and imaginary part, or magnitude, in dB or not, and phase in degrees or radians, and a coherence. Without a header,
    the columns are frequency in Hz, real and imaginary part, unless they look like dB or degrees.
    """
    content = read_bytes(path)
    try:
        text = decode_text(content)
    except UnicodeDecodeError:
        text = content.decode("latin-1")  # of spreadsheets on Windows, which write the sign of degrees so
    lines = [line for line in text.splitlines() if line.strip()]
    comments = [line.lstrip("#%! \t") for line in lines if line.lstrip().startswith(("#", "%", "!"))]
    lines = [line for line in lines if not line.lstrip().startswith(("#", "%", "!"))]
    if not lines:
        raise ProblemError(path.name, "no rows", "rows of frequency in Hz, real part, imaginary part")
    separator = next((mark for mark in (";", "\t", ",") if mark in lines[-1]), " ")
    rows, first = [_entries(line, separator) for line in lines], 0
    header: list[str] | None = None
    if _numbers(rows[0], separator) is None:
        header, first = rows[0], 1
    else:  # the last comment with as many names
        named = (_entries(line, separator) for line in reversed(comments))
        header = next((names for names in named if len(names) == len(rows[0]) and any(_kinds(names))), None)
    columns = WITHOUT_HEADER if header is None else _columns(path.name, header)
    kinds, table = ", ".join(kind for kind, _ in columns), list[list[float]]()
    for i, row in enumerate(rows[first:], first):
        numbers = _numbers(row, separator)
        if numbers is None or len(numbers) != len(columns) or not np.isfinite(numbers).all():
            commas = separator == "," and len(row) == 2 * len(columns)
            advice = "With decimal commas, columns are separated by semicolons or tabs." if commas else ""
            expected = f"{len(columns)} finite numbers: {kinds}"
            raise ProblemError(f"{path.name}: row {i}", brief(separator.join(row)), expected, advice)
        table.append(numbers)
    if not table:
        raise ProblemError(path.name, "no rows", f"rows of {kinds}")
    values = np.array(table)
    if header is None and any(POLAR[0] <= largest <= POLAR[1] for largest in np.abs(values[:, 1:]).max(axis=0)):
        raise ProblemError(f"{path.name}: header", "none", FORMS, QUESTION)
    return _cartesian(path.name, columns, values, first)


def _entries(line: str, separator: str) -> list[str]:
    """Return the entries of a line, without blanks around them."""
    if separator == " ":
        return re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", line)  # a name keeps its unit: frequency [Hz]
    return [entry.strip() for entry in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]


def _numbers(entries: Sequence[str], separator: str) -> list[float] | None:
    """Return entries as numbers, None if one is none."""
    try:
        return [float(entry if separator == "," else entry.replace(",", ".")) for entry in entries]
    except ValueError:
        return None


def _kinds(names: Sequence[str]) -> list[tuple[str, str] | None]:
    """Return what each column holds, and its unit, empty if it has none; None for a name that is not known."""
    found = list[tuple[str, str] | None]()
    for name in names:
        words = re.findall(r"\|\w\||rad/s(?:ec)?|[^\W_]+²?|°", name.lower())
        kinds = [KINDS[word] for word in words if word in KINDS]
        unit = next((w for w in reversed(words) if w in TO_HERTZ or w in TO_RADIANS or w == "db"), "")
        # a unit says what a name leaves open: "rad/s" is a frequency, "dB" a magnitude, "deg" a phase
        found.append((kinds[0], unit) if kinds else None)
    return found


def _columns(file: str, names: Sequence[str]) -> list[tuple[str, str]]:
    """Return what each named column holds, and its unit; ProblemError where that is not said, or makes no response."""
    columns = list[tuple[str, str]]()
    for name, column in zip(names, _kinds(names), strict=True):
        if column is None:
            raise ProblemError(f"{file}: header", brief(name), f"names of columns such as {FORMS}")
        kind, unit = column
        if kind == FREQUENCY and unit not in TO_HERTZ:
            angular = any(word in name.lower() for word in ("omega", "angular", "w"))
            if angular or unit:
                raise ProblemError(f"{file}: header", brief(name), "a frequency with its unit, [Hz] or [rad/s]")
            unit = "hz"
        if kind == PHASE and unit not in TO_RADIANS:
            raise ProblemError(f"{file}: header", brief(name), "a phase with its unit: 'phase [deg]' or 'phase [rad]'")
        columns.append((kind, unit))
    kinds = sorted(kind for kind, _ in columns if kind != COHERENCE)
    if kinds not in (sorted((FREQUENCY, REAL, IMAGINARY)), sorted((FREQUENCY, MAGNITUDE, PHASE))):
        missing = "The imaginary part is missing." if kinds == sorted((FREQUENCY, REAL)) else ""
        raise ProblemError(f"{file}: header", brief(", ".join(names)), f"the columns of one response: {FORMS}", missing)
    return columns


def _cartesian(file: str, columns: Sequence[tuple[str, str]], values: Array, first: int) -> Array:
    """Return frequency in Hz, real and imaginary part, and coherence, from columns with units; ``first``: their row."""
    by_kind = {kind: (values[:, i], unit) for i, (kind, unit) in enumerate(columns)}
    frequency, unit = by_kind[FREQUENCY]
    hertz, known = frequency * TO_HERTZ[unit], [by_kind[COHERENCE][0]] if COHERENCE in by_kind else []
    if REAL in by_kind:
        return np.column_stack([hertz, by_kind[REAL][0], by_kind[IMAGINARY][0], *known])
    (magnitude, of_magnitude), (phase, of_phase) = by_kind[MAGNITUDE], by_kind[PHASE]
    if of_magnitude == "db":
        magnitude = 10 ** (magnitude / 20)
    for i in np.flatnonzero(magnitude < 0)[:1]:
        advice = "Is it in dB? The header 'magnitude [dB]' says so."
        raise ProblemError(f"{file}: row {first + i}", f"the magnitude {magnitude[i]:g}", "zero or above", advice)
    angle = phase * TO_RADIANS[of_phase]
    return np.column_stack([hertz, magnitude * np.cos(angle), magnitude * np.sin(angle), *known])


NUMBERS = {"a": "A", "b": "B", "e": "E", "ts": "Ts"}  # fields of a plant, by their names in lower case
NUMBERS |= {"inputdelay": "InputDelay", "iodelay": "ioDelay", "internaldelay": "InternalDelay"}
DELAYS = {"inputdelay", "iodelay", "internaldelay"}
SAVE = "s = struct('A', sys.A, 'B', sys.B, 'Ts', sys.Ts); save plant.mat s -v7"


def plant_in_mat(path: Path) -> tuple[Array, Array, float, tuple[str, ...], tuple[str, ...]]:
    """Return A, B, the sampling time (0: continuous), and names of states and controls, if given, of a .mat file."""
    variables = mat_variables(str(path), read_bytes(path), SAVE)
    tables = {"": variables} | {f"{name}.": _structure(value) for name, value in variables.items()}
    # fields in lower case: A of today's objects is a in older ones
    fields = {name: {key.lower(): value for key, value in table.items()} for name, table in tables.items()}
    found = {name: known for name, known in fields.items() if "b" in known}
    if len(found) != 1:
        several = f"the plants {', '.join(name.rstrip('.') or 'A, B' for name in found)}"
        got = several if found else f"the variables {', '.join(variables) or 'none'}"
        expected = "the matrices A and B, and Ts, or one structure with these fields"
        raise ProblemError(path.name, got, expected, f"In MATLAB: {SAVE}.")
    ((name, known),) = found.items()
    numbers = dict[str, Array]()
    for key, field in NUMBERS.items():
        if key in known:
            numbers[key] = np.atleast_2d(real_array(f"{path.name}: {name}{field}", known[key]))
        elif key in ("a", "ts"):
            expected = "seconds per step, or 0 for a continuous plant" if key == "ts" else "the state matrix"
            raise ProblemError(f"{path.name}: {name}{field}", "nothing", expected, f"Save sys.{field}, too.")
    A, step = numbers["a"], numbers["ts"]
    E = numbers.get("e", np.zeros((0, 0)))
    if step.size != 1 or step.item() < 0:
        advice = "MATLAB's -1 is a step of unknown length: set sys.Ts."
        raise ProblemError(f"{path.name}: {name}Ts", brief(step.ravel().tolist()), "seconds per step, or 0", advice)
    if E.size and not (E.shape == A.shape and (np.eye(len(A)) == E).all()):
        raise ProblemError(f"{path.name}: {name}E", "a descriptor matrix", "none", "In MATLAB: ss(sys, 'explicit').")
    for key in DELAYS & {key for key, value in numbers.items() if value.any()}:
        advice = "In MATLAB: absorbDelay of the discrete plant makes it states."
        raise ProblemError(f"{path.name}: {name}{NUMBERS[key]}", "a delay", "a plant without delays", advice)
    labels = [_labels(known.get(f"{of}name"), known.get(f"{of}unit")) for of in ("state", "input")]
    return A, numbers["b"], step.item(), labels[0], labels[1]


def _structure(value: FileValue) -> dict[str, FileValue]:
    """Return the fields of a structure as scipy reads it; none of other variables."""
    names = getattr(getattr(value, "dtype", None), "names", None)
    return {} if not names or value.size != 1 else {name: value[name].item() for name in names}


def _labels(names: FileValue, units: FileValue) -> tuple[str, ...]:
    """Return the texts of a cell array with their units; none if one is empty."""
    texts, brackets = _texts(names), _texts(units)
    if not texts or not all(texts):
        return ()
    brackets = brackets if len(brackets) == len(texts) else [""] * len(texts)
    return tuple(f"{text} [{unit}]" if unit else text for text, unit in zip(texts, brackets, strict=True))


def _texts(cells: FileValue) -> list[str]:
    """Return the texts of a cell array as scipy reads it, or of an array of text."""
    cells = np.ravel(np.zeros(0) if cells is None else cells)
    return ["".join(map(str, np.ravel(one))).strip() for one in cells] if cells.dtype.kind in "OU" else []
