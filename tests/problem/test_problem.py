"""The description of a problem: dynamics, sets, costs, validation, replay and measures, each against another source."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import linprog
from scipy.signal import cont2discrete

import lin_freq_ocp as lfo
from lin_freq_ocp.analysis import measures, sizes
from lin_freq_ocp.errors import NumericalError, ProblemError
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box, Everything, Point, end_within
from lin_freq_ocp.problem.simulation import simulate
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

T, N, M = 5, 3, 2  # horizon, states, controls: all different, so that an exchanged axis is an error


def generator(seed: int) -> np.random.Generator:
    return np.random.default_rng(seed)


def dynamics_data(seed: int, varying: str) -> dict[str, np.ndarray]:
    """Return A, B and offset, those named in ``varying`` one per time."""
    rng = generator(seed)
    shapes = {"A": (N, N), "B": (N, M), "offset": (N,)}
    return {name: rng.normal(size=(T, *shape) if name in varying else shape) for name, shape in shapes.items()}


def at_time(data: np.ndarray, t: int, constant_ndim: int) -> np.ndarray:
    return data[t] if data.ndim > constant_ndim else data


VARYING = ["", "A", "B", "offset", "A B offset"]


# ---------------------------------------------------------------------------------------------------- dynamics


@pytest.mark.parametrize("varying", VARYING)
def test_successors_are_the_sums_of_the_definition(varying):
    data = dynamics_data(1, varying)
    dynamics = LinearDynamics(**data)
    rng = generator(2)
    x, u = rng.normal(size=(T + 1, N)), rng.normal(size=(T, M))
    found = dynamics.successors(x, u)
    assert found.shape == (T, N)
    assert dynamics.time_varying == ("A" in varying or "B" in varying)
    for t in range(T):
        A, B, d = at_time(data["A"], t, 2), at_time(data["B"], t, 2), at_time(data["offset"], t, 1)
        for i in range(N):
            by_hand = sum(A[i, j] * x[t, j] for j in range(N)) + sum(B[i, j] * u[t, j] for j in range(M)) + d[i]
            assert found[t, i] == pytest.approx(by_hand, rel=1e-13)
        for expected, given_back in zip((A, B, d), dynamics.at(t), strict=True):
            np.testing.assert_array_equal(given_back, expected)
    np.testing.assert_array_equal(found, dynamics.successors(x[:-1], u))  # x_T is not used


@pytest.mark.parametrize("varying", VARYING)
def test_pull_back_is_the_adjoint_of_the_linear_part(varying):
    dynamics = LinearDynamics(**dynamics_data(3, varying))
    rng = generator(4)
    for _ in range(5):
        x, u, eta = rng.normal(size=(T, N)), rng.normal(size=(T, M)), rng.normal(size=(T, N))
        linear = dynamics.successors(x, u) - dynamics.successors(np.zeros((T, N)), np.zeros((T, M)))
        in_x, in_u = dynamics.pull_back(eta)
        assert in_x.shape == (T, N)
        assert in_u.shape == (T, M)
        for t in range(T):  # stage by stage, so that a shift in time cannot cancel
            assert eta[t] @ linear[t] == pytest.approx(in_x[t] @ x[t] + in_u[t] @ u[t], rel=1e-12, abs=1e-12)


def test_magnitudes_bound_every_term():
    data = dynamics_data(5, "A B offset")
    x, u = generator(6).normal(size=(T, N)), generator(7).normal(size=(T, M))
    sums = LinearDynamics(**data).magnitudes().successors(np.abs(x), np.abs(u))
    by_hand = np.array(
        [
            np.abs(data["A"][t] * x[t]).sum(1) + np.abs(data["B"][t] * u[t]).sum(1) + np.abs(data["offset"][t])
            for t in range(T)
        ]
    )
    np.testing.assert_allclose(sums, by_hand, rtol=1e-13)


def test_zero_order_hold_is_the_flow_of_the_differential_equation():
    rng = generator(8)
    A, B, d, h = rng.normal(size=(N, N)), rng.normal(size=(N, M)), rng.normal(size=N), 0.7
    dynamics = LinearDynamics.from_continuous(A, B, h, offset=d)
    assert dynamics.sampling_time == h
    for _ in range(3):
        x, u = rng.normal(size=N), rng.normal(size=M)
        flow = solve_ivp(lambda t, state, u=u: A @ state + B @ u + d, (0, h), x, rtol=1e-11, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(dynamics.successors(x[None], u[None])[0], flow, rtol=1e-8)


def test_zero_order_hold_agrees_with_scipy_and_with_the_double_integrator():
    rng = generator(9)
    A, B = rng.normal(size=(4, 4)), rng.normal(size=(4, 2))
    sampled = cont2discrete((A, B, np.eye(4), np.zeros((4, 2))), 0.3)
    dynamics = LinearDynamics.from_continuous(A, B, 0.3)
    np.testing.assert_allclose(dynamics.A, sampled[0], rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(dynamics.B, sampled[1], rtol=1e-12, atol=1e-13)
    assert not dynamics.offset.any()
    h = 0.25  # A is singular here: no formula with its inverse would do
    fall = LinearDynamics.from_continuous([[0, 1], [0, 0]], [[0], [2]], h, offset=[0, -9.81])
    np.testing.assert_allclose(fall.A, [[1, h], [0, 1]], atol=1e-15)
    np.testing.assert_allclose(fall.B, [[h**2], [2 * h]], rtol=1e-14)
    np.testing.assert_allclose(fall.offset, [-9.81 * h**2 / 2, -9.81 * h], rtol=1e-14)


def test_two_half_steps_are_one_step():
    rng = generator(10)
    A, B, d = rng.normal(size=(N, N)), rng.normal(size=(N, M)), rng.normal(size=N)
    half, whole = (LinearDynamics.from_continuous(A, B, h, offset=d) for h in (0.1, 0.2))
    x, u = rng.normal(size=(1, N)), rng.normal(size=(1, M))
    np.testing.assert_allclose(half.successors(half.successors(x, u), u), whole.successors(x, u), rtol=1e-12)


PLANT = ([[0.0, 1.0], [-2.0, -0.3]], [[0.0], [1.5]], [[1.0, 0.0]], [[0.0]])


def test_continuous_plant_is_sampled_as_python_control_does():
    plant = control.ss(*PLANT)
    expected = control.c2d(plant, 0.05)
    dynamics = LinearDynamics.from_statespace(plant, sampling_time=0.05)
    np.testing.assert_allclose(dynamics.A, expected.A, rtol=1e-12)
    np.testing.assert_allclose(dynamics.B, expected.B, rtol=1e-12)
    assert dynamics.sampling_time == 0.05
    assert dynamics.state_names == tuple(plant.state_labels)
    assert dynamics.control_names == tuple(plant.input_labels)


def test_discrete_plant_is_taken_as_it_is():
    for own, asked, result in ((0.1, None, 0.1), (0.1, 0.1, 0.1), (True, None, None), (True, 0.2, 0.2)):
        dynamics = LinearDynamics.from_statespace(control.ss(*PLANT, own), sampling_time=asked, state_names=["a", "b"])
        np.testing.assert_array_equal(dynamics.A, PLANT[0])
        np.testing.assert_array_equal(dynamics.B, PLANT[1])
        assert dynamics.sampling_time == result
        assert dynamics.state_names == ("a", "b")


@pytest.mark.parametrize(
    ("plant", "sampling_time", "field"),
    [
        (control.ss(*PLANT, None), 0.1, "plant.dt"),  # unspecified, which is neither continuous nor discrete
        (control.ss(*PLANT), None, "sampling_time"),
        (control.ss(*PLANT, 0.1), 0.2, "sampling_time"),
        (control.ss(*PLANT, 1e-5), 1.0005e-5, "sampling_time"),  # small, but a disagreement of 0.05 %
        (control.ss(*PLANT, 1e-9), 5e-9, "sampling_time"),
        (control.ss(*PLANT), -0.1, "dynamics.sampling_time"),
        (control.tf([1], [1, 1]), 0.1, "plant"),
        ("plant", 0.1, "plant"),
    ],
    ids=["no dt", "no step", "mismatch", "100 kHz mismatch", "GHz mismatch", "negative", "transfer function", "text"],
)
def test_plants_that_say_too_little_or_contradict_are_refused(plant, sampling_time, field):
    with pytest.raises(ProblemError) as caught:
        LinearDynamics.from_statespace(plant, sampling_time=sampling_time)
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: LinearDynamics(np.ones((2, 3)), np.ones((2, 1))), "dynamics.A"),
        (lambda: LinearDynamics(np.ones(2), np.ones((2, 1))), "dynamics.A"),
        (lambda: LinearDynamics(np.ones((0, 0)), np.ones((0, 1))), "dynamics.A"),
        (lambda: LinearDynamics(np.eye(2), np.ones(2)), "dynamics.B"),
        (lambda: LinearDynamics(np.eye(2), np.ones((3, 1))), "dynamics.B"),
        (lambda: LinearDynamics(np.eye(2), np.ones((2, 0))), "dynamics.B"),
        (lambda: LinearDynamics(np.eye(2), np.ones((2, 1)), offset=[1.0]), "dynamics.offset"),
        (lambda: LinearDynamics([[1.0, np.nan], [0.0, 1.0]], np.ones((2, 1))), "dynamics.A[0][1]"),
        (lambda: LinearDynamics(np.eye(2), [[np.inf], [0.0]]), "dynamics.B[0][0]"),
        (lambda: LinearDynamics(np.eye(2) * 1j, np.ones((2, 1))), "dynamics.A"),
        (lambda: LinearDynamics([["a"]], [[1.0]]), "dynamics.A"),
        (lambda: LinearDynamics([[1.0, 2.0], [3.0]], [[1.0]]), "dynamics.A"),
        (lambda: LinearDynamics([[1.0]], [[1.0]], sampling_time=0.0), "dynamics.sampling_time"),
        (lambda: LinearDynamics([[1.0]], [[1.0]], sampling_time=[0.1, 0.2]), "dynamics.sampling_time"),
        (lambda: LinearDynamics([[1.0]], [[1.0]], state_names=["a", "b"]), "dynamics.state_names"),
        (lambda: LinearDynamics(np.eye(2), np.eye(2), control_names=["a", "a"]), "dynamics.control_names"),
        (lambda: LinearDynamics([[1.0]], [[1.0]], state_names="a"), "dynamics.state_names"),
        (lambda: LinearDynamics([[1.0]], [[1.0]], state_names=[" "]), "dynamics.state_names"),
        (lambda: LinearDynamics.from_continuous(np.eye(2), np.ones((3, 1)), 0.1), "dynamics.A, B"),
        (lambda: LinearDynamics.from_continuous([[1e6]], [[1.0]], 1.0), "dynamics.A[0][0]"),  # exp(1e6)
    ],
)
def test_dynamics_that_are_none_are_refused_by_name(make, field):
    with pytest.raises(ProblemError) as caught:
        make()
    assert caught.value.field == field
    assert str(caught.value).startswith(f"{field}: got ")


# ------------------------------------------------------------------------------------------------------------ sets

BOXES = {
    "bounded": Box([-1.0, 0.0, 2.0], [1.0, 0.5, 2.0]),
    "half spaces": Box([None, 0.0, None], [1.0, None, None]),
    "point": Point([0.3, -0.2, 1.0]),
    "everything": Everything().at_dimension(3, "set"),
    "one number": Box(-2, None).at_dimension(3, "set"),
}


def oracle_support(box: Box, y: np.ndarray) -> float:
    """Return max <y, v> over the box by HiGHS, which knows nothing of closed forms."""
    answer = linprog(-y, bounds=list(zip(box.lower, box.upper, strict=True)), method="highs")
    assert answer.status in (0, 3)
    return np.inf if answer.status == 3 else -answer.fun


@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES.keys())
def test_support_and_normal_gap_against_linear_programming(box):
    rng = generator(11)
    directions = [rng.normal(size=3) * rng.integers(0, 2, size=3) for _ in range(12)]
    for y in [*directions, *np.eye(3), *-np.eye(3), np.zeros(3)]:
        expected = oracle_support(box, y)
        v = box.project(rng.normal(size=3))
        assert box.support(y) == pytest.approx(expected, abs=1e-12)
        assert box.normal_gap_terms(v, y).sum() == pytest.approx(expected - y @ v, abs=1e-12)
        assert box.normal_gap_terms(v, y).sum() >= 0


@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES.keys())
def test_normal_gap_is_zero_exactly_on_the_normal_cone(box):
    rng = generator(12)
    for _ in range(20):
        w = 3 * rng.normal(size=3)
        v = box.project(w)
        assert box.contains(v)
        assert box.normal_gap_terms(v, w - v).sum() == pytest.approx(0, abs=1e-12)  # w - P(w) is normal at P(w)
        for i in np.flatnonzero((v > box.lower) & (v < box.upper)):
            for sign in (1, -1):
                assert (
                    box.normal_gap_terms(v, sign * np.eye(3)[i]).sum() > 0
                )  # nothing is normal where the box leaves room


@pytest.mark.parametrize("box", BOXES.values(), ids=BOXES.keys())
def test_projection_is_the_nearest_point(box):
    rng = generator(13)
    for _ in range(20):
        w = 3 * rng.normal(size=3)
        nearest = box.project(w)
        np.testing.assert_array_equal(box.project(nearest), nearest)
        np.testing.assert_allclose(box.violation(w), np.abs(w - nearest), atol=1e-15)
        for other in (box.project(3 * rng.normal(size=3)) for _ in range(5)):
            assert (w - nearest) @ (other - nearest) <= 1e-12  # the variational inequality


def test_contains_is_the_definition_in_every_row():
    box = Box([0.0, -np.inf], [1.0, 2.0])
    points = np.array([[0.0, 2.0], [1.0, -1e300], [1.0 + 1e-9, 0.0], [0.5, 2.1], [-0.1, 0.0]])
    np.testing.assert_array_equal(box.contains(points), [True, True, False, False, False])
    np.testing.assert_array_equal(box.contains(points, tolerance=1e-8), [True, True, True, False, False])
    np.testing.assert_allclose(box.violation(points)[:, 0], [0, 0, 1e-9, 0, 0.1], rtol=1e-6)


def test_a_box_per_time_is_a_box_at_each_time():
    lower, upper = np.array([[0.0, -1.0], [-np.inf, 2.0]]), np.array([[1.0, 1.0], [5.0, 2.0]])
    tube, y = Box(lower, upper), np.array([[1.0, -2.0], [-0.5, 3.0]])
    for t in range(2):
        alone = Box(lower[t], upper[t])
        assert tube.support(y)[t] == alone.support(y[t])
        np.testing.assert_array_equal(tube.fixed[t], alone.fixed)
    np.testing.assert_array_equal(tube.fixed, [[False, False], [False, True]])


def test_a_direction_without_bound_and_a_zero_direction():
    box = Box([None, 0.0], [None, 1.0])
    assert box.support(np.array([0.0, 1.0])) == 1.0
    assert box.support(np.zeros(2)) == 0.0  # not NaN from 0 * inf
    assert box.support(np.array([1e-300, 0.0])) == np.inf
    assert box.normal_gap_terms(np.array([5.0, 1.0]), np.array([0.0, 3.0])).sum() == 0.0
    assert box.normal_gap_terms(np.array([5.0, 1.0]), np.array([0.0, -3.0])).sum() == 3.0


def test_an_end_within_bounds_is_membership_in_both_and_keeps_itself_where_there_is_no_point():
    one, other = Box([-1.0, -np.inf], [1.0, 3.0]), Box([0.0, -2.0], [np.inf, 5.0])
    both, beyond = end_within(one, other)
    points = 4 * generator(14).normal(size=(200, 2))
    np.testing.assert_array_equal(both.contains(points), one.contains(points) & other.contains(points))
    assert not beyond.any()
    kept, beyond = end_within(Point([2.0, 0.0]), one)
    np.testing.assert_array_equal(beyond, [True, False])
    np.testing.assert_array_equal(kept.lower, [2.0, 0.0])
    assert not end_within(Point([1.0 + 1e-12, 0.0]), one)[1].any()  # rounding


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Box([1.0, 0.0], [0.0, 1.0]), "Box.lower[0]"),
        (lambda: Box(np.zeros((2, 2)), [[0.0, 0.0], [0.0, -1.0]]), "Box.lower[1][1]"),
        (lambda: Box(np.inf, None), "Box.lower"),
        (lambda: Box(None, -np.inf), "Box.upper"),
        (lambda: Box(np.nan, 1.0), "Box.lower"),
        (lambda: Box([0.0, 0.0], [1.0, 1.0, 1.0]), "Box"),
        (lambda: Box(np.zeros((1, 2, 3)), 1.0), "Box"),
        (lambda: Box("a", 1.0), "Box.lower"),
        (lambda: Box(1j, 2.0), "Box.lower"),
        (lambda: Point([np.inf]), "Point[0]"),
        (lambda: Box([0.0, 0.0], 1.0).at_dimension(3, "control_set"), "control_set"),
    ],
)
def test_sets_that_are_none_are_refused_by_name(make, field):
    with pytest.raises(ProblemError) as caught:
        make()
    assert caught.value.field == field


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


def test_gradient_magnitudes_are_the_sums_of_absolute_terms():
    terms = random_cost(21, per_time=True)
    cost = QuadraticCost(**terms).at_dimensions(N, M, T)
    rng = generator(22)
    x, u = rng.normal(size=(T + 1, N)), rng.normal(size=(T, M))
    in_x, in_u = cost.gradient_magnitudes(x, u)
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
    bent = np.einsum("ti,tij,tj->t", w, cost.stage_hessians(), w)
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


def problem(**changes: Any) -> OptimalControlProblem:
    """Return a problem of two states and one control, with what a test changes."""
    given: dict[str, Any] = {
        "dynamics": LinearDynamics(
            [[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]], sampling_time=0.1, state_names=["position [m]", "speed [m/s]"]
        ),
        "horizon": 4,
        "cost": QuadraticCost(R=1.0),
    }
    return OptimalControlProblem(**(given | changes))


@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        ({"dynamics": np.eye(2)}, "dynamics", "LinearDynamics"),
        ({"horizon": 0}, "horizon", "whole number"),
        ({"horizon": 4.0}, "horizon", "whole number"),
        ({"horizon": True}, "horizon", "whole number"),
        ({"horizon": "4"}, "horizon", "whole number"),
        ({"cost": 1.0}, "cost", "QuadraticCost"),
        ({"cost": QuadraticCost(R=np.eye(2))}, "cost.R", "(1, 1)"),
        ({"cost": QuadraticCost(q=np.ones((5, 2)))}, "cost.q", "(4, 2)"),
        ({"cost": QuadraticCost(x_ref=np.ones((4, 2)))}, "cost.x_ref", "(5, 2)"),
        ({"dynamics": LinearDynamics(np.ones((5, 2, 2)), np.ones((2, 1)))}, "dynamics.A", "4 steps"),
        ({"dynamics": LinearDynamics(np.eye(2), np.ones((3, 2, 1)))}, "dynamics.B", "4 steps"),
        ({"dynamics": LinearDynamics(np.eye(2), np.ones((2, 1)), np.ones((5, 2)))}, "dynamics.offset", "4 steps"),
        ({"control_set": Box([-1, -1], [1, 1])}, "control_set", "bounds for 1"),
        ({"control_set": 5.0}, "control_set", "Box"),
        ({"control_set": "box"}, "control_set", "Box"),
        ({"control_set": [Box(-1, 1)] * 5}, "control_set", "4 sets"),
        ({"control_set": [Box(-1, 1), 0, 0, 0]}, "control_set", "4 sets"),
        ({"control_set": Box(np.zeros((5, 1)), None)}, "control_set", "4 times"),
        ({"state_set": [Box(-1, 1)] * 4}, "state_set", "5 sets"),
        ({"state_set": Box(np.zeros((4, 2)), None)}, "state_set", "5 times"),
        ({"state_set": [Box(-1, 1)] * 4 + [Box([0] * 3, 1)]}, "state_set[4]", "bounds for 2"),
        ({"initial_state": [0.0, 0.0, 0.0]}, "initial_state", "2"),
        ({"initial_state": [0.0, np.nan]}, "initial_state[1]", "finite"),
        ({"initial_state": "origin"}, "initial_state", "numbers"),
        ({"terminal_state": Box(np.zeros((5, 2)), 1)}, "terminal_state", "single set"),
        ({"terminal_state": [1.0]}, "terminal_state", "2"),
        ({"control_spectrum": "low"}, "control_spectrum", "a band"),
        ({"control_spectrum": 20}, "control_spectrum", "a band"),
        ({"state_spectrum": [lfo.low_pass(2.0), None]}, "state_spectrum[1]", "a band"),
        ({"state_spectrum": lfo.low_pass(1.0, component="angle")}, "state_spectrum.component", "'position [m]'"),
        ({"control_spectrum": lfo.low_pass(1.0, component=1)}, "control_spectrum.component", "0 .. 0"),
        ({"control_spectrum": lfo.low_pass(cutoff_hz=6)}, "control_spectrum.low_pass", "Nyquist frequency 5 Hz"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_a_description_that_is_no_problem_names_field_got_and_expected(changes, field, words):
    with pytest.raises(ProblemError) as caught:
        problem(**changes)
    error = caught.value
    assert error.field == field
    assert error.got
    assert words in str(error)
    assert re.match(rf"{re.escape(field)}: got .+; expected .+\.", str(error))
    assert isinstance(error, ValueError)  # so that plain "except ValueError" works


@pytest.mark.parametrize(("end", "value"), [("initial_state", 0.0), ("terminal_state", [[0.0, 0.0]])])
def test_an_end_of_the_wrong_kind_is_named_after_the_end(end, value):
    with pytest.raises(ProblemError) as caught:
        problem(**{end: value})
    assert caught.value.field == end


def test_tubes_take_the_ends_into_the_sets_of_their_times():
    states = [Box([-1.0, -2.0], [1.0 + t, None]) for t in range(5)]
    made = problem(
        state_set=states, initial_state=[0.5, 7.0], terminal_state=Box([0.0, None], [None, 3.0]), control_set=Box(-2, 3)
    )
    tube = made.state_tube
    np.testing.assert_array_equal(tube.lower[0], [0.5, 7.0])
    np.testing.assert_array_equal(tube.upper[0], [0.5, 7.0])
    for t in (1, 2, 3):
        np.testing.assert_array_equal(tube.lower[t], [-1.0, -2.0])
        np.testing.assert_array_equal(tube.upper[t], [1.0 + t, np.inf])
    np.testing.assert_array_equal(tube.lower[4], [0.0, -2.0])
    np.testing.assert_array_equal(tube.upper[4], [5.0, 3.0])
    np.testing.assert_array_equal(made.control_tube.lower, np.full((4, 1), -2.0))
    np.testing.assert_array_equal(made.control_tube.upper, np.full((4, 1), 3.0))


def test_without_sets_and_ends_nothing_is_bounded():
    made = problem()
    for tube, shape in ((made.state_tube, (5, 2)), (made.control_tube, (4, 1))):
        np.testing.assert_array_equal(tube.lower, np.full(shape, -np.inf))
        np.testing.assert_array_equal(tube.upper, np.full(shape, np.inf))
    assert made.control_stop.shape == (3, 1)
    assert made.state_stop.shape == (3, 2)
    assert not made.control_stop.any()
    assert not made.state_stop.any()


def all_arrays(*owners: Any) -> dict[str, np.ndarray]:
    return {
        f"{type(owner).__name__}.{name}": value
        for owner in owners
        for name, value in [(field.name, getattr(owner, field.name)) for field in dataclasses.fields(owner)]
        if isinstance(value, np.ndarray)
    }


def test_nothing_can_be_changed_after_construction():
    A, lower, u = np.eye(2), np.array([-1.0]), np.zeros((4, 1))
    made = problem(dynamics=LinearDynamics(A, np.ones((2, 1))), control_set=Box(lower, [1.0]), initial_state=[0, 0])
    trajectory = simulate(made, u)
    multipliers = Multipliers(1, np.zeros((4, 2)), np.zeros((5, 2)), u, np.zeros((3, 1)), np.zeros((3, 2)))
    arrays = all_arrays(
        made.dynamics, made.cost, made.initial_state, made.state_tube, made.control_tube, trajectory, multipliers
    ) | {"control_stop": made.control_stop, "state_stop": made.state_stop, "Point.value": Point([1.0]).value}
    assert len(arrays) > 20
    for name, array in arrays.items():
        assert not array.flags.writeable, name
    A[0, 0], lower[0], u[0, 0] = 9.0, 9.0, 9.0  # the user's own arrays stay the user's
    assert made.dynamics.A[0, 0] == 1.0
    assert made.control_tube.lower[0, 0] == -1.0
    assert trajectory.u[0, 0] == 0.0
    for owner, field in ((made, "horizon"), (made.dynamics, "A"), (made.cost, "R"), (trajectory, "x")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(owner, field, None)


def test_a_read_only_view_of_writable_numbers_is_copied():
    base = {name: np.zeros(shape) for name, shape in (("A", (2, 2)), ("rho", (3, 1)), ("lower", (2,)))}
    views = {name: array.view() for name, array in base.items()}
    for view in views.values():
        view.flags.writeable = False
    dynamics, box = LinearDynamics(views["A"], np.ones((2, 1))), Box(views["lower"], None)
    complex_base = np.zeros((3, 1), dtype=complex)
    complex_view = complex_base.view()
    complex_view.flags.writeable = False
    zero = np.zeros((4, 2)), np.zeros((5, 2)), np.zeros((4, 1))
    multipliers = Multipliers(1, *zero, complex_view, np.zeros((3, 2)))
    for array in (*base.values(), complex_base):
        array[...] = 5.0
    assert not dynamics.A.any()
    assert not box.lower.any()
    assert not multipliers.rho_u.any()


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Trajectory(np.zeros((4, 2)), np.zeros((4, 1))), "trajectory"),
        (lambda: Trajectory(np.zeros(5), np.zeros((4, 1))), "trajectory"),
        (lambda: Trajectory(np.full((5, 2), np.nan), np.zeros((4, 1))), "trajectory.x[0][0]"),
        (lambda: problem().require(Trajectory(np.zeros((6, 2)), np.zeros((5, 1)))), "trajectory"),
        (lambda: problem().require(Trajectory(np.zeros((5, 1)), np.zeros((4, 1)))), "trajectory"),
    ],
)
def test_trajectories_of_another_shape_are_refused(make, field):
    with pytest.raises(ProblemError) as caught:
        make()
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("eta_C", [1.0, 2.0]),
        ("eta_C", np.nan),
        ("eta", np.zeros(4)),
        ("mu", np.zeros((4, 2))),
        ("nu", np.zeros((5, 1))),
        ("rho_u", np.zeros((4, 1))),
        ("rho_u", np.full((3, 1), np.nan * 1j)),
        ("rho_x", np.zeros((3, 1))),
    ],
)
def test_multipliers_of_another_shape_are_refused(field, value):
    right = {
        "eta_C": 1.0,
        "eta": np.zeros((4, 2)),
        "mu": np.zeros((5, 2)),
        "nu": np.zeros((4, 1)),
        "rho_u": np.zeros((3, 1)),
        "rho_x": np.zeros((3, 2)),
    }
    Multipliers(**right)  # or the test would say nothing
    with pytest.raises(ProblemError) as caught:
        Multipliers(**(right | {field: value}))
    assert caught.value.field == f"multipliers.{field}"


def test_other_ends_make_the_problem_that_a_new_one_would_be():
    made = problem(state_set=Box([-2, -3], [2, 3]), initial_state=[1.0, 0.0], terminal_state=Box([0, -1], [1, 5]))
    _ = made.state_tube, made.ends  # known by now: the other problem must not take them over
    moved = made.with_ends(initial_state=[-1.0, 2.0], terminal_state=Box([-9, 0], [9, 1]))
    anew = problem(state_set=Box([-2, -3], [2, 3]), initial_state=[-1.0, 2.0], terminal_state=Box([-9, 0], [9, 1]))
    for one, other in zip((moved.state_tube, *moved.ends), (anew.state_tube, *anew.ends), strict=True):
        np.testing.assert_array_equal(one.lower, other.lower)
        np.testing.assert_array_equal(one.upper, other.upper)
    np.testing.assert_array_equal(made.state_tube.lower[0], [1.0, 0.0])
    np.testing.assert_array_equal(made.with_ends(initial_state=[0, 0]).ends[1].upper, [1, 3])


def test_a_cost_with_diagonal_matrices_is_judged_by_their_entries():
    assert QuadraticCost(Q=[[1, 0], [0, -2.0]], R=1.0).at_dimensions(2, 1, 4).nonconvexity() == (0, -2.0)
    assert QuadraticCost(Q=[[1, 0], [0, 2.0]], R=1.0).at_dimensions(2, 1, 4).nonconvexity() is None


# ---------------------------------------------------------------------------------------------------------- replay


@pytest.mark.parametrize("varying", VARYING)
def test_simulate_is_the_recursion(varying):
    data = dynamics_data(25, varying)
    made = OptimalControlProblem(LinearDynamics(**data), T, QuadraticCost(), initial_state=[1.0, -2.0, 0.5])
    u = generator(26).normal(size=(T, M))
    trajectory = simulate(made, u)
    x = [1.0, -2.0, 0.5]
    for t in range(T):
        np.testing.assert_allclose(trajectory.x[t], x, rtol=1e-11, atol=1e-12)
        A, B, d = at_time(data["A"], t, 2), at_time(data["B"], t, 2), at_time(data["offset"], t, 1)
        x = [sum(A[i, j] * x[j] for j in range(N)) + sum(B[i, j] * u[t, j] for j in range(M)) + d[i] for i in range(N)]
    np.testing.assert_allclose(trajectory.x[T], x, rtol=1e-11, atol=1e-12)
    np.testing.assert_array_equal(trajectory.u, u)
    np.testing.assert_allclose(measures.one_step_residual(made, trajectory), 0, atol=1e-12)
    np.testing.assert_array_equal(simulate(made, u, initial_state=[0.0, 0.0, 1.0]).x[0], [0.0, 0.0, 1.0])


def test_simulate_refuses_what_overflows():
    made = OptimalControlProblem(LinearDynamics([[1e100]], [[1.0]]), 6, QuadraticCost(), initial_state=[1.0])
    with pytest.raises(NumericalError, match="t = 4"):  # 1, 1e100, 1e200, 1e300, overflow
        simulate(made, np.zeros((6, 1)))
    simulate(made, np.zeros((6, 1)), initial_state=[0.0])


@pytest.mark.parametrize(
    ("u", "start", "field"),
    [
        (np.zeros((5, 1)), [0.0, 0.0], "u"),
        (np.zeros(4), [0.0, 0.0], "u"),
        (np.full((4, 1), np.inf), [0.0, 0.0], "u[0][0]"),
        (np.zeros((4, 1)), [0.0], "initial_state"),
        (np.zeros((4, 1)), None, "initial_state"),  # the problem has none
    ],
)
def test_simulate_refuses_what_it_cannot_replay(u, start, field):
    with pytest.raises(ProblemError) as caught:
        simulate(problem(initial_state=Box([0, 0], [0, 1])), u, start)
    assert caught.value.field == field


# -------------------------------------------------------------------------------------------------------- measures


@settings(max_examples=15, derandomize=True, deadline=None)
@given(seed=st.integers(0, 10**6), size=st.integers(1, 4), times=st.integers(1, 30), varying=st.booleans())
def test_amplification_is_the_norm_of_the_product(seed, size, times, varying):
    A = generator(seed).normal(size=(times, size, size))
    A = A if varying else np.broadcast_to(A[0], A.shape)
    given_A = A if varying else A[0]
    made = OptimalControlProblem(LinearDynamics(given_A, np.ones((size, 1))), times, QuadraticCost())
    product = np.eye(size)
    for matrix in A:
        product = matrix @ product
    assert measures.amplification(made.linear, times) == pytest.approx(np.linalg.norm(product, 2), rel=1e-9)


@pytest.mark.parametrize(
    ("A", "times", "expected"),
    [
        ([[1e30]], 5, 1e150),
        ([[1e-30]], 5, 1e-150),  # needs rescaling on the way
        (np.array([[[1e200]], [[1e200]], [[1e-250]]]), 3, 1e150),  # overflows on the way, not at the end
        (np.array([[[1e-200]], [[1e-200]], [[1e250]]]), 3, 1e-150),
        ([[1e200]], 5, np.finfo(float).max),
        ([[0.0, 1.0], [0.0, 0.0]], 2, 0.0),  # nilpotent
        ([[0.0, -3.0], [3.0, 0.0]], 2, 9.0),
    ],
)
def test_amplification_at_the_ends_of_the_number_range(A, times, expected):
    dynamics = LinearDynamics(A, np.ones((np.shape(A)[-1], 1)))
    assert measures.amplification(dynamics, times) == pytest.approx(expected, rel=1e-9)


def test_a_replay_means_something_up_to_a_growth():
    assert measures.replay_is_meaningful(4.5e4)  # the pendulum at 0.01 s
    assert not measures.replay_is_meaningful(3e46)  # and at 0.1 s


@pytest.mark.parametrize("length", [11, 12])
def test_stopband_energy_is_the_energy_of_the_removed_part(length):
    """Parseval: the half spectrum counts a pair of bins once, the signal without the band the energy of both."""
    rng = generator(27)
    signal = rng.normal(size=(length, 2))
    stopped = rng.random((length // 2 + 1, 2)) < 0.5
    stopped[0], stopped[-1] = [True, False], [False, True]
    kept = np.fft.irfft(np.where(stopped, 0, np.fft.rfft(signal, axis=0)), n=length, axis=0)
    energy = np.zeros(2)
    for j in range(2):
        bins = np.flatnonzero(stopped[:, j])
        single = [k for k in bins if k == 0 or 2 * k == length]
        for k in bins:
            phase = np.exp(-2j * np.pi * k * np.arange(length) / length)
            energy[j] += abs(signal[:, j] @ phase) ** 2
        twice = energy[j] * 2 - sum(abs(np.fft.fft(signal[:, j])[k]) ** 2 for k in single)
        removed = (signal[:, j] ** 2).sum() - (kept[:, j] ** 2).sum()
        assert twice / length == pytest.approx(removed, rel=1e-10)
    assert measures.stopband_energy(signal, stopped) == pytest.approx(energy.sum(), rel=1e-12)
    assert measures.stopband_energy(kept, stopped) == pytest.approx(0, abs=1e-24)
    assert measures.stopband_energy(signal, np.zeros_like(stopped)) is None
    assert measures.stopband_peak(signal, np.zeros_like(stopped)) is None


@pytest.mark.parametrize("length", [15, 16])
def test_stopband_peak_is_the_largest_dtft_between_the_bins(length):
    rng = generator(28)
    signal = rng.normal(size=(length, 2))
    stopped = np.zeros((length // 2 + 1, 2), dtype=bool)
    stopped[2:5, 0] = stopped[6, 0] = stopped[5:, 1] = True
    time = np.arange(length)
    largest = 0.0
    for j, first, last in ((0, 2, 4), (0, 6, 6), (1, 5, length // 2)):
        omega = 2 * np.pi / length * np.linspace(first, last, measures.ZERO_PADDING * (last - first) + 1)
        largest = max(largest, np.abs(np.exp(-1j * np.outer(omega, time)) @ signal[:, j]).max())
    peak = measures.stopband_peak(signal, stopped)
    assert peak == pytest.approx(largest, rel=1e-12)
    assert peak >= np.abs(np.fft.rfft(signal, axis=0))[stopped].max() - 1e-12
    kept = np.fft.irfft(np.where(stopped, 0, np.fft.rfft(signal, axis=0)), n=length, axis=0)
    assert measures.stopband_peak(kept, stopped) > 1e-3  # zero bins are not zero energy between them


def test_stopped_runs_are_the_runs():
    mask = np.array([True, True, False, True, False, False, True])
    assert measures.stopped_runs(mask) == [(0, 1), (3, 3), (6, 6)]
    assert measures.stopped_runs(np.zeros(4, dtype=bool)) == []
    assert measures.stopped_runs(np.ones(4, dtype=bool)) == [(0, 3)]


def test_padded_spectrum_holds_the_bins():
    signal = generator(29).normal(size=(9, 2))
    omega, magnitude = measures.padded_spectrum(signal)
    step = measures.ZERO_PADDING
    np.testing.assert_allclose(magnitude[::step], np.abs(np.fft.rfft(signal, axis=0)), rtol=1e-12)
    np.testing.assert_allclose(omega[::step], 2 * np.pi * np.arange(5) / 9, rtol=1e-14)


def measured(changes: dict[str, Any], x: Any, u: Any) -> measures.Measures:
    return measures.measure(problem(**changes), Trajectory(x, u))


def test_measures_by_hand():
    x = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, -4.0], [0.0, 0.0], [1.5, 1.0]])
    u = np.array([[1.0], [-3.0], [0.0], [2.0]])
    found = measured(
        {
            "state_set": Box([-1, -1], [1, 1]),
            "control_set": Box(-2.5, 1.5),
            "terminal_state": Box([0.5, None], [1.0, None]),
            "initial_state": [1.0, 1.0],  # missed, which is no violation of the state set
            "control_spectrum": lfo.stop_band(bins=[2]),
        },
        x,
        u,
    )
    assert found.cost == pytest.approx(0.5 * (1 + 9 + 4))
    assert found.max_control == 3.0
    assert found.control_violation == 0.5  # 2 - 1.5 and -2.5 - (-3)
    assert found.state_violation == 3.0  # -1 - (-4)
    assert found.terminal_error == 0.5
    assert found.terminal_errors == (0.5, 0.0)
    assert found.stopband_energy == pytest.approx(abs(1 + 3 + 0 - 2) ** 2)  # sum of (-1)^t u_t
    assert found.stopband_peak == pytest.approx(2.0)
    assert found.state_stopband_energy is None
    assert found.state_stopband_peak is None
    assert found.amplification == pytest.approx(np.linalg.norm([[1, 0.4], [0, 1]], 2))


def test_a_free_end_has_no_error():
    found = measured({}, np.ones((5, 2)), np.ones((4, 1)))
    assert found.terminal_error is None
    assert found.terminal_errors is None
    assert found.control_violation == 0.0
    assert found.state_violation == 0.0


def test_one_step_residual_is_what_the_dynamics_miss():
    made = problem(initial_state=[0.0, 1.0])
    trajectory = simulate(made, np.ones((4, 1)))
    x = trajectory.x.copy()
    x[2, 1] += 0.25
    residual = measures.one_step_residual(made, Trajectory(x, trajectory.u))
    expected = np.zeros((4, 2))
    expected[1] = [0.0, 0.25]
    expected[2] = [-0.025, -0.25]  # A (0, 0.25) is missing in the next step
    np.testing.assert_allclose(residual, expected, atol=1e-14)


def test_a_trajectory_of_another_problem_is_not_measured():
    with pytest.raises(ProblemError):
        measures.measure(problem(), Trajectory(np.zeros((4, 2)), np.zeros((3, 1))))


def test_stated_sizes_come_from_ends_then_references_then_bounds():
    made = problem(
        state_set=Box([-9.0, -7.0], [5.0, 3.0]),
        initial_state=[0.5, 0.0],
        terminal_state=Box([-2.0, None], [1.0, None]),
        control_set=Box(-3.0, None),
    )
    states, controls = sizes.stated_sizes(made)
    np.testing.assert_array_equal(states, [2.0, 7.0])
    np.testing.assert_array_equal(controls, [3.0])
    tracking = problem(
        state_set=Box([-9.0, -7.0], [5.0, 3.0]), cost=QuadraticCost(R=1.0, x_ref=[0.25, -4.0], u_ref=[-0.5])
    )
    states, controls = sizes.stated_sizes(tracking)
    np.testing.assert_array_equal(states, [0.25, 4.0])
    np.testing.assert_array_equal(controls, [0.5])
    for part in sizes.stated_sizes(problem()):  # nothing is said, but a size is a size
        assert (part > 0).all()
        assert np.isfinite(part).all()


def test_bounds_per_time_may_have_none():
    box = Box([[None, -1], [0, None]], None)
    assert box.lower.tolist() == [[-np.inf, -1], [0, -np.inf]]
    assert box.upper.tolist() == [[np.inf, np.inf], [np.inf, np.inf]]
