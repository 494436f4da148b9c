"""Piecewise-smooth dynamics: modes, domains, replays, linearisations, and what is refused."""

from __future__ import annotations

from math import exp

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp import library
from lin_freq_ocp.dynamics import SmoothMode
from lin_freq_ocp.transform.hybrid import piecewise_smooth

R, L, TC, I_REF = 2.0, 1e-3, 2.5e-4, 1.0


def buck_step(i: float, v: float, diode: float = 0.0) -> float:
    """Return i+ by the paper's formula, eq. (buck dynamics), with the power (R + r_d)/R."""
    a = exp(-R * TC / L)
    border = (I_REF - v / R) / a + v / R
    if i <= border:
        return a * i + (1 - a) * v / R
    d = I_REF * exp(-(R + diode) * TC / L)
    return ((v - i * R) / (v - I_REF * R)) ** ((R + diode) / R) * d


@expensive
@pytest.mark.parametrize("diode", [0.0, 0.1, 1.0])
def test_the_converter_is_the_papers(diode):
    problem = library.buck_converter(horizon=1, diode_resistance=diode, terminal_state=None)
    rng = np.random.default_rng(0)
    seen = set()
    for i, v in zip(rng.uniform(0, 1, 60), rng.uniform(2.2, 6, 60), strict=True):
        replay = lfo.simulate(problem, [[v]], [i])
        assert replay.x[1, 0] == pytest.approx(buck_step(i, v, diode), rel=1e-12)
        seen.add(int(problem.dynamics.sequence_of(replay.x, replay.u)[0]))
    assert seen == {0, 1}


@pytest.mark.parametrize("diode", [0.0, 0.3])
def test_the_converter_is_continuous_at_its_border(diode):
    a = exp(-R * TC / L)
    dynamics = library.buck_converter(diode_resistance=diode).dynamics
    for v in (2.2, 2.9, 4.0):
        border = (I_REF - v / R) / a + v / R
        found = dynamics.jets_at(np.array([[border, v]]))
        assert found.f[0].values[0, 0] == pytest.approx(I_REF, abs=1e-12)
        assert found.f[1].values[0, 0] == pytest.approx(I_REF, abs=1e-12)


def test_the_simplified_map_with_losses_in_its_coefficients_would_jump():
    """By I_ref (1 - exp(-r_d Tc/L)): why diode_resistance=0 puts r_d = 0 into c and d, too."""
    diode, v = 0.3, 3.0
    a, d = exp(-R * TC / L), I_REF * exp(-(R + diode) * TC / L)
    border = (I_REF - v / R) / a + v / R
    second = (d * v - R * d * border) / (v - I_REF * R)
    assert I_REF - second == pytest.approx(I_REF * (1 - exp(-diode * TC / L)), rel=1e-12)


def test_the_norm_example_is_the_papers():
    problem = library.norm_dynamics(initial_state=(0.6, -0.8), horizon=2)
    replay = lfo.simulate(problem, [[0.25], [0.5]])
    np.testing.assert_allclose(replay.x[1], [0.6 * 0.75, 0.25])
    np.testing.assert_allclose(replay.x[2], [0.45 * 0.5, 0.5 * np.hypot(0.45, 0.25)])


def test_maxima_and_minima_make_a_mode_for_each_choice():
    def f(x, u):
        return [lfo.maximum(lfo.minimum(x[0], -u[0], names=("x", "-u")), u[0] - x[0] ** 2, names=("", "square"))]

    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(f, 1, 1)
    assert dynamics.mode_names == ("x", "x, square", "-u", "-u, square")
    problem = lfo.OptimalControlProblem(dynamics, 1, lfo.QuadraticCost(R=1.0), initial_state=[0.0])
    for x, u in np.random.default_rng(1).uniform(-1, 1, (40, 2)):
        replay = lfo.simulate(problem, [[u]], [x])
        assert replay.x[1, 0] == pytest.approx(max(min(x, -u), u - x**2), abs=1e-15)


def test_absolute_values_are_maxima():
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(lambda x, u: [abs(x[0]) + u[0]], 1, 1)
    problem = lfo.OptimalControlProblem(dynamics, 2, lfo.QuadraticCost(R=1.0), initial_state=[-2.0])
    assert lfo.simulate(problem, [[-3.0], [1.0]]).x.ravel().tolist() == [-2.0, -1.0, 2.0]


def test_linearised_modes_agree_to_first_order():
    problem = library.buck_converter(horizon=3)
    at = lfo.simulate(problem, [[2.4], [2.3], [2.6]])
    affine = problem.affine_at(at)
    assert affine.borders == ()
    np.testing.assert_allclose(
        affine.dynamics.along(affine.dynamics.sequence_of(at.x, at.u)).successors(at.x, at.u), at.x[1:], rtol=1e-14
    )
    arrays, h = affine.dynamics.arrays(3), 1e-6
    near = problem.dynamics.jets_at(np.hstack([at.x[:3] + h, at.u - h]))
    moved = arrays.images(at.x[:3] + h, at.u - h)
    for i in range(2):
        np.testing.assert_allclose(moved[:, i], near.f[i].values, atol=1e-10)


def test_outside_its_domain_a_mode_does_not_hold():
    problem = library.buck_converter(horizon=1, v_min=None, v_max=None, terminal_state=None)
    assert lfo.simulate(problem, [[1.0]]).x[1, 0] == pytest.approx(buck_step(0.65, 1.0))
    with pytest.raises(lfo.errors.NumericalError, match="No mode of the dynamics is defined and holds at t = 0"):
        lfo.simulate(problem, [[1.0]], [3.0])
    trajectory = lfo.Trajectory([[3.0], [1.0]], [[1.0]])
    failed = {one.label for one in lfo.certify(problem, trajectory).failed}
    assert "S-f" in failed


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: lfo.PiecewiseSmoothDynamics([], 1, 1), "a list of at least one SmoothMode"),
        (lambda: lfo.PiecewiseSmoothDynamics([SmoothMode(3)], 1, 1), r"dynamics.modes\[0\].f"),
        (lambda: lfo.PiecewiseSmoothDynamics([SmoothMode(lambda x, u: [x[0], u[0]])], 1, 1), "one for each state"),
        (lambda: lfo.PiecewiseSmoothDynamics([SmoothMode(["x_0"], ["abs(x_0)"])], 1, 1), "smooth functions"),
        (lambda: lfo.PiecewiseSmoothDynamics([SmoothMode(lambda x, u: [x[0]], name="a")] * 2, 1, 1), "second time"),
        (lambda: lfo.PiecewiseSmoothDynamics([SmoothMode(lambda x, u: [x[0]], [lfo.signals(2, 1)[0][0]])], 1, 1),
         r"region\[0\]"),
        (lambda: lfo.PiecewiseSmoothDynamics.from_formulas(["+".join(f"abs(sin({k}*x_0))" for k in range(1, 8))], 1, 1),
         "more than 64 combinations"),
        (lambda: library.buck_converter(v_min=1.9), "the pole of the second mode"),
        (lambda: library.buck_converter(diode_resistance=-1.0), "diode_resistance"),
        (lambda: library.norm_dynamics(horizon=0), "horizon"),
    ],
)  # fmt: skip
def test_bad_dynamics_are_refused(make, words):
    with pytest.raises(lfo.errors.ProblemError, match=words):
        make()


def test_other_kinds_of_dynamics_are_asked_for_in_words():
    problem = library.buck_converter(horizon=2)
    with pytest.raises(lfo.errors.UnsupportedError, match="PiecewiseSmoothDynamics; expected LinearDynamics"):
        _ = problem.linear
    with pytest.raises(lfo.errors.UnsupportedError, match="expected PiecewiseAffineDynamics"):
        problem.with_modes([0, 0])
    with pytest.raises(lfo.errors.UnsupportedError, match="LinearDynamics; expected PiecewiseSmooth"):
        _ = piecewise_smooth(library.pendulum(horizon=10))
    with pytest.raises(lfo.errors.UnsupportedError, match="'spectral', which is for linear and frequency-resp"):
        lfo.solve(problem, method="spectral")
    with pytest.raises(lfo.errors.UnsupportedError, match="'nonsmooth', which is for pulse-train and piecewise-s"):
        lfo.solve(library.pendulum(horizon=10), method="nonsmooth")
