"""A controller as C: the tables of its problem beside the kernel that serves Python, with a test and a description.

The problem of a step is that of ``Controller`` with all rows that may give way soft from the beginning, so that one
phase answers every state (docs/embedded.md). The texts of the files stand in ``templates/``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import Array, brief, require_bool
from lin_freq_ocp.base.atomic import write_each, writing
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.loop.step_problem import free_first_state, soften
from lin_freq_ocp.methods.candidate import require_convex
from lin_freq_ocp.methods.condensed.native import ARRAYS, BOUNDS, INTEGERS, NativeKernel, model_arrays
from lin_freq_ocp.methods.condensed.plans import CondensedSolver
from lin_freq_ocp.methods.condensed.tables import (
    GRADIENT_DEPENDENCE,
    MOST_UNKNOWNS,
    ROW_TOLERANCE,
    SOLVED,
    CondensedTables,
)
from lin_freq_ocp.methods.spectral import REDUCTIONS
from lin_freq_ocp.methods.spectral.model import LtiUnits, lti_problem, natural_units, refusal
from lin_freq_ocp.methods.spectral.reductions import soft_set
from lin_freq_ocp.problem.description import problem_facts
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reductions import reduce_problem
from lin_freq_ocp.problem.reformulations import Translation, translation_of
from lin_freq_ocp.problem.terms.term import TermKind

TEMPLATES = ("controller.h", "controller.c", "test_controller.c", "Makefile", "README.md")
KERNEL = {"lfo_kernel.h": "kernel.h", "lfo_kernel.c": "kernel.c"}

LARGEST_STATE = 1e12  # in its unit: squares of this and their sums stay finite in float

FLOAT_GROWTH = 1e47
"""Largest growth of the open loop over the horizon in float: a pendulum with a growth of 3e46 agrees with double."""

RECORDED, MEASURED = 100, 1000  # steps of the generated test, and of the count of changes
PUSH_EVERY, PUSH, NOISE = 25, 0.2, 1e-3  # disturbances of these steps, of states in units of order 1
RETREATS = 30  # to a quarter of the distance to the first state, until the problem has a plan again
LOST = 10.0  # units, or times the first state: farther away the plant is lost, although soft rows may have a plan
LEAST_REACH = 1e-3  # part of the disturbances that remains where larger ones lead to states without a plan

STRUCT_BYTES = 84  # of lfo_memory without its number: 16 pointers of 4 bytes, 5 integers
STACK_BYTES = 512  # of the frames of controller_step, lfo_step and sweep without their arrays
CANDIDATE_INTEGERS, CANDIDATE_REALS, QUEUE = 6, 3, 4  # of struct candidate in kernel.c; LFO_QUEUE


@dataclass(frozen=True)
class Real:
    """A type of numbers in C, with the tolerances of a step in it and the difference that its test allows."""

    name: str
    suffix: str
    dtype: np.dtype[np.floating]
    digits: int
    tolerance: float
    dependence: float
    allowed: float

    @property
    def bytes(self) -> int:
        """Return the size of a number."""
        return self.dtype.itemsize

    def literal(self, value: float) -> str:
        """Return a constant of C; numbers below the least normal one are zero, as they are slow to compute with."""
        least = float(np.finfo(self.dtype).tiny)
        text = f"{0.0 if abs(value) < least else float(self.dtype.type(value)):.{self.digits}g}"
        return text + ("" if set(text) & set(".e") else ".0") + self.suffix


REALS = {
    "double": Real("double", "", np.dtype(np.float64), 17, ROW_TOLERANCE, GRADIENT_DEPENDENCE, 1e-6),
    "float": Real("float", "f", np.dtype(np.float32), 9, 2e-5, 1e-4, 1e-2),  # some 100 units of rounding
}


@dataclass(frozen=True)
class Work:
    """Multiply-adds of a sweep, and at most of a change of the working set."""

    sweep: int
    change: int


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
        Bytes of the tables; the code takes some 8 kB more.
    ram, stack : int
        Bytes of the struct ``controller`` with pointers of 4 bytes, and of the stack at most, by estimate.
    cap : int
        Most changes of the working set in a step.
    changes, steps : int
        Most changes in so many disturbed steps, in double and without this cap.
    work : Work
        Multiply-adds of a sweep and of a change.

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
    work: Work

    def __str__(self) -> str:
        return (
            f"{self.folder}: a controller of {plural(self.unknowns, 'unknown')} in {self.real}\n"
            f"tables {self.flash} bytes, RAM {self.ram} bytes, stack about {self.stack} bytes\n"
            f"at most {self.changes} changes in each of {self.steps} disturbed steps; the cap is {self.cap}\n"
            f"a sweep has {self.work.sweep} multiply-adds, a change at most {self.work.change}"
        )


def step_problem(problem: OptimalControlProblem, penalties: Mapping[str, float]) -> OptimalControlProblem:
    """Return the problem that a generated controller solves at each step."""
    return soften(free_first_state(problem), penalties)


def log_header(states: int, controls: int, references: bool) -> str:
    """Return the first line of a log."""
    letters = [("x", states), ("r", states if references else 0), ("u", controls)]
    return ",".join([f"{letter}{i + 1}" for letter, count in letters for i in range(count)] + ["status"])


@dataclass(frozen=True, eq=False)
class _Embedded:
    """The problem of a step in units of order 1, its tables and its options."""

    problem: OptimalControlProblem  # reduced, with its states counted from the origin
    origin: Array
    units: LtiUnits
    solver: CondensedSolver
    delay: int
    references: bool
    real: Real
    cap: int

    @property
    def tables(self) -> CondensedTables:
        """Return the tables as they were set up."""
        return self.solver.kernel.tables

    @cached_property
    def arrays(self) -> dict[str, NDArray[np.floating | np.integer]]:
        """Return the arrays of lfo_model, where times with the same bounds share a column."""
        found = dict(model_arrays(self.tables))
        n, count = self.tables.loop.shape[1], len(self.tables.families)
        if self.references:
            found["W"] = np.insert(found["W"], n, _reference_columns(self.tables).T, axis=0)
        over_time = np.vstack([found["d"].T, *(found[name] for name in BOUNDS)])
        shared, column = np.unique(over_time, axis=1, return_inverse=True)
        parts = np.split(shared, n + count * np.arange(len(BOUNDS)))
        return found | {"d": parts[0].T, **dict(zip(BOUNDS, parts[1:], strict=True)), "column": column.astype(np.int16)}

    @cached_property
    def integers(self) -> dict[str, int]:
        """Return the integers of lfo_model."""
        (T, n, m), tables, count = self.tables.loop.shape, self.tables, len(self.tables.families)
        parameters, columns = n * (2 if self.references else 1) + 1, self.arrays["lower"].shape[1]
        values = (T, n, m, parameters, tables.unknowns, count, columns, min(tables.unknowns, count * (T + 1)), self.cap)
        return dict(zip(INTEGERS, values, strict=True))

    @property
    def reals(self) -> int:
        """Return how many numbers lfo_memory needs, as lfo_reals counts them."""
        k, r, (T, _, m) = self.integers["most_active"], self.tables.unknowns, self.tables.loop.shape
        return 4 * r + 4 * T * m + 4 * k + k * r + k * k

    @property
    def rows(self) -> int:
        """Return how many rows there are."""
        return self.integers["families"] * (self.integers["T"] + 1)

    @property
    def flash(self) -> int:
        """Return the bytes of all tables; arrays that are equal are one."""
        sizes = [self.arrays[name].size for name, same in self.shared_names.items() if name == same]
        numbers = sum(sizes) - self.arrays["column"].size + 2 * self.integers["n"] + self.integers["m"]
        return numbers * self.real.bytes + 2 * self.arrays["column"].size

    @cached_property
    def shared_names(self) -> dict[str, str]:
        """Return for each array the first one that is equal to it."""
        names = list[str]()
        for name in ARRAYS:
            equal = [other for other in names if np.array_equal(self.arrays[other], self.arrays[name])]
            names.append(equal[0] if equal else name)
        return dict(zip(ARRAYS, names, strict=True))

    @property
    def ram(self) -> int:
        """Return the bytes of struct controller where pointers have 4 bytes."""
        numbers = self.reals + self.integers["p"] - 1 + self.integers["m"] + 1
        found = STRUCT_BYTES + numbers * self.real.bytes + 4 * self.integers["most_active"] + self.rows
        return -(-found // self.real.bytes) * self.real.bytes

    @property
    def stack(self) -> int:
        """Return the bytes of the stack in a step, by estimate."""
        candidate = 4 * CANDIDATE_INTEGERS + CANDIDATE_REALS * self.real.bytes
        families, n = self.integers["families"], self.integers["n"]
        return STACK_BYTES + (families + QUEUE) * candidate + 5 * n * self.real.bytes

    @property
    def work(self) -> Work:
        """Return the multiply-adds of a sweep and of a change."""
        (T, n, m), r = self.tables.loop.shape, self.tables.unknowns
        k, families = self.integers["most_active"], self.integers["families"]
        return Work(T * m * r + T * (n + families) * (n + m), T * m * r + 8 * r * k + 3 * k * k)


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
        raise ProblemError(
            "changes", brief(changes), "a whole number, zero or above", "None is a cap that no step meets."
        )
    require_bool("references", references)
    limit = memory_bytes(memory)
    embedded = _embed(step_problem(problem, penalties), delay, bool(references), REALS[real], changes)
    needed = embedded.ram + embedded.stack
    if limit is not None and needed > limit:
        parts = f"{needed} bytes: {embedded.ram} of struct controller, {embedded.stack} of stack"
        advice = 'A shorter horizon, a lower cut-off, fewer bounds or real="float" need less.'
        raise ProblemError("memory", f"{limit} bytes", f"at least {parts}", advice)
    steps = _disturbed_steps(embedded, MEASURED)
    summary = GeneratedController(
        folder, real, embedded.tables.unknowns, embedded.flash, embedded.ram, embedded.stack, embedded.cap,
        max(step.changes for step in steps), len(steps), embedded.work,
    )  # fmt: skip
    texts = _files(problem, embedded, steps[:RECORDED], summary)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_each({folder / name: text.encode() for name, text in texts.items()})
    return summary


def memory_bytes(given: object) -> int | None:
    """Return a size of memory in bytes; "64k" is 64 * 1024, None is none."""
    if given is None:
        return None
    found = re.fullmatch(r"(\d+)([kM]?)", str(given)) if isinstance(given, (str, int)) else None
    size = 0 if found is None or isinstance(given, bool) else int(found[1]) * {"": 1, "k": 1024, "M": 1024**2}[found[2]]
    if size == 0:
        raise ProblemError("memory", brief(given), 'bytes, a whole number above zero, or a text such as "64k"')
    return size


def _embed(problem: OptimalControlProblem, delay: int, references: bool, real: Real, changes: int | None) -> _Embedded:
    """Set up the tables of a step; UnsupportedError, with field and reason, if the controller is not of the class."""
    try:
        reason = _refusal(problem)
        if reason is None:
            if not problem.ends[0].fixed.all():
                problem = problem.with_ends(np.zeros(problem.state_dim))
            require_convex(problem)
            translation = translation_of(problem)
            reduced = reduce_problem(translation.problem, REDUCTIONS).problem
            reason = _refusal_of_reduction(translation, reduced)
        if reason is not None:
            raise UnsupportedError(reason)
        units = natural_units(reduced)
        if references:
            reduced = reduced.with_references({"x_ref": np.zeros(reduced.state_dim)})
        solver = CondensedSolver(lti_problem(reduced, units), units)
    except UnsupportedError as error:
        reason = str(error).removeprefix("method 'condensed': ")
        raise UnsupportedError(f"generate: {reason}") from None
    A, T = problem.linear.A, problem.horizon
    with np.errstate(over="ignore"):
        growth = float(np.abs(np.linalg.eigvals(A)).max(initial=0.0) ** T)
    if real.name == "float" and growth > FLOAT_GROWTH:
        what = f"the open loop grows by {growth:.0e} over the horizon; float was checked up to {FLOAT_GROWTH:.0e}"
        raise UnsupportedError(f'generate: real: {what}. Use real="double", or a shorter horizon.')
    cap = solver.kernel.tables.most_changes if changes is None else changes
    return _Embedded(reduced, translation.origin, units, solver, delay, references, real, cap)


def _refusal(problem: OptimalControlProblem) -> str | None:
    """Return the field of a problem that is outside of the class, with the reason, or None."""
    linear, cost = problem.linear, problem.quadratic
    if linear.time_varying:
        return "dynamics: A or B depends on time; a generated controller has one A and one B."
    if any(part.ndim == 3 for part in (cost.Q, cost.R, cost.S)):
        return "cost: Q, R or S depends on time; a generated controller has one of each."
    if any(rows.time_varying for rows in problem.stage_rows):
        return "stage_rows: C or D depends on time; a generated controller has one of each for every row."
    if problem.horizon * problem.control_dim > MOST_UNKNOWNS:
        controls = f"{problem.horizon} steps of {plural(problem.control_dim, 'control')}"
        return f"horizon: {controls}; a generated controller takes {MOST_UNKNOWNS} controls over the horizon."
    if problem.state_stop.any():
        return "state_spectrum: stop bands of states; a generated controller takes those of controls only."
    if any(not one.penalty.reach and one.periodic for one in problem.links):
        return "terminal_state: linked to the initial state; a generated controller starts where the plant is."
    return None


def _refusal_of_reduction(translation: Translation, reduced: OptimalControlProblem) -> str | None:
    """Return why the problem as the Fourier-domain method takes it is outside of the class, or None."""
    problem = translation.problem
    if not np.array_equal(problem.control_stop, reduced.control_stop):
        return "control_spectrum: soft stop bands; a generated controller takes hard ones."
    if reduced.state_dim != problem.state_dim or reduced.control_dim != problem.control_dim:
        return "cost: it needs further states; a generated controller takes quadratic costs of states and controls."
    for term in reduced.terms:
        if term.kind is not TermKind.STAGE_ROWS and soft_set(reduced, term) is None:
            field = "cost" if term.kind.is_cost else str(term.kind).replace(" ", "_")
            taken = "quadratic costs, bounds, joint rows, rate limits and stop bands of controls"
            return f"{field}: {term.name}; a generated controller takes {taken}."
    reason = refusal(reduced)
    return reason and f"problem: {reason}."


def _reference_columns(tables: CondensedTables) -> Array:
    """Return v of a unit of each state's reference, (T m, n), where the tables have references of zero."""
    lti, (T, n, _) = tables.loop.lti, tables.loop.shape
    end, columns = np.where(np.isnan(lti.end), np.nan, 0.0), list[Array]()
    for i in range(n):
        linear = np.repeat(-lti.M[:, i : i + 1], T, axis=1)
        alone = replace(lti, linear=linear, p=-lti.P[:, i], offset=None, end=end)
        unit = replace(tables, loop=replace(tables.loop, lti=alone))
        columns.append(unit.centers(np.zeros((1, n)), np.ones(1)))
    return np.hstack(columns)


@dataclass(frozen=True, eq=False)
class _RecordedStep:
    """A measured state, its reference and its control, in units of order 1, and the changes of the working set."""

    state: Array
    reference: Array
    control: Array
    changes: int


def _disturbed_steps(embedded: _Embedded, count: int) -> list[_RecordedStep]:
    """Return steps of a loop with pushes and noise, all from states with a plan; UnsupportedError if there is none."""
    tables, kernel, rng = embedded.tables, embedded.solver.kernel, np.random.default_rng(0)
    lti, (_, n, m) = tables.loop.lti, tables.loop.shape
    drift = np.zeros(n) if lti.offset is None else lti.offset[:, 0]
    if not isinstance(kernel, NativeKernel):
        count = RECORDED  # NumPy is some 100 times slower
    x, acting, reference = lti.start, np.zeros(m), np.zeros(n)
    farthest = LOST * max(1.0, float(np.abs(x).max()))
    anchor, reach, steps = np.zeros(n), 1.0, list[_RecordedStep]()
    for k in range(count):
        if k % PUSH_EVERY == 0:
            x = x + (reach * PUSH * rng.uniform(-1, 1, n) if k else 0.0)
            if embedded.references:
                reference = PUSH * rng.uniform(-1, 1, n)
                kernel.take(_at_reference(embedded, tables, reference))
        for _ in range(RETREATS):
            begin = lti.A @ x + lti.B @ acting + drift if embedded.delay else x
            if np.abs(begin).max() <= farthest and kernel.step(begin) == SOLVED:
                break
            x, acting, reach = anchor + (x - anchor) / 4, acting / 4, max(reach / 2, LEAST_REACH)
        else:
            raise UnsupportedError("generate: problem: no state was found from which it has a plan.")
        control = kernel.control
        steps.append(_RecordedStep(x, reference, control, kernel.changes))
        anchor = x if k == 0 else anchor
        x = lti.A @ x + lti.B @ (acting if embedded.delay else control) + drift + reach * NOISE * rng.standard_normal(n)
        acting = control
    return steps


def _at_reference(embedded: _Embedded, tables: CondensedTables, reference: Array) -> CondensedTables:
    """Return the tables with another reference of all states, in units of order 1."""
    stated = embedded.problem.with_references({"x_ref": reference * embedded.units.x})
    changed = tables.with_data(lti_problem(stated, embedded.units))
    assert changed is not None  # the same rows are bounded
    return changed


def _files(
    problem: OptimalControlProblem, embedded: _Embedded, steps: Sequence[_RecordedStep], summary: GeneratedController
) -> dict[str, str]:
    """Return the texts of all files by their names."""
    real, units, integers = embedded.real, embedded.units, embedded.integers
    T, n, m = (integers[name] for name in "Tnm")
    states = np.array([step.state for step in steps]) * units.x + embedded.origin
    references = np.array([step.reference for step in steps]) * units.x + embedded.origin
    controls = np.array([step.control for step in steps]) * units.u
    largest = np.abs(controls).max(axis=0)
    sizes = np.where(largest > 0, largest, 1.0)
    tables = {name: embedded.arrays[name] for name, same in embedded.shared_names.items() if name == same}
    tables |= {"origin": embedded.origin, "state_unit": units.x, "control_unit": units.u}
    recorded = {"states": states, "controls": controls} | ({"references": references} if embedded.references else {})
    fields = [(name, str(value)) for name, value in integers.items()]
    fields += [("tolerance", real.literal(real.tolerance)), ("dependent", real.literal(real.dependence))]
    values = {
        "title": _comment_text(problem.name or "A controller"),
        "version": version("lin-freq-ocp"),
        "heading": problem.name or "A controller",
        "facts": problem_facts(problem),
        "real": real,
        "states": n,
        "controls": m,
        "horizon": T,
        "unknowns": summary.unknowns,
        "families": max(integers["families"], 1),
        "reals": embedded.reals,
        "members": max(integers["most_active"], 1),
        "rows": max(embedded.rows, 1),
        "parameters": integers["p"] - 1,
        "largest": LARGEST_STATE,
        "flash": summary.flash,
        "delay": embedded.delay,
        "references": embedded.references,
        "header": log_header(n, m, embedded.references),
        "work": summary.work,
        "summary": summary,
        "allowed": f"{real.allowed:g}",
        "steps": len(steps),
    }
    environment = Environment(
        loader=PackageLoader("lin_freq_ocp.loop"),
        autoescape=False,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    arrays = {
        "controller.c": [_array(name, array, real) for name, array in tables.items()],
        "test_controller.c": [_array(name, array, real) for name, array in recorded.items()]
        + [_array("sizes", sizes, REALS["double"])],
    }
    fields += [(name, same) for name, same in embedded.shared_names.items()]
    texts = {
        name: environment.get_template(name).render(values | {"arrays": arrays.get(name, []), "fields": fields})
        for name in TEMPLATES
    }
    source = resources.files("lin_freq_ocp.methods.condensed")
    for name, file in KERNEL.items():
        texts[name] = source.joinpath(file).read_text().replace('"kernel.h"', '"lfo_kernel.h"')
    settings = {"LFO_REAL": real.name, "LFO_SQRT": f"sqrt{real.suffix}", "LFO_FAMILIES": values["families"]}
    lines = [f"#define {name} {value}\n" for name, value in (settings | {"LFO_STATES": n}).items()]
    texts["lfo_kernel.h"] = texts["lfo_kernel.h"].replace(
        "#ifndef LFO_REAL\n", "".join(lines) + "#ifndef LFO_REAL\n", 1
    )
    return texts


def _array(name: str, array: NDArray[np.floating | np.integer], real: Real) -> tuple[str, str, list[str]]:
    """Return a table as its name, its type and its lines; an empty one has a zero, as C needs."""
    flat = array.ravel() if array.size else np.zeros(1)
    whole = array.dtype.kind == "i"
    texts = [str(int(value)) if whole else real.literal(float(value)) for value in flat]
    lines = [", ".join(texts[first : first + 6]) for first in range(0, len(texts), 6)]
    kind = "short" if whole else "double" if name == "sizes" else "lfo_real"
    return name, kind, [line + "," for line in lines[:-1]] + lines[-1:]


def _comment_text(text: str) -> str:
    """Return a text in ASCII in one line that ends no comment."""
    return " ".join(text.replace("*/", "* /").replace("\\", "/").encode("ascii", "replace").decode().split())
