"""What every backend returns, and the table of backends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from importlib import import_module

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.transcription.program import Program

DEFAULT_TOLERANCE = 1e-10
"""Feasibility and gap asked of a backend, on a program scaled to order 1: far below the judge's 1e-6."""


class Claim(Enum):
    """What a solver says of its own answer; none is believed before its residuals are computed."""

    SOLVED = "solved"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    LIMIT = "stopped at a limit"
    INTERRUPTED = "interrupted"
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class Solution:
    """A backend's answer in the program's units and signs (P z + q + A'y = 0).

    Attributes
    ----------
    claim : Claim
    z : (variables,) or None
        A point; with UNBOUNDED, a direction of descent.
    y : (rows,) or None
        Duals; with INFEASIBLE, a Farkas ray (A'y = 0 and support < 0 for the bounds).
    words : str
        The solver's own status.
    """

    claim: Claim
    z: Array | None
    y: Array | None
    words: str


Solver = Callable[[Program, float, float | None], Solution]
"""(program, tolerance, time limit in seconds or None) -> Solution."""


def require_no_cones(program: Program, name: str) -> None:
    """Raise UnsupportedError if a quadratic-programming solver is given second-order cones."""
    if program.cones:
        raise UnsupportedError(
            f"backend: {name!r} solves quadratic programs only, and this problem has Euclidean norms (balls, masks, "
            "energy bounds); use 'clarabel'."
        )


_MODULES = {"clarabel": "clarabel_", "osqp": "osqp_", "qpsolvers": "qpsolvers_"}


def backend(name: str) -> Solver:
    """Return the solver of that name; ``qpsolvers:NAME`` is any solver that qpsolvers finds installed.

    Raises
    ------
    UnsupportedError
        If there is no backend of that name.
    MissingExtraError
        If its package is not installed.
    """
    family, _, member = name.partition(":")
    if family not in _MODULES or bool(member) != (family == "qpsolvers"):
        raise UnsupportedError(
            f"backend: got {name!r}; expected 'clarabel', 'osqp' or 'qpsolvers:NAME' (such as 'qpsolvers:piqp')."
        )
    module = import_module(f"lin_freq_ocp.backends.{_MODULES[family]}")
    return module.named(member) if member else module.solve
