"""The answer of every solver, and the register of solvers: a new one is one file and one entry of ``REGISTER``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.errors import UnsupportedError, missing_extra
from lin_freq_ocp.program.program import Program

DEFAULT_TOLERANCE = 1e-10  # feasibility and gap asked of a solver, on a program scaled to order 1
CONTRADICTION = 1e-6  # violation of bounds of order 1 by each other, or of rows without variables: no point exists


class Claim(Enum):
    """The claim of a solver on its answer; the residuals decide."""

    SOLVED = "solved"
    INFEASIBLE = "infeasible"
    UNBOUNDED = "unbounded"
    LIMIT = "stopped at a limit"
    TIME_LIMIT = "stopped at the time limit"
    STOPPED = "stopped as asked"
    INTERRUPTED = "interrupted"
    FAILED = "failed"


@dataclass(frozen=True, eq=False)
class Solution:
    """A solver's answer in the program's units and signs (P z + q + A'y = 0)."""

    claim: Claim
    z: Array | None  # a point, with binaries the best found; with UNBOUNDED, a direction of descent
    y: Array | None  # duals; with INFEASIBLE, a Farkas ray (A'y = 0, support < 0 for the bounds); None with binaries
    message: str  # the status in the words of the solver
    bound: float | None = None  # with binaries: claimed lower bound on the objective, constant included


NO_POINT = Solution(Claim.INFEASIBLE, None, None, "infeasible without a search")
# (program, tolerance, time limit in seconds or None) -> Solution. The tolerance is that of residuals and gap; of a
# program with binaries, the relative gap between cost and bound.
Solver = Callable[[Program, float, float | None], Solution]


@dataclass(frozen=True)
class SolverEntry:
    """A solver in the register.

    Attributes
    ----------
    load : callable
        Returns the solver, given the text after ``name:``.
    package : str, optional
        The package that must be installed.
    binaries, cones : bool
        Whether it solves programs with binaries, and whether it takes second-order cones.
    example : str, optional
        Such a text after ``name:``, if the solver needs one.
    """

    load: Callable[[str], Solver]
    package: str | None = None
    binaries: bool = False
    cones: bool = False
    example: str | None = None


def names(binaries: bool = False) -> list[str]:
    """Return the registered names of solvers for programs with or without binaries."""
    return [name for name, entry in REGISTER.items() if entry.binaries == binaries]


def backend(name: str, binaries: bool = False) -> Solver:
    """Return the solver with this name, for programs with binaries or without.

    Raises UnsupportedError if there is none, and MissingExtraError if its package is not installed.
    """
    family, _, member = name.partition(":")
    entry = REGISTER.get(family)
    if entry is None or entry.binaries != binaries or bool(member) != (entry.example is not None):
        expected = [(known, REGISTER[known].example) for known in names(binaries)]
        listed = [f"'{known}'" if example is None else f"'{known}:NAME'" for known, example in expected]
        examples = [f" (such as '{known}:{example}')" for known, example in expected if example]
        purpose = " for a mixed-integer program" if binaries else "".join(examples)
        raise UnsupportedError(f"backend: got {name!r}; expected {', '.join(listed[:-1])} or {listed[-1]}{purpose}.")
    if entry.package is not None and find_spec(entry.package) is None:
        raise missing_extra(f"backend {name!r}", entry.package, family)
    solver = entry.load(member)

    def solve(program: Program, tolerance: float, time_limit: float | None) -> Solution:
        if program.cones and not entry.cones:
            raise UnsupportedError(
                f"backend: {name!r} solves quadratic programs only, and this problem has Euclidean norms (balls, "
                "masks, energy bounds); use 'clarabel'."
            )
        return solver(program, tolerance, time_limit)

    return solve


def _module(name: str) -> ModuleType:
    """Return a file of this folder, imported when its solver is first needed."""
    return import_module(f"lin_freq_ocp.program.backends.{name}")


REGISTER: dict[str, SolverEntry] = {
    "clarabel": SolverEntry(lambda _: _module("clarabel_").solve, cones=True),
    "osqp": SolverEntry(lambda _: _module("osqp_").solve),
    "qpsolvers": SolverEntry(lambda member: _module("qpsolvers_").solver(member), example="piqp"),
    "scip": SolverEntry(lambda _: _module("scip_").solve, package="pyscipopt", binaries=True, cones=True),
    "daqp": SolverEntry(lambda _: _module("daqp_").solve, package="daqp", binaries=True),
}
"""The solvers by name; a new one is one more entry."""
