"""What every solver returns, and the register of solvers: a new one is one file and one call of ``register``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from importlib.util import find_spec

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.errors import MissingExtraError, UnsupportedError
from lin_freq_ocp.transcription.program import Program

# Feasibility and gap asked of a solver, on a program scaled to order 1: far below the judge's 1e-6
DEFAULT_TOLERANCE = 1e-10
# Bounds of order 1 exclude each other, or rows without variables are violated, by this much: solvers forgive less
EXCLUDED = 1e-6


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
    """A solver's answer in the program's units and signs (P z + q + A'y = 0).

    Attributes
    ----------
    claim : Claim
    z : (variables,) or None
        A point, of programs with binaries the best found; with UNBOUNDED, a direction of descent.
    y : (rows,) or None
        Duals; with INFEASIBLE, a Farkas ray (A'y = 0 and support < 0 for the bounds). None with binaries.
    words : str
        The solver's own status.
    bound : float or None
        With binaries: a claimed lower bound on the program's objective, constant included.
    """

    claim: Claim
    z: Array | None
    y: Array | None
    words: str
    bound: float | None = None


# The answer to a program whose bounds exclude each other
NO_POINT = Solution(Claim.INFEASIBLE, None, None, "infeasible without a search")
# (program, tolerance, time limit in seconds or None) -> Solution. The tolerance is that of residuals and gap; of a
# program with binaries, the relative gap between cost and bound.
Solver = Callable[[Program, float, float | None], Solution]


@dataclass(frozen=True)
class _Entry:
    """How a registered solver is loaded, the package it needs, and which programs it takes."""

    load: Callable[[str], Solver]
    package: str | None
    binaries: bool
    cones: bool
    example: str | None


_REGISTER: dict[str, _Entry] = {}


def register(
    name: str,
    load: Callable[[str], Solver],
    package: str | None = None,
    binaries: bool = False,
    cones: bool = False,
    example: str | None = None,
) -> None:
    """Make a solver known.

    Parameters
    ----------
    name : str
    load : callable
        Returns the solver, given what follows ``name:``; called when the solver is first asked for.
    package : str, optional
        What must be installed.
    binaries, cones : bool
        Whether it is a solver of programs with binaries, and whether it takes second-order cones.
    example : str, optional
        Of what follows ``name:``, where something must.
    """
    _REGISTER[name] = _Entry(load, package, binaries, cones, example)


def names(binaries: bool = False) -> list[str]:
    """Return the registered names of solvers for programs with or without binaries."""
    return [name for name, entry in _REGISTER.items() if entry.binaries == binaries]


def backend(name: str, binaries: bool = False) -> Solver:
    """Return the solver of that name, for programs with binaries or without.

    Raises
    ------
    UnsupportedError
        If there is no such solver.
    MissingExtraError
        If its package is not installed.
    """
    family, _, member = name.partition(":")
    entry = _REGISTER.get(family)
    if entry is None or entry.binaries != binaries or bool(member) != (entry.example is not None):
        raise UnsupportedError(f"backend: got {name!r}; expected {_expected(binaries)}.")
    if entry.package is not None and find_spec(entry.package) is None:
        raise MissingExtraError(
            f"backend {name!r}: {entry.package} is not installed. "
            f"Install it with: pip install 'lin-freq-ocp[{family}]'."
        )
    solver = entry.load(member)

    def solve(program: Program, tolerance: float, time_limit: float | None) -> Solution:
        if program.cones and not entry.cones:
            raise UnsupportedError(
                f"backend: {name!r} solves quadratic programs only, and this problem has Euclidean norms (balls, "
                "masks, energy bounds); use 'clarabel'."
            )
        return solver(program, tolerance, time_limit)

    return solve


def _expected(binaries: bool) -> str:
    entries = [(name, _REGISTER[name].example) for name in names(binaries)]
    listed = [f"'{name}'" if example is None else f"'{name}:NAME'" for name, example in entries]
    examples = [f" (such as '{name}:{example}')" for name, example in entries if example]
    purpose = " for a mixed-integer program" if binaries else "".join(examples)
    return f"{', '.join(listed[:-1])} or {listed[-1]}{purpose}"


def _module(name: str) -> Callable[[str], Solver]:
    """Return what loads ``solver(member)`` of a module of this folder."""
    return lambda member: import_module(f"lin_freq_ocp.backends.{name}").solver(member)


register("clarabel", _module("clarabel_"), cones=True)
register("osqp", _module("osqp_"))
register("qpsolvers", _module("qpsolvers_"), example="piqp")
register("scip", _module("scip_"), package="pyscipopt", binaries=True, cones=True)
register("daqp", _module("daqp_"), package="daqp", binaries=True)
