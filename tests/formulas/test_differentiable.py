"""Functions that are no formulas: as pieces of dynamics, their derivatives, and what is refused; CasADi's functions."""

from __future__ import annotations

import math
import pickle
import sys
from dataclasses import replace
from math import exp

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.formulas import exact_text, random_formula
from helpers.seeds import expensive, seeds
from lin_freq_ocp import library
from lin_freq_ocp.batch import fingerprint
from lin_freq_ocp.certificate import judge
from lin_freq_ocp.dynamics import SmoothMode
from lin_freq_ocp.formulas import Formula, formula_from_text, interval_jets, jets_of, nodes_in_order, values_of

X, U = lfo.signals(2, 1)
POLE, KEPT = 2.0, exp(-0.5)
AT_START = {"horizon": 2, "initial_state": [0.9351278729299871], "terminal_state": None}


def excess(x, u):
    return x[0] - (1 - u[0] / 2) / KEPT - u[0] / 2


def off(x, u):
    """Compute the second mode of the buck converter by a loop: KEPT is a product of ten parts."""
    kept = 1.0
    for _ in range(10):
        kept *= exp(-0.05)
    if u[0] <= POLE:
        return math.nan
    return 1 - POLE * kept * excess(x, u) / (u[0] - POLE)


def off_slopes(x, u):
    over, under = POLE * KEPT * excess(x, u), u[0] - POLE
    return np.array([[-POLE * KEPT / under, over / under**2 - (1 - KEPT) / under]])


def buck(second, **arguments):
    """Return the converter of the library with its second mode as given."""
    problem = library.buck_converter(**arguments)
    modes = [problem.dynamics.modes[0], replace(problem.dynamics.modes[1], f=second)]
    return replace(problem, dynamics=lfo.PiecewiseSmoothDynamics(modes, 1, 1))


@expensive
@pytest.mark.parametrize(("arguments", "cost"), [({"horizon": 3}, 17.345547997984184), (AT_START, 11.554464138730564)])
def test_the_converter_with_a_mode_that_is_no_formula_has_the_same_optimum(arguments, cost):
    function = lfo.DifferentiableFunction(off, off_slopes, check_at=[([0.9], [2.7]), ([0.4], [5.1])])
    result = lfo.solve(buck(function, **arguments))
    assert result.cost == pytest.approx(cost, rel=1e-10)
    same = judge(library.buck_converter(**arguments), result.trajectory, result.multipliers)
    assert [one.residual for one in result.certificate.conditions] == pytest.approx(
        [one.residual for one in same.conditions], abs=1e-12
    )
    facts = result.certificate.borders
    assert (facts.joint, facts.printed, facts.times) == (True, same.borders.printed, same.borders.times)
    assert facts.printed == (arguments is not AT_START)
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.worst.relative <= 1e-12
    assert result.message == "no global bound: off is no formula; only formulas have bounds over boxes."
    assert result.lower_bound == 0  # as the cost is never negative


@expensive
def test_norms_within_and_around_are_kinks_as_in_formulas():
    product = lfo.DifferentiableFunction(
        lambda x, u: x[:, 0] * u[:, 0], lambda x, u: np.hstack([u, x]), vectorized=True, check_at=[([0.3], [0.4])]
    )
    known = library.norm_dynamics(initial_state=(0.0, 1.0), horizon=3)
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(
        lambda x, u: [product(x[:1], 1 - u)[0], product(lfo.norm(x), u)[0]], 2, 1
    )
    result = lfo.solve(replace(known, dynamics=dynamics), method="nonsmooth")
    assert result.cost == pytest.approx(1.0, rel=1e-10)
    assert {kink.time for kink in result.certificate.borders.norms} == {1, 2}
    assert result.certificate.worst.relative <= 1e-10
    around = lfo.norm([product(X[:1], U)[0], X[1]])
    assert jets_of([around], np.array([[3.0, 8.0, 2.0]])).slopes[0, 0] == pytest.approx([0.6 * 2, 0.8, 0.6 * 3])


def test_maxima_of_functions_make_modes():
    push = lfo.DifferentiableFunction(
        lambda x, u: [np.sinh(x[0]), x[0] + u[0] ** 2], lambda x, u: [[np.cosh(x[0]), 0], [1, 2 * u[0]]], outputs=2
    )
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(
        lambda x, u: [lfo.maximum(*push(x, u), names=("sinh", "sum")) - abs(u[0])], 1, 1
    )
    assert dynamics.mode_names == ("sinh, max 0", "sinh, max 1", "sum, max 0", "sum, max 1")
    problem = lfo.OptimalControlProblem(dynamics, 1, lfo.QuadraticCost(R=1.0), initial_state=[0.0])
    for x, u in np.random.default_rng(1).uniform(-2, 2, (20, 2)):
        replay = lfo.simulate(problem, [[u]], [x])
        assert replay.x[1, 0] == pytest.approx(max(np.sinh(x), x + u**2) - abs(u), abs=1e-14)


def as_function(formula, hessian):
    """Return a formula of X and U as a function with derivatives."""

    def part(name):
        return lambda x, u: getattr(jets_of([formula], np.append(x, u)[None]), name)[0]

    return lfo.DifferentiableFunction(part("values"), part("slopes"), part("curvatures") if hessian else None)


@pytest.mark.parametrize("seed", seeds(range(8)))
def test_functions_of_formulas_have_the_derivatives_of_the_whole_formula(seed):
    rng = np.random.default_rng(seed)
    outer = random_formula(rng, 4, [*X, *U])
    inner = [random_formula(rng, 3, [*X, *U]) for _ in range(3)]
    made = {variable: part for variable, part in zip((*X, *U), inner, strict=True)}
    for node in nodes_in_order([outer]):
        parts = tuple(made[argument] for argument in node.arguments)
        made.setdefault(node, replace(node, arguments=parts))
    y = rng.uniform(-1, 1, (4, 3))
    exact = jets_of([made[outer]], y)
    function = as_function(outer, True)
    np.testing.assert_allclose(values_of(list(function(inner[:2], inner[2:])), y), exact.values, rtol=1e-13)
    for hessian, accuracy in ((True, 1e-12), (False, 1e-8)):
        found = jets_of(list(as_function(outer, hessian)(inner[:2], inner[2:])), y)
        np.testing.assert_allclose(found.values, exact.values, rtol=1e-13)
        np.testing.assert_allclose(found.slopes, exact.slopes, atol=1e-12 * (1 + np.abs(exact.slopes).max()))
        size = 1 + np.abs(exact.curvatures).max()
        np.testing.assert_allclose(found.curvatures, exact.curvatures, atol=accuracy * size)


def test_all_outputs_are_evaluated_once_for_each_point():
    seen = []

    def call(x, u):
        seen.append((*x, *u))
        return [x[0], u[0], 1]

    function = lfo.DifferentiableFunction(call, lambda x, u: [[1, 0, 0], [0, 0, 1], [0, 0, 0]], outputs=3)
    first, second, third = function(X, U)
    dynamics = lfo.PiecewiseSmoothDynamics(
        [SmoothMode([first, second * third], [third - 2]), SmoothMode([first, third], [2 - third])], 2, 1
    )
    seen.clear()
    y = np.arange(12.0).reshape(4, 3)
    assert dynamics.jets_at(y).f[0].values.tolist() == [[row[0], row[2]] for row in y]
    assert len(seen) == 4
    again = pickle.loads(pickle.dumps(lfo.DifferentiableFunction(math.pow, math.pow)))
    assert again.title == "pow"


def test_functions_of_many_points_and_functions_that_use_one_buffer_are_the_same():
    buffer = np.empty(1)

    def reused(x, u):
        buffer[:] = x[0] ** 3 * u[0]
        return buffer

    plain = lfo.DifferentiableFunction(reused, lambda x, u: [3 * x[0] ** 2 * u[0], x[0] ** 3])
    whole = lfo.DifferentiableFunction(
        lambda x, u: (x**3 * u)[:, 0],
        lambda x, u: np.hstack([3 * x**2 * u, x**3]),
        lambda x, u: np.stack([np.hstack([6 * x * u, 3 * x**2]), np.hstack([3 * x**2, 0 * x])], axis=1),
        vectorized=True,
        check_at=[([0.3], [0.7])],
    )
    y = np.random.default_rng(0).uniform(1, 2, (5, 3))
    one, other = (jets_of(list(function(X[:1], U)), y) for function in (plain, whole))
    np.testing.assert_allclose(one.values, other.values, rtol=1e-14)
    np.testing.assert_allclose(one.slopes, other.slopes, rtol=1e-14)
    np.testing.assert_allclose(one.curvatures, other.curvatures, atol=1e-8)


def test_where_a_function_is_not_defined_no_mode_holds():
    def root(x, u):
        return math.sqrt(x[0]) if x[0] >= 0 else math.nan

    function = lfo.DifferentiableFunction(root, lambda x, u: [[0.5 / math.sqrt(x[0]) if x[0] >= 0 else math.nan, 0]])
    made = jets_of(
        list(function(X[:1], U)), np.array([[4.0, 0, 0], [-1.0, 0, 0], [0.0, 0, 0]])
    )  # at 0: ZeroDivisionError
    assert made.values[0, 0] == 2
    assert made.slopes[0, 0, 0] == 0.25
    assert np.isnan([made.values[1, 0], made.slopes[1, 0, 0], made.slopes[2, 0, 0]]).all()
    edge = jets_of(list(function(X[:1], U)), np.array([[1e-6, 0, 0]]))  # differences to the left leave the domain
    assert np.isfinite(edge.curvatures).all()
    nothing = jets_of(list(function([np.log(X[0])], U)), np.array([[-1.0, 0, 0]]))  # its argument is no number
    assert np.isnan(nothing.values).all()
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics([SmoothMode(function)], 1, 1), 1, lfo.QuadraticCost(R=1.0), initial_state=[1.0]
    )
    with pytest.raises(lfo.errors.NumericalError, match="No mode of the dynamics is defined"):
        lfo.simulate(problem, [[0.0]], [-1.0])


SCALES = [1e-9, 1e-3, 1.0, 1e4, 1e9]


@pytest.mark.parametrize("scale", SCALES)
def test_right_derivatives_pass_the_check_at_all_scales_and_wrong_ones_do_not(scale):
    def make(factor):
        return lfo.DifferentiableFunction(
            lambda x, u: np.sin(x[0] / scale) + 1e6 + u[0] * x[0] / scale,
            lambda x, u: [np.cos(x[0] / scale) / scale + u[0] / scale, factor * x[0] / scale],
            lambda x, u: [[-np.sin(x[0] / scale) / scale**2, 1 / scale], [factor / scale, 0.0]],
            sizes=[scale, 1.0],
        )

    points = [([0.0], [0.3]), ([0.7 * scale], [0.0]), ([1e-12 * scale], [2.0])]
    make(1.0).check_derivatives(points)
    with pytest.raises(lfo.errors.ProblemError, match=r"function.jacobian\[0, 1\].*derivative of output 0 by u\[0\]"):
        make(1.01).check_derivatives(points)


def two(x, u):
    return [x[0] * u[0], x[1] ** 3]


def two_slopes(x, u):
    return [[u[0], 0, x[0]], [0, 3 * x[1] ** 2, 0]]


@pytest.mark.parametrize(
    ("jacobian", "hessian", "words"),
    [
        (lambda x, u: [[u[0], 0, -x[0]], [0, 3 * x[1] ** 2, 0]], None,
         r"two.jacobian\[0, 2\]: got -1.5, at x = \[1.5, 0.7\], u = \[2.5\]; expected 1.5.* of output 0 by u\[0\]"),
        (lambda x, u: [[0, u[0], x[0]], [0, 3 * x[1] ** 2, 0]], None, r"two.jacobian\[0, 0\]: got 0, .* by x\[0\]"),
        (lambda x, u: [[u[0], 0, x[0]], [0, 3 * x[1] ** 2, math.nan]], None, r"two.jacobian\[1, 2\]: got nan"),
        (two_slopes, lambda x, u: np.zeros((2, 3, 3)), r"two.hessian\[0, 2, 0\].*output 0 by u\[0\] and x\[0\]"),
        (lambda x, u: np.array(two_slopes(x, u)).T, None, r"two.jacobian: got shape \(3, 2\).*expected shape \(2, 3\)"),
    ],
)  # fmt: skip
def test_wrong_derivatives_are_named(jacobian, hessian, words):
    with pytest.raises(lfo.errors.ProblemError, match=words):
        lfo.DifferentiableFunction(two, jacobian, hessian, outputs=2, check_at=[([1.5, 0.7], [2.5])])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda f: f(3, lambda x, u: 0), "DifferentiableFunction.call: got 3; expected a function"),
        (lambda f: f(two, None), "jacobian: got None.*lfo.from_casadi"),
        (lambda f: f(two, two_slopes, 3), "hessian"),
        (lambda f: f(two, two_slopes, outputs=0), "outputs"),
        (lambda f: f(two, two_slopes, name=3), "name"),
        (lambda f: f(two, two_slopes, vectorized=1), "vectorized"),
        (lambda f: f(two, two_slopes, sizes=[1, 0]), "sizes"),
        (lambda f: f(two, two_slopes, 0, 2, sizes=[1, 1], check_at=[([1, 1], [1])]), "hessian"),
        (lambda f: f(two, two_slopes, None, 2, sizes=[1, 1], check_at=[([1, 1], [1])]), "two.sizes: got 2 numbers"),
        (lambda f: f(two, two_slopes, None, 2, check_at=3), "check_at"),
        (lambda f: f(two, two_slopes, None, 2, check_at=[3]), r"check_at\[0\]"),
        (lambda f: f(lambda x, u: 1 / x[0], lambda x, u: [1], check_at=[([0.0], [])]), "no finite number at x = "),
        (lambda f: f(lambda x, u: x[0] if x[0] <= 1 else math.nan, lambda x, u: [1], check_at=[([1.0], [])]),
         r"nothing finite on one of the sides of x\[0\] = 1"),
        (lambda f: f(two, two_slopes)([1, 2], [3]), r"two.call: got shape \(2,\).*expected shape \(1,\)"),
        (lambda f: f(lambda x, u: None, two)([1]), "got None at x = .*expected real numbers"),
        (lambda f: f(lambda x, u: 1j, two)([1]), "got 1j"),
        (lambda f: f(lambda x, u: [[1], 2], two)([1]), "expected real numbers"),
        (lambda f: f(lambda x, u: math.log(x[0]), two)([-1]), r"ValueError.*at x = \[-1.0\].*Return nan where"),
        (lambda f: f(lambda x, u: x.fill(0), two)([1]), "read-only"),
        (lambda f: f(two, two_slopes)("ab", [1]), "two.x"),
        (lambda f: f(two, two_slopes)([[1, 2]], [1]), "two.x.*a list of formulas or numbers"),
        (lambda f: f(two, two_slopes)([X[0], lfo.signals(3, 1)[0][0]], U), "the same signals"),
        (lambda f: lfo.PiecewiseSmoothDynamics([SmoothMode(f(two, two_slopes))], 2, 1), "1 formulas; expected 2"),
        (lambda f: f(lambda x, u: 1 / 0, two, vectorized=True)([1]), "ZeroDivisionError"),
    ],
)  # fmt: skip
def test_bad_functions_are_refused(make, words):
    with pytest.raises(lfo.errors.ProblemError, match=words):
        make(lfo.DifferentiableFunction)


@expensive
def test_files_need_formulas_and_explanations_say_what_is_missing(tmp_path):
    function = lfo.DifferentiableFunction(off, off_slopes)
    problem = buck(function, horizon=1, terminal_state=None)
    with pytest.raises(
        lfo.errors.ProblemError, match=r"dynamics.modes\[1\].f\[0\]: got the function off; expected formulas"
    ):
        lfo.write_problem(problem, tmp_path / "buck.toml")
    result = lfo.solve(problem, method="nonsmooth")
    with pytest.raises(lfo.errors.ProblemError, match="got the function off"):
        result.dump(tmp_path / "run.zip")
    result.save(tmp_path / "answer.npz")
    saved = lfo.load(tmp_path / "answer.npz")
    assert lfo.certify(problem, saved.trajectory).pmp == "satisfied"
    assert "off(x_0, u_0)[0]" in repr(problem.dynamics)
    half = lfo.DifferentiableFunction(lambda x, u: x / 2, lambda x, u: 0 * x + [0.5, 0.0], vectorized=True)
    missed = replace(problem, dynamics=lfo.PiecewiseSmoothDynamics([SmoothMode(half)], 1, 1), terminal_state=[1.0])
    with pytest.raises(lfo.errors.UnsupportedError, match="with the status 'numerical_error'"):
        lfo.explain(missed)
    with pytest.raises(lfo.errors.UnsupportedError, match="off is no formula"):
        interval_jets(problem.dynamics.modes[1].f, np.zeros((1, 2)), np.ones((1, 2)))


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (lambda x, u: x[0] if x[0] > 0 else u[0], "lfo.maximum"),
        (lambda x, u: x[0] if x[0] == 0 else u[0], "lfo.maximum"),
        (lambda x, u: x[0] if u[0] != 1.5 else u[0], "lfo.maximum"),
        (lambda x, u: x[0] if x[0] else u[0], "lfo.maximum"),
        (lambda x, u: np.where(x[0] > 0, x[0], u[0]), "lfo.maximum"),
        (lambda x, u: max(x[0], u[0]), "lfo.maximum"),
        (lambda x, u: float(x[0]), "arctan"),
        (lambda x, u: math.sin(x[0]), "arctan"),
        (lambda x, u: np.interp(x[0], [0, 1], [0, 1]), "arctan"),
        (lambda x, u: np.cbrt(x[0]), "TypeError"),
        (lambda x, u: int(x[0]), "TypeError"),
        (lambda x, u: [1, 2][x[0]], "TypeError"),
        (lambda x, u: x[0] % 2, "TypeError"),
        (lambda x, u: x[2], "IndexError"),
        (lambda x, u: sum(x[0] for _ in range(u[0])), "TypeError"),
    ],
)
def test_functions_that_cannot_be_traced_are_told_what_can(body, words):
    with pytest.raises(lfo.errors.ProblemError, match=f"{words}.*lfo.DifferentiableFunction"):
        lfo.PiecewiseSmoothDynamics.from_formulas(lambda x, u: [body(x, u)], 1, 1)


def test_without_casadi_its_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(lfo.errors.MissingExtraError, match=r"'lin-freq-ocp\[casadi\]', or .* -e '\.\[casadi\]'"):
        lfo.from_casadi(two, 2, 1)


def test_arguments_that_have_the_names_of_signals_come_in_their_own_order():
    made = lfo.DifferentiableFunction(
        lambda u, x: x[0] * u[0] ** 2, lambda u, x: [[u[0] ** 2, 2 * x[0] * u[0]]],
        lambda u, x: [[[0, 2 * u[0]], [2 * u[0], 2 * x[0]]]], check_at=[([3.0], [2.0])],
    )  # fmt: skip
    assert made([3.0], [2.0]).tolist() == [12.0]


@pytest.fixture(name="casadi")
def casadi_fixture():
    return pytest.importorskip("casadi")


def test_functions_of_casadi_become_formulas_where_these_have_its_operations(casadi):
    def f(x, u):
        return [
            casadi.norm_2(x) * casadi.tanh(u[0]) ** 3 - 2 * x[0] / x[1] + casadi.exp(-x[0]) + 1 / u[0],
            casadi.sqrt(x[0] + 2) + casadi.atan(x[1]) ** 2 + casadi.sin(x[0]) * casadi.cos(u[0]) + casadi.log(x[1]),
        ]

    made = lfo.from_casadi(f, 2, 1)
    formulas = list(made(X, U))
    assert {one.kind for one in nodes_in_order(formulas)} >= {"norm", "tanh", "arctan", "sqrt"}
    y = np.random.default_rng(0).uniform(0.5, 2, (6, 3))
    np.testing.assert_allclose(values_of(formulas, y), [made(row[:2], row[2:]) for row in y], rtol=1e-14)
    again = [formula_from_text("f", exact_text(one), (2, 1)) for one in formulas]
    np.testing.assert_array_equal(values_of(again, y), values_of(formulas, y))
    found, exact = jets_of(formulas, y), made.derivatives_at(y[:, :2], y[:, 2:])
    np.testing.assert_allclose(found.slopes, exact[1], rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(found.curvatures, exact[2], rtol=1e-10, atol=1e-12)


def test_functions_of_casadi_have_their_inputs_by_name(casadi):
    x, u = casadi.SX.sym("x", 2), casadi.SX.sym("u")
    named = casadi.Function("named", [u, x], [x[1] - 2 * u], ["u", "x"], ["y"])
    for made in (lfo.from_casadi(named), lfo.from_casadi(lambda u, x: x[1] - 2 * u[0], 2, 1)):
        assert made([0.0, 5.0], [1.0]).tolist() == [3.0]


def test_other_functions_of_casadi_have_its_derivatives(casadi):
    x, u = casadi.SX.sym("x", 2), casadi.SX.sym("u", 1)
    plain = casadi.Function("power", [x, u], [casadi.vertcat(casadi.sinh(x[0]) * u[0], 0, x[1] ** 2.5)])
    made = lfo.from_casadi(plain)
    made.check_derivatives([([0.3, 0.8], [1.7]), ([2.0, 3.0], [-0.4])])
    assert made.title == "power"
    assert [str(one) for one in made(X, U)] == [f"Formula(power(x_0, x_1, u_0)[{i}])" for i in range(3)]
    exact = np.array([[u0 * math.cosh(a), 0, math.sinh(a)] for a, u0 in ((0.3, 1.7), (1.0, 2.0))])
    found = jets_of(list(made(X, U)), np.array([[0.3, 0.8, 1.7], [1.0, 1.0, 2.0]]))
    np.testing.assert_allclose(found.slopes[:, 0], exact, rtol=1e-14)
    assert found.curvatures[:, 2, 1, 1] == pytest.approx([2.5 * 1.5 * 0.8**0.5, 2.5 * 1.5])
    sent = pickle.loads(pickle.dumps(made))
    np.testing.assert_array_equal(sent([1, 2], [3]), made([1, 2], [3]))
    changed = casadi.vertcat(casadi.sinh(x[0]) * u[0], 1, x[1] ** 2.5)
    other = lfo.from_casadi(casadi.Function("power", [x, u], [changed]))
    assert fingerprint(made) == fingerprint(lfo.from_casadi(plain)) != fingerprint(other)


def test_a_table_of_casadi_is_a_function_and_its_maxima_are_modes(casadi):
    x, u = casadi.MX.sym("x", 1), casadi.MX.sym("u", 1)
    table = casadi.interpolant("table", "bspline", [[0.0, 1.0, 2.0, 3.0]], [0.0, 1.0, 8.0, 27.0])  # a cubic is exact
    made = lfo.from_casadi(casadi.Function("cubic", [x, u], [table(x) + u]))
    made.check_derivatives([([1.3], [0.2])])
    kinked = lfo.from_casadi(casadi.Function("kinked", [x, u], [casadi.fmax(x, u) - casadi.fabs(x)]))
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(lambda x, u: [kinked(x, u)[0] + made(x, u)[0]], 1, 1)
    assert len(dynamics.modes) == 4
    problem = lfo.OptimalControlProblem(dynamics, 1, lfo.QuadraticCost(R=1.0), initial_state=[0.0])
    for a, b in np.random.default_rng(2).uniform(0.1, 2.9, (9, 2)):
        expected = max(a, b) - a + a**3 + b
        assert lfo.simulate(problem, [[b]], [a]).x[1, 0] == pytest.approx(expected, rel=1e-12)


@expensive
def test_the_converter_by_casadi_has_the_optimum_of_the_converter_by_formulas(casadi):
    def fraction(x, u):
        return KEPT * excess(x, u) / (u[0] - POLE)

    box = np.array([[0.8, 2.2]]), np.array([[0.9, 2.3]])
    translated = list(lfo.from_casadi(lambda x, u: 1 - POLE * fraction(x, u), 1, 1)(*lfo.signals(1, 1)))
    found, exact = (interval_jets(f, *box) for f in (translated, library.buck_converter().dynamics.modes[1].f))
    np.testing.assert_allclose(found.values, exact.values, rtol=0.1)
    np.testing.assert_allclose(found.slopes, exact.slopes, rtol=0.1)
    other = lfo.from_casadi(lambda x, u: 1 - POLE * casadi.expm1(casadi.log1p(fraction(x, u))), 1, 1)
    result = lfo.solve(buck(other, **AT_START), method="nonsmooth")
    assert result.cost == pytest.approx(11.554464138730564, rel=1e-10)
    assert result.certificate.worst.relative <= 1e-12


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda c: lfo.from_casadi(3), "from_casadi: got 3; expected a casadi.Function"),
        (lambda c: lfo.from_casadi(lambda x, u: x), "from_casadi.states"),
        (lambda c: lfo.from_casadi(lambda x, u: [x[7]], 1, 1), "RuntimeError.*expression of casadi.SX"),
        (lambda c: lfo.from_casadi(c.Function("f", [c.SX.sym("x"), c.SX.sym("u")], [c.SX(1)]), 2, 1),
         "from_casadi.states: got 2; expected 1, as the function has"),
        (lambda c: lfo.from_casadi(lambda x, u: x.T, 2, 1), "a matrix 1 x 2; expected columns"),
        (lambda c: lfo.from_casadi(c.Function("f", [c.SX.sym("x")], [c.SX(1)])), "1 inputs and 1 outputs"),
        (lambda c: lfo.from_casadi(lambda x, u: c.erf(x) + c.fmax(u, 0), 1, 1), "got fmax, with .* smooth=True"),
        (lambda c: lfo.from_casadi(lambda x, u: c.if_else(x[0] > 0, x[0], u[0]), 1, 1), "got if_else_zero"),
        (lambda c: lfo.from_casadi(lambda x, u: c.erf(x), 2, 1)(X[:1], U), r"x \(1,\).*expected x \(2,\)"),
        (lambda c: lfo.from_casadi(lambda x, u: x, 2, 1)([1], [1]), r"expected x \(2,\)"),
        (lambda c: lfo.PiecewiseSmoothDynamics.from_formulas(c.Function("f", [c.SX.sym("x")], [c.SX(1)]), 1, 1),
         "lfo.from_casadi"),
        (lambda c: lfo.PiecewiseSmoothDynamics(
            [SmoothMode(["x_0"], lfo.from_casadi(lambda x, u: c.fabs(x), 1, 1))], 1, 1),
         "a maximum or minimum in a region"),
    ],
)  # fmt: skip
def test_other_things_of_casadi_are_refused(casadi, make, words):
    with pytest.raises(lfo.errors.ProblemError, match=words):
        make(casadi)


def test_who_says_so_gets_a_function_with_absolute_values_as_a_smooth_one(casadi):
    made = lfo.from_casadi(lambda x, u: casadi.fabs(x[0]) ** 3 + u[0], 1, 1, smooth=True)
    assert isinstance(made(X[:1], U)[0], Formula)
    found = jets_of(list(made(X[:1], U)), np.array([[-2.0, 0.0, 1.0], [0.0, 0.0, 1.0]]))
    assert found.slopes[:, 0, 0].tolist() == [-12.0, 0.0]
    made.check_derivatives([([-0.4], [1.0]), ([0.9], [1.0])])
