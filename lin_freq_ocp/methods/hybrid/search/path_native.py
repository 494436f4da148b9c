"""The embedding of path relaxations in C, compiled once per user and called by ctypes; its source is path.c."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.native_code import compiled_library
from lin_freq_ocp.program.hybrid.path_relaxation import PathProgram

OPTIMAL, DECIDED, INFEASIBLE, STALLED = range(4)
"""How a run ends: at the tolerance; where the cutoff decides; with a ray; without any of these."""

INTEGERS = ("edges", "width", "rows", "signals", "equations", "coupled", "times", "modes", "linear", "conic")
INTEGERS += ("shares", "images")
ARRAYS = ("C", "place", "time", "leaves", "enters", "over", "b", "cost", "G", "share")


class Path(ctypes.Structure):
    """lfo_path of path.c."""

    _fields_ = [(name, ctypes.c_int) for name in INTEGERS] + [(name, ctypes.c_void_p) for name in ARRAYS]


def path_library() -> ctypes.CDLL | None:
    """Return the compiled code; None, with a warning, if there is none."""
    found = compiled_library(__file__, "path.c", "../../dense.h")
    if found is not None:
        found.lfo_path_run.argtypes = [ctypes.c_void_p] * 5 + [ctypes.c_double] * 4
    return found


@dataclass(frozen=True, eq=False)
class PathPoint:
    """The last point of a run, homogeneous in tau: w (E, W), p (equations,), z (E, linear rows).

    ``bound`` is that of (p, z)/tau for an objective on the edges, ``proven`` that which a shortest path proves.
    """

    end: int
    w: Array
    p: Array
    z: Array
    tau: float
    bound: float
    proven: float


def run_path(
    library: ctypes.CDLL, program: PathProgram, tolerance: float, proven: float, cutoff: float, clear: float
) -> PathPoint:
    """Solve a path program to a tolerance of the point and one of its proven bound, or until the cutoff decides.

    A node must be split if the bound misses the cost by less than ``clear`` times the distance to the cutoff.
    """
    (edges, width), k, n = program.cost.shape, program.middle.shape[1], (program.C.shape[1] - 2) // 2
    signals, linear, conic = program.signals.shape[1], program.linear.shape[1], program.cone.shape[1]
    integers = (edges, width, program.C.shape[1], signals, len(program.b), len(program.coupled))
    integers += (program.t[-1] + 1, max(program.i.max(), program.j.max()) + 1, linear, conic, linear - 2 * k, n)
    arrays = (  # edges side by side: the last index
        _with_edges_last(program.C, program.signals),
        _contiguous(program.places.T, np.int64),
        _contiguous(program.t, np.int64),
        _contiguous(program.i, np.int64),
        _contiguous(program.j, np.int64),
        _contiguous(program.coupled),
        _contiguous(program.b),
        _contiguous(program.cost.T),
        _with_edges_last(program.linear, program.cone),
        _contiguous((program.present / program.sizes)[:, 2 * k :].T),
    )
    model = Path(*integers, *(array.ctypes.data for array in arrays))
    w, p, z, ends = np.empty((width, edges)), np.empty(len(program.b)), np.empty((linear + conic, edges)), np.empty(3)
    written = (array.ctypes.data for array in (w, p, z, ends))
    end = library.lfo_path_run(ctypes.byref(model), *written, tolerance, proven, cutoff, clear)
    return PathPoint(end, w.T, p, z[:linear].T, *ends.tolist())


def _contiguous(array: Array | Indices, kind: DTypeLike = np.float64) -> NDArray[np.generic]:
    return np.ascontiguousarray(array, dtype=kind)


def _with_edges_last(first: Array, second: Array) -> Array:
    """Return the rows (E, rows, W) of both as (rows, W, E)."""
    return np.ascontiguousarray(np.concatenate([first, second], axis=1).transpose(1, 2, 0))
