"""A controller as C: the tables of its problem, the kernel that serves Python, a test and a description.

The problem of a step is that of ``Controller`` with all rows that may give way soft from the beginning, so that one
phase answers every state (docs/embedded.md). The texts of the files stand in ``templates/``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import brief, require_bool
from lin_freq_ocp.base.atomic import reason, write_each
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.loop.step_problem import free_first_state, soften
from lin_freq_ocp.loop.step_tables import REALS, RECORDED, Real, RecordedStep, StepTables
from lin_freq_ocp.loop.windows import has_windows, promises
from lin_freq_ocp.methods.condensed.native import WINDOW_ARRAYS, model_arrays
from lin_freq_ocp.problem.description import problem_facts
from lin_freq_ocp.problem.ocp import OptimalControlProblem

TEMPLATES = ("controller.h", "controller.c", "lfo_settings.h", "test_controller.c", "Makefile", "README.md")

LARGEST_STATE = 1e12  # in its unit: squares of this and their sums stay finite in float
HIDDEN = 100  # a control whose terms round by this many tolerances of a row is that of the feedback alone

NOT_IN_C = re.compile(r"[^A-Za-z0-9 _.-]")  # no other character of a name reaches C, and no more than these
LONGEST_TITLE = 60
MARKUP = re.compile(r"[\\`*\[\]<>&]")  # of Markdown and HTML


@dataclass(frozen=True, eq=False)
class GeneratedController:
    """A controller that has been written as C.

    Attributes
    ----------
    folder : Path
    real : str
        "double" or "float".
    unknowns : int
    flash : int
        Bytes of the tables; the code takes some 6 kB more.
    ram, stack : int
        Bytes of the struct ``controller`` with pointers of 4 bytes; and of the stack, by estimate.
    cap : int
        Most changes of the working set in a step.
    changes, steps : int
        Most changes in so many disturbed steps, in double and without this cap.
    sweep_work, change_work : int
        Multiply-adds of a sweep, and at most of a change.
    promises : tuple of str
        The largest amplitudes of applied controls whose windows are limited.

    Examples
    --------
    >>> import tempfile
    >>> controller = lfo.RecedingHorizon(lfo.library.double_integrator(horizon=20, terminal_state=None))
    >>> written = lfo.generate(controller, tempfile.mkdtemp(), real="float")
    >>> written.real, written.unknowns
    ('float', 5)
    """

    folder: Path
    real: str
    unknowns: int
    flash: int
    ram: int
    stack: int
    cap: int
    changes: int
    steps: int
    sweep_work: int
    change_work: int
    promises: tuple[str, ...] = ()

    def __str__(self) -> str:
        return "".join(f"{line}\n" for line in self.promises) + (
            f"{self.folder}: a controller of {plural(self.unknowns, 'unknown')} in {self.real}\n"
            f"tables {self.flash} bytes, RAM {self.ram} bytes, stack about {self.stack} bytes\n"
            f"at most {self.changes} changes in each of {self.steps} disturbed steps; the cap is {self.cap}\n"
            f"a sweep has {self.sweep_work} multiply-adds, a change at most {self.change_work}"
        )


def step_problem(problem: OptimalControlProblem, penalties: Mapping[str, float]) -> OptimalControlProblem:
    """Return the problem that a generated controller solves at each step."""
    return soften(free_first_state(problem), penalties)


def log_header(states: int, controls: int, references: bool) -> str:
    """Return the first line of a log."""
    letters = [("x", states), ("r", states if references else 0), ("u", controls)]
    return ",".join([f"{letter}{i + 1}" for letter, count in letters for i in range(count)] + ["status"])


MARK = "Written by lin_freq_ocp"  # in the header of every controller


def generate(
    problem: OptimalControlProblem,
    penalties: Mapping[str, float],
    delay: int,
    folder: Path,
    real: object = "double",
    changes: object = None,
    memory: object = None,
    references: object = False,
) -> GeneratedController:
    """Write the controller of a problem into a folder; see ``lfo.generate``."""
    if not isinstance(real, str) or real not in REALS:
        raise ProblemError("real", brief(real), '"double" or "float"')
    if changes is not None and (isinstance(changes, bool) or not isinstance(changes, int) or changes < 0):
        advice = "None is a cap that hardly any step reaches."
        raise ProblemError("changes", brief(changes), "a whole number, zero or above", advice)
    require_bool("references", references)
    match = re.fullmatch(r"(\d+)([kM]?)", str(memory))
    limit = int(match[1]) * {"": 1, "k": 1024, "M": 1024**2}[match[2]] if match else 0
    if memory is not None and not limit:
        raise ProblemError("memory", brief(memory), 'bytes, a whole number above zero, or a text such as "64k"')
    try:
        tables = StepTables.of(step_problem(problem, penalties), delay, bool(references), REALS[real], changes)
        steps = [] if memory is not None and tables.ram + tables.stack > limit else tables.disturbed_steps()
    except UnsupportedError as error:
        refused = str(error).removeprefix("method 'condensed': ")
        raise UnsupportedError(f"generate: {refused}") from None
    if not steps:
        parts = f"{tables.ram} of struct controller, {tables.stack} of stack"
        advice = 'A shorter horizon, a lower cut-off, fewer bounds or real="float" need less.'
        raise ProblemError("memory", f"{limit} bytes", f"at least {tables.ram + tables.stack} bytes: {parts}", advice)
    most = max(step.changes for step in steps)
    counts = tables.solver.kernel.tables.unknowns, tables.flash, tables.ram, tables.stack, tables.cap, most, len(steps)
    promised = tuple(promises(problem)) if has_windows(problem) else ()
    summary = GeneratedController(folder, real, *counts, *tables.work, promised)
    texts = _files(problem, tables, steps[:RECORDED], summary, limit)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        header = folder / "controller.h"
        own = header.is_file() and MARK in header.read_text(encoding="utf-8", errors="replace")
        if any(folder.iterdir()) and not own:
            expected = "a new or empty folder, or one that generate wrote before"
            raise ProblemError(str(folder), "a folder with other files", expected, "They could be replaced.")
    except OSError as error:
        raise ProblemError(str(folder), reason(error), "a folder that can be written") from None
    write_each({folder / name: text.encode() for name, text in texts.items()})
    return summary


def _files(
    problem: OptimalControlProblem,
    tables: StepTables,
    steps: Sequence[RecordedStep],
    summary: GeneratedController,
    memory: int,
) -> dict[str, str]:
    """Return the texts of all files by their names."""
    measured = np.flatnonzero(~tables.known)
    real, units, integers = tables.real, tables.units, tables.integers
    controls = np.array([step.control for step in steps]) * units.u
    largest = np.abs(controls).max(axis=0)
    recorded = {"controls": controls, "sizes": np.where(largest > 0, largest, 1.0)}
    recorded["states"] = (np.array([step.state for step in steps]) * units.x + tables.origin)[:, measured]
    if tables.references:
        references = np.array([step.reference for step in steps])
        recorded["references"] = references * units.x[measured] + tables.origin[measured]
    name = problem.name or "A controller"
    values = {
        "heading": markdown(name),
        "title": NOT_IN_C.sub("_", name)[:LONGEST_TITLE],
        "version": version("lin-freq-ocp"),
        "facts": [(markdown(term), markdown(text)) for term, text in problem_facts(problem)],
        "states": [markdown(problem.state_names[i]) for i in measured],
        "controls": [markdown(control) for control in problem.control_names],
        "known": [markdown(problem.state_names[i]) for i in np.flatnonzero(tables.known)],
        "measured": len(measured),
        "at_measured": [int(i) for i in measured],
        "struct": tables.fields,
        "memory": memory,
        "real": real,
        "integers": integers,
        "numbers": {"tolerance": real.tolerance, "dependent": real.dependence},
        "largest": LARGEST_STATE,
        "largest_term": HIDDEN * real.tolerance / real.epsilon,
        "limits": len(tables.arrays["limit_e"]),
        "delay": tables.delay,
        "references": tables.references,
        "header": log_header(len(measured), integers["m"], tables.references),
        "summary": summary,
        "steps": len(steps),
        "capped": tables.cap < tables.tables.most_changes,
        "tables": [(name, *_lines(array, real)) for name, array in tables.arrays.items()],
        "fields": [*model_arrays(tables.tables), *(WINDOW_ARRAYS if tables.windows else ()), "column"],
        "windows": [] if tables.windows is None else tables.windows.fields(integers["T"]),
        "recorded": [(name, *_lines(array, real)) for name, array in recorded.items()],
    }
    environment = Environment(
        loader=PackageLoader("lin_freq_ocp.loop"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    source = resources.files("lin_freq_ocp.methods.condensed")
    kernel = {f"lfo_{name}": source.joinpath(name).read_text() for name in ("kernel.h", "kernel.c")}
    kernel["lfo_kernel.c"] = kernel["lfo_kernel.c"].replace('"kernel.h"', '"lfo_settings.h"')
    return kernel | {name: environment.get_template(name).render(values) for name in TEMPLATES}


def markdown(text: str) -> str:
    """Return a text on one line for a file in Markdown, which shows each of its characters."""
    return MARKUP.sub(r"\\\g<0>", " ".join(text.split()))


def _lines(array: NDArray[np.floating | np.integer], real: Real) -> tuple[str, list[str]]:
    """Return the type and the lines of a table; an empty one has a zero, as C needs."""
    flat = array.ravel() if array.size else np.zeros(1)
    whole = array.dtype.kind == "i"
    texts = [str(int(value)) if whole else real.literal(float(value)) for value in flat]
    return "short" if whole else "lfo_real", [", ".join(texts[i : i + 6]) + "," for i in range(0, len(texts), 6)]
