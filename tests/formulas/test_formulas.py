"""Formulas: values and derivatives against differences, what is refused, and modes from maxima and minima."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lin_freq_ocp as lfo
from helpers.formulas import exact_text, random_formula
from helpers.seeds import examples, seeds
from lin_freq_ocp.formulas import MOST_LEVELS, Formula, formula_from_text, jets_of, nodes_in_order, text_of, values_of

N, M = 2, 1
X, U = lfo.signals(N, M)


@settings(derandomize=True, max_examples=examples(60), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 8))
def test_a_formula_is_what_numpy_makes_of_numbers_and_has_its_derivatives(seed, size):
    formula = random_formula(np.random.default_rng(seed), size, [*X, *U])
    y = np.random.default_rng(seed + 1).uniform(-1, 1, (3, N + M))
    numbers = random_formula(np.random.default_rng(seed), size, list(y.T))
    found = jets_of([formula], y)
    again = formula_from_text("f", exact_text(formula), (N, M))
    np.testing.assert_array_equal(values_of([again], y), values_of([formula], y))
    np.testing.assert_allclose(found.values[:, 0], numbers, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(values_of([formula], y), found.values, rtol=1e-14, atol=1e-16)
    h = 1e-5
    scale = 1 + np.abs(found.curvatures).max() + np.abs(found.slopes).max()
    for j in range(N + M):
        shift = h * np.eye(N + M)[j]
        above, below = jets_of([formula], y + shift), jets_of([formula], y - shift)
        slopes, curvatures = ((one - other) / (2 * h) for one, other in zip(_parts(above), _parts(below), strict=True))
        assert np.abs(slopes - found.slopes[..., j]).max() <= 1e-6 * scale**2
        assert np.abs(curvatures - found.curvatures[..., j]).max() <= 1e-6 * scale**3


def _parts(found):
    return found.values, found.slopes


def test_norms_have_the_derivative_that_is_selected():
    q = lfo.norm([X[0], 2 * X[1]])
    y = np.array([[0.0, 0.0, 1.0], [3.0, 2.0, 1.0]])
    plain = jets_of([q], y)
    assert plain.values[:, 0].tolist() == [0.0, 5.0]
    np.testing.assert_allclose(plain.slopes[1, 0], [0.6, 1.6, 0.0])
    assert not plain.slopes[0].any()
    chosen = jets_of([q], y, {q: np.array([[0.3, -0.4], [np.nan, np.nan]])})
    np.testing.assert_allclose(chosen.slopes[0, 0], [0.3, -0.8, 0.0])
    np.testing.assert_allclose(chosen.slopes[1], plain.slopes[1])
    assert not chosen.curvatures[0].any()


def test_arrays_and_functions_of_numpy_make_formulas():
    A = np.array([[1.0, 2.0], [3.0, 4.0]])
    made = A @ X + np.array([5.0, 6.0]) * U[0]
    np.testing.assert_allclose(values_of(list(made), np.array([[1.0, 10.0, 100.0]])), [[521.0, 643.0]])
    assert (np.float64(2) * X[0] + X[0] - 3 * X[0] + 0.5).constant == 0.5
    assert isinstance(np.exp(X[0]), Formula)
    assert text_of(np.exp(X[0]) / (1 + U[0] ** 2), ["a", "b", "c"]) == "exp(a) / ((c)**2 + 1)"


def test_a_formula_that_occurs_twice_is_one_node():
    common = X[0] * U[0]
    assert len(nodes_in_order([common + common * X[1], np.sin(common)])) == 3 + 4


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: X[0] < 1, "lfo.maximum or lfo.minimum"),
        (lambda: X[0] ** 0.5, "a whole number from 2 to 16"),
        (lambda: X[0] ** X[1], "a whole number from 2 to 16"),
        (lambda: X[0] / 0, "a quotient by 0"),
        (lambda: X[0] + "a", "formula"),
        (lambda: X[0] * True, "a number or a formula"),
        (lambda: X[0] + lfo.signals(3, 1)[0][0], "the same signals"),
        (lambda: lfo.norm([1.0, 2.0]), "lfo.signals"),
        (lambda: lfo.maximum(X[0]), "two arguments or more"),
        (lambda: lfo.minimum(1, 2), "at least one of them a formula"),
        (lambda: lfo.maximum(X[0], 1.0, names=["a"]), "2 names"),
        (lambda: lfo.maximum(X[0], 0, names="ab"), "2 names"),
        (lambda: lfo.minimum(X[0], 0, names=["a", " "]), "2 names"),
        (lambda: X[0] + np.nan, "nan"),
        (lambda: max(X[0], 0), "lfo.maximum or lfo.minimum"),
        (lambda: np.maximum(X, 0), "lfo.maximum or lfo.minimum"),
        (lambda: lfo.signals(1, 1.5), "controls"),
        (lambda: lfo.signals(0, 1), "states"),
    ],
)
def test_bad_formulas_are_refused(make, words):
    with pytest.raises(lfo.errors.ProblemError, match=words):
        make()


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("norm(x_0, x_1) * u_0", 5 * 0.5),
        ("-x_0 + 2 * x_1 - 1e-1", -3 + 8 - 0.1),
        ("min(x_0, -u_0) / x_1 ** 2", None),
        ("exp(0) + sqrt(4)", 3.0),
        ("tanh(x_0 - 3) + arctan(x_1) / arctan(4)", 1.0),
        ("(x_0 - x_1)**2 - abs(-2)", -1.0),
    ],
)
def test_texts_are_formulas(text, value):
    formula = formula_from_text("f", text, (N, M))
    if value is not None:
        assert values_of([formula], np.array([[3.0, 4.0, 0.5]]))[0, 0] == pytest.approx(value)
    assert exact_text(formula_from_text("f", exact_text(formula), (N, M))) == exact_text(formula)


@pytest.mark.parametrize(
    "text",
    ["x_2", "x_0 +", "__import__('os')", "x_0.real", "x_0 if u_0 else 1", "max(x_0)", "norm()", "1 / 0", "x_0 ** u_0",
     "", "cbrt(x_0)", "x_0 < 1", "[x_0]", "exp(x=1)", "'a'", "True", "x_0 + " * 3000 + "1"],
)  # fmt: skip
def test_texts_that_say_anything_else_are_refused(text):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        formula_from_text("f[0]", text, (N, M))
    assert caught.value.field == "f[0]"


@pytest.mark.parametrize(
    "nested",
    [
        lambda levels: "x_0" + " + x_0" * levels,
        lambda levels: "x_0" + " * (2 - u_0)" * (levels - 1),  # a difference within a product
        lambda levels: "-" * levels + "x_0",
        lambda levels: "1**" * levels + "2",
    ],
)
def test_the_depth_of_a_formula_has_a_limit_of_its_own(nested):
    """The parser's own depth depends on the version of Python and on where it is called."""
    formula_from_text("f[0]", nested(MOST_LEVELS - 1), (N, M))
    with pytest.raises(lfo.errors.ProblemError, match="nested too deeply"):
        formula_from_text("f[0]", nested(MOST_LEVELS + 2), (N, M))


@pytest.mark.parametrize(
    "text",
    [
        *("0**-1", "0**-1 * x_0", "0.0**-0.5", "(-2)**0.5 * x_0", "9**9**9", "10**400", "0x" + "f" * 400),
        *(
            "1e999 * x_0",
            "log(0) + x_0",
            "sqrt(-1) * x_0",
            "exp(1e9)",
            "0 / 0",
            "x_0 / 0",
            "x_0 / (x_0 - x_0)",
            "x_0 / 1e-320",
        ),
        *("1e300 * x_0 * 1e300", "1" * 5000, "1" * 5000 + " * x_0", "(" * 1500 + "x_0" + ")" * 1500),
        *(
            "-" * 9000 + "x_0",
            "sin(" * 300 + "x_0" + ")" * 300,
            "+".join(["x_0"] * 20_000),
            "x_0**" * 5000 + "2",
            "x_0 " * 50_000,
        ),
    ],
)
def test_texts_without_a_value_or_without_end_are_refused(text):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        formula_from_text("dynamics.f[0]", text, (2, 1))
    assert caught.value.field == "dynamics.f[0]"
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("join", seeds([" + ", " - ", " * "]))
def test_long_formulas_are_read(join):
    """As numpy has it, summed in the same order; the parser nests them as deeply as they are long."""
    rng = np.random.default_rng(3)
    factors, phases = rng.uniform(0.9, 1.1, (2, 1200))
    terms = [f"({a:.3f} + sin(x_0 - {b:.3f}) / 100)" for a, b in zip(factors, phases, strict=True)]
    formula = formula_from_text("f", join.join(terms), (1, 1))
    x = np.linspace(-1, 1, 5)
    parts = [a + np.sin(x - b) / 100 for a, b in zip(factors.round(3), phases.round(3), strict=True)]
    expected = {" + ": np.sum, " - ": lambda p, axis: p[0] - np.sum(p[1:], axis), " * ": np.prod}[join](parts, axis=0)
    found = values_of([formula], np.stack([x, 0 * x], axis=1))[:, 0]
    np.testing.assert_allclose(found, expected, rtol=1e-11)


def test_a_problem_with_long_formulas_is_solved():
    """The sum of 1200 times x_0 / 1200 is x_0: the optimum is that of the short formula."""
    found = []
    for text in ("x_0", " + ".join(["x_0 / 1200"] * 1200)):
        dynamics = lfo.PiecewiseSmoothDynamics.from_formulas([f"{text} + u_0 - 0.1 * x_0**2"], 1, 1)
        ends = {"initial_state": [1.0], "terminal_state": [0.0]}
        problem = lfo.OptimalControlProblem(dynamics, 2, lfo.QuadraticCost(R=1.0), **ends)
        found.append(lfo.solve(problem, lfo.solvers.Nonsmooth(global_bound=False)))
    assert found[0].cost == pytest.approx(found[1].cost, rel=1e-9)
    assert found[0].status == found[1].status
