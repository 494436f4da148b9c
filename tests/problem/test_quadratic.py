"""The quadratic cost against its definition and differences."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.linear_problems import M, N, T, at_time, generator
from lin_freq_ocp import QuadraticCost
from lin_freq_ocp.base import split_signals, stack_signals
from lin_freq_ocp.errors import ProblemError

# ------------------------------------------------------------------------------------------------------------ costs


def random_cost(seed: int, per_time: bool) -> dict[str, np.ndarray]:
    """Return every term of a cost, one per time where that is allowed."""
    rng = generator(seed)
    times = (T,) if per_time else ()
    raw = {
        "Q": rng.normal(size=(*times, N, N)),
        "R": rng.normal(size=(*times, M, M)),
        "S": rng.normal(size=(*times, N, M)),
        "q": rng.normal(size=(*times, N)),
        "r": rng.normal(size=(*times, M)),
        "P": rng.normal(size=(N, N)),
        "p": rng.normal(size=N),
        "x_ref": rng.normal(size=(T + 1, N) if per_time else N),
        "u_ref": rng.normal(size=(T, M) if per_time else M),
    }
    for field in "QRP":
        raw[field] = raw[field] + np.swapaxes(raw[field], -1, -2)
    return raw


def loop_cost(terms: dict[str, np.ndarray], x: np.ndarray, u: np.ndarray) -> list[float]:
    """Return the stage costs by the sums of the definition, entry by entry."""

    def at(field: str, t: int, ndim: int) -> np.ndarray:
        return at_time(terms[field], t, ndim)

    stages = []
    for t in range(T):
        a, b = x[t] - at("x_ref", t, 1), u[t] - at("u_ref", t, 1)
        Q, R, S, q, r = at("Q", t, 2), at("R", t, 2), at("S", t, 2), at("q", t, 1), at("r", t, 1)
        total = sum(0.5 * Q[i, j] * a[i] * a[j] for i in range(N) for j in range(N))
        total += sum(0.5 * R[i, j] * b[i] * b[j] for i in range(M) for j in range(M))
        total += sum(S[i, j] * a[i] * b[j] for i in range(N) for j in range(M))
        stages.append(total + sum(q[i] * x[t, i] for i in range(N)) + sum(r[j] * u[t, j] for j in range(M)))
    a = x[T] - at("x_ref", T, 1)
    end = sum(0.5 * terms["P"][i, j] * a[i] * a[j] for i in range(N) for j in range(N))
    return [*stages, end + sum(terms["p"][i] * x[T, i] for i in range(N))]


@pytest.mark.parametrize("per_time", [False, True])
def test_cost_is_the_sum_of_the_definition(per_time):
    terms = random_cost(15, per_time)
    cost = QuadraticCost(**terms).at_dimensions(N, M, T)
    rng = generator(16)
    x, u = rng.normal(size=(T + 1, N)), rng.normal(size=(T, M))
    expected = loop_cost(terms, x, u)
    np.testing.assert_allclose(cost.stage_values(x, u), expected, rtol=1e-12)
    assert cost.value(x, u) == pytest.approx(sum(expected), rel=1e-12)


@pytest.mark.parametrize("field", ["Q", "R", "S", "q", "r", "P", "p", "x_ref", "u_ref"])
def test_every_term_of_the_cost_counts(field):
    """Moving any one entry of any one term moves the cost by what the definition says."""
    terms = random_cost(17, per_time=False)
    rng = generator(18)
    x, u = rng.normal(size=(T + 1, N)), rng.normal(size=(T, M))
    before = QuadraticCost(**terms).at_dimensions(N, M, T).value(x, u)
    changed = dict(terms)
    changed[field] = terms[field] + np.eye(*terms[field].shape) if terms[field].ndim == 2 else terms[field] + 1.0
    after = QuadraticCost(**changed).at_dimensions(N, M, T).value(x, u)
    expected = sum(loop_cost(changed, x, u)) - sum(loop_cost(terms, x, u))
    assert abs(expected) > 1e-3
    assert after - before == pytest.approx(expected, rel=1e-10)


def test_the_half_is_part_of_the_definition():
    cost = QuadraticCost(Q=1.0, R=3.0, P=5.0).at_dimensions(1, 1, 2)
    assert cost.value(np.array([[2.0], [0.0], [1.0]]), np.array([[0.0], [4.0]])) == 0.5 * (4 + 3 * 16 + 5)


def test_linear_terms_act_on_the_variables_and_not_on_the_deviations():
    cost = QuadraticCost(q=[1.0], r=[10.0], p=[100.0], x_ref=[7.0], u_ref=[7.0]).at_dimensions(1, 1, 1)
    assert cost.value(np.array([[2.0], [3.0]]), np.array([[4.0]])) == 2 + 40 + 300


@pytest.mark.parametrize("per_time", [False, True])
def test_gradient_is_the_central_difference(per_time):
    cost = QuadraticCost(**random_cost(19, per_time)).at_dimensions(N, M, T)
    rng = generator(20)
    x, u = rng.normal(size=(T + 1, N)), rng.normal(size=(T, M))
    in_x, in_u = cost.gradient(x, u)
    step = 0.5  # exact for a quadratic, whatever the step
    for array, gradient, which in ((x, in_x, 0), (u, in_u, 1)):
        assert gradient.shape == array.shape
        for index in np.ndindex(array.shape):
            move = np.zeros_like(array)
            move[index] = step
            ahead, behind = [(x + s * move, u) if which == 0 else (x, u + s * move) for s in (1, -1)]
            slope = (cost.value(*ahead) - cost.value(*behind)) / (2 * step)
            assert gradient[index] == pytest.approx(slope, rel=1e-9, abs=1e-9)


def test_slope_magnitudes_are_the_sums_of_absolute_terms():
    terms = random_cost(21, per_time=True)
    cost = QuadraticCost(**terms).at_dimensions(N, M, T)
    rng = generator(22)
    x, u = rng.normal(size=(T + 1, N)), rng.normal(size=(T, M))
    in_x, in_u = split_signals(cost.slope_magnitudes(stack_signals(x, u)), N)
    a, b = np.abs(x) + np.abs(terms["x_ref"]), np.abs(u) + np.abs(terms["u_ref"])
    for t in range(T):
        Q, R, S = (np.abs(terms[field][t]) for field in "QRS")
        np.testing.assert_allclose(in_x[t], Q @ a[t] + S @ b[t] + np.abs(terms["q"][t]), rtol=1e-12)
        np.testing.assert_allclose(in_u[t], R @ b[t] + S.T @ a[t] + np.abs(terms["r"][t]), rtol=1e-12)
    np.testing.assert_allclose(in_x[T], np.abs(terms["P"]) @ a[T] + np.abs(terms["p"]), rtol=1e-12)
    true_x, true_u = cost.gradient(x, u)
    assert (np.abs(true_x) <= in_x).all()
    assert (np.abs(true_u) <= in_u).all()


def test_stage_hessians_are_second_differences():
    cost = QuadraticCost(**random_cost(23, per_time=True)).at_dimensions(N, M, T)
    rng = generator(24)
    x, u, dx, du = (rng.normal(size=shape) for shape in ((T + 1, N), (T, M), (T + 1, N), (T, M)))
    values = [cost.stage_values(x + s * dx, u + s * du)[:T] for s in (1, 0, -1)]
    w = np.hstack([dx[:T], du])
    bent = np.einsum("ti,tij,tj->t", w, cost.stage_hessians, w)
    np.testing.assert_allclose(bent, values[0] - 2 * values[1] + values[2], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("terms", "expected"),
    [
        ({"Q": 1.0, "R": 1.0}, None),
        ({"Q": np.diag([1.0, 0.0]), "R": 0.0}, None),  # semidefinite is convex
        ({"Q": np.array([[1.0, 1.0], [1.0, 1.0]]) / 3}, None),  # eigenvalue 0 up to rounding
        ({"R": -2.0}, (0, -2.0)),
        ({"Q": [np.eye(2), np.diag([1.0, -0.5]), np.eye(2)]}, (1, -0.5)),
        ({"P": np.diag([1.0, -3.0])}, (-1, -3.0)),
        ({"Q": 1.0, "R": 1.0, "S": [[2.0], [0.0]]}, (0, -1.0)),  # convex in x and in u, not in (x, u): 1 - 2
        ({"Q": [np.diag([1e12, -0.6]), np.diag([1.0, -0.5]), np.eye(2)]}, (1, -0.5)),  # rounding there, fault here
    ],
    ids=["convex", "semidefinite", "rounding", "R", "Q at 1", "P", "S", "behind a large one"],
)
def test_nonconvexity_is_found_where_it_is(terms, expected):
    found = QuadraticCost(**terms).at_dimensions(2, 1, 3).nonconvexity()
    if expected is None:
        assert found is None
    else:
        assert found is not None
        assert found[0] == expected[0]
        assert found[1] == pytest.approx(expected[1], rel=1e-12)


def test_numbers_stand_for_multiples_of_the_identity():
    terms = QuadraticCost(Q=2.0, R=3.0, P=4.0).at_dimensions(3, 2, 4)
    for found, factor, size in ((terms.Q, 2, 3), (terms.R, 3, 2), (terms.P, 4, 3)):
        np.testing.assert_array_equal(found, factor * np.eye(size))


@pytest.mark.parametrize(
    ("terms", "field"),
    [
        ({"Q": [[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}, "cost.Q"),
        ({"R": [[1.0, 1e-9], [0.0, 1.0]]}, "cost.R"),
        ({"P": np.ones((T, N, N))}, "cost.P"),
        ({"Q": np.eye(2)}, "cost.Q"),
        ({"R": np.ones((T + 1, M, M))}, "cost.R"),
        ({"S": np.zeros((M, N))}, "cost.S"),
        ({"S": 1.0}, "cost.S"),
        ({"q": 1.0}, "cost.q"),
        ({"q": np.ones((T + 1, N))}, "cost.q"),
        ({"r": np.ones(N)}, "cost.r"),
        ({"p": np.ones((T, N))}, "cost.p"),
        ({"x_ref": np.ones((T, N))}, "cost.x_ref"),
        ({"u_ref": np.ones((T + 1, M))}, "cost.u_ref"),
    ],
)
def test_costs_that_do_not_fit_are_refused_by_name(terms, field):
    with pytest.raises(ProblemError) as caught:
        QuadraticCost(**terms).at_dimensions(N, M, T)
    assert caught.value.field == field


def test_rounding_of_a_symmetric_matrix_is_no_asymmetry():
    rounded = np.array([[1.0, 0.3], [0.1 + 0.2, 1.0]])
    assert rounded[0, 1] != rounded[1, 0]
    np.testing.assert_array_equal(QuadraticCost(Q=rounded).at_dimensions(2, 1, 1).Q, rounded)


# ------------------------------------------------------------------------------------------------- the whole problem


def test_a_cost_with_diagonal_matrices_is_judged_by_their_entries():
    assert QuadraticCost(Q=[[1, 0], [0, -2.0]], R=1.0).at_dimensions(2, 1, 4).nonconvexity() == (0, -2.0)
    assert QuadraticCost(Q=[[1, 0], [0, 2.0]], R=1.0).at_dimensions(2, 1, 4).nonconvexity() is None
