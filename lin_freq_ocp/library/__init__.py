"""Named problems, each with its source; `lin-freq-ocp list` shows them.

A new benchmark is a function that returns an OptimalControlProblem, in a new file or one with similar problems, an
import here, its name in ``__all__``, and an entry in one of the tables below. `lin-freq-ocp show` prints its docstring
and its parameters, and `lin-freq-ocp list` the first line.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files

from lin_freq_ocp.base.errors import answer_misspelt, entry_named
from lin_freq_ocp.library.ball_and_paddle import ball_and_paddle
from lin_freq_ocp.library.flexible import crane, flexible_joint_arm, flexible_satellite
from lin_freq_ocp.library.kinks import absolute_value, max_min_network, switched_rotation
from lin_freq_ocp.library.masses import double_integrator, mass_chain, scanner, two_mass_drive, two_mass_spring
from lin_freq_ocp.library.paper import buck_converter, norm_dynamics, pendulum
from lin_freq_ocp.library.power_electronics import buck_affine, pulse_pattern
from lin_freq_ocp.library.swing_up import cart_pole, pendulum_swing_up, planar_quadrotor
from lin_freq_ocp.library.vehicles import elliptic_rendezvous, quadcopter, quarter_car
from lin_freq_ocp.library.walls import cart_between_walls, cart_pole_with_walls, pendulum_with_wall
from lin_freq_ocp.library.waveforms import StimulatedAxis, mri_gradient, printer_move, wave_energy
from lin_freq_ocp.problem.ocp import OptimalControlProblem

# fmt: off
__all__ = [
    "StimulatedAxis",
    "absolute_value", "ball_and_paddle", "buck_affine", "buck_converter", "cart_between_walls", "cart_pole",
    "cart_pole_with_walls", "crane", "double_integrator", "elliptic_rendezvous", "flexible_joint_arm",
    "flexible_satellite", "mass_chain", "max_min_network", "mri_gradient", "norm_dynamics", "pendulum",
    "pendulum_swing_up", "pendulum_with_wall", "planar_quadrotor", "printer_move", "pulse_pattern", "quadcopter",
    "quarter_car", "scanner", "switched_rotation", "two_mass_drive", "two_mass_spring", "wave_energy",
]
# fmt: on

answer_misspelt(globals())

Benchmark = Callable[..., OptimalControlProblem]


def _by_name(*functions: Benchmark) -> dict[str, Benchmark]:
    return {function.__name__: function for function in functions}


# fmt: off
# Simple problems first.
LINEAR = _by_name(
    pendulum, double_integrator, two_mass_spring, crane, flexible_joint_arm, flexible_satellite, mass_chain, quadcopter,
    elliptic_rendezvous, quarter_car, scanner, two_mass_drive,
)
# See docs/minimum_time.md, docs/residual_vibration.md and docs/levels.md.
WAVEFORMS = _by_name(mri_gradient, printer_move, pulse_pattern)
# See docs/hybrid_systems.md.
PIECEWISE_AFFINE = _by_name(
    absolute_value, max_min_network, switched_rotation, pendulum_with_wall, buck_affine, cart_between_walls,
    cart_pole_with_walls, ball_and_paddle,
)
# fmt: on
PIECEWISE_SMOOTH = _by_name(norm_dynamics, buck_converter, pendulum_swing_up, cart_pole, planar_quadrotor)
# See docs/frequency_response.md.
MEASURED = _by_name(wave_energy)
PROBLEMS = LINEAR | WAVEFORMS | MEASURED | PIECEWISE_AFFINE | PIECEWISE_SMOOTH
# In the order of `lin-freq-ocp list`, which shows problems without a field at its end.
FIELDS = {
    "Motion": "pendulum double_integrator two_mass_spring crane flexible_joint_arm mass_chain quadcopter quarter_car "
    "scanner printer_move two_mass_drive",
    "Medical imaging": "mri_gradient",
    "Power electronics": "pulse_pattern buck_affine buck_converter",
    "Space": "flexible_satellite elliptic_rendezvous",
    "Energy": "wave_energy",
    "Swing-up and flip": "pendulum_swing_up cart_pole planar_quadrotor",
    "Impact and friction": "pendulum_with_wall cart_between_walls cart_pole_with_walls ball_and_paddle",
    "Theory": "absolute_value max_min_network switched_rotation norm_dynamics",
}
# Of the plants, as SVG in the folder sketches; a sketch that is not listed here has the name of its problem.
# fmt: off
SKETCHES = {
    "pendulum": "cart_pendulum", "cart_pole": "cart_pendulum", "double_integrator": "cart", "two_mass_drive": "drive",
    "two_mass_spring": "two_masses", "flexible_satellite": "satellite", "elliptic_rendezvous": "rendezvous",
    "mri_gradient": "gradient_coil", "printer_move": "printer", "pulse_pattern": "inverter",
    "buck_affine": "buck_converter", "wave_energy": "point_absorber", "pendulum_with_wall": "wall",
    "pendulum_swing_up": "swing_up",
}
# fmt: on


def sketch_of(name: str) -> str:
    """Return the sketch of a problem's plant as SVG, in the colours of its page; empty for other names."""
    path = files("lin_freq_ocp.library") / "sketches" / f"{SKETCHES.get(name, name)}.svg"
    return path.read_text(encoding="utf-8") if name in PROBLEMS else ""


def by_name(name: str) -> Benchmark:
    """Return the function that makes the named problem.

    Raises
    ------
    ProblemError
        If there is no problem of that name; it lists all names, and the nearest.
    """
    return entry_named("name", name, PROBLEMS)
