"""Modes of formulas with maxima and minima: those that never hold are left out, names differ, and the map is the same.

Random formulas are texts, which Python itself evaluates: the modes must agree with it wherever they hold.
"""

import itertools
import math

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive, seeds
from lin_freq_ocp.problem import unique_names

FUNCTIONS = {"abs": abs, "max": max, "min": min, "sin": math.sin, "tanh": math.tanh}
SIGNALS = ("x_0", "x_1", "u_0")

EXAMPLES = {
    "saturated input": (["x_0 + 0.1*x_1", "x_1 + 0.1*max(-1, min(u_0, 1))"], 3),
    "soft threshold": (["max(x_0 + 0.1*u_0 - 0.06, min(0, x_0 + 0.1*u_0 + 0.06))"], 3),
    "saturated pendulum": (["x_0 + 0.1*x_1", "x_1 + 0.1*sin(x_0) + 0.1*max(-1, min(u_0, 1))"], 3),
    "drag": (["x_0 + 0.1*x_1", "x_1 - 0.1*abs(x_1)*x_1 + 0.1*u_0"], 2),
    "Coulomb friction": (["x_0 + 0.1*x_1", "x_1 + 0.1*(u_0 - max(-0.5, min(50*x_1, 0.5)))"], 3),
    "stick-slip": (["x_0 + 0.1*x_1", "max(x_1 + 0.1*u_0 - 0.05, min(0, x_1 + 0.1*u_0 + 0.05))"], 3),
    "dead zone": (["x_0 + 0.1*(max(u_0 - 1, 0) + min(u_0 + 1, 0))"], 3),
    "clipped twice": (["x_0 + max(-1, min(1, max(-2, min(2, u_0))))"], 5),
    "distances": (["0.1*(" + " + ".join(f"abs(x_0 - {k})" for k in range(7)) + ") + u_0"], 8),
    "the same twice": (["0.5*max(x_0 + u_0, u_0 + x_0)"], 1),
    "above": (["0.5*max(x_0**2 + 1, 0) + u_0"], 1),
    "a constant choice": (["0.5*x_0*max(sin(u_0*0 + 1), 2) + u_0"], 1),
    "rounding": (["0.5*max(x_0 + 0.1 + 0.2, x_0 + 0.3) + u_0"], 1),
}


def random_formula(rng, depth):
    """Return a text of signals, numbers, sums, products, abs, max, min, sin, tanh and clips."""
    if depth == 0 or rng.random() < 0.1:
        return str(rng.choice(SIGNALS)) if rng.random() < 0.8 else f"{rng.uniform(-2, 2):.3g}"
    parts = [random_formula(rng, depth - 1) for _ in range(3)]
    limit = f"{rng.uniform(0.2, 2):.3g}"
    return str(
        rng.choice(
            [
                f"abs({parts[0]})",
                f"max({parts[0]}, {parts[1]})",
                f"min({parts[0]}, {parts[1]}, {parts[2]})",
                f"max(-{limit}, min({parts[0]}, {limit}))",
                f"({parts[0]}) + {limit} * ({parts[1]})",
                f"({parts[0]}) * ({parts[1]})",
                f"{rng.choice(['sin', 'tanh'])}({parts[0]})",
            ]
        )
    )


def maps_of_modes(dynamics, y):
    """Return what the modes lead to at points y (points, n + m), (points, modes, n); nan where a mode does not hold."""
    jets = dynamics.jets_at(y)
    holds = [(region.values <= 1e-9).all(axis=1) for region in jets.regions]
    return np.stack([np.where(on[:, None], f.values, np.nan) for f, on in zip(jets.f, holds, strict=True)], axis=1)


@pytest.mark.parametrize("seed", seeds(range(12)))
def test_random_formulas_are_accepted_and_their_modes_cover_everything(seed):
    rng = np.random.default_rng(seed)
    formulas = [random_formula(rng, 3) for _ in range(2)]
    try:
        dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(formulas, 2, 1)
    except lfo.errors.ProblemError as error:
        if "64 combinations" in str(error):
            pytest.skip(str(error))
        raise
    assert len({*dynamics.mode_names}) == len(dynamics.modes)
    y = rng.uniform(-3, 3, (50, 3))
    signals = [dict(zip(SIGNALS, map(float, point), strict=True)) for point in y]
    expected = [[eval(text, {"__builtins__": {}}, FUNCTIONS | one) for text in formulas] for one in signals]
    found = maps_of_modes(dynamics, y)
    assert not np.isnan(found).all(axis=1).any()
    np.testing.assert_allclose(np.nanmin(found, axis=1), expected, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(np.nanmax(found, axis=1), expected, rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("name", EXAMPLES)
def test_choices_that_never_hold_are_no_modes(name):
    formulas, count = EXAMPLES[name]
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(formulas, len(formulas), 1)
    assert len(dynamics.modes) == count
    found = maps_of_modes(dynamics, np.random.default_rng(0).uniform(-8, 8, (50, len(formulas) + 1)))
    assert not np.isnan(found).all(axis=1).any()


@expensive
@pytest.mark.parametrize("name", ["saturated input", "saturated pendulum", "Coulomb friction", "stick-slip"])
def test_saturation_and_friction_have_an_answer(name):
    formulas, _ = EXAMPLES[name]
    n = len(formulas)
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(formulas, n, 1, 0.1),
        4,
        lfo.QuadraticCost(R=0.1, Q=1.0, P=1.0),
        control_set=lfo.Box(-3, 3),
        state_set=lfo.Box(-5, 5),
        initial_state=np.r_[1.0, np.zeros(n - 1)],
    )
    result = lfo.solve(problem, lfo.solvers.Nonsmooth(global_bound=False))
    assert result.certificate.feasible
    assert result.certificate.pmp == "satisfied"


@expensive
def test_a_switching_function_that_is_flat_and_above_zero_where_a_search_begins_does_not_stop_it():
    """At x = 0 the slope of 1 - x^2 is zero: nothing says how to get where x^2 - 1 is the larger one."""
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(["max(x_0**2 - 1, 0) + u_0"], 1, 1),
        3,
        lfo.QuadraticCost(R=1.0, Q=1.0),
        control_set=lfo.Box(-1, 1),
        initial_state=[0.0],
        terminal_state=[1.0],
    )
    result = lfo.solve(problem, method="nonsmooth")
    assert result.cost == pytest.approx(0.5, rel=1e-6)  # rest, and one step of 1


def test_the_formula_with_repeated_names_is_solved():
    text = "x_0/(1+abs(x_0)) + max(x_0, u_0) + abs(u_0)"
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas([text], 1, 1)
    assert len({*dynamics.mode_names}) == len(dynamics.modes) == 6  # half planes x, u and x - u: six sectors


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["a", "b"], ["a", "b"]),
        (["a", "b", "a"], ["a (1)", "b", "a (2)"]),
        (["a", "a", "a (1)"], ["a (2)", "a (3)", "a (1)"]),
        (["", "mode 0"], ["mode 0 (1)", "mode 0 (2)"]),
        (["", ""], ["", ""]),
    ],
)
def test_names_of_derived_modes_differ(given, expected):
    assert unique_names(given) == expected


def test_named_arguments_may_repeat():
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(
        lambda x, u: [lfo.maximum(x[0], u[0], names=["on", "off"]) + lfo.maximum(x[0], 1, names=["on", ""])], 1, 1
    )
    assert len({*dynamics.mode_names}) == len(dynamics.modes) == 4


def test_one_mode_may_stand_for_several_patterns_of_guards():
    hot, cold = (lfo.AffineMode([[a]], [[1.0]], name=name) for a, name in ((0.9, "hot"), (0.8, "cold")))
    modes = {"++": hot, "--": hot, "+-": cold, "-+": None}
    dynamics = lfo.PiecewiseAffineDynamics.from_guards([[1.0], [1.0]], None, [0.0, 1.0], modes)
    assert dynamics.mode_names == ("hot (1)", "hot (2)", "cold")


def test_modes_are_the_sign_patterns_that_occur():
    """Three lines in general position cut the plane into seven parts, not eight."""
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(["abs(x_0) + abs(u_0) + abs(x_0 + u_0 - 1)"], 1, 1)
    points = itertools.product(np.linspace(-3, 3, 25), repeat=2)
    signs = {tuple(np.sign([x, u, x + u - 1])) for x, u in points}
    assert len(dynamics.modes) == len({one for one in signs if 0 not in one}) == 7
