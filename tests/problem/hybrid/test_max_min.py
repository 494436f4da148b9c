"""Maxima and minima of affine functions: the modes are the function, without idle rows, in readable words."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lin_freq_ocp as lfo
from helpers.kinked_maps import problem_of, random_kinks
from helpers.replacing import substitute
from helpers.seeds import examples, seeds
from lin_freq_ocp.base import cell_of, irredundant, natural_sizes
from lin_freq_ocp.problem.hybrid import SMALLEST_PIECE

SEEDS = st.integers(0, 2**32 - 1)
from_formulas = lfo.PiecewiseAffineDynamics.from_formulas


def random_expression(rng, signals, size, depth):
    """Return an expression and the function of v (points, n + m) that it stands for."""
    if depth == 0 or rng.random() < 0.2:
        row, constant = rng.normal(size=len(signals)) / size, rng.normal()
        return row @ signals + constant, lambda v: v @ row + constant
    kind = rng.integers(5)
    count = 2 if kind else 3
    parts = [random_expression(rng, signals, size, depth - 1) for _ in range(count)]
    expressions, functions = zip(*parts, strict=True)
    if kind == 0:
        return lfo.maximum(*expressions), lambda v: np.max([f(v) for f in functions], axis=0)
    if kind == 1:
        return lfo.minimum(*expressions, 0.3), lambda v: np.minimum(np.min([f(v) for f in functions], axis=0), 0.3)
    if kind == 2:
        return expressions[0] - 2 * expressions[1], lambda v: functions[0](v) - 2 * functions[1](v)
    if kind == 3:
        factor = rng.normal()
        return factor * (expressions[0] + 1) / 2, lambda v: factor * (functions[0](v) + 1) / 2
    return abs(expressions[0]), lambda v: np.abs(functions[0](v))


def values(dynamics, v):
    """Return what the modes make of points (points, n + m), each by the first that holds."""
    n, step = dynamics.state_dim, dynamics.stepper(1)
    return np.array([step(0, point[:n], point[n:]) for point in v])


@settings(derandomize=True, max_examples=examples(12), deadline=None)
@given(seed=SEEDS, n=st.integers(1, 3), m=st.integers(1, 2), depth=st.integers(1, 2))
def test_the_modes_are_the_function_and_continuous(seed, n, m, depth):
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.integers(-9, 9, n + m)
    x, u = lfo.signals(n, m)
    made = [random_expression(rng, np.concatenate([x, u]), sizes, depth if i == 0 else 1) for i in range(n)]
    dynamics = from_formulas([size * one for size, (one, _) in zip(sizes, made, strict=False)], n, m)
    v = rng.normal(size=(200, n + m)) * 3 * sizes
    expected = np.stack([function(v) for _, function in made], axis=1)
    np.testing.assert_allclose(values(dynamics, v) / sizes[:n], expected, rtol=1e-9, atol=1e-9)
    if len(dynamics.modes) <= 12:
        box = 3 * sizes
        problem = problem_of(dynamics, state_set=lfo.Box(-box[:n], box[:n]), control_set=lfo.Box(-box[n:], box[n:]))
        assert all(border.jump < 1e-12 for border in problem.borders)
    for mode in dynamics.modes:
        if mode.everywhere:
            continue
        matrix, limits = np.hstack([mode.region.C, mode.region.D]), mode.region.e
        units = natural_sizes(matrix, limits, np.full(n + m, np.inf), 0.0)
        assert len(irredundant(cell_of(matrix * units, limits), SMALLEST_PIECE)) == len(limits)


@pytest.mark.parametrize("seed", seeds(range(4)))
def test_kinks_written_as_maxima_are_the_kinks(seed):
    rng = np.random.default_rng(seed)
    kinked = random_kinks(rng, 2, 1, 3)
    x, u = lfo.signals(2, 1)
    v = np.concatenate([x, u])
    kinks = [lfo.maximum(row @ v - edge, 0) for row, edge in zip(kinked.h, kinked.d[0], strict=True)]
    dynamics = from_formulas(kinked.F[0] @ v + kinked.c[0] + np.array(kinks, dtype=object) @ kinked.g, 2, 1)
    points = kinked.points(rng, 100)
    np.testing.assert_allclose(values(dynamics, points), kinked.value(0, points), rtol=1e-12, atol=1e-12)
    met = {tuple(signs) for signs in kinked.signs(0, 100 * kinked.points(rng, 20000))}
    assert len(met) <= len(dynamics.modes) <= 8
    boxes = kinked.boxes()
    mine, theirs = (problem_of(one, **boxes).borders for one in (dynamics, kinked.dynamics()))
    found = [sorted((abs(b.limit), *np.abs(b.g).round(9)) for b in borders) for borders in (mine, theirs)]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9, atol=1e-9)


# --- how many modes, and what they are called -------------------------------------------------------------------------

X, U = lfo.signals(2, 1)

COUNTS = {
    "affine": (X[0] + 2 * U[0], [""]),
    "absolute value": (lfo.maximum(X[0], -X[0]) + U[0], ["max is x_0", "max is -x_0"]),
    "the same twice": (lfo.maximum(X[0], X[0]), ["max is x_0"]),
    "the same up to rounding": (lfo.maximum(0.1 * X[0] + 0.2 * X[0], 0.3 * X[0]), ["max is 0.3 x_0"]),
    "one that is never the largest": (lfo.maximum(X[0], X[0] - 1, U[0]), ["max is x_0", "max is u_0"]),
    "constants": (lfo.maximum(1, 2, X[0]), ["max is 2", "max is x_0"]),
    "saturation": (
        lfo.minimum(lfo.maximum(X[0], -1), 1),
        ["max is x_0, min is x_0", "max is x_0, min is 1", "max is -1, min is -1"],
    ),
    "saturation with names": (
        lfo.minimum(lfo.maximum(X[0], -1, names=["", "low"]), 1, names=["", "high"]),
        ["", "high", "low"],
    ),
    "largest of a largest": (lfo.maximum(lfo.maximum(X[0], X[1]), U[0]), ["max is x_0", "max is u_0", "max is x_1"]),
    "hidden branches": (
        lfo.maximum(lfo.minimum(X[0], 1), lfo.minimum(X[0], 2)),
        ["min is x_0", "min is 1, min is 2, max is 2"],
    ),
    "what cancels": (lfo.maximum(X[0], 0) - lfo.maximum(X[0], 0) + X[1], None),
    "the max of a min": (lfo.maximum(lfo.minimum(X[0], -U[0]), U[0] - X[0]), None),
    "dead zone": (
        lfo.maximum(X[0] - 1, 0, names=["right", ""]) + lfo.minimum(X[0] + 1, 0, names=["left", ""]),
        ["right", "", "left"],
    ),
}


@pytest.mark.parametrize("name", COUNTS)
def test_modes_have_the_names_of_their_branches(name):
    expression, names = COUNTS[name]
    dynamics = from_formulas([expression, 0], 2, 1)
    if names is not None:
        assert sorted(mode.name for mode in dynamics.modes) == sorted(names)
    if name == "what cancels":  # of two objects, so there were two combinations, of one map
        assert dynamics.modes[0].everywhere
    if name == "the max of a min":
        assert len(dynamics.modes) == 4  # where u - x is the largest is not convex
    problem = problem_of(dynamics)
    assert all(border.continuous for border in problem.borders)


def test_one_object_branches_once():
    once = lfo.maximum(X[0], 0)
    assert len(from_formulas([once - once, once], 2, 1).modes) == 2
    assert from_formulas([once - once + X[1], X[0]], 2, 1).modes[0].everywhere


def test_regions_have_rows_in_the_words_of_the_expression():
    modes = from_formulas([lfo.minimum(lfo.maximum(2 * X[0], U[0]), 4), 0], 2, 1).modes
    low, high, middle = (
        next(mode for mode in modes if mode.name == name)
        for name in ("max is 2 x_0, min is 2 x_0", "max is 2 x_0, min is 4", "max is u_0, min is u_0")
    )
    for mode, rows in (
        (low, [([-2, 0, 1], 0), ([2, 0, 0], 4)]),
        (high, [([-2, 0, 0], -4), ([-2, 0, 1], 0)]),
        (middle, [([2, 0, -1], 0), ([0, 0, 1], 4)]),
    ):
        stacked = np.column_stack([mode.region.C, mode.region.D, mode.region.e])
        assert sorted(map(tuple, stacked)) == sorted((*row, limit) for row, limit in rows)


def test_names_of_components_are_used_and_long_ones_cut():
    names = {"state_names": ["position [m]", "speed [m/s]"], "control_names": ["force [N]"]}
    many = lfo.maximum(X[0] + 1.23456789 * X[1] + 2.5 * U[0] - 1.25e6, 0)
    assert from_formulas([many, X[1]], 2, 1, 0.1, **names).mode_names == (
        "max is position + 1.235 speed + 2.5 force - ...",
        "max is 0",
    )
    twins = lfo.maximum(X[0] + 1e-9 * X[1], X[0] + 1.00001e-9 * X[1], 0)
    assert len(set(from_formulas([twins, 0], 2, 1).mode_names)) == 3
    dynamics = from_formulas([lfo.maximum(X[0], 0, names=["on", "off"]), 0], 2, 1, 0.5, **names)
    assert (dynamics.mode_names, dynamics.sampling_time) == (("on", "off"), 0.5)
    assert dynamics.state_names == ("position [m]", "speed [m/s]")


def test_matrices_act_on_signals():
    A, B = np.array([[1.0, 0.1], [-0.2, 0.9]]), np.array([[0.0], [0.5]])
    (mode,) = from_formulas(lambda x, u: A @ x + B @ u + np.array([1.0, -1.0]), 2, 1).modes
    np.testing.assert_array_equal(mode.linear.A, A)
    np.testing.assert_array_equal(mode.linear.B, B)
    np.testing.assert_array_equal(mode.linear.offset, [1.0, -1.0])


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "field", "words"),
    [
        (lambda: from_formulas([X[0]], 2, 1), "f", "got 1 formulas; expected 2, one for each state"),
        (lambda: from_formulas([], 2, 1), "f", "got 0 formulas"),
        (lambda: from_formulas(X[0], 2, 1), "f", "got 1 formulas"),
        (lambda: from_formulas(None, 2, 1), "f", "lfo.signals"),
        (lambda: from_formulas(X, 2, 0), "control_dim", "whole number"),
        (lambda: from_formulas([X[0], "y"], 2, 1), "f[1]", "'y'"),
        (lambda: from_formulas([X[0], lfo.signals(1, 1)[0][0]], 2, 1), "f[1]", "2 states and 1 control"),
        (lambda: from_formulas(X, 2, 1, state_names=["a"]), "dynamics.state_names", "2 different names"),
        (lambda: from_formulas([X[0] * X[1], 0], 2, 1), "f[0]", "got 'x_0 * (x_1)'"),
        (lambda: from_formulas([X[0], 1 / X[0]], 2, 1), "f[1]", "PiecewiseSmoothDynamics"),
        (lambda: from_formulas([X[0], lfo.maximum(X[0] ** 2, X[1])], 2, 1), "f[1]", "affine functions of x and u"),
        (lambda: from_formulas([lfo.maximum(X[0], 0) * X[0], 0], 2, 1), "f[0]", "affine functions of x and u"),
        (lambda: from_formulas(np.exp(X), 2, 1), "f[0]", "got 'exp(x_0)'"),
        (lambda: from_formulas([lfo.norm(X), 0], 2, 1), "f[0]", "got 'norm(x_0, x_1)'"),
        (lambda: from_formulas(lfo.DifferentiableFunction(np.add, np.add, outputs=2)(X, X), 2, 1), "f[0]", "got 'add("),
    ],
)
def test_what_is_not_piecewise_affine_is_refused(make, field, words):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        make()
    assert caught.value.field == field
    assert words in str(caught.value)


def test_too_many_combinations_are_refused(monkeypatch):
    substitute(monkeypatch, "problem.hybrid.MOST_PIECES", 8)
    x, u = lfo.signals(4, 1)
    from_formulas([sum(abs(one) for one in x[:3]), *x[1:]], 4, 1)
    with pytest.raises(lfo.errors.ProblemError, match="more than 8 combinations"):
        from_formulas([sum(abs(one) for one in x) + u[0], *x[1:]], 4, 1)
