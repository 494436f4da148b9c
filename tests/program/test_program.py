"""Residuals of a program, which judge a solver."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.sparse as sp

from lin_freq_ocp.program import Program


def hand_program() -> tuple[Program, np.ndarray, np.ndarray]:
    """Return min 1/2 |z|^2 - 2 z_0 + 5 with z_0 + z_1 = 1, z_1 >= -3, z_0 <= 1.2, and its answer."""
    program = Program(
        P=sp.csc_array(np.eye(2)),
        q=np.array([-2.0, 0.0]),
        constant=5.0,
        A=sp.csc_array(np.array([[1.0, 1.0], [0.0, 1.0], [1.0, 0.0]])),
        lower=np.array([1.0, -3.0, -np.inf]),
        upper=np.array([1.0, np.inf, 1.2]),
    )
    # z = (1.2, -0.2): z_1 + y_0 = 0 gives y_0 = 0.2, and 1.2 - 2 + 0.2 + y_2 = 0 gives y_2 = 0.6
    return program, np.array([1.2, -0.2]), np.array([0.2, 0.0, 0.6])


def test_residuals_of_an_answer_found_by_hand_are_zero():
    program, z, y = hand_program()
    assert program.residuals(z, y).worst < 1e-15
    assert program.objective(z) == pytest.approx(0.5 * (1.44 + 0.04) - 2.4 + 5)
    np.testing.assert_array_equal(program.equality, [True, False, False])


@pytest.mark.parametrize(
    ("dz", "dy", "kind", "size"),
    [
        ((1e-3, 0.0), (0, 0, 0), "primal", 1e-3 / 1.201),  # both z_0 <= 1.2 and the equation
        ((0.0, -1e-3), (0, 0, 0), "primal", 1e-3 / 1.2),
        ((0.0, 0.0), (1e-3, 0, 0), "dual", 1e-3 / 2),
        ((0.0, 0.0), (0, 0, -1e-3), "dual", 1e-3 / 2),
        ((0.0, 0.0), (0, 1e-3, 0), "dual", 1e-3 / 2),  # z_1 has no upper bound: no positive dual
    ],
)
def test_residuals_measure_what_was_perturbed(dz, dy, kind, size):
    program, z, y = hand_program()
    residuals = program.residuals(z + dz, y + dy)
    assert getattr(residuals, kind) == pytest.approx(size, rel=1e-6)
    assert residuals.worst >= getattr(residuals, kind)


def test_residuals_refuse_duals_of_the_wrong_sign():
    """At z <= 0.3, -y fails stationarity; a dual on the side without bound fails even where stationarity holds."""
    program = Program(
        sp.csc_array([[1.0]]), np.array([-1.0]), sp.csc_array([[1.0]]), np.array([-np.inf]), np.array([0.3])
    )
    z = np.array([0.3])
    assert program.residuals(z, np.array([0.7])).worst < 1e-15
    assert program.residuals(z, np.array([-0.7])).dual > 0.5
    other = dataclasses.replace(program, q=np.array([1.0]))  # min 1/2 z^2 + z, z <= 0.3: z = -1, y = 0
    assert other.residuals(np.array([-1.0]), np.zeros(1)).worst == 0
    cheat = other.residuals(z, np.array([-1.3]))  # stationary at the bound, with a sign it cannot have
    assert cheat.dual == pytest.approx(1.0)


def test_residuals_see_a_dual_without_an_active_bound():
    """Feasible and stationary, but not complementary: only the gap tells."""
    program = Program(sp.csc_array([[1.0]]), np.array([-1.0]), sp.csc_array([[1.0]]), np.array([-1.0]), np.array([0.9]))
    residuals = program.residuals(np.array([0.5]), np.array([0.5]))
    assert residuals.primal == 0
    assert residuals.dual == 0
    objective = 0.5 * 0.5**2 + 0.5  # its terms in absolute value
    assert residuals.gap == pytest.approx(0.5 * (0.9 - 0.5) / objective)


@pytest.mark.parametrize("broken", ["z", "y", "both"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_residuals_of_an_answer_that_is_no_number_are_never_small(broken, value):
    program, z, y = hand_program()
    if broken in ("z", "both"):
        z = np.array([value, -0.2])
    if broken in ("y", "both"):
        y = np.array([value, 0.0, 0.6])
    with np.errstate(invalid="ignore"):
        worst = program.residuals(z, y).worst
    assert not worst <= 1e-6


def test_the_gap_is_that_of_the_lagrangian_dual():
    """For z and y that are stationary, the gap is J(z) minus the dual function, evaluated here by a fine grid."""
    program = Program(
        sp.csc_array([[2.0]]), np.array([-3.0]), sp.csc_array([[1.0]]), np.array([-0.5]), np.array([1.0]), 7.0
    )
    z = np.array([0.8])
    y = 3.0 - 2 * z  # stationary
    grid = np.linspace(-5, 5, 200_001)
    dual = (grid**2 - 3 * grid + 7 + y * grid).min() - max(y * 1.0, -y * 0.5)
    scale = 0.64 + 3 * 0.8  # what the terms of the objective add up to
    assert program.residuals(z, y).gap == pytest.approx((program.objective(z) - dual[0]) / scale, rel=1e-6)


def test_a_proof_of_infeasibility_rests_on_bounds_that_exist():
    """z >= 1 and z <= 0 contradict each other; without the upper bound, the same duals prove nothing."""
    none, ray = np.zeros(1), np.array([-1.0, 1.0])
    lower, upper = np.array([1.0, -np.inf]), np.array([np.inf, 0.0])
    program = Program(sp.csc_array((1, 1)), none, sp.csc_array([[1.0], [1.0]]), lower, upper)
    assert program.infeasibility_residual(ray) == 0
    feasible = dataclasses.replace(program, upper=np.full(2, np.inf))
    assert feasible.infeasibility_residual(ray) == pytest.approx(1.0)


def test_residuals_refuse_duals_outside_the_polar_of_a_cone():
    """Min 0 with s = (z_0, z_1) in a cone: the duals (0, 1) are stationary, and complementary at 0, but no normal."""
    program = Program(
        sp.csc_array((2, 2)),
        np.array([0.0, -1.0]),
        sp.csc_array(np.eye(2)),
        np.zeros(2),
        np.full(2, np.inf),
        cones=(slice(0, 2),),
    )
    assert program.residuals(np.zeros(2), np.array([0.0, 1.0])).dual == pytest.approx(1.0)
    inside = dataclasses.replace(program, q=np.array([1.0, -1.0]))
    assert inside.residuals(np.zeros(2), np.array([-1.0, 1.0])).worst == 0


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_of_several_rows_on_one_variable_the_tightest_bounds_count(order):
    """-4 <= z <= 3, -2 <= 2 z <= 4 and -5 <= -z <= 1, in any order: -1 <= z <= 2."""
    rows = np.array([[1.0, -4.0, 3.0], [2.0, -2.0, 4.0], [-1.0, -5.0, 1.0]])[list(order)]
    program = Program(sp.csc_array((1, 1)), np.zeros(1), sp.csc_array(rows[:, :1]), rows[:, 1], rows[:, 2])
    bounds = program.single_bounds()
    assert (bounds.below.tolist(), bounds.above.tolist(), bounds.violation) == ([-1.0], [2.0], 0.0)


@pytest.mark.parametrize(
    ("coefficients", "lower", "upper"),
    [([0.0], [-3.0], [-1.0]), ([0.0], [1.0], [3.0]), ([1.0, 1.0], [2.0, 0.0], [3.0, 1.0])],
    ids=["0 <= -1", "1 <= 0", "2 <= z <= 1"],
)
def test_rows_that_no_point_satisfies_are_violations(coefficients, lower, upper):
    rows = sp.csc_array(np.array(coefficients)[:, None])
    rows.eliminate_zeros()
    program = Program(sp.csc_array((1, 1)), np.zeros(1), rows, np.array(lower), np.array(upper))
    bounds = program.single_bounds()
    assert bounds.violation == 1.0
    assert (bounds.below <= bounds.above).all()
