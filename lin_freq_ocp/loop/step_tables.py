"""The problem of a step of a generated controller in units of order 1: its tables, its sizes in C, disturbed steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.loop.step_problem import ControlLimits, complete_reference, first_known_states, known_states
from lin_freq_ocp.loop.windows import control_windows, without_first_plan, without_windows
from lin_freq_ocp.methods.candidate import require_convex
from lin_freq_ocp.methods.condensed.native import (
    BOUNDS,
    COUNTS,
    INDICES,
    INTEGERS,
    KERNEL_ARRAYS,
    OF_WINDOWS,
    WINDOW_INTEGERS,
    array_lengths,
    model_arrays,
)
from lin_freq_ocp.methods.condensed.plans import CondensedSolver
from lin_freq_ocp.methods.condensed.tables import (
    GRADIENT_DEPENDENCE,
    MOST_UNKNOWNS,
    ROW_TOLERANCE,
    SOLVED,
    CondensedTables,
)
from lin_freq_ocp.methods.condensed.windows import FACETS, ControlWindows
from lin_freq_ocp.methods.spectral.model import LtiUnits, lti_problem, natural_units, refusal
from lin_freq_ocp.methods.spectral.reductions import REDUCTIONS, soft_set
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.term import TermKind
from lin_freq_ocp.transform.reductions import reduce_problem
from lin_freq_ocp.transform.reformulations import translation_of

TAKEN = "a generated controller takes quadratic costs, bounds, joint rows, rate limits and stop bands of controls"

FLOAT_GROWTH = 1e47
"""Largest growth of the open loop over the horizon in float: a pendulum with a growth of 3e46 agrees with double."""

RECORDED, MEASURED = 100, 1000  # steps of the generated test, and of the count of changes
PUSH_EVERY, PUSH, NOISE = 25, 0.2, 1e-3  # disturbances of these steps, of states in units of order 1
RETREATS = 30  # to a quarter of the distance to the first state, until the problem has a plan again
LOST = 10.0  # units, or times the first state: farther away the plant is lost, although soft rows may have a plan
LEAST_REACH = 1e-3  # part of the disturbances that remains where larger ones lead to states without a plan

POINTER_BYTES, INTEGER_BYTES = 4, 4  # of small processors
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
class RecordedStep:
    """A measured state, its reference and its control, in units of order 1, and the changes of the working set."""

    state: Array
    reference: Array
    control: Array
    changes: int


@dataclass(frozen=True, eq=False)
class StepTables:
    """The problem of a step in units of order 1, with its tables and its options."""

    problem: OptimalControlProblem  # reduced, with its states counted from the origin
    limits: ControlLimits  # of the problem as it was stated
    origin: Array
    known: Mask  # (n,), the states that follow from the controls alone
    first_known: Array  # these at the first step, in their units
    plant: LinearDynamics  # as it was stated
    units: LtiUnits
    windows: ControlWindows | None
    solver: CondensedSolver
    tables: CondensedTables  # as they were set up
    delay: int
    references: bool
    real: Real
    cap: int

    @classmethod
    def of(
        cls, given: OptimalControlProblem, delay: int, references: bool, real: Real, changes: int | None
    ) -> StepTables:
        """Set up the tables; UnsupportedError, with field and reason, if the problem is not of the class."""
        problem, origin = _condensed_problem(without_windows(given))
        units = natural_units(problem)
        windows = control_windows(given, units, delay)
        if windows is not None and without_first_plan(given):
            raise UnsupportedError(without_first_plan(given))
        known = known_states(given.linear)
        if references:
            problem = _with_reference(problem, known, np.zeros((~known).sum()))
        with np.errstate(over="ignore"):
            growth = float(np.abs(np.linalg.eigvals(problem.linear.A)).max() ** problem.horizon)
        if real.name == "float" and growth > FLOAT_GROWTH:
            what = f"the open loop grows by {growth:.0e} over the horizon; float was checked up to {FLOAT_GROWTH:.0e}"
            raise UnsupportedError(f'real: {what}. Use real="double", or a shorter horizon.')
        solver = CondensedSolver(lti_problem(problem, units), units, windows)
        tables = solver.kernel.tables
        cap = tables.most_changes if changes is None else changes
        stated = ControlLimits.of(given), origin, known, first_known_states(given, known), given.linear
        return cls(problem, *stated, units, windows, solver, tables, delay, references, real, cap)

    @cached_property
    def arrays(self) -> dict[str, NDArray[np.floating | np.integer]]:
        """Return the arrays of lfo_model, where times with the same bounds share a column, and the units."""
        _, n, m = self.tables.loop.shape
        found: dict[str, NDArray[np.floating | np.integer]] = {**model_arrays(self.tables)}
        found |= {} if self.windows is None else self.windows.arrays(self.tables)
        if self.references:
            found["W"] = np.insert(found["W"], n, self._reference_columns().T, axis=0)
        over_time = np.vstack([found["d"].T, *(found[name] for name in BOUNDS)])
        shared, column = np.unique(over_time, axis=1, return_inverse=True)
        d, *bounds = np.split(shared, n + len(self.tables.families) * np.arange(len(BOUNDS)))
        found |= {"d": d.T, **dict(zip(BOUNDS, bounds, strict=True)), "column": column.astype(np.int16)}
        if self.delay:
            found |= {"plant": self.tables.loop.lti.A}
        units = {"origin": self.origin, "state_unit": self.units.x, "control_unit": self.units.u}
        if self.kept:
            (A, B, d), known = self.plant.at(0), self.known
            units |= {"kept_A": A[np.ix_(known, known)], "kept_B": B[known], "kept_d": d[known]}
            place = np.argsort(np.argsort(known, kind="stable"))
            units |= {"kept_begin": self.first_known, "place": place.astype(np.int16)}
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
        """Return v of a unit of each measured state's reference, (T m, measured), where these references are zero."""
        lti, (T, n, _) = self.tables.loop.lti, self.tables.loop.shape
        end, columns = np.where(np.isnan(lti.end), np.nan, 0.0), list[Array]()
        for i in np.flatnonzero(~self.known):
            linear = np.repeat(-lti.M[:, i : i + 1], T, axis=1)
            alone = replace(lti, linear=linear, p=-lti.P[:, i], offset=None, end=end)
            unit = replace(self.tables, loop=replace(self.tables.loop, lti=alone))
            columns.append(unit.centers(np.zeros((1, n)), np.ones(1)))
        return np.hstack(columns)

    @cached_property
    def integers(self) -> dict[str, int]:
        """Return the integers of lfo_model."""
        (T, n, m), r, count = self.tables.loop.shape, self.tables.unknowns, len(self.tables.families)
        parameters, columns = n + self.references * self.measured + 1, self.arrays["lower"].shape[1]
        of_windows = dict.fromkeys(OF_WINDOWS, 0) if self.windows is None else self.windows.integers(T)
        rows = count * (T + 1) + of_windows["cells"] * FACETS
        values = (T, n, m, parameters, r, count, columns, min(r, rows), self.cap)
        return dict(zip(INTEGERS, values, strict=True)) | of_windows

    @property
    def reals(self) -> int:
        """Return how many numbers lfo_memory needs, as lfo_reals counts them."""
        return sum(array_lengths(KERNEL_ARRAYS, self.integers).values())

    @property
    def kept(self) -> int:
        """Return how many states follow from the controls alone."""
        return int(self.known.sum())

    @property
    def measured(self) -> int:
        """Return how many states are measured."""
        return len(self.known) - self.kept

    @property
    def fields(self) -> list[tuple[str, str, int, str]]:
        """Return the type, name, length and meaning of the arrays of struct controller, after lfo_memory."""
        parameters, m = self.integers["p"], self.integers["m"]
        indices = sum(array_lengths(INDICES, self.integers).values())
        fields = [("lfo_real", "start", parameters - 1, "where the last plan begins, in units of order 1")]
        fields += [("lfo_real", "last", m, "the control returned last, or that which acts in its place")]
        if self.kept or self.windows:
            fields += [("int", "begun", 1, "whether there was a step")]
        if self.kept:
            fields += [("lfo_real", "kept", self.kept, "the states that follow from the controls alone")]
            fields += [("lfo_real", "acted", m, "the control that acted after these states")]
        fields += [("lfo_real", "reals", self.reals, "")]
        fields += [("int", "members", max(indices, 1), ""), ("signed char", "flags", max(self.rows, 1), "")]
        return fields

    @property
    def ram(self) -> int:
        """Return the bytes of struct controller on a small processor."""
        size = self.real.dtype.itemsize
        sizes, widest = {"lfo_real": size, "int": INTEGER_BYTES, "signed char": 1}, max(POINTER_BYTES, size)
        memory = [
            (POINTER_BYTES, len(KERNEL_ARRAYS) + len(INDICES) + 1),
            (INTEGER_BYTES, len(COUNTS)),
            (size, 2),
            (widest, 0),
        ]
        end = 0
        for width, count in [*memory, *((sizes[kind], count) for kind, _, count, _ in self.fields), (widest, 0)]:
            end = -(-end // width) * width + width * count
        return end

    @property
    def rows(self) -> int:
        """Return how many rows there are."""
        families, T, cells = (self.integers[name] for name in ("families", "T", "cells"))
        return families * (T + 1) + cells * FACETS

    @property
    def flash(self) -> int:
        """Return the bytes of all tables."""
        sizes = (
            (array, array.itemsize if array.dtype.kind == "i" else self.real.dtype.itemsize)
            for array in self.arrays.values()
        )
        pointers = POINTER_BYTES + INTEGER_BYTES * len(WINDOW_INTEGERS)
        return sum(array.size * size for array, size in sizes) + self.integers["sets"] * pointers

    @property
    def stack(self) -> int:
        """Return the bytes of the stack in a step, by estimate."""
        size, integers = self.real.dtype.itemsize, self.integers
        candidates = (integers["families"] + QUEUE) * (4 * CANDIDATE_INTEGERS + CANDIDATE_REALS * size)
        return STACK_BYTES + candidates + 5 * integers["n"] * size

    @property
    def work(self) -> tuple[int, int]:
        """Return the multiply-adds of a sweep, and at most of a change."""
        T, n, m, r, families, k = (self.integers[name] for name in ("T", "n", "m", "r", "families", "most_active"))
        return T * m * r + T * (n + families) * (n + m), T * m * r + 8 * r * k + 3 * k * k

    def disturbed_steps(self) -> list[RecordedStep]:
        """Return steps of a loop with pushes and noise, all from states with a plan; at least one."""
        kernel, rng, reach = self.solver.kernel, np.random.default_rng(0), 1.0
        lti, (_, n, m) = self.tables.loop.lti, self.tables.loop.shape
        drift = np.zeros(n) if lti.offset is None else lti.offset[:, 0]
        measured, free, start = ~self.known, self.measured, lti.start.copy()
        start[self.known] = (self.first_known - self.origin[self.known]) / self.units.x[self.known]
        x, acting, reference, anchor = start, np.zeros(m), np.zeros(free), np.zeros(n)
        farthest, steps = LOST * max(1.0, float(np.abs(x).max())), list[RecordedStep]()
        for k in range(MEASURED):
            moved = lti.B @ acting + drift  # by the control that acts, until a delayed plan begins
            if k % PUSH_EVERY == 0 and k:
                x = x + reach * PUSH * rng.uniform(-1, 1, n) * measured
            if k % PUSH_EVERY == 0 and self.references:
                reference = PUSH * rng.uniform(-1, 1, free)
                stated = _with_reference(self.problem, self.known, reference * self.units.x[measured])
                changed = self.tables.with_data(lti_problem(stated, self.units))
                assert changed is not None  # the same rows are bounded
                kernel.take(changed)
            for _ in range(RETREATS):
                begin = lti.A @ x + moved if self.delay else x
                if np.abs(begin).max() <= farthest and kernel.step(begin) == SOLVED:
                    break
                target, reach = anchor + (begin - anchor) / 4, max(reach / 2, LEAST_REACH)
                if self.delay:
                    back = (target - moved - lti.A[:, self.known] @ x[self.known])[measured]
                    target[measured] = np.linalg.lstsq(lti.A[np.ix_(measured, measured)], back)[0]
                x = np.where(measured, target, x)
            else:
                raise UnsupportedError("problem: no state was found with a plan. lfo.solve(problem) says why.")
            anchor = anchor if k else begin
            steps.append(RecordedStep(x, reference, kernel.control, kernel.changes))
            if self.windows is not None:
                kernel.apply(kernel.control)
            control = acting if self.delay else steps[-1].control
            x = lti.A @ x + lti.B @ control + drift + reach * NOISE * rng.standard_normal(n) * measured
            acting = steps[-1].control
        return steps


def _with_reference(problem: OptimalControlProblem, known: Mask, measured: Array) -> OptimalControlProblem:
    """Return the problem with a reference of the measured states, (measured,)."""
    return problem.with_references({"x_ref": complete_reference(problem, known, measured)})
