"""What every mixed-integer backend returns, and the table of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.backends.base import Claim
from lin_freq_ocp.errors import MissingExtraError, UnsupportedError
from lin_freq_ocp.transcription.program import Program


@dataclass(frozen=True, eq=False)
class MixedSolution:
    """What a solver says of a program with binaries; nothing of it is proven.

    Attributes
    ----------
    claim : Claim
    z : (variables,) or None
        The best point found, also with LIMIT and INTERRUPTED.
    bound : float or None
        A claimed lower bound on the program's objective, constant included.
    words : str
        The solver's own status.
    """

    claim: Claim
    z: Array | None
    bound: float | None
    words: str


NOTHING = MixedSolution(Claim.INFEASIBLE, None, None, "infeasible without a search")
"""The answer to a program whose bounds exclude each other."""

EXCLUDED = 1e-6
"""Bounds of order 1 exclude each other, or rows without variables are violated, by this much: solvers forgive less."""

MixedSolver = Callable[[Program, Indices, float | None, float], MixedSolution]
"""(program, indices of binaries, time limit in seconds or None, relative gap) -> MixedSolution."""

_MODULES = {"scip": ("scip_", "pyscipopt"), "daqp": ("daqp_", "daqp")}


def mixed_backend(name: str) -> MixedSolver:
    """Return the solver of that name.

    Raises
    ------
    UnsupportedError
        If there is no mixed-integer backend of that name.
    MissingExtraError
        If its package is not installed.
    """
    if name not in _MODULES:
        raise UnsupportedError(f"backend: got {name!r}; expected 'scip' or 'daqp' for a mixed-integer program.")
    module, package = _MODULES[name]
    try:
        import_module(package)
    except ImportError:
        raise MissingExtraError(
            f"backend {name!r}: {package} is not installed. Install it with: pip install 'lin-freq-ocp[{name}]'."
        ) from None
    return import_module(f"lin_freq_ocp.backends.{module}").solve


@dataclass(frozen=True, eq=False)
class Bounded:
    """The rows of a program that stand alone, with those about one variable as its bounds.

    Attributes
    ----------
    below, above : (variables,)
        Bounds of the variables.
    A : sparse (rows, variables); lower, upper : (rows,)
        The other rows, outside cones; none is empty.
    consistent : bool
        Whether no bound excludes another, and rows without variables hold.
    """

    below: Array
    above: Array
    A: sp.csr_array
    lower: Array
    upper: Array
    consistent: bool


def bounded(program: Program) -> Bounded:
    """Return the rows outside cones, with bounds apart."""
    A = sp.csr_array(program.A)
    count = np.diff(A.indptr)
    single = program.alone & (count == 1)
    below, above = np.full(len(program.q), -np.inf), np.full(len(program.q), np.inf)
    first = A.indptr[:-1][single]
    column, value = A.indices[first], A.data[first]
    limits = np.sort([program.lower[single] / value, program.upper[single] / value], axis=0)
    np.maximum.at(below, column, limits[0])
    np.minimum.at(above, column, limits[1])
    empty, rest = program.alone & (count == 0), program.alone & (count > 1)
    excess = np.concatenate([below - above, program.lower[empty], -program.upper[empty]])
    above = np.where(below > above, below, above)
    consistent = bool(excess.max(initial=0.0) <= EXCLUDED)
    return Bounded(below, above, sp.csr_array(A[rest]), program.lower[rest], program.upper[rest], consistent)
