"""The library as a whole: names, defaults, optima by another solver, refused arguments."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.library_physics import solved
from helpers.seeds import seeds
from lin_freq_ocp import library
from lin_freq_ocp.errors import ProblemError

OPTIMA = {  # cost with and without the frequency constraint
    "pendulum": (3199.18631986, 2852.70530277),  # both from two methods that share nothing
    "double_integrator": (6.38576233691, 6.00060024032),
    "two_mass_spring": (50.4862977331, 41.3177311758),
    "crane": (0.719207751701, 0.655514950858),
    "flexible_joint_arm": (984.752938389, 827.388038701),
    "flexible_satellite": (41.0797037435, 32.4357346488),
    "mass_chain": (56.64018380722854, 56.5029911564),
    "quadcopter": (29.6604499018, 28.065115242),
    "elliptic_rendezvous": (0.587739072184, 0.571568434291),
    "quarter_car": (6.85887326012, 4.91039276872),
    "scanner": (4.39154494386, 0.613200976605),
    "two_mass_drive": (169.571733778, 168.567331521),
}
WITHOUT_BAND = {
    "pendulum": {"cutoff": None},
    "double_integrator": {"cutoff_hz": None},
    "two_mass_spring": {"notch_width_hz": None},
    "crane": {"notch_width_hz": None},
    "flexible_joint_arm": {"notch_width_hz": None},
    "flexible_satellite": {"notch_width_hz": None},
    "mass_chain": {"cutoffs_hz": None},
    "quadcopter": {"cutoff_hz": None},
    "elliptic_rendezvous": {"cutoff_hz": None},
    "quarter_car": {"stop_band_hz": None},
    "scanner": {"cutoff_hz": None, "notch_width_hz": None},
    "two_mass_drive": {"notch_width_hz": None},
}


@pytest.mark.parametrize("name", library.LINEAR)
def test_every_problem_is_known_by_the_name_of_its_function(name):
    problem = library.by_name(name)()
    assert library.PROBLEMS[name] is getattr(library, name)
    assert problem.name == name
    assert 20 <= len(library.by_name(name).__doc__.splitlines()[0]) <= 100


@pytest.mark.parametrize("name", library.LINEAR)
def test_controls_are_bounded_and_the_initial_state_is_a_point(name):
    problem = library.by_name(name)()
    assert np.isfinite(problem.control_tube.lower).all()
    assert np.isfinite(problem.control_tube.upper).all()
    assert problem.initial_state.fixed.all()


@pytest.mark.parametrize("name", library.LINEAR)
def test_frequency_constraint_is_there_by_default_and_absent_on_request(name):
    problem, free = library.by_name(name)(), library.by_name(name)(**WITHOUT_BAND[name])
    assert problem.control_stop.any() or problem.state_stop.any()
    assert not free.control_stop.any()
    assert not free.state_stop.any()


@pytest.mark.parametrize("name", seeds(library.LINEAR))
def test_optimum_agrees_with_cvxpy_and_the_frequency_constraint_costs_something(name):
    with_band, without_band = OPTIMA[name]
    problem = library.by_name(name)()
    cost, x, u = solved(problem)
    assert cost == pytest.approx(with_band, rel=1e-6)
    assert problem.cost.value(x, u) == pytest.approx(cost, rel=1e-6)
    free = library.by_name(name)(**WITHOUT_BAND[name])
    cost, x, u = solved(free)
    assert cost == pytest.approx(without_band, rel=1e-6)
    assert with_band > 1.002 * without_band
    stopped = np.abs(np.fft.rfft(x, axis=0))[problem.state_stop], np.abs(np.fft.rfft(u, axis=0))[problem.control_stop]
    assert max(part.max(initial=0) for part in stopped) > 0.1


@pytest.mark.parametrize("name", library.LINEAR)
def test_horizon_of_one_step_is_possible(name):
    assert library.by_name(name)(horizon=1, **WITHOUT_BAND[name]).horizon == 1


def test_unknown_name_suggests_the_nearest():
    with pytest.raises(ProblemError, match=r"one of pendulum, .*Did you mean 'mass_chain'\?"):
        library.by_name("masschain")
    with pytest.raises(ProblemError, match=r"planar_quadrotor\.$"):
        library.by_name("zzz")


@pytest.mark.parametrize("name", library.LINEAR)
@pytest.mark.parametrize(
    "wrong", [{"horizon": 0}, {"horizon": 2.5}, {"initial_state": (0.0,)}, {"terminal_state": (float("nan"), 0.0)}]
)
def test_wrong_arguments_are_problem_errors(name, wrong):
    with pytest.raises(ProblemError):
        library.by_name(name)(**wrong)


@pytest.mark.parametrize("name", [name for name in library.LINEAR if name != "quadcopter"])  # published sampled
def test_sampling_time_below_zero_is_a_problem_error(name):
    with pytest.raises(ProblemError):
        library.by_name(name)(sampling_time=-0.1)


@pytest.mark.parametrize(
    ("name", "wrong", "message"),
    [
        ("pendulum", {"parameters": "other"}, "'paper' or 'physical'"),
        ("double_integrator", {"speed_bound": -1.0}, "speed_bound"),
        ("double_integrator", {"cutoff_hz": 30.0}, "Nyquist"),
        ("two_mass_spring", {"stiffness": 0.0}, "stiffness"),
        ("two_mass_spring", {"notch_width_hz": 0.0}, "width"),
        ("crane", {"cable_length": 0.0}, "cable_length"),
        ("crane", {"swing_bound": -0.1}, "swing_bound"),
        ("crane", {"acceleration_bound": -1.0}, "acceleration_bound"),
        ("flexible_joint_arm", {"stiffness_ratio": 0.0}, "stiffness_ratio"),
        ("flexible_joint_arm", {"torsion_bound": -0.1}, "torsion_bound"),
        ("flexible_satellite", {"torque_bound": -1.0}, "torque_bound"),
        ("mass_chain", {"cutoffs_hz": (4.0,)}, "cutoffs_hz"),
        ("mass_chain", {"cutoffs_hz": 4.0}, "cutoffs_hz"),
        ("mass_chain", {"stiffness": -1.0}, "stiffness"),
        ("mass_chain", {"damping": "much"}, "damping"),
        ("quadcopter", {"reference": (0.0, 0.0, 1.0)}, "reference"),
        ("quadcopter", {"tilt_bound": -0.1}, "tilt_bound"),
        ("quadcopter", {"lowest_height": "low"}, "lowest_height"),
        ("quadcopter", {"rotor_bounds": 13.0}, "rotor_bounds"),
        ("elliptic_rendezvous", {"eccentricity": 1.0}, "eccentricity"),
        ("elliptic_rendezvous", {"eccentricity": (0.1, 0.2)}, "eccentricity"),
        ("elliptic_rendezvous", {"perigee_radius": 0.0}, "perigee_radius"),
        ("elliptic_rendezvous", {"first_anomaly": None}, "first_anomaly"),
        ("quarter_car", {"bump_height": (0.1, 0.1)}, "bump_height"),
        ("quarter_car", {"stop_band_hz": 4.0}, "stop_band_hz"),
        ("quarter_car", {"stop_band_hz": (8.0, 4.0)}, "width"),
        ("scanner", {"resonance_hz": -1.0}, "resonance_hz"),
        ("two_mass_drive", {"torque_bound": -1.0}, "torque_bound"),
        ("two_mass_drive", {"elastic": 1}, "elastic"),
    ],
)
def test_wrong_physics_is_refused_by_name(name, wrong, message):
    with pytest.raises(ProblemError, match=message):
        library.by_name(name)(**wrong)
