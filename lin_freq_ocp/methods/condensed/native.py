"""The condensed method's step in C, compiled once per user and called by ctypes; its source is kernel.c."""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.condensed.tables import GRADIENT_DEPENDENCE, ROW_TOLERANCE, CondensedTables
from lin_freq_ocp.methods.condensed.windows import FACETS, ControlWindows, WindowDuals
from lin_freq_ocp.methods.native_code import compiled_library

NONE = 1e30  # LFO_NONE of kernel.h: no bound, or no limit of a multiplier
FAMILIES, STATES = 64, 64  # LFO_FAMILIES, LFO_STATES of kernel.h

INTEGERS: tuple[str, ...] = ("T", "n", "m", "p", "r", "families", "columns", "most_active", "most_changes")
OF_WINDOWS: tuple[str, ...] = ("sets", "cells", "inner")
REALS = ("tolerance", "dependent")
BOUNDS = ("lower", "upper", "limit_low", "limit_up")
ARRAYS = ("A", "B", "K", "d", "W", "E", "C", "D", "size", *BOUNDS)
WINDOW_ARRAYS = ("past", "inner_A", "inner_C", "inner_state", "of_controls")
WINDOW_INTEGERS = ("length", "hop", "points", "slots", "component", "begin", "cell")
COUNTS = ("active", "plans", "changes", "sweeps", "exceeded", "stuck")
HEADER = Path(__file__).with_name("kernel.h").read_text(encoding="utf-8")
KERNEL_ARRAYS, INDICES = (
    re.findall(r"X\((\w+), ([^)]*)\)", HEADER.split(f"#define {name}(X)")[1].split("#define")[0])
    for name in ("LFO_ARRAYS", "LFO_INDICES")
)
"""The arrays of lfo_memory of kernel.h: their names, and their lengths in letters."""


class Model(ctypes.Structure):
    """lfo_model of kernel.h."""

    _fields_ = (
        [(name, ctypes.c_int) for name in (*INTEGERS, *OF_WINDOWS)]
        + [(name, ctypes.c_double) for name in REALS]
        + [(name, ctypes.c_void_p) for name in (*ARRAYS, "windows", *WINDOW_ARRAYS, "column")]
    )


class Windows(ctypes.Structure):
    """lfo_windows of kernel.h."""

    _fields_ = (*((name, ctypes.c_int) for name in WINDOW_INTEGERS), ("wave", ctypes.c_void_p))


class Memory(ctypes.Structure):
    """lfo_memory of kernel.h."""

    _fields_ = (
        [(name, ctypes.c_void_p) for name, _ in (*KERNEL_ARRAYS, *INDICES, ("flag", ""))]
        + [(name, ctypes.c_int) for name in COUNTS]
        + [("worth", ctypes.c_double), ("rest", ctypes.c_double)]
    )


def array_lengths(parts: Sequence[tuple[str, str]], integers: Mapping[str, int]) -> dict[str, int]:
    """Return the lengths of arrays of lfo_memory for the integers of lfo_model, by name."""
    k, controls = integers["most_active"], integers["T"] * integers["m"]
    letters = {**integers, "k": k, "c": controls if integers["sets"] else 0, "a": k if integers["sets"] else 0, "2": 2}
    return {name: math.prod(letters[letter] for letter in length.split(" * ")) for name, length in parts}


def library() -> ctypes.CDLL | None:
    """Return the compiled kernel; None, with a warning, if there is none."""
    return compiled_library(__file__, "kernel.c", "kernel.h")


def data_arrays(tables: CondensedTables) -> dict[str, Array]:
    """Return offsets, bounds and limits by their names in lfo_model, a column for each time 0 .. T."""
    (T, n, _), offset = tables.loop.shape, tables.loop.lti.offset
    sides = np.clip([*tables.bounds, *tables.limits], -NONE, NONE)
    d = np.zeros((T + 1, n)) if offset is None else np.vstack([offset.T, np.zeros(n)])
    return {"d": d, "size": tables.sizes, **dict(zip(BOUNDS, sides, strict=True))}


def model_arrays(tables: CondensedTables) -> dict[str, Array]:
    """Return the arrays of lfo_model by their names, but for ``column``."""
    loop, (T, _, m), C = tables.loop, tables.loop.shape, tables.C + tables.D @ tables.loop.K
    E, back = np.empty((len(C), T + 1, m)), C
    E[:, T] = tables.D
    for t in range(T - 1, -1, -1):
        E[:, t] = back @ loop.lti.B
        back = back @ loop.A
    return {
        "A": loop.A, "B": loop.lti.B, "K": loop.K, "W": np.vstack([tables.W.T, tables.V.T]), "E": E, "C": C,
        "D": tables.D, **data_arrays(tables),
    }  # fmt: skip


class NativeKernel:
    """The compiled step with the tables of one problem; the multipliers of a step are the start of the next.

    With ``windows``, ``apply`` follows each step.
    """

    def __init__(self, tables: CondensedTables, compiled: ctypes.CDLL, windows: ControlWindows | None = None):
        self.tables, self.windows, self._library = tables, windows, compiled
        (T, n, m), count, r = tables.loop.shape, len(tables.families), tables.unknowns
        of_windows = dict.fromkeys(OF_WINDOWS, 0) if windows is None else windows.integers(T)
        rows = count * (T + 1) + of_windows["cells"] * FACETS
        values = T, n, m, n + 1, r, count, T + 1, min(r, rows), tables.most_changes
        integers = dict(zip(INTEGERS, values, strict=True)) | of_windows
        arrays = model_arrays(tables) | {"column": np.arange(T + 1, dtype=np.int16)}
        sets = (Windows * of_windows["sets"])()
        if windows is not None:
            arrays |= windows.arrays(tables)
        self._arrays = {name: np.array(array, order="C") for name, array in arrays.items()}
        for i, numbers in enumerate([] if windows is None else windows.fields(T)):
            sets[i] = Windows(**numbers, wave=self._arrays[f"wave{i}"].ctypes.data)
        self._model = Model(**integers, tolerance=ROW_TOLERANCE, dependent=GRADIENT_DEPENDENCE)
        for name in {*ARRAYS, *WINDOW_ARRAYS, "column"} & self._arrays.keys():
            setattr(self._model, name, self._arrays[name].ctypes.data)
        self._sets, self._model.windows = sets, ctypes.addressof(sets)
        self._memory, model = Memory(), ctypes.byref(self._model)
        self._work = np.zeros(compiled.lfo_reals(model)), np.zeros(compiled.lfo_integers(model), np.int32)
        flags, self._stage = np.zeros(rows, np.int8), (count, T + 1)
        self._x, self._u, self._weights, self._flags = np.zeros(n), np.zeros(m), np.zeros(self._stage), flags
        pointers = [ctypes.c_void_p(part.ctypes.data) for part in (*self._work, flags, self._x, self._u, self._weights)]
        memory = ctypes.byref(self._memory)
        # pointers are made once: a call then takes a microsecond
        self._step, self._read = (model, memory, *pointers[3:5], None), (model, memory, pointers[5])
        self._next = model, memory, pointers[4]
        compiled.lfo_begin(model, memory, *pointers[:3])
        lengths, counts = (array_lengths(parts, integers) for parts in (KERNEL_ARRAYS, INDICES))
        self._parts = dict(zip(lengths, np.split(self._work[0], np.cumsum([*lengths.values()])[:-1]), strict=True))
        self._indices = dict(zip(counts, np.split(self._work[1], np.cumsum([*counts.values()])[:-1]), strict=True))

    def take(self, tables: CondensedTables) -> None:
        """Take other references, offsets, ends and bounds of the same problem; the multipliers stay."""
        self.tables = tables
        self._arrays["W"][tables.loop.shape[1]] = tables.W[:, -1]
        for name, array in data_arrays(tables).items():
            self._arrays[name][:] = array

    @property
    def changes(self) -> int:
        """Return how many changes of the working set the last step made."""
        return self._memory.changes

    def step(self, x: Array, most_changes: int | None = None) -> int:
        """Solve from an initial state, (n,), with so many changes at most; return SOLVED, LIMIT or INFEASIBLE."""
        self._x[:] = x
        self._model.most_changes = self.tables.most_changes if most_changes is None else most_changes
        return self._library.lfo_step(*self._step)

    @property
    def unknowns(self) -> Array:
        """Return xi of the last step, (r,), whether or not its working set has settled."""
        return self._parts["xi"].copy()

    @property
    def ray(self) -> Array | None:
        """Return multipliers of the rows whose gradients cancel, (families, T+1), after INFEASIBLE; else None."""
        row, active = self._memory.stuck, self._memory.active
        if not row:
            return None
        weights = np.zeros(len(self._flags))
        weights[self._indices["member"][:active]] = self._parts["w"][:active]
        weights[abs(row) - 1] = np.sign(row)
        return weights[: math.prod(self._stage)].reshape(self._stage)

    @property
    def control(self) -> Array:
        """Return u_0 of the last step, (m,)."""
        return self._u.copy()

    @property
    def plan(self) -> Array:
        """Return v of the last step, (T m,)."""
        return self._parts["plan"].copy()

    @property
    def multipliers(self) -> Array:
        """Return the multipliers of the rows, (families, T+1)."""
        self._library.lfo_multipliers(*self._read)
        return self._weights.copy()

    @property
    def plan_of_controls(self) -> Array:
        """Return the controls that the last step chose with windows, (T, m)."""
        T, _, m = self.tables.loop.shape
        return self._parts["control"].reshape(T, m).copy()

    @property
    def exceeded(self) -> bool:
        """Whether the last plan exceeds soft rows."""
        return self._memory.exceeded > 0

    @property
    def raised(self) -> float:
        """Return by how much past and rest of the plan before exceed the level of a window, relative; at least 0."""
        return max(float(self._memory.rest) - 1, 0.0)

    @property
    def shift(self) -> Array:
        """Return how far u_0 of the last step moves at most, (m,), if the levels of its active windows change by 1.

        To first order: the gradients of the active rows are R'Q, and xi moves by Q'R'^-1 times the change.
        """
        active, rows = self._memory.active, self._indices["member"]
        Q, R = (self._parts[name].reshape(self._model.most_active, -1)[:active] for name in "QR")
        moved = np.linalg.solve(np.tril(R[:, :active]).T, Q @ self.tables.V[: len(self._u)].T)
        return np.abs(moved[rows[:active] >= math.prod(self._stage)]).sum(axis=0)

    @property
    def window_duals(self) -> Callable[[], Sequence[WindowDuals]]:
        """Return a function that reads the multipliers of each set for the last step."""
        assert self.windows is not None
        active, horizon, indices = self._memory.active, self.tables.loop.shape[0], self._indices
        rows, weights = indices["member"][:active] - math.prod(self._stage), self._parts["lambda"][:active]
        oldest = indices["first"].copy(), indices["begin"].copy()
        return partial(self.windows.duals, horizon, rows, weights.copy(), *oldest)

    def apply(self, u: Array) -> None:
        """Go on to the next step with the control that acts, (m,)."""
        self._u[:] = u
        self._library.lfo_apply(*self._next)

    def correct_past(self, change: Array, ago: int) -> None:
        """Add a change, (m,), to the applied control so many samples before the next plan begins."""
        sums, windows = self._parts["sums"], self.windows.sets if self.windows else ()
        oldest = self._indices["first"], self._indices["begin"]
        for i, (one, of_set, slot, begin) in enumerate(zip(self._sets, windows, *oldest, strict=True)):
            both, first = 2 * one.points, 2 * one.cell
            for age in (-ago - of_set.begins(slot, begin, self.tables.loop.shape[0])[:-1]).tolist():
                if 0 <= age < one.length:
                    sums[first : first + both] += change[one.component] * self._arrays[f"wave{i}"][age]
                first += both
