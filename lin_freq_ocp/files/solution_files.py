"""Trajectories in files: .npz archives with multipliers and summary, CSV tables, and .mat files.

The suffix of a name decides the format. CSV tables are written with all digits, and read from any table with the
columns of a problem; .mat files hold x, u and t, one row per time, as MATLAB's lsim and ode45 return them. If a file
has controls only, the states follow from the problem's dynamics.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lin_freq_ocp.base.archives import mat_variables, read_bytes
from lin_freq_ocp.base.arrays import Array, brief, real_array
from lin_freq_ocp.base.atomic import write_bytes, write_text
from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.files import reading
from lin_freq_ocp.files.reading import FileArray, FileTable, FileValue
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory, horizon_advice
from lin_freq_ocp.transform.simulation import simulate

CLOCK_TOLERANCE = 0.1  # error of a clock in periods since its first time: times are rounded, a wrong rate adds up

STEP, SECONDS = "t", "time [s]"  # columns that count the steps and the seconds; either may be missing
NOT_FINITE = ("-inf", "inf", "nan")
FORMULAS = ("=", "+", "-", "@", "'")  # first characters of cells that a spreadsheet evaluates, or takes for a quote

SCHEMA = 2  # version of the layout of the .npz; earlier ones are read
# Fields of Multipliers that are one array, with the dimensions of each.
DIMENSIONS_OF_MULTIPLIERS = {"eta_C": 0, "eta": 2, "mu": 2, "nu": 2, "rho_u": 2, "rho_x": 2}
WEIGHTS = "weights"  # field of Multipliers of piecewise-affine dynamics, an array of two dimensions
FREQUENCIES = "frequencies/"  # the same, of where the multipliers of a mask at every frequency stand
FAMILY = "stage/"  # prefix of the name of a family of joint rows: its multipliers are an array of their own
TABLE, MATLAB, ARCHIVE = ".csv", ".mat", ".npz"


def load_trajectory(path: str | PathLike[str], problem: OptimalControlProblem) -> tuple[Trajectory, Multipliers | None]:
    """Read a .csv, a .mat, or, with any other suffix, an .npz; only an .npz can have multipliers."""
    read = {TABLE: read_csv, MATLAB: read_mat}.get(Path(path).suffix.lower())
    if read is not None:
        return read(path, problem), None
    saved = load_solution(path)
    return saved.trajectory, saved.multipliers


def save_trajectory(
    path: str | PathLike[str],
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    multipliers: Multipliers | None,
    summary: Mapping[str, object],
) -> None:
    """Write the trajectory to a .csv or a .mat, or all to an .npz, also without a suffix."""
    save = {TABLE: save_csv, MATLAB: save_mat}.get(kind_of_file(path))
    if save is not None:
        save(path, problem, trajectory)
    else:
        save_solution(path, trajectory, multipliers, summary)


def kind_of_file(path: str | PathLike[str], field: str = "") -> str:
    """Return the suffix that says how a trajectory is written to this file; a name without a suffix is an .npz."""
    suffix = Path(path).suffix.lower() or ARCHIVE
    if suffix not in (ARCHIVE, TABLE, MATLAB):
        expected = f"one that ends in {ARCHIVE}, {TABLE} or {MATLAB}"
        advice = "Only an .npz holds the multipliers, too."
        raise ProblemError(field or str(path), f"a name that ends in {suffix}", expected, advice)
    return suffix


@dataclass(frozen=True, eq=False)
class SavedSolution:
    """What a solution file holds.

    Attributes
    ----------
    trajectory : Trajectory
        States and controls.
    multipliers : Multipliers or None
        None if the file has none.
    summary : dict
        Status, cost, method and so on, as they were saved; empty if the file has none.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator()).save("run.npz")
    >>> lfo.load("run.npz").summary["status"]
    'optimal'
    """

    trajectory: Trajectory
    multipliers: Multipliers | None
    summary: FileTable


def save_solution(
    path: str | PathLike[str], trajectory: Trajectory, multipliers: Multipliers | None, summary: Mapping[str, object]
) -> None:
    """Write a solution to an .npz: the fields of Trajectory and Multipliers under their names, summary and schema."""
    write_bytes(path, solution_bytes(trajectory, multipliers, summary))


def solution_bytes(trajectory: Trajectory, multipliers: Multipliers | None, summary: Mapping[str, object]) -> bytes:
    """Return the content of the file of ``save_solution``."""
    fields: dict[str, ArrayLike] = {"x": trajectory.x, "u": trajectory.u}
    if multipliers is not None:
        fields |= {name: getattr(multipliers, name) for name in DIMENSIONS_OF_MULTIPLIERS}
        fields |= {FAMILY + name: weights for name, weights in multipliers.stage.items()}
        fields |= {FREQUENCIES + name: points for name, points in multipliers.frequencies.items()}
        fields |= {} if multipliers.weights is None else {WEIGHTS: multipliers.weights}
    return reading.npz_bytes(fields | {"schema": SCHEMA, "summary": json.dumps(dict(summary))})


def load_solution(path: str | PathLike[str]) -> SavedSolution:
    """Read a solution from an .npz that has at least x (T+1, n) and u (T, m).

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    SavedSolution

    Raises
    ------
    ProblemError
        If it is no such file, lacks x or u or some of the multipliers, or shapes do not match.

    Examples
    --------
    >>> lfo.solve(lfo.library.double_integrator()).save("run.npz")
    >>> lfo.load("run.npz").trajectory.x.shape[1]
    2
    """
    path = Path(path)
    with reading.opened_npz(str(path), path) as archive:
        arrays: dict[str, FileArray] = {name: archive[name] for name in archive.files}
    with reading.naming_file(path):
        reading.require_schema(arrays["schema"].tolist() if "schema" in arrays else SCHEMA, SCHEMA)
        trajectory, multipliers = Trajectory(*(_number_array(arrays, name, 2) for name in ("x", "u"))), None
        if any(name in arrays for name in DIMENSIONS_OF_MULTIPLIERS):
            fields = {name: _number_array(arrays, name, count) for name, count in DIMENSIONS_OF_MULTIPLIERS.items()}
            eta_C = float(fields.pop("eta_C"))
            weights = _number_array(arrays, WEIGHTS, 2) if WEIGHTS in arrays else None
            stage, frequencies = (  # by the names of families and masks, each an array of its own
                {
                    key.removeprefix(prefix): _number_array(arrays, key, *dims)
                    for key in arrays
                    if key.startswith(prefix)
                }
                for prefix, dims in ((FAMILY, (2,)), (FREQUENCIES, (1, 2)))
            )
            multipliers = Multipliers(eta_C, **fields, stage=stage, weights=weights, frequencies=frequencies)
            eta, nu = trajectory.x[1:].shape, trajectory.u.shape
            if (multipliers.eta.shape, multipliers.nu.shape) != (eta, nu):
                got = f"eta {multipliers.eta.shape}, nu {multipliers.nu.shape}"
                raise ProblemError("multipliers", got, f"eta {eta}, nu {nu}, as the trajectory has it")
        summary = reading.parsed_json("summary", str(arrays["summary"])) if "summary" in arrays else {}
        if not isinstance(summary, dict):
            raise ProblemError("summary", brief(summary), "a JSON object")
        return SavedSolution(trajectory, multipliers, summary)


def _number_array(arrays: Mapping[str, FileArray], name: str, *dimensions: int) -> FileArray:
    if name not in arrays:
        raise ProblemError(name, f"nothing (there is {', '.join(arrays) or 'no array'})", "an array of this name")
    array = arrays[name]
    if array.dtype.kind not in "biufc" or array.ndim not in dimensions:
        expected = f"numbers in {' or '.join(map(str, dimensions))} dimensions"
        raise ProblemError(name, f"{array.dtype} of shape {array.shape}", expected)
    return array


def read_csv(path: str | PathLike[str], problem: OptimalControlProblem) -> Trajectory:
    """Read a trajectory from a table: a header, then one row for each time 0 .. T.

    Columns are found by the problem's names of states and controls, with or without their units, in any order. Other
    columns are left out. The controls at time T have no effect, and are not read. A table that has, apart
    from the clock, controls only is simulated from the problem's initial state; it may end at time T-1.

    Parameters
    ----------
    path : path
        Text in UTF-8, separated by commas; or by semicolons or tabs, and numbers may then have decimal commas.
    problem : OptimalControlProblem
        Its names, horizon and sampling time; "t" is checked to count steps, "time [s]" to count seconds.

    Returns
    -------
    Trajectory

    Raises
    ------
    ProblemError
        If the table does not fit: the field names file, line and column.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator())
    >>> result.to_csv("run.csv")
    >>> bool((lfo.read_csv("run.csv", result.problem).x == result.trajectory.x).all())
    True
    """
    path = Path(path)
    text = reading.read_text(path)
    with reading.naming_file(path):
        table = parse_table(text)
        states = [table.find(name, problem.state_names) for name in problem.state_names]
        controls = [table.find(name, problem.control_names) for name in problem.control_names]
        known = {*states, *controls, table.find(STEP), table.find(SECONDS)}
        require_columns(table, problem.control_names, controls)
        replay = all(column is None for column in states)
        if not replay:
            require_columns(table, problem.state_names, states)
        elif others := [brief(name) for i, name in enumerate(table.head) if i not in known]:
            expected = f"columns for the states, {', '.join(map(repr, problem.state_names))}, or none but controls"
            raise ProblemError("columns", ", ".join(others), expected, suggestion(table.head[0], problem.state_names))
        T = problem.horizon
        if len(table.rows) != T + 1 and not (replay and len(table.rows) == T):
            expected = f"{T + 1}{f', or {T}' if replay else ''}: one per time, below the header"
            raise ProblemError("rows", f"{len(table.rows)}", expected, horizon_advice(len(table.rows) - (not replay)))
        for name, period in ((STEP, 1.0), (SECONDS, problem.sampling_time)):
            clock = table.find(name)
            if clock is not None and period is not None:
                times = np.array([row[0] for row in table.numbers([clock], len(table.rows))])
                require_clock(f"column {name!r}", times, period, [f"line {line}" for line in table.lines])
        x = None if replay else table.numbers(states, T + 1)
        return trajectory_from_signals(problem, x, table.numbers(controls, T))


def parse_table(text: str) -> Table:
    """Read a CSV text: separated by commas; or by semicolons or tabs, and numbers may then have decimal commas."""
    first = text.lstrip().partition("\n")[0]
    separator = next((mark for mark in ";\t" if mark in first and "," not in first), ",")
    decimal = "." if separator == "," else ","
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, skipinitialspace=True, delimiter=separator)
    lines: list[int] = []
    rows: list[list[str]] = []
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                rows.append([cell.strip().replace(decimal, ".") for cell in cells])
                lines.append(reader.line_num)
    except csv.Error as error:
        raise ProblemError(f"line {reader.line_num}", f"{error}", "comma-separated values") from None
    if not rows:
        raise ProblemError("header", "an empty file", "the names of the columns")
    for line, cells in zip(lines, rows, strict=True):
        if len(cells) != len(rows[0]):
            raise ProblemError(f"line {line}", f"{len(cells)} cells", f"{len(rows[0])}, as many as the header has")
    return Table(rows[0], lines[1:], rows[1:])


@dataclass(frozen=True)
class Table:
    """A header, and rows of cells with their lines in the file."""

    head: list[str]
    lines: list[int]
    rows: list[list[str]]

    def find(self, name: str, among: Sequence[str] = ()) -> int | None:
        """Return the column of a name; or, where the problem has no other such name, of the name without its unit."""
        short = name.split(" [")[0]
        alone = sum(known.split(" [")[0] == short for known in among) == 1
        for wanted in map(str.strip, (header(name), name, header(short), short) if alone else (header(name), name)):
            if wanted in self.head:
                if self.head.count(wanted) > 1:
                    raise ProblemError(f"column {wanted!r}", f"{self.head.count(wanted)} of them", "one")
                return self.head.index(wanted)
        return None

    def numbers(self, columns: Sequence[int | None], count: int) -> list[list[float]]:
        """Return the first ``count`` rows of these columns."""
        present = [column for column in columns if column is not None]

        def number_at(row: int, column: int) -> float:
            cell = self.rows[row][column]
            try:
                number = float(cell)
            except ValueError:
                number = math.nan
            if not math.isfinite(number):
                location = f"line {self.lines[row]}, column {self.head[column]!r}"
                raise ProblemError(location, brief(cell) if cell else "an empty cell", "a finite number")
            return number

        return [[number_at(row, column) for column in present] for row in range(count)]


def require_columns(table: Table, names: Sequence[str], columns: Sequence[int | None]) -> None:
    """Raise ProblemError for a column that was not found."""
    for name, column in zip(names, columns, strict=True):
        if column is None:
            got = f"none (there is {', '.join(map(brief, table.head))})"
            raise ProblemError(f"column {name!r}", got, "a column of this name", suggestion(name, table.head))


def save_csv(path: str | PathLike[str], problem: OptimalControlProblem, trajectory: Trajectory) -> None:
    """Write a trajectory with all digits, one row per time.

    Columns: t, the time in seconds if the problem has a sampling time, states, controls (empty at t = T).
    """
    problem.require(trajectory)
    step, controls = problem.sampling_time, [*trajectory.u.tolist(), [""] * problem.control_dim]
    clock = [] if step is None else [SECONDS]
    rows = enumerate(zip(trajectory.x.tolist(), controls, strict=True))
    table = ([t, *(t * step for _ in clock if step), *x, *u] for t, (x, u) in rows)
    write_table(path, [STEP, *clock, *problem.state_names, *problem.control_names], table)


def write_table(path: str | PathLike[str], names: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Write a CSV table with all digits, in which no spreadsheet takes a cell for a formula; "-inf" is a number."""
    text = io.StringIO()
    table = csv.writer(text)
    table.writerow(map(header, names))
    for row in rows:
        table.writerow([header(one) if isinstance(one, str) and one not in NOT_FINITE else one for one in row])
    write_text(path, text.getvalue())


def header(name: str) -> str:
    """Return a name as the head of a column: after an apostrophe, if a spreadsheet would take it for a formula.

    A name that begins with an apostrophe gets another, so that no two names get the same head.
    """
    return f"'{name}" if name.lstrip()[:1] in FORMULAS else name


def read_mat(path: str | PathLike[str], problem: OptimalControlProblem) -> Trajectory:
    """Read a trajectory from a .mat file: x (T+1, n) and u (T, m), one row per time, as lsim and ode45 have them.

    Without x, the controls are simulated from the problem's initial state. u may have T+1 rows, as for lsim; its last
    row acts on nothing. t, a vector in seconds, is compared with the sampling time if there are both. Other variables
    are left out.

    Parameters
    ----------
    path : path
        Of version 5 or 7; MATLAB's ``save`` writes 7.3 only if asked to.
    problem : OptimalControlProblem
        Its horizon, dimensions and sampling time.

    Returns
    -------
    Trajectory

    Raises
    ------
    ProblemError
        If it is no such file, or a variable does not fit: the field names file and variable.

    Examples
    --------
    >>> result = lfo.solve(lfo.library.double_integrator())
    >>> result.to_mat("run.mat")
    >>> bool((lfo.read_mat("run.mat", result.problem).x == result.trajectory.x).all())
    True
    """
    path = Path(path)
    variables = mat_variables(str(path), read_bytes(path), "save(name, 'x', 'u', 't', '-v7')")
    with reading.naming_file(path):
        if "u" not in variables:
            got = f"nothing (there is {', '.join(variables) or 'no variable'})"
            raise ProblemError("u", got, "a variable of this name", "Rename it in MATLAB, and save x, u and t.")
        signals = {name: variables[name] for name in ("x", "u", "t") if name in variables}
        for name, value in signals.items():
            if not isinstance(value, np.ndarray) or value.dtype.kind not in "iuf":
                kinds = {"c": "a complex matrix", "U": "text"}
                got = kinds.get(np.asarray(value).dtype.kind, "a sparse matrix or a structure")
                raise ProblemError(name, got, "a matrix of real numbers, full")
        trajectory = trajectory_from_signals(problem, signals.get("x"), signals["u"])
        if "t" in signals:
            t, rows = signals["t"], len(signals.get("x", signals["u"]))
            if t.shape not in ((rows, 1), (1, rows)):
                raise ProblemError("t", f"shape {t.shape}", f"shape ({rows}, 1), one time for each row")
            if problem.sampling_time is not None:
                require_clock("t", real_array("t", t.ravel()), problem.sampling_time)
        return trajectory


def save_mat(path: str | PathLike[str], problem: OptimalControlProblem, trajectory: Trajectory) -> None:
    """Write a trajectory to a .mat file (version 5), which MATLAB loads: one row per time.

    Variables: x (T+1, n), u (T, m), t (T+1, 1) in seconds (in steps, if the problem has no sampling time), and the
    cell arrays state_names (n, 1) and control_names (m, 1).
    """
    problem.require(trajectory)
    variables = {
        "x": trajectory.x,
        "u": trajectory.u,
        "t": problem.times[:, None],
        "state_names": _cells(problem.state_names),
        "control_names": _cells(problem.control_names),
    }
    from scipy.io import savemat  # slow to import

    stream: FileValue = BytesIO()  # stubs of scipy know names of files only
    savemat(stream, variables)
    write_bytes(path, stream.getvalue())


def _cells(names: tuple[str, ...]) -> NDArray[np.object_]:
    cells = np.empty((len(names), 1), dtype=object)
    cells[:, 0] = names
    return cells


def trajectory_from_signals(problem: OptimalControlProblem, x: ArrayLike | None, u: ArrayLike) -> Trajectory:
    """Return states x (T+1, n) and controls u (T, m), or (T+1, m), as a trajectory; without x, u is simulated."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    states = None if x is None else _fit_shape("x", x, [(T + 1, n)])
    controls = real_array("u", _fit_shape("u", u, [(T, m), (T + 1, m)])[:T])  # u_T has no effect
    return simulate(problem, controls) if states is None else Trajectory(real_array("x", states), controls)


def _fit_shape(field: str, given: ArrayLike, shapes: list[tuple[int, int]]) -> FileArray:
    signal = np.asarray(given)
    if signal.shape in shapes:
        return signal
    turned = signal.ndim == 2 and signal.shape[::-1] in shapes
    advice = horizon_advice(len(signal) - (field == "x")) if signal.shape[1:] == shapes[0][1:] else ""
    advice = f"Transpose it: in MATLAB {field} = {field}.', in numpy {field}.T." if turned else advice
    expected = f"shape {' or '.join(map(str, shapes))}, one row per time"
    raise ProblemError(field, f"shape {signal.shape}", expected, advice)


def require_clock(field: str, times: Array, period: float, locations: Sequence[str] | None = None) -> None:
    """Raise ProblemError unless the times increase by one period each; ``locations`` replace indices in errors."""
    off = np.abs(times - times[:1] - period * np.arange(len(times))) > CLOCK_TOLERANCE * period
    if off.any():
        k = int(np.argmax(off))
        location = f"{field}[{k}]" if locations is None else f"{locations[k]}, {field}"
        expected = f"{times[0] + k * period:.12g}, {k} periods of {period:.12g} after {times[0]:.12g}"
        advice = "Sample the signals with the problem's sampling time."
        raise ProblemError(location, f"{times[k]:.12g}", expected, advice)
