"""A run in one file: the problem, the options, the result or error and the environment, to be repeated elsewhere."""

from __future__ import annotations

import io
import json
import platform
import re
import traceback
import zipfile
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

from threadpoolctl import threadpool_info

from lin_freq_ocp.base.archives import LARGE, require_file, require_modest
from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.atomic import write_bytes
from lin_freq_ocp.base.errors import ProblemError, warn_user
from lin_freq_ocp.files import reading
from lin_freq_ocp.files.problem_file import ARRAYS_SUFFIX, problem_files, read_problem
from lin_freq_ocp.files.reading import FileTable
from lin_freq_ocp.files.solution_files import SavedSolution, load_solution, solution_bytes
from lin_freq_ocp.files.summary import result_summary
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.outcome import Outcome

PACKAGE = "lin-freq-ocp"
SCHEMA = 1  # version of the layout; a file with another version is refused
# Files in the zip archive: the second if some arrays are large, the third if there is a trajectory.
PROBLEM, ARRAYS, SOLUTION, RUN = "problem.toml", "problem" + ARRAYS_SUFFIX, "solution.npz", "run.json"
NUMBER = int | float | None
OPTIONS = {
    **{"method": str, "backend": str, "time_limit": NUMBER, "tolerance": NUMBER, "node_limit": int | None},
    **{"start": (list, dict), "global_bound": bool},
}


@dataclass(frozen=True, eq=False)
class RunRecord:
    """A run, as it was dumped.

    Attributes
    ----------
    problem : OptimalControlProblem
        The same, to the last bit.
    options : dict
        What solve was given: method, backend, time_limit and tolerance; node_limit, start and global_bound if given.
    summary : dict or None
        What ``lin-freq-ocp solve --json`` prints of the result; None if there was none.
    solution : SavedSolution or None
        Trajectory and multipliers, if it had any.
    error : dict or None
        If solve ended with an error that has no result: its "type", "message" and "places" in the code.
    environment : dict
        Versions of Python and of packages, system, processor and BLAS.
    """

    problem: OptimalControlProblem
    options: FileTable
    summary: FileTable | None
    solution: SavedSolution | None
    error: FileTable | None
    environment: FileTable


def dump_run(
    path: str | PathLike[str],
    problem: OptimalControlProblem,
    options: FileTable,
    result: Outcome | None = None,
    error: Exception | None = None,
) -> None:
    """Write a run, and its result or error, to one zip archive that ``load_run`` reads; a file there is replaced."""
    summary = None if result is None else result_summary(result)
    run = {
        "schema": SCHEMA,
        "options": options,
        "environment": environment(options.get("backend")),
        "summary": summary,
        "error": None if error is None else describe_error(error),
    }
    contents = problem_files(problem, PROBLEM)
    if result is not None and result.trajectory is not None and summary is not None:
        contents[SOLUTION] = solution_bytes(result.trajectory, result.multipliers, summary)
    contents[RUN] = (json.dumps(run, indent=2, default=float) + "\n").encode()
    large = sum(map(len, contents.values())) > LARGE  # many zeros would compress so well that a reader suspects a bomb
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED if large else zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(contents):
            archive.writestr(name, contents[name])
    write_bytes(path, buffer.getvalue())


@contextmanager
def dumping_errors(
    path: str | PathLike[str] | None, problem: OptimalControlProblem, options: FileTable
) -> Generator[None]:
    """Dump the run to the path, if any, when an error ends it; the error goes on, even if that fails."""
    try:
        yield
    except Exception as error:
        if path is not None:
            try:
                dump_run(path, problem, options, error=error)
            except Exception as failed:  # the original error must not be replaced
                warn_user(f"nothing dumped: {failed}")
        raise


def read_run(path: str | PathLike[str]) -> RunRecord:
    """Read a dumped run; nothing in it is executed; ProblemError names the file, that within, and the location."""
    path = Path(path)
    with TemporaryDirectory() as name:
        folder = Path(name)
        _unpack(path, folder)
        with reading.naming_file(path):
            run = _read_record(folder / RUN)
            problem = read_problem(folder / PROBLEM)
            solution = load_solution(folder / SOLUTION) if (folder / SOLUTION).exists() else None
            if solution is not None:
                with reading.naming_file(folder / SOLUTION):
                    problem.require(solution.trajectory)
    return RunRecord(problem, run["options"], run["summary"], solution, run["error"], run["environment"])


def describe_error(error: Exception) -> FileTable:
    """Return an error for JSON; places are modules and lines, and no folder is named."""
    frames = traceback.walk_tb(error.__traceback__)
    places = [f"{frame.f_globals.get('__name__', '?')}:{line} {frame.f_code.co_name}" for frame, line in frames]
    message = error.strerror if isinstance(error, OSError) else str(error)
    return {"type": type(error).__name__, "message": message or "", "places": places}


def environment(backend: str | None = None) -> FileTable:
    """Return the versions of Python, of this package and of its dependencies, system, processor and BLAS, for JSON.

    ``backend`` is as given to solve; the package of a solver that qpsolvers calls is found by its name.
    """
    required = [need for need in requires(PACKAGE) or () if "extra ==" not in need]
    needed = [re.split(r"[^\w.-]", need, maxsplit=1)[0] for need in required]
    solver = (backend or "").partition(":")[2]
    names = [PACKAGE, *needed, *([solver, f"{solver}py"] if solver else [])]
    packages: FileTable = {}
    for name in names:
        with suppress(PackageNotFoundError):
            packages[name] = version(name)
    blas = {
        " ".join(str(pool.get(k)) for k in ("internal_api", "version", "architecture")) for pool in threadpool_info()
    }
    return {
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": platform.system(),
        "processor": platform.machine(),
        "packages": packages,
        "blas": sorted(blas),
    }


DUMPED = "a file that lin-freq-ocp solve --dump wrote"


def _unpack(path: Path, folder: Path) -> None:
    """Write the files that belong to a run to the folder; others are ignored."""
    require_file(str(path), path)
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            require_modest(str(path), len(entries), sum(entry.file_size for entry in entries), path.stat().st_size)
            present = {entry.filename: entry for entry in entries}
            for name in (PROBLEM, ARRAYS, SOLUTION, RUN):
                if name in present and present[name].compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise ProblemError(f"{path.name}: {name}", "another compression", "deflate, or none")
                if name in present:
                    (folder / name).write_bytes(archive.read(name))
                elif name in (PROBLEM, RUN):
                    raise ProblemError(str(path), f"an archive without {name}", DUMPED)
    except ProblemError:
        raise
    except reading.DAMAGED as error:
        raise ProblemError(str(path), f"unreadable ({error})", DUMPED) from None


def _read_record(path: Path) -> FileTable:
    with reading.naming_file(path):
        run = reading.parsed_json("JSON syntax", path.read_bytes(), infinite=True)
        reading.require_keys("run", run, ("schema", "options", "environment", "summary", "error"))
        reading.require_schema(run["schema"], SCHEMA)
        reading.require_keys("options", run["options"], optional=OPTIONS)
        for key, kinds in OPTIONS.items():
            if key in run["options"] and not isinstance(run["options"][key], kinds):
                raise ProblemError(f"options.{key}", brief(run["options"][key]), "an option of solve")
        for key in ("environment", "summary", "error"):
            if not isinstance(run[key], dict) and (run[key] is not None or key == "environment"):
                raise ProblemError(key, brief(run[key]), "a table")
        return run
