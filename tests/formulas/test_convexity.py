"""What is proven to be convex is convex, and what is not convex is not proven to be."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.formulas import convex_curvature, formula_from_text, is_convex, jets_of, least_curvature, values_of

T = 4
CONVEX = [  # text, and half the width of the box; inf: everywhere
    ("3*x_0 - u_0 + t", np.inf),
    ("(x_0 - 2*u_0 + sin(t))**4 + 0.5*(u_0 - 1)**2", np.inf),
    ("exp(x_0 + u_0**2) + cosh(x_0 - t)", np.inf),
    ("look_up(t, 1, 0, 2, 3) * (x_0**2 + 1) + 0.1*t*u_0**2", np.inf),
    ("sqrt(1 + x_0**2)", 0.3),
    ("cos(x_0) + x_0**2 + u_0**2", 5.0),
    ("x_0*u_0 + x_0**2 + u_0**2", np.inf),
    ("-log(x_0 + 2)", 1.0),
    ("(x_0 + 2*u_0)**2", np.inf),  # its own diagonal has a negative entry
    ("x_0**4 + (x_0 - 3*u_0)**2 + u_0**2", np.inf),
    ("(x_0 + 2*u_0)**2 + (x_0 - 2*u_0)**2", np.inf),
]
OTHERS = [
    ("x_0*u_0", np.inf),
    ("-x_0**2", np.inf),
    ("x_0**3", 1.0),
    ("cos(x_0)", 1.0),
    ("look_up(t, 1, 0, -2, 3) * x_0**2", np.inf),
    ("(2 - t) * x_0**2", np.inf),
    ("exp(-x_0**2)", 2.0),
    ("x_0**2 - 0.01*u_0**2", np.inf),
    ("(x_0**2)**2 - x_0**2", 1.0),
    ("sqrt(x_0 + 2)", 1.0),
    ("abs(x_0)", 1.0),
]


def proven(text, half):
    formula, box = formula_from_text("f", text, (1, 1)), np.full((T, 2), half)
    return formula, is_convex(formula, -box, box), least_curvature(formula, -box, box)


@pytest.mark.parametrize(("text", "half"), CONVEX)
def test_convex_formulas_are_proven(text, half):
    assert proven(text, half)[1]


@pytest.mark.parametrize(("text", "half"), OTHERS)
def test_other_formulas_are_not(text, half):
    assert not proven(text, half)[1]


@pytest.mark.parametrize(("text", "half"), CONVEX + OTHERS)
def test_what_is_said_of_a_formula_holds_at_random_points(text, half):
    formula, convex, least = proven(text, half)
    rng, size = np.random.default_rng(0), min(half, 2.0)
    for t in range(T):
        a, b = rng.uniform(-size, size, (2, 200, 2))
        at = np.array([t])
        values = [values_of([formula], y, at)[:, 0] for y in (a, b, (a + b) / 2)]
        if convex:
            assert (values[2] <= (values[0] + values[1]) / 2 + 1e-9 * (1 + np.abs(values[2]))).all()
        if "abs" not in text:
            hessians = jets_of([formula], a, times=at).curvatures[:, 0]
            smallest = np.linalg.eigvalsh(hessians - np.diag(np.where(np.isfinite(least[t]), least[t], -1e9)))
            assert (smallest[:, 0] >= -1e-9 * np.abs(hessians).max()).all()
        if convex:
            box = np.full((T, 2), half)
            curvature = convex_curvature(formula, -box, box)
            smallest = np.linalg.eigvalsh(jets_of([formula], a, times=at).curvatures[:, 0] - np.diag(curvature[t]))
            assert (curvature >= 0).all()
            assert (smallest[:, 0] >= -1e-9 * np.abs(hessians).max()).all()


def test_terms_without_a_coupling_keep_their_curvature_where_others_are_unbounded():
    formula, box = formula_from_text("f", "(x_0 - 10)**4 + 3*u_0**2", (1, 1)), np.full((T, 2), np.inf)
    np.testing.assert_allclose(convex_curvature(formula, -box, box), [[0.0, 6.0]] * T)


def test_a_function_without_enclosures_is_not_proven():
    table = lfo.DifferentiableFunction(lambda x, u: [x[0] ** 2], lambda x, u: [[2 * x[0], 0.0]], name="table")
    x, u = lfo.signals(1, 1)
    box = np.ones((T, 2))
    assert not is_convex(table(x, u)[0], -box, box)
