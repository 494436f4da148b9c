"""Named problems, each with its source; `lin-freq-ocp list` shows them.

A new benchmark is a function in a file of its own, which returns an OptimalControlProblem, an import here, and an entry
in one of the tables below. Its docstring is what `lin-freq-ocp show` prints of it and of its parameters.
"""

from __future__ import annotations

from collections.abc import Callable

from lin_freq_ocp.errors import ProblemError, suggestion
from lin_freq_ocp.library.linear.crane import crane as crane
from lin_freq_ocp.library.linear.double_integrator import double_integrator as double_integrator
from lin_freq_ocp.library.linear.elliptic_rendezvous import elliptic_rendezvous as elliptic_rendezvous
from lin_freq_ocp.library.linear.flexible_joint_arm import flexible_joint_arm as flexible_joint_arm
from lin_freq_ocp.library.linear.flexible_satellite import flexible_satellite as flexible_satellite
from lin_freq_ocp.library.linear.mass_chain import mass_chain as mass_chain
from lin_freq_ocp.library.linear.pendulum import pendulum as pendulum
from lin_freq_ocp.library.linear.quadcopter import quadcopter as quadcopter
from lin_freq_ocp.library.linear.quarter_car import quarter_car as quarter_car
from lin_freq_ocp.library.linear.scanner import scanner as scanner
from lin_freq_ocp.library.linear.two_mass_spring import two_mass_spring as two_mass_spring
from lin_freq_ocp.library.piecewise.absolute_value import absolute_value as absolute_value
from lin_freq_ocp.library.piecewise.ball_and_paddle import ball_and_paddle as ball_and_paddle
from lin_freq_ocp.library.piecewise.buck_affine import buck_affine as buck_affine
from lin_freq_ocp.library.piecewise.buck_converter import buck_converter as buck_converter
from lin_freq_ocp.library.piecewise.cart_between_walls import cart_between_walls as cart_between_walls
from lin_freq_ocp.library.piecewise.cart_pole_with_walls import cart_pole_with_walls as cart_pole_with_walls
from lin_freq_ocp.library.piecewise.max_min_network import max_min_network as max_min_network
from lin_freq_ocp.library.piecewise.norm_dynamics import norm_dynamics as norm_dynamics
from lin_freq_ocp.library.piecewise.pendulum_with_wall import pendulum_with_wall as pendulum_with_wall
from lin_freq_ocp.library.piecewise.switched_rotation import switched_rotation as switched_rotation
from lin_freq_ocp.problem.ocp import OptimalControlProblem

# Problems with linear dynamics by their names, simple ones first.
LINEAR: dict[str, Callable[..., OptimalControlProblem]] = {
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
# Problems with piecewise-affine dynamics, simple ones first; see docs/hybrid_systems.md.
PIECEWISE_AFFINE: dict[str, Callable[..., OptimalControlProblem]] = {
    "absolute_value": absolute_value,
    "max_min_network": max_min_network,
    "switched_rotation": switched_rotation,
    "pendulum_with_wall": pendulum_with_wall,
    "buck_affine": buck_affine,
    "cart_between_walls": cart_between_walls,
    "cart_pole_with_walls": cart_pole_with_walls,
    "ball_and_paddle": ball_and_paddle,
}
# Problems with piecewise-smooth dynamics: Examples 2 and 3 of the paper.
PIECEWISE_SMOOTH: dict[str, Callable[..., OptimalControlProblem]] = {
    "norm_dynamics": norm_dynamics,
    "buck_converter": buck_converter,
}
# Every problem by its name; the first line of each docstring says what it shows.
PROBLEMS: dict[str, Callable[..., OptimalControlProblem]] = LINEAR | PIECEWISE_AFFINE | PIECEWISE_SMOOTH


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
