"""The piecewise-affine problems of the library: parameters, data, borders, and the equations they stand for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.hybrid_equations import STEPS, outside, random_points, single_step
from lin_freq_ocp import library
from lin_freq_ocp.cli import build
from lin_freq_ocp.errors import ProblemError

ALL = pytest.mark.parametrize("name", library.PIECEWISE_AFFINE)

# --- all of them


@ALL
def test_every_problem_is_described_and_bounded(name):
    problem = library.by_name(name)()
    assert library.PROBLEMS[name] is library.PIECEWISE_AFFINE[name] is getattr(library, name)
    assert problem.name == name
    assert 20 <= len(library.by_name(name).__doc__.splitlines()[0]) <= 100
    assert isinstance(problem.dynamics, lfo.PiecewiseAffineDynamics)
    assert problem.initial_state.fixed.all()
    for box in (problem.state_boxes, problem.control_tube):
        assert np.isfinite(box.lower).all()
        assert np.isfinite(box.upper).all()
    assert len(set(problem.dynamics.mode_names)) == len(problem.dynamics.modes)


def test_linear_problems_come_first():
    hybrid = [*library.PIECEWISE_AFFINE, *library.PIECEWISE_SMOOTH]
    assert [*library.LINEAR, *library.WAVEFORMS, *library.MEASURED, *hybrid] == list(library.PROBLEMS)
    for builder in library.LINEAR.values():
        assert isinstance(builder().dynamics, lfo.LinearDynamics)


@ALL
def test_modes_lead_where_the_original_equations_do(name):
    problem = single_step(name)
    x, u = random_points(problem, 4000)
    inside = outside(problem, x, u) < 0
    assert (inside.sum(axis=1) == 1).all()
    chosen = np.unique(np.concatenate([np.flatnonzero(of_mode)[:30] for of_mode in inside.T] + [np.arange(100)]))
    assert inside[chosen].any(axis=0).all(), "every mode is met"
    for state, control in zip(x[chosen], u[chosen], strict=True):
        reached = lfo.simulate(problem, control[None], initial_state=state).x[1]
        np.testing.assert_allclose(reached, STEPS[name](state, control), rtol=0, atol=1e-12)


@ALL
def test_borders_are_continuous_where_the_original_equations_are(name):
    problem, near = single_step(name), 1e-9
    x, u = random_points(problem, 30_000 if name == "ball_and_paddle" else 4000, seed=1)
    assert problem.borders
    for border in problem.borders:
        beyond = (x @ border.h_x + u @ border.h_u - border.limit)[:, None]
        on_x, on_u = x - beyond * border.h_x, u - beyond * border.h_u
        shared = (outside(problem, on_x, on_u)[:, [border.first, border.second]] <= 1e-12).all(axis=1)
        across = near * border.h_x, near * border.h_u
        jumps = [
            np.abs(np.subtract(STEPS[name](a - across[0], b - across[1]), STEPS[name](a + across[0], b + across[1])))
            for a, b in zip(on_x[shared][:20], on_u[shared][:20], strict=True)
        ]
        assert jumps
        assert (np.max(jumps) < 1e-6) == border.continuous


BORDERS: dict[str, dict[tuple[str, str], bool]] = {
    "absolute_value": {("+", "-"): True},
    "max_min_network": {
        ("x", "-u"): True,
        ("x", "u - x, left"): True,
        ("-u", "u - x, above"): True,
        ("u - x, above", "u - x, left"): True,
    },
    "switched_rotation": {("+", "-"): False},
    "pendulum_with_wall": {("free", "contact"): True},
    "buck_affine": {("on", "off"): True},
    "cart_between_walls": {("free", "impact right"): False, ("free", "impact left"): False},
    "cart_pole_with_walls": {
        ("right wall", "free"): False,
        ("left wall", "free"): False,
        ("right wall", "leaving right"): True,
        ("left wall", "leaving left"): True,
        ("free", "leaving right"): True,
        ("free", "leaving left"): True,
    },
    "ball_and_paddle": {
        **{
            ("free", f"slide {way} {where}"): True for way in ("right", "left") for where in ("on paddle", "at ceiling")
        },
        **{
            (f"stick {where}", f"slide {way} {where}"): True
            for way in ("right", "left")
            for where in ("on paddle", "at ceiling")
        },
        **{
            (f"slide {way} on paddle", f"{law} at ceiling"): False
            for way in ("right", "left")
            for law in ("stick", "slide right", "slide left")
        },
    },
}
"""Which modes meet, the first listed first, and whether the map is continuous there."""


@ALL
def test_borders_are_those_of_the_page(name):
    problem = single_step(name)
    names = problem.dynamics.mode_names
    assert {(names[one.first], names[one.second]): one.continuous for one in problem.borders} == BORDERS[name]


@ALL
def test_spectra_are_those_of_the_references_or_given_or_none(name):
    builder, controls = library.by_name(name), library.by_name(name)().control_dim
    expected = np.zeros((7, controls), dtype=bool)
    expected[4:] = True
    assert np.array_equal(builder(horizon=12, control_spectrum="freq").control_stop, expected)
    assert not builder(horizon=12, control_spectrum=None).control_stop.any()


def test_spectra_are_texts_bins_or_bands():
    def removed(given: Any, horizon: int = 12) -> list[int]:
        return np.flatnonzero(library.absolute_value(horizon, control_spectrum=given).control_stop).tolist()

    for given in ("freq", [4, 5, 6], (4, 5, 6), lfo.stop_band(bins=[4, 5, 6]), [lfo.low_pass(np.pi / 2)]):
        assert removed(given) == [4, 5, 6]
    assert [removed("freq", horizon) for horizon in (4, 5, 6, 9)] == [[2], [2], [2, 3], [3, 4]]
    for given in (None, "none", []):
        assert removed(given) == []


@ALL
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"horizon": 0}, "horizon"),
        ({"horizon": 2.5}, "horizon"),
        ({"initial_state": (0.0,) * 3}, "initial_state"),
        ({"terminal_state": (float("nan"),)}, "terminal_state"),
        ({"terminal_cost": 1}, "terminal_cost"),
        ({"control_spectrum": "low"}, "control_spectrum: got 'low'"),
        ({"control_spectrum": "freq", "horizon": 3}, "at least 4"),
        ({"control_spectrum": [1, 2.5]}, "control_spectrum"),
        ({"control_spectrum": 3}, "control_spectrum"),
        ({"control_spectrum": [True]}, "bins"),
    ],
)
def test_wrong_arguments_are_problem_errors(name, wrong, message):
    with pytest.raises(ProblemError, match=message):
        library.by_name(name)(**wrong)


@pytest.mark.parametrize(
    ("name", "wrong", "message"),
    [
        ("absolute_value", {"control_bound": -1.0}, "control_bound"),
        ("absolute_value", {"preferred_control": (0.1, 0.2)}, "preferred_control"),
        ("absolute_value", {"state_bound": "wide"}, "state_bound"),
        ("max_min_network", {"load_first": 1}, "load_first"),
        ("max_min_network", {"control_bound": 0.0}, "control_bound"),
        ("switched_rotation", {"state_bounds": -1.0}, "state_bounds"),
        ("switched_rotation", {"control_bound": "1"}, "control_bound"),
        ("pendulum_with_wall", {"sampling_time": 0.0}, "sampling_time"),
        ("pendulum_with_wall", {"torque_bound": -4.0}, "torque_bound"),
        ("pendulum_with_wall", {"state_bounds": (0.2,)}, "state_set"),
        ("buck_affine", {"sampling_time": -1.0}, "sampling_time"),
        ("buck_affine", {"pieces": 0}, "pieces"),
        ("buck_affine", {"linearised_at": 2.0}, "linearised_at: got 2.0; expected a voltage above 2 V"),
        ("buck_affine", {"voltage_bounds": (2.0, 6.0)}, "voltage_bounds"),
        ("buck_affine", {"voltage_bounds": (3.0, 2.5)}, "voltage_bounds"),
        ("buck_affine", {"voltage_bounds": None}, "voltage_bounds"),
        ("cart_between_walls", {"restitution": 1.1}, "restitution: got 1.1; expected a number from 0 to 1"),
        ("cart_between_walls", {"restitution": None}, "restitution"),
        ("cart_between_walls", {"speed_bound": -5.0}, "speed_bound"),
        ("cart_pole_with_walls", {"force_bound": -2.0}, "force_bound"),
        ("cart_pole_with_walls", {"sampling_time": None}, "sampling_time"),
        ("ball_and_paddle", {"keep_over_paddle": None}, "keep_over_paddle"),
        ("ball_and_paddle", {"friction": "none"}, "friction"),
        ("ball_and_paddle", {"acceleration_bounds": (1.0, -1.0)}, "acceleration_bounds"),
    ],
)
def test_wrong_physics_is_refused_by_name(name, wrong, message):
    with pytest.raises(ProblemError, match=message):
        library.by_name(name)(**wrong)


@ALL
def test_terminal_cost_is_that_of_a_stage_or_absent(name):
    builder = library.by_name(name)
    with_it, without = builder().cost, builder(terminal_cost=False).cost
    assert not without.P.any()
    assert not without.p.any()
    if with_it.Q.any():
        assert np.array_equal(with_it.P, with_it.Q)
        assert np.array_equal(with_it.Q, without.Q)
        assert not with_it.p.any()
    else:
        assert with_it.p.any()


def test_settings_of_the_command_line():
    problem = build("switched_rotation", ["horizon=9", 'control_spectrum="freq"', "initial_state=[1, 1]"])
    assert np.flatnonzero(problem.control_stop).tolist() == [3, 4]
    assert np.flatnonzero(build("buck_affine", ["control_spectrum=[2]"]).control_stop).tolist() == [2]
    assert not build("max_min_network", ['control_spectrum="none"']).control_stop.any()
    assert not build("pendulum_with_wall", ["terminal_cost=false"]).cost.P.any()


# --- the data as they are printed


def assert_mode(dynamics: lfo.PiecewiseAffineDynamics, name: str, **printed: Any) -> None:
    """Compare A, B, offset, G, H and h of a mode with what is printed; what is not given must be zero."""
    arrays, mode = dynamics.arrays(1), dynamics.mode_names.index(name)
    rows = np.isfinite(arrays.h[0, mode])
    for part in ("A", "B", "offset", "G", "H", "h"):
        given = getattr(arrays, part)[0, mode]
        given = given[rows] if part in ("G", "H", "h") else given
        np.testing.assert_allclose(given, np.reshape(printed.get(part, np.zeros(given.shape)), given.shape), atol=1e-15)


def test_data_of_the_rotation():
    dynamics, c, s = library.switched_rotation().dynamics, 0.4, 0.4 * np.sqrt(3)
    assert dynamics.mode_names == ("+", "-")
    assert_mode(dynamics, "+", A=[[c, -s], [s, c]], B=[0, 1], G=[-1, 0])
    assert_mode(dynamics, "-", A=[[c, s], [-s, c]], B=[0, 1], G=[1, 0])


def test_data_of_the_pendulum():
    dynamics = library.pendulum_with_wall().dynamics
    assert_mode(dynamics, "free", A=[[1, 0.02], [0.2, 1]], B=[0, 0.02], G=[1, 0], h=0.1)
    assert_mode(dynamics, "contact", A=[[1, 0.02], [-1.8, 1]], B=[0, 0.02], offset=[0, 0.2], G=[-1, 0], h=-0.1)


def test_data_of_the_cart():
    dynamics, impact = library.cart_between_walls().dynamics, [[1, 0], [0, -0.5]]
    assert_mode(dynamics, "free", A=[[1, 0.01], [0, 1]], B=[0, 0.01], G=[[1, 0.01], [-1, -0.01]], h=[0.4, 0.4])
    assert_mode(dynamics, "impact right", A=impact, G=[-1, -0.01], h=-0.4)
    assert_mode(dynamics, "impact left", A=impact, G=[1, 0.01], h=-0.4)


def test_data_of_the_cart_pole():
    dynamics = library.cart_pole_with_walls().dynamics
    free = np.array([[1, 0, 0.05, 0], [0, 1, 0, 0.05], [0, 0.5, 1, 0], [0, 1, 0, 1]])
    pushed, B = free.copy(), [0, 0, 0.05, 0.05]
    pushed[3] += 0.05 * np.array([100, -100, 30, -30])  # at the left wall, too: f_l falls as the tip moves right
    into, push = np.array([1, -1, 0, 0]), np.array([100, -100, 30, -30])
    assert_mode(dynamics, "free", A=free, B=B, G=[into, -into], h=[0.5, 0.5])
    assert_mode(dynamics, "right wall", A=pushed, B=B, offset=[0, 0, 0, -2.5], G=[-into, -push], h=[-0.5, -50])
    assert_mode(dynamics, "left wall", A=pushed, B=B, offset=[0, 0, 0, 2.5], G=[into, push], h=[-0.5, -50])
    assert_mode(dynamics, "leaving right", A=free, B=B, G=[-into, push], h=[-0.5, 50])
    assert_mode(dynamics, "leaving left", A=free, B=B, G=[into, -push], h=[-0.5, 50])


def test_data_of_the_buck():
    dynamics, a = library.buck_affine().dynamics, np.exp(-0.5)
    alpha, k = (1 / a - 1) / 2, 2 * a / 0.35
    assert_mode(dynamics, "on", A=a, B=a * alpha, G=1, H=alpha, h=1 / a)
    assert_mode(dynamics, "off", A=-k, B=-k * alpha, offset=1 + k / a, G=-1, H=-alpha, h=-1 / a)


def test_data_of_the_ball():
    """Spot values of the published model: a step in the air, and rows of sticking to the paddle."""
    dynamics = library.ball_and_paddle().dynamics
    arrays, names = dynamics.arrays(1), dynamics.mode_names
    free, stick = (names.index(name) for name in ("free", "stick on paddle"))
    expected = np.eye(10)
    expected[np.arange(5), np.arange(5, 10)] = 0.05
    np.testing.assert_allclose(arrays.A[0, free], expected, atol=1e-15)
    np.testing.assert_allclose(arrays.offset[0, free], [0, -0.025, 0, 0, 0, 0, -0.5, 0, 0, 0], atol=1e-15)
    B = np.zeros((10, 2))
    B[[3, 8], 0] = B[[4, 9], 1] = 0.0025, 0.05
    np.testing.assert_allclose(arrays.B[0, free], B, atol=1e-15)
    speed = np.zeros(10)
    speed[[5, 7, 8]] = 5 / 7, -0.1 * 2 / 7, 2 / 7  # of a solid sphere that rolls on
    np.testing.assert_allclose(arrays.A[0, stick, 5], speed, atol=1e-15)
    np.testing.assert_allclose(arrays.B[0, stick, 5], [0.05 * 2 / 7, 0], atol=1e-15)


COSTS: dict[str, Any] = {  # the cost of a point of x, the last state, and a control, as the references define it
    "switched_rotation": lambda x, u: x @ x + u @ u,
    "pendulum_with_wall": lambda x, u: 100 * x[0] ** 2 + 10 * x[1] ** 2 + u @ u,
    "buck_affine": lambda x, u: 20 * (x[0] - 0.75) ** 2 + u @ u,
    "cart_between_walls": lambda x, u: 0.01 * (x @ x + u @ u),
    "cart_pole_with_walls": lambda x, u: 0.5 * x @ x + 0.05 * u @ u,
    "ball_and_paddle": lambda x, u: (x * x) @ [1, 1, 0.01, 1, 1, 1, 1, 0.01, 1, 1] + (u * u) @ [0.01, 0.001],
}


@pytest.mark.parametrize("name", COSTS)
def test_costs_have_no_one_half(name):
    problem, rng = library.by_name(name)(horizon=3), np.random.default_rng(2)
    x, u = rng.standard_normal((4, problem.state_dim)), rng.standard_normal((3, problem.control_dim))
    stages = sum(COSTS[name](x[t], u[t]) for t in range(3))
    assert problem.value(x, u) == pytest.approx(stages + COSTS[name](x[3], np.zeros_like(u[0])), rel=1e-12)
    without = library.by_name(name)(horizon=3, terminal_cost=False)
    assert without.value(x, u) == pytest.approx(stages, rel=1e-12)
