"""Linear dynamics along a trajectory of a nonlinear model, against pendulums that are differentiated by hand."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.seeds import expensive

PERIOD = 0.1
GRAVITY, DAMPING = 9.81, 0.3


def pendulum_slope(t, x, u, params):
    """Return dx/dt of a damped pendulum, x = (angle, speed); at 0 it hangs."""
    gain = params.get("gain", 1.0)
    return np.array([x[1], -GRAVITY * np.sin(x[0]) - DAMPING * x[1] + gain * u[0] * np.cos(x[0])])


def pendulum(dt=0.0):
    return control.nlsys(pendulum_slope, None, states=["angle", "speed"], inputs=["force"], dt=dt)


def jacobians(x, u):
    """Return the derivatives of the slope by x and by u, by hand."""
    return (
        np.array([[0, 1], [-GRAVITY * np.cos(x[0]) - u[0] * np.sin(x[0]), -DAMPING]]),
        np.array([[0], [np.cos(x[0])]]),
    )


def sampled(x, u, steps=400):
    """Return the state after one period and its derivatives, by Runge-Kutta steps of the equations by hand."""

    def slope(y):
        x, phi = y[:2], y[2:].reshape(2, 3)
        A, B = jacobians(x, u)
        return np.concatenate([pendulum_slope(0, x, u, {}), (A @ phi + np.hstack([np.zeros((2, 2)), B])).ravel()])

    y, h = np.concatenate([x, np.eye(2, 3).ravel()]), PERIOD / steps
    for _ in range(steps):
        k1 = slope(y)
        k2 = slope(y + h / 2 * k1)
        k3 = slope(y + h / 2 * k2)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(y + h * k3))
    return y[:2], y[2:].reshape(2, 3)


def replayed(u, start):
    """Return the states of the nonlinear pendulum, u being held over each period."""
    x = [np.asarray(start, dtype=float)]
    for force in u:
        answer = solve_ivp(lambda t, y, f: pendulum_slope(t, y, f, {}), (0, PERIOD), x[-1], args=(force,), rtol=1e-11)
        x.append(answer.y[:, -1])
    return np.array(x)


def somewhere(T=7, seed=4):
    rng = np.random.default_rng(seed)
    return rng.uniform(-2, 2, size=(T + 1, 2)), rng.uniform(-3, 3, size=(T, 1))


@expensive
@pytest.mark.parametrize("integrator", ["DOP853", "Radau"])
def test_a_sampled_pendulum_has_the_analytic_derivatives(integrator):
    x, u = somewhere(3)
    dynamics = lfo.LinearDynamics.linearised(pendulum(), x, u, PERIOD, integrator=integrator)
    assert (dynamics.A.shape, dynamics.B.shape, dynamics.offset.shape) == ((3, 2, 2), (3, 2, 1), (3, 2))
    assert dynamics.sampling_time == PERIOD
    assert (dynamics.state_names, dynamics.control_names) == (("angle", "speed"), ("force",))
    successors = dynamics.successors(x, u)
    for t in range(3):
        after, slope = sampled(x[t], u[t])
        np.testing.assert_allclose(successors[t], after, rtol=0, atol=2e-11)
        np.testing.assert_allclose(np.hstack([dynamics.A[t], dynamics.B[t]]), slope, rtol=0, atol=2e-11)


def test_a_discrete_model_is_reproduced_exactly():
    """Its value to rounding; its derivatives to that of the differences."""
    x, u = somewhere()
    dynamics = lfo.LinearDynamics.linearised(pendulum(dt=PERIOD), x, u)
    expected = np.array([pendulum_slope(0, *point, {}) for point in zip(x[:-1], u, strict=True)])
    np.testing.assert_allclose(dynamics.successors(x, u), expected, rtol=0, atol=1e-14)
    for t in range(7):
        A, B = jacobians(x[t], u[t])
        np.testing.assert_allclose(dynamics.A[t], A, rtol=0, atol=2e-11)
        np.testing.assert_allclose(dynamics.B[t], B, rtol=0, atol=2e-11)
    assert dynamics.sampling_time == PERIOD


def test_a_point_gives_a_constant_model():
    """Upright, the pendulum is the linear one; the last state of a trajectory takes no part."""
    x, u = np.array([np.pi, 0.0]), np.array([0.0])
    dynamics = lfo.LinearDynamics.linearised(pendulum(), x, u, PERIOD, state_names=["a [rad]", "w [rad/s]"])
    assert not dynamics.time_varying
    A, B = jacobians(x, u)
    expected = expm(PERIOD * np.block([[A, B], [np.zeros((1, 3))]]))
    np.testing.assert_allclose(np.hstack([dynamics.A, dynamics.B]), expected[:2], rtol=0, atol=1e-11)
    np.testing.assert_allclose(dynamics.successors(x[None], u[None])[0], x, rtol=0, atol=1e-11)  # an equilibrium
    assert dynamics.state_names == ("a [rad]", "w [rad/s]")
    along = lfo.LinearDynamics.linearised(pendulum(), np.tile(x, (4, 1)), np.zeros((3, 1)), PERIOD)
    np.testing.assert_allclose(along.A, np.broadcast_to(dynamics.A, (3, 2, 2)), rtol=1e-12)


def test_a_linear_model_is_sampled_as_ever():
    plant = control.ss([[0, 1], [-2, -0.3]], [[0], [1.5]], [[1, 0]], [[0]])
    dynamics = lfo.LinearDynamics.linearised(plant, [0.3, -40.0], [2.0], PERIOD)
    expected = lfo.LinearDynamics.from_statespace(plant, PERIOD)
    np.testing.assert_allclose(dynamics.A, expected.A, rtol=0, atol=1e-11)
    np.testing.assert_allclose(dynamics.B, expected.B, rtol=0, atol=1e-11)
    np.testing.assert_allclose(dynamics.offset, 0, atol=1e-10)


def test_parameters_and_time_reach_the_model():
    """The slope of u is the gain times the time; period t begins at t times the sampling time."""

    def update(t, x, u, params):
        return params["gain"] * t * u

    system = control.nlsys(update, None, states=1, inputs=1, dt=0, params={"gain": 1.0})
    x, u = np.zeros((4, 1)), np.zeros((3, 1))
    dynamics = lfo.LinearDynamics.linearised(system, x, u, 0.5, params={"gain": 3.0})
    begins = 0.5 * np.arange(3)
    np.testing.assert_allclose(dynamics.B[:, 0, 0], 3 * ((begins + 0.5) ** 2 - begins**2) / 2, rtol=1e-11)
    discrete = control.nlsys(update, None, states=1, inputs=1, dt=True, params={"gain": 2.0})
    dynamics = lfo.LinearDynamics.linearised(discrete, x, u)
    np.testing.assert_allclose(dynamics.B[:, 0, 0], [0, 2, 4], rtol=1e-11, atol=1e-13)
    assert dynamics.sampling_time is None


def test_natural_sizes_set_the_steps():
    """A model that bends within a micrometre needs to know that 1e-6 is its size; without it there is no answer."""

    def update(t, x, u, params):
        return 1e-6 * np.sin(x / 1e-6) + u

    system = control.nlsys(update, None, states=1, inputs=1, dt=1)
    x, u = [0.4e-6], [0.0]
    A = lfo.LinearDynamics.linearised(system, x, u, state_scale=1e-6, control_scale=[1e-6]).A
    assert A[0, 0] == pytest.approx(np.cos(0.4), rel=1e-10)
    with pytest.raises(lfo.errors.ProblemError, match=r"derivatives of state 0 by x\[0\].*State state_scale") as caught:
        lfo.LinearDynamics.linearised(system, x, u)
    assert caught.value.field == "system, t = 0"


@pytest.mark.parametrize(("turns", "tolerance"), [(0, 1e-10), (16, 3e-9), (160, 3e-7)])
def test_an_angle_may_have_turned_often(turns, tolerance):
    """The steps grow slower than the angle: after 160 turns they are 0.03 rad, not 1 rad."""
    x, u = np.array([0.5 + 2 * np.pi * turns, 1.0]), np.array([2.0])
    dynamics = lfo.LinearDynamics.linearised(pendulum(dt=PERIOD), x, u)
    np.testing.assert_allclose(dynamics.A, jacobians(x, u)[0], rtol=0, atol=GRAVITY * tolerance)


@pytest.mark.parametrize("where", [1e-4, -1e-4])
def test_near_a_kink_there_are_no_derivatives(where):
    """Dry friction; away from the kink, and with drag v|v|, which is smooth enough at rest, there are."""

    def linearised(friction, speed):
        system = control.nlsys(lambda t, x, u, params: u - friction(x), None, states=["v"], inputs=["f"], dt=0)
        return lfo.LinearDynamics.linearised(system, [speed], [0.0], PERIOD)

    with pytest.raises(lfo.errors.ProblemError, match="farther from the kink"):
        linearised(np.abs, where)
    away = linearised(np.abs, 1000 * where).A[0, 0]
    assert away == pytest.approx(np.exp(-PERIOD * np.sign(where)), rel=1e-9)
    assert linearised(lambda v: v * np.abs(v), 0.0).A[0, 0] == pytest.approx(1.0, abs=1e-3 * PERIOD)


@pytest.mark.parametrize("dt", [0, PERIOD])
@pytest.mark.parametrize(
    ("update", "found"),
    [
        (lambda x, u: u[0] - abs(x[0]), "state 0 by x[0]: 1 on the left, -1 on the right"),
        (lambda x, u: x[0] + max(u[0] - 2, 0), "state 0 by u[0]: 0 on the left, 1 on the right"),
        (lambda x, u: 5 * x[0] + np.tanh(x[1]) * np.sign(x[1]), "state 0 by x[1]: -1 on the left, 1 on the right"),
        (lambda x, u: np.sqrt(abs(x[1])), "on the left"),
        (lambda x, u: 1e-4 * abs(x[0] - 1e-11), "on the left"),
    ],
)
def test_at_a_kink_there_are_no_derivatives(update, found, dt):
    """Central differences are those of a smooth model there."""
    system = control.nlsys(lambda t, x, u, params: [update(x, u), -x[1]], None, states=2, inputs=1, dt=dt)
    with pytest.raises(lfo.errors.ProblemError, match="farther from the kink") as caught:
        lfo.LinearDynamics.linearised(system, [0.0, 0.0], [2.0], PERIOD)
    assert found in str(caught.value)
    assert caught.value.field == "system, t = 0"
    assert lfo.LinearDynamics.linearised(system, [0.5, 0.5], [3.0], PERIOD).A.shape == (2, 2)


@pytest.mark.parametrize(
    "smooth", [lambda v: v**2, lambda v: v**3 - 1e3, lambda v: abs(v) ** 1.5, lambda v: v * abs(v), np.cos, np.cosh]
)
@pytest.mark.parametrize("point", [0.0, 1e-3, -2.0])
def test_curvature_is_no_kink(smooth, point):
    system = control.nlsys(lambda t, x, u, params: smooth(x) + u, None, states=1, inputs=1, dt=PERIOD)
    slope = lfo.LinearDynamics.linearised(system, [point], [0.0]).A[0, 0]
    assert slope == pytest.approx((smooth(point + 1e-6) - smooth(point - 1e-6)) / 2e-6, abs=2e-3)


@expensive
def test_stiff_models_are_sent_to_the_implicit_integrator(monkeypatch):
    """The time constant 1e-5 s is over at once: after 0.1 s the fast state is at 2 u, and nothing else matters."""
    system = control.nlsys(lambda t, x, u, params: (2 * u - x) / 1e-5, None, states=1, inputs=1, dt=0)
    substitute(monkeypatch, "problem.MOST_EVALUATIONS", 100)
    with pytest.raises(lfo.errors.ProblemError, match="integrator='Radau'") as caught:
        lfo.LinearDynamics.linearised(system, [1.0], [0.5], PERIOD)
    monkeypatch.undo()
    assert caught.value.field == "system, t = 0"
    dynamics = lfo.LinearDynamics.linearised(system, [1.0], [0.5], PERIOD, integrator="Radau")
    np.testing.assert_allclose([dynamics.A[0, 0], dynamics.B[0, 0], dynamics.offset[0]], [0, 2, 0], atol=1e-9)


@expensive
def test_one_step_around_a_trajectory_reduces_the_miss():
    """Swing to 2 rad at rest: the optimum of the model along a trajectory misses the end by less than that did."""
    T, start, goal = 20, [0.0, 0.0], [2.0, 0.0]

    def optimum_around(x, u):
        problem = lfo.OptimalControlProblem(
            dynamics=lfo.LinearDynamics.linearised(pendulum(), x, u, PERIOD),
            horizon=T,
            cost=lfo.QuadraticCost(R=1.0),
            control_set=lfo.Box(-60, 60),
            initial_state=start,
            terminal_state=goal,
            control_spectrum=lfo.low_pass(cutoff_hz=4),
        )
        result = lfo.solve(problem)
        assert result.certificate.pmp == "satisfied"
        return result.trajectory.u

    u, misses = np.zeros((T, 1)), []
    for _ in range(5):
        x = replayed(u, start)
        misses.append(np.abs(x[-1] - goal).max())
        u = optimum_around(x, u)
    assert misses[1] < 0.8 * misses[0]
    constant = lfo.LinearDynamics.linearised(pendulum(), start, [0.0], PERIOD)
    assert constant.A.ndim == 2
    assert misses[-1] < 1e-3 * misses[0]


POINT = np.zeros(2), np.zeros(1)


@pytest.mark.parametrize(
    ("change", "field", "words"),
    [
        ({"system": control.tf([1], [1, 1])}, "system", "got TransferFunction"),
        ({"system": "pendulum"}, "system", "See control.nlsys"),
        ({"system": pendulum(dt=None)}, "system.dt", "Set system.dt"),
        ({"sampling_time": None}, "sampling_time", "The system is continuous"),
        ({"sampling_time": -1.0}, "dynamics.sampling_time", "above zero"),
        ({"system": pendulum(dt=0.2)}, "sampling_time", "0.2, the sampling time of the discrete system"),
        ({"integrator": "Euler"}, "integrator", "'DOP853' or 'Radau'"),
        (
            {"x": np.zeros(3)},
            "x, u",
            "got shapes (3,) and (1,); expected x (2,) and u (1,), or x (T+1, 2) and u (T, 1)",
        ),
        ({"u": np.zeros(2)}, "x, u", "shapes (2,) and (2,)"),
        ({"u": np.zeros((4, 1))}, "x, u", "shapes (2,) and (4, 1)"),
        ({"x": np.zeros((6, 2)), "u": np.zeros((4, 1))}, "x, u", "shapes (6, 2) and (4, 1)"),
        ({"x": np.zeros((2, 5)), "u": np.zeros((1, 4))}, "x, u", "time is axis 0"),
        ({"x": [0.0, np.nan]}, "x[1]", "got nan"),
        ({"state_scale": 0.0}, "state_scale", "above zero"),
        ({"control_scale": [1.0, 2.0]}, "control_scale", "or 1 of them"),
        ({"state_names": ["one"]}, "dynamics.state_names", "2 different names"),
    ],
)
def test_what_does_not_fit_is_refused(change, field, words):
    given = {"system": pendulum(), "x": POINT[0], "u": POINT[1], "sampling_time": PERIOD} | change
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.LinearDynamics.linearised(**given)
    assert caught.value.field == field
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("update", "words"),
    [
        (lambda t, x, u, params: np.array([np.nan, 0.0]), "got [nan, 0.0] at x = "),
        (lambda t, x, u, params: np.zeros(3), "expected 2 finite numbers, one per state"),
        (lambda t, x, u, params: np.array([1j, 0]), "expected 2 finite numbers"),
        (lambda t, x, u, params: np.array([0, 1e6 * (1 + x[1] ** 2)]), "system, t = 2: got"),  # infinite at once
    ],
    ids=["nan", "three derivatives", "complex", "escape"],
)
def test_models_without_a_finite_value_are_refused_with_the_time(update, words):
    """Up to time 1 the model is at rest; what it does then is met in the third of periods of 0.5 s."""
    system = control.nlsys(
        lambda t, x, u, params: update(t, x, u, params) if t > 1 else np.zeros(2), None, states=2, inputs=1, dt=0
    )
    with np.errstate(over="ignore", invalid="ignore"), pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.LinearDynamics.linearised(system, np.zeros((4, 2)), np.zeros((3, 1)), 0.5)
    assert words in str(caught.value)
    assert "t = " in caught.value.field


def rotating(t, x, u, params):
    """Return the state after one period of a pendulum, by Euler's method."""
    return x + PERIOD * pendulum_slope(t, x, u, params)


def lifted(dynamics, horizon=8):
    cost, box = lfo.QuadraticCost(Q=0.1, R=1.0), lfo.Box(-4, 4)
    return lfo.OptimalControlProblem(dynamics, horizon, cost, box, initial_state=[0, 0], terminal_state=[0.3, 0])


@expensive
def test_successive_linearisation_ends_where_formulas_do():
    system = control.nlsys(rotating, None, states=["angle", "speed"], inputs=["force"], dt=PERIOD)
    dynamics = lfo.PiecewiseSmoothDynamics.from_system(system)
    assert (dynamics.state_names, dynamics.sampling_time) == (("angle", "speed"), PERIOD)
    formulas = lfo.PiecewiseSmoothDynamics.from_formulas(
        lambda x, u: [
            x[0] + PERIOD * x[1],
            x[1] + PERIOD * (-GRAVITY * np.sin(x[0]) - DAMPING * x[1] + u[0] * np.cos(x[0])),
        ],
        2,
        1,
    )
    found, expected = (lfo.solve(lifted(one), global_bound=False) for one in (dynamics, formulas))
    assert found.status == "locally_optimal"
    assert found.cost == pytest.approx(expected.cost, rel=1e-8)
    again = lfo.LinearDynamics.linearised(system, found.trajectory.x, found.control)
    assert lfo.solve(lifted(again)).cost == pytest.approx(found.cost, rel=1e-8)  # its own linearisation


def test_a_continuous_model_is_sampled():
    dynamics = lfo.PiecewiseSmoothDynamics.from_system(pendulum(), PERIOD)
    x, u = np.array([0.3, -0.2]), np.array([0.7])
    successor, slope = sampled(x, u)
    found = dynamics.jets_at(np.append(x, u)[None]).f[0]
    np.testing.assert_allclose(found.values[0], successor, atol=1e-9)
    np.testing.assert_allclose(found.slopes[0], slope, atol=1e-7)


def test_a_model_without_a_value_is_not_defined_there():
    def failing(t, x, u, params):
        return np.sqrt(x) + u

    system = control.nlsys(failing, None, states=["x"], inputs=["u"], dt=1.0)
    dynamics = lfo.PiecewiseSmoothDynamics.from_system(system)
    found = dynamics.jets_at(np.array([[4.0, 1.0], [-1.0, 0.0]])).f[0]
    assert found.values[0, 0] == pytest.approx(3.0)
    assert np.isnan(found.values[1, 0])
    with pytest.raises(lfo.errors.ProblemError, match=r"system: got int; expected a control.NonlinearIOSystem"):
        lfo.PiecewiseSmoothDynamics.from_system(3)
