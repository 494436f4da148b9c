"""The condensed method's step in C, compiled once per user and called by ctypes; its source is kernel.c."""

from __future__ import annotations

import ctypes
import math
import re
from pathlib import Path

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.methods.condensed.tables import GRADIENT_DEPENDENCE, ROW_TOLERANCE, CondensedTables
from lin_freq_ocp.methods.native_code import compiled_library

NONE = 1e30  # LFO_NONE of kernel.h: no bound, or no limit of a multiplier
FAMILIES, STATES = 64, 64  # LFO_FAMILIES, LFO_STATES of kernel.h

INTEGERS = ("T", "n", "m", "p", "r", "families", "columns", "most_active", "most_changes")
REALS = ("tolerance", "dependent")
BOUNDS = ("lower", "upper", "limit_low", "limit_up")
KERNEL_ARRAYS = tuple(
    re.findall(r"X\((\w+), ([^)]*)\)", Path(__file__).with_name("kernel.h").read_text(encoding="utf-8"))
)
"""LFO_ARRAYS of kernel.h: the names of the arrays of lfo_memory, and their lengths in letters of lfo_model and k."""

COUNTS = ("active", "plans", "changes", "sweeps", "exceeded", "stuck")
ARRAYS = ("A", "B", "K", "d", "W", "E", "C", "D", "size", *BOUNDS, "column")


class Model(ctypes.Structure):
    """lfo_model of kernel.h."""

    _fields_ = (
        [(name, ctypes.c_int) for name in INTEGERS]
        + [(name, ctypes.c_double) for name in REALS]
        + [(name, ctypes.c_void_p) for name in ARRAYS]
    )


class Memory(ctypes.Structure):
    """lfo_memory of kernel.h."""

    _fields_ = (
        [(name, ctypes.c_void_p) for name, _ in KERNEL_ARRAYS]
        + [("member", ctypes.c_void_p), ("flag", ctypes.c_void_p)]
        + [(name, ctypes.c_int) for name in COUNTS]
        + [("worth", ctypes.c_double)]
    )


def part_lengths(T: int, m: int, r: int, k: int) -> dict[str, int]:
    """Return the lengths of the arrays of lfo_memory, for at most k active rows."""
    letters = {"T": T, "m": m, "r": r, "k": k}
    return {name: math.prod(letters[letter] for letter in length.split(" * ")) for name, length in KERNEL_ARRAYS}


def library() -> ctypes.CDLL | None:
    """Return the compiled kernel; None without a compiler, or, with a warning, if the compilation fails."""
    purpose = "the control step in C could not be compiled, NumPy computes it"
    return compiled_library(__file__, ("kernel.h", "kernel.c"), purpose)


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
    """The compiled step with the tables of one problem; the multipliers of a step are the start of the next."""

    def __init__(self, tables: CondensedTables, compiled: ctypes.CDLL):
        self.tables, self._library = tables, compiled
        (T, n, m), count, r = tables.loop.shape, len(tables.families), tables.unknowns
        self._arrays = {name: np.array(array, order="C") for name, array in model_arrays(tables).items()}
        rows = count * (T + 1)
        most = min(r, rows)
        integers = dict(zip(INTEGERS, (T, n, m, n + 1, r, count, T + 1, most, tables.most_changes), strict=True))
        self._model = Model(**integers, tolerance=ROW_TOLERANCE, dependent=GRADIENT_DEPENDENCE)
        self._column = np.arange(T + 1, dtype=np.int16)
        for name, array in (*self._arrays.items(), ("column", self._column)):
            setattr(self._model, name, array.ctypes.data)
        self._memory, model = Memory(), ctypes.byref(self._model)
        self._work = np.zeros(compiled.lfo_reals(model)), np.zeros(most, np.int32), np.zeros(rows, np.int8)
        self._x, self._u, self._weights = np.zeros(n), np.zeros(m), np.zeros((count, T + 1))
        pointers = [ctypes.c_void_p(part.ctypes.data) for part in (*self._work, self._x, self._u, self._weights)]
        memory = ctypes.byref(self._memory)
        # pointers are made once: a call then takes a microsecond
        self._step, self._read = (model, memory, *pointers[3:5], None), (model, memory, pointers[5])
        compiled.lfo_begin(model, memory, *pointers[:3])
        lengths = part_lengths(T, m, r, most)
        ends = np.cumsum(list(lengths.values()))[:-1]
        self._parts = dict(zip(lengths, np.split(self._work[0], ends), strict=True))

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
        weights = np.zeros(self._weights.shape)
        weights.flat[self._work[1][:active]] = self._parts["w"][:active]
        weights.flat[abs(row) - 1] = np.sign(row)
        return weights

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
