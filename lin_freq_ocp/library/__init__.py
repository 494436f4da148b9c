"""Named problems, each with its source; `lin-freq-ocp list` shows them.

A new benchmark is a function that returns an OptimalControlProblem, in a new file or one with similar problems, an
import here, and an entry in one of the tables below. `lin-freq-ocp show` prints its docstring and its parameters, and
`lin-freq-ocp list` the first line.
"""

from __future__ import annotations

from collections.abc import Callable

from lin_freq_ocp.base.errors import ProblemError, suggestion
from lin_freq_ocp.library.ball_and_paddle import ball_and_paddle as ball_and_paddle
from lin_freq_ocp.library.flexible import crane as crane
from lin_freq_ocp.library.flexible import flexible_joint_arm as flexible_joint_arm
from lin_freq_ocp.library.flexible import flexible_satellite as flexible_satellite
from lin_freq_ocp.library.kinks import absolute_value as absolute_value
from lin_freq_ocp.library.kinks import max_min_network as max_min_network
from lin_freq_ocp.library.kinks import switched_rotation as switched_rotation
from lin_freq_ocp.library.masses import double_integrator as double_integrator
from lin_freq_ocp.library.masses import mass_chain as mass_chain
from lin_freq_ocp.library.masses import scanner as scanner
from lin_freq_ocp.library.masses import two_mass_spring as two_mass_spring
from lin_freq_ocp.library.paper import buck_converter as buck_converter
from lin_freq_ocp.library.paper import norm_dynamics as norm_dynamics
from lin_freq_ocp.library.paper import pendulum as pendulum
from lin_freq_ocp.library.power_electronics import buck_affine as buck_affine
from lin_freq_ocp.library.power_electronics import pulse_pattern as pulse_pattern
from lin_freq_ocp.library.swing_up import cart_pole as cart_pole
from lin_freq_ocp.library.swing_up import pendulum_swing_up as pendulum_swing_up
from lin_freq_ocp.library.swing_up import planar_quadrotor as planar_quadrotor
from lin_freq_ocp.library.vehicles import elliptic_rendezvous as elliptic_rendezvous
from lin_freq_ocp.library.vehicles import quadcopter as quadcopter
from lin_freq_ocp.library.vehicles import quarter_car as quarter_car
from lin_freq_ocp.library.walls import cart_between_walls as cart_between_walls
from lin_freq_ocp.library.walls import cart_pole_with_walls as cart_pole_with_walls
from lin_freq_ocp.library.walls import pendulum_with_wall as pendulum_with_wall
from lin_freq_ocp.library.waveforms import mri_gradient as mri_gradient
from lin_freq_ocp.library.waveforms import printer_move as printer_move
from lin_freq_ocp.library.waveforms import wave_energy as wave_energy
from lin_freq_ocp.problem.ocp import OptimalControlProblem

Benchmark = Callable[..., OptimalControlProblem]


def _by_name(*functions: Benchmark) -> dict[str, Benchmark]:
    return {function.__name__: function for function in functions}


# Simple problems first.
LINEAR = _by_name(
    pendulum,
    double_integrator,
    two_mass_spring,
    crane,
    flexible_joint_arm,
    flexible_satellite,
    mass_chain,
    quadcopter,
    elliptic_rendezvous,
    quarter_car,
    scanner,
)
# See docs/minimum_time.md, docs/residual_vibration.md and docs/levels.md.
WAVEFORMS = _by_name(mri_gradient, printer_move, pulse_pattern)
# See docs/hybrid_systems.md.
PIECEWISE_AFFINE = _by_name(
    absolute_value,
    max_min_network,
    switched_rotation,
    pendulum_with_wall,
    buck_affine,
    cart_between_walls,
    cart_pole_with_walls,
    ball_and_paddle,
)
PIECEWISE_SMOOTH = _by_name(norm_dynamics, buck_converter, pendulum_swing_up, cart_pole, planar_quadrotor)
# See docs/frequency_response.md.
MEASURED = _by_name(wave_energy)
PROBLEMS = LINEAR | WAVEFORMS | MEASURED | PIECEWISE_AFFINE | PIECEWISE_SMOOTH
# In the order of `lin-freq-ocp list`, which shows problems without a field at its end.
FIELDS = {
    "Motion": "pendulum double_integrator two_mass_spring crane flexible_joint_arm mass_chain quadcopter quarter_car "
    "scanner printer_move",
    "Medical imaging": "mri_gradient",
    "Power electronics": "pulse_pattern buck_affine buck_converter",
    "Space": "flexible_satellite elliptic_rendezvous",
    "Energy": "wave_energy",
    "Swing-up and flip": "pendulum_swing_up cart_pole planar_quadrotor",
    "Impact and friction": "pendulum_with_wall cart_between_walls cart_pole_with_walls ball_and_paddle",
    "Theory": "absolute_value max_min_network switched_rotation norm_dynamics",
}


def by_name(name: str) -> Benchmark:
    """Return the function that makes the named problem.

    Raises
    ------
    ProblemError
        If there is no problem of that name; it lists all names, and the nearest.
    """
    if name in PROBLEMS:
        return PROBLEMS[name]
    raise ProblemError("name", repr(name), f"one of {', '.join(PROBLEMS)}", suggestion(name, PROBLEMS))
