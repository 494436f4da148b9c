"""Named problems, each with its source; `lin-freq-ocp list` shows them."""

from __future__ import annotations

from collections.abc import Callable

from lin_freq_ocp.errors import ProblemError, suggestion
from lin_freq_ocp.library.crane import crane
from lin_freq_ocp.library.double_integrator import double_integrator
from lin_freq_ocp.library.elliptic_rendezvous import elliptic_rendezvous
from lin_freq_ocp.library.flexible_joint_arm import flexible_joint_arm
from lin_freq_ocp.library.flexible_satellite import flexible_satellite
from lin_freq_ocp.library.mass_chain import mass_chain
from lin_freq_ocp.library.pendulum import pendulum
from lin_freq_ocp.library.quadcopter import quadcopter
from lin_freq_ocp.library.quarter_car import quarter_car
from lin_freq_ocp.library.scanner import scanner
from lin_freq_ocp.library.two_mass_spring import two_mass_spring
from lin_freq_ocp.problem.ocp import OptimalControlProblem

__all__ = [
    "PROBLEMS",
    "by_name",
    "crane",
    "double_integrator",
    "elliptic_rendezvous",
    "flexible_joint_arm",
    "flexible_satellite",
    "mass_chain",
    "pendulum",
    "quadcopter",
    "quarter_car",
    "scanner",
    "two_mass_spring",
]

PROBLEMS: dict[str, Callable[..., OptimalControlProblem]] = {
    "pendulum": pendulum,
    "double_integrator": double_integrator,
    "two_mass_spring": two_mass_spring,
    "crane": crane,
    "flexible_joint_arm": flexible_joint_arm,
    "flexible_satellite": flexible_satellite,
    "mass_chain": mass_chain,
    "quadcopter": quadcopter,
    "elliptic_rendezvous": elliptic_rendezvous,
    "quarter_car": quarter_car,
    "scanner": scanner,
}
"""Every problem by its name, simple ones first; the first line of each docstring says what it shows."""


def by_name(name: str) -> Callable[..., OptimalControlProblem]:
    """Return the function that makes the named problem.

    Raises
    ------
    ProblemError
        If there is no problem of that name; it lists those there are, and the nearest.
    """
    if name in PROBLEMS:
        return PROBLEMS[name]
    raise ProblemError("name", repr(name), f"one of {', '.join(PROBLEMS)}", suggestion(name, PROBLEMS))
