"""A controller as C: the tables of its problem, the kernel that serves Python, a test and a description.

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
from lin_freq_ocp.base.atomic import reason, write_each
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.loop.step_problem import ControlLimits, free_first_state, known_states, soften
from lin_freq_ocp.methods.candidate import require_convex
from lin_freq_ocp.methods.condensed.native import BOUNDS, INTEGERS, NativeKernel, model_arrays
from lin_freq_ocp.methods.condensed.plans import CondensedSolver
from lin_freq_ocp.methods.condensed.tables import (
    GRADIENT_DEPENDENCE,
    MOST_UNKNOWNS,
    ROW_TOLERANCE,
    SOLVED,
    CondensedTables,
)
from lin_freq_ocp.methods.spectral.model import LtiUnits, lti_problem, natural_units, refusal
from lin_freq_ocp.methods.spectral.reductions import REDUCTIONS, soft_set
from lin_freq_ocp.problem.description import problem_facts
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.transform.reductions import reduce_problem
from lin_freq_ocp.transform.reformulations import translation_of

TEMPLATES = ("controller.h", "controller.c", "lfo_settings.h", "test_controller.c", "Makefile", "README.md")
TAKEN = "a generated controller takes quadratic costs, bounds, joint rows, rate limits and stop bands of controls"

LARGEST_STATE = 1e12  # in its unit: squares of this and their sums stay finite in float
HIDDEN = 100  # a control whose terms round by this many tolerances of a row is that of the feedback alone

FLOAT_GROWTH = 1e47
"""Largest growth of the open loop over the horizon in float: a pendulum with a growth of 3e46 agrees with double."""

RECORDED, MEASURED = 100, 1000  # steps of the generated test, and of the count of changes
PUSH_EVERY, PUSH, NOISE = 25, 0.2, 1e-3  # disturbances of these steps, of states in units of order 1
RETREATS = 30  # to a quarter of the distance to the first state, until the problem has a plan again
LOST = 10.0  # units, or times the first state: farther away the plant is lost, although soft rows may have a plan
LEAST_REACH = 1e-3  # part of the disturbances that remains where larger ones lead to states without a plan

NOT_IN_COMMENTS = re.compile(r"[^A-Za-z0-9 _.,:;()=+-]")  # of C: no other character of a name reaches them
MARKUP = re.compile(r"[\\`*\[\]<>&]")  # of Markdown and HTML

STRUCT_BYTES = 88  # of lfo_memory without its number: 16 pointers of 4 bytes, 6 integers
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
    def epsilon(self) -> float:
        """Return the relative rounding of a number, twice the largest rounding error."""
        return float(np.finfo(self.dtype).eps)

    def below(self, values: Array) -> Array:
        """Return the numbers rounded down to this type."""
        rounded = values.astype(self.dtype)
        return np.where(rounded > values, np.nextafter(rounded, self.dtype.type(-np.inf)), rounded).astype(np.float64)

    def literal(self, value: float) -> str:
        """Return a constant of C; numbers below the least normal one are zero, as they are slow to compute with."""
        least = float(np.finfo(self.dtype).tiny)
        text = f"{0.0 if abs(value) < least else float(self.dtype.type(value)):.{self.digits}g}"
        return text + ("" if set(text) & set(".e") else ".0") + self.suffix


REALS = {
    "double": Real("double", "", np.dtype(np.float64), 17, ROW_TOLERANCE, GRADIENT_DEPENDENCE, 1e-6),
    "float": Real("float", "f", np.dtype(np.float32), 9, 5e-6, 3e-5, 1e-2),  # 80 and 500 units of rounding
}


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
        Bytes of the struct ``controller`` with pointers of 4 bytes, and of the stack, by estimate.
    cap : int
        Most changes of the working set in a step.
    changes, steps : int
        Most changes in so many disturbed steps, in double and without this cap.
    sweep_work, change_work : int
        Multiply-adds of a sweep, and at most of a change.

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

    def __str__(self) -> str:
        return (
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
        tables = _StepTables.of(step_problem(problem, penalties), delay, bool(references), REALS[real], changes)
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
    summary = GeneratedController(folder, real, *counts, *tables.work)
    texts = _files(problem, tables, steps[:RECORDED], summary)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ProblemError(str(folder), reason(error), "a folder that can be written") from None
    write_each({folder / name: text.encode() for name, text in texts.items()})
    return summary


def _condensed_problem(problem: OptimalControlProblem) -> tuple[OptimalControlProblem, Array]:
    """Return the problem that the condensed method takes and the origin of its states.

    UnsupportedError, with field and reason, if a problem is not of the class.
    """
    linear, cost = problem.linear, problem.quadratic
    controls = f"{problem.horizon} steps of {plural(problem.control_dim, 'control')}"
    for outside, refused in (
        (linear.time_varying, "dynamics: A or B depends on time; a generated controller has one A and one B."),
        (max(part.ndim for part in (cost.Q, cost.R, cost.S)) == 3, "cost: Q, R or S depends on time."),
        (any(rows.time_varying for rows in problem.stage_rows), "stage_rows: C or D depends on time."),
        (
            problem.horizon * problem.control_dim > MOST_UNKNOWNS,
            f"horizon: {controls}; a generated controller takes {MOST_UNKNOWNS} controls over the horizon.",
        ),
        (problem.state_stop.any(), f"state_spectrum: stop bands of states; {TAKEN}."),
        (any(link.periodic for link in problem.links), "terminal_state: it is linked to the measured initial state."),
    ):
        if outside:
            raise UnsupportedError(refused)
    require_convex(problem)
    if not problem.ends[0].fixed.all():
        problem = problem.with_ends(np.zeros(problem.state_dim))
    translation = translation_of(problem)
    reduced = reduce_problem(translation.problem, REDUCTIONS).problem
    if not np.array_equal(problem.control_stop, reduced.control_stop):
        raise UnsupportedError(f"control_spectrum: soft stop bands; {TAKEN}, and these bands hard.")
    for term in reduced.terms:
        if term.kind is not TermKind.STAGE_ROWS and soft_set(reduced, term) is None:
            field = "cost" if term.kind.is_cost or term.source is None else term.source[0]
            raise UnsupportedError(f"{field}: {term.name}; {TAKEN}.")
    refused = refusal(reduced)
    if refused is not None:
        raise UnsupportedError(f"problem: {refused}.")
    return reduced, translation.origin


@dataclass(frozen=True, eq=False)
class _RecordedStep:
    """A measured state, its reference and its control, in units of order 1, and the changes of the working set."""

    state: Array
    reference: Array
    control: Array
    changes: int


@dataclass(frozen=True, eq=False)
class _StepTables:
    """The problem of a step in units of order 1, with its tables and its options."""

    problem: OptimalControlProblem  # reduced, with its states counted from the origin
    limits: ControlLimits  # of the problem as it was stated
    origin: Array
    units: LtiUnits
    solver: CondensedSolver
    tables: CondensedTables  # as they were set up
    delay: int
    references: bool
    real: Real
    cap: int

    @classmethod
    def of(
        cls, given: OptimalControlProblem, delay: int, references: bool, real: Real, changes: int | None
    ) -> _StepTables:
        """Set up the tables; UnsupportedError, with field and reason, if the problem is not of the class."""
        problem, origin = _condensed_problem(given)
        units = natural_units(problem)
        if references:
            problem = problem.with_references({"x_ref": np.zeros(problem.state_dim)})
        with np.errstate(over="ignore"):
            growth = float(np.abs(np.linalg.eigvals(problem.linear.A)).max() ** problem.horizon)
        if real.name == "float" and growth > FLOAT_GROWTH:
            what = f"the open loop grows by {growth:.0e} over the horizon; float was checked up to {FLOAT_GROWTH:.0e}"
            raise UnsupportedError(f'real: {what}. Use real="double", or a shorter horizon.')
        solver = CondensedSolver(lti_problem(problem, units), units)
        tables = solver.kernel.tables
        cap = tables.most_changes if changes is None else changes
        return cls(problem, ControlLimits.of(given), origin, units, solver, tables, delay, references, real, cap)

    @cached_property
    def arrays(self) -> dict[str, NDArray[np.floating | np.integer]]:
        """Return the arrays of lfo_model, where times with the same bounds share a column, and the units."""
        found, (_, n, m) = model_arrays(self.tables), self.tables.loop.shape
        if self.references:
            found["W"] = np.insert(found["W"], n, self._reference_columns().T, axis=0)
        over_time = np.vstack([found["d"].T, *(found[name] for name in BOUNDS)])
        shared, column = np.unique(over_time, axis=1, return_inverse=True)
        d, *bounds = np.split(shared, n + len(self.tables.families) * np.arange(len(BOUNDS)))
        found |= {"d": d.T, **dict(zip(BOUNDS, bounds, strict=True)), "column": column.astype(np.int16)}
        if self.delay:
            found |= {"plant": self.tables.loop.lti.A}
        units = {"origin": self.origin, "state_unit": self.units.x, "control_unit": self.units.u}
        rows, bounds = self.limits, np.append(self.limits.upper, -self.limits.lower)
        given, signs = np.isfinite(bounds), np.repeat([1.0, -1.0], m)
        limits = {
            "limit_acting": np.append(rows.acting, np.tile(np.arange(m), 2)[given]).astype(np.int16),
            "limit_C": np.vstack([rows.C, np.zeros((given.sum(), n))]),
            "limit_D": np.append(rows.d, signs[given]),
            "limit_e": self.real.below(np.append(rows.e, bounds[given])),
        }
        return {**found, **units, **limits}

    def _reference_columns(self) -> Array:
        """Return v of a unit of each state's reference, (T m, n), where the problem has references of zero."""
        lti, (T, n, _) = self.tables.loop.lti, self.tables.loop.shape
        end, columns = np.where(np.isnan(lti.end), np.nan, 0.0), list[Array]()
        for i in range(n):
            linear = np.repeat(-lti.M[:, i : i + 1], T, axis=1)
            alone = replace(lti, linear=linear, p=-lti.P[:, i], offset=None, end=end)
            unit = replace(self.tables, loop=replace(self.tables.loop, lti=alone))
            columns.append(unit.centers(np.zeros((1, n)), np.ones(1)))
        return np.hstack(columns)

    @cached_property
    def integers(self) -> dict[str, int]:
        """Return the integers of lfo_model."""
        (T, n, m), r, count = self.tables.loop.shape, self.tables.unknowns, len(self.tables.families)
        parameters, columns = n * (1 + self.references) + 1, self.arrays["lower"].shape[1]
        values = (T, n, m, parameters, r, count, columns, min(r, count * (T + 1)), self.cap)
        return dict(zip(INTEGERS, values, strict=True))

    @property
    def reals(self) -> int:
        """Return how many numbers lfo_memory needs, as lfo_reals counts them."""
        T, _, m, _, r, _, _, k, _ = self.integers.values()
        return 4 * r + 4 * T * m + 4 * k + k * r + k * k

    @property
    def rows(self) -> int:
        """Return how many rows there are."""
        return self.integers["families"] * (self.integers["T"] + 1)

    @property
    def flash(self) -> int:
        """Return the bytes of all tables."""
        sizes = (
            (array, array.itemsize if array.dtype.kind == "i" else self.real.dtype.itemsize)
            for array in self.arrays.values()
        )
        return sum(array.size * size for array, size in sizes)

    @property
    def ram(self) -> int:
        """Return the bytes of struct controller where pointers have 4 bytes."""
        size, integers = self.real.dtype.itemsize, self.integers
        numbers = self.reals + integers["p"] - 1 + integers["m"] + 1
        return -(-(STRUCT_BYTES + numbers * size + 4 * integers["most_active"] + self.rows) // size) * size

    @property
    def stack(self) -> int:
        """Return the bytes of the stack in a step, by estimate."""
        size, integers = self.real.dtype.itemsize, self.integers
        candidates = (integers["families"] + QUEUE) * (4 * CANDIDATE_INTEGERS + CANDIDATE_REALS * size)
        return STACK_BYTES + candidates + 5 * integers["n"] * size

    @property
    def work(self) -> tuple[int, int]:
        """Return the multiply-adds of a sweep, and at most of a change."""
        T, n, m, _, r, families, _, k, _ = self.integers.values()
        return T * m * r + T * (n + families) * (n + m), T * m * r + 8 * r * k + 3 * k * k

    def disturbed_steps(self) -> list[_RecordedStep]:
        """Return steps of a loop with pushes and noise, all from states with a plan; at least one."""
        kernel, rng, reach = self.solver.kernel, np.random.default_rng(0), 1.0
        lti, (_, n, m) = self.tables.loop.lti, self.tables.loop.shape
        drift = np.zeros(n) if lti.offset is None else lti.offset[:, 0]
        x, acting, reference, anchor = lti.start, np.zeros(m), np.zeros(n), np.zeros(n)
        farthest, steps = LOST * max(1.0, float(np.abs(x).max())), list[_RecordedStep]()
        for k in range(MEASURED if isinstance(kernel, NativeKernel) else RECORDED):  # NumPy is some 100 times slower
            moved = lti.B @ acting + drift  # by the control that acts, until a delayed plan begins
            if k % PUSH_EVERY == 0 and k:
                x = x + reach * PUSH * rng.uniform(-1, 1, n)
            if k % PUSH_EVERY == 0 and self.references:
                reference = PUSH * rng.uniform(-1, 1, n)
                stated = self.problem.with_references({"x_ref": reference * self.units.x})
                changed = self.tables.with_data(lti_problem(stated, self.units))
                assert changed is not None  # the same rows are bounded
                kernel.take(changed)
            for _ in range(RETREATS):
                begin = lti.A @ x + moved if self.delay else x
                if np.abs(begin).max() <= farthest and kernel.step(begin) == SOLVED:
                    break
                nearer, reach = anchor + (begin - anchor) / 4, max(reach / 2, LEAST_REACH)
                x = np.asarray(np.linalg.lstsq(lti.A, nearer - moved)[0], dtype=np.float64) if self.delay else nearer
            else:
                raise UnsupportedError("problem: no state was found with a plan. lfo.solve(problem) says why.")
            anchor = anchor if k else begin
            steps.append(_RecordedStep(x, reference, kernel.control, kernel.changes))
            control = acting if self.delay else steps[-1].control
            x = lti.A @ x + lti.B @ control + drift + reach * NOISE * rng.standard_normal(n)
            acting = steps[-1].control
        return steps


def _files(
    problem: OptimalControlProblem, tables: _StepTables, steps: Sequence[_RecordedStep], summary: GeneratedController
) -> dict[str, str]:
    """Return the texts of all files by their names."""
    real, units, integers = tables.real, tables.units, tables.integers
    controls = np.array([step.control for step in steps]) * units.u
    largest = np.abs(controls).max(axis=0)
    recorded = {"controls": controls, "sizes": np.where(largest > 0, largest, 1.0)}
    for name in ("state", "reference") if tables.references else ("state",):
        recorded[f"{name}s"] = np.array([getattr(step, name) for step in steps]) * units.x + tables.origin
    name = problem.name or "A controller"
    values = {
        "heading": markdown(name),
        "title": NOT_IN_COMMENTS.sub("_", name),
        "version": version("lin-freq-ocp"),
        "facts": [(markdown(term), markdown(text)) for term, text in problem_facts(problem)],
        "states": [markdown(state) for state in problem.state_names],
        "controls": [markdown(control) for control in problem.control_names],
        "known": [f"x[{i}]" for i in np.flatnonzero(known_states(problem.linear)) if integers["n"] > 1],
        "real": real,
        "integers": integers,
        "numbers": {"tolerance": real.tolerance, "dependent": real.dependence},
        "reals": tables.reals,
        "rows": tables.rows,
        "largest": LARGEST_STATE,
        "largest_term": HIDDEN * real.tolerance / real.epsilon,
        "limits": len(tables.arrays["limit_e"]),
        "delay": tables.delay,
        "references": tables.references,
        "header": log_header(integers["n"], integers["m"], tables.references),
        "summary": summary,
        "steps": len(steps),
        "capped": tables.cap < tables.tables.most_changes,
        "tables": [(name, *_lines(array, real)) for name, array in tables.arrays.items()],
        "fields": [*model_arrays(tables.tables), "column"],
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
