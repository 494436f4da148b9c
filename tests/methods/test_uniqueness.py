"""Whether multipliers are the only ones, and abnormal ones: where they exist, and that they win nowhere they need not.

A constraint given twice leaves the normal multipliers many; abnormal ones (eta_C = 0) exist only where constraints
oppose each other: where some are equations in disguise. What opposes itself at one time within a set has no multiplier
that the theorem counts (C-ii): the adjoint and the frequency multipliers are zero then.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.random.mixed import problem_of, random_model
from helpers.replacing import substitute
from helpers.seeds import seeds
from lin_freq_ocp.certificate import judge
from lin_freq_ocp.methods import Uniqueness, abnormal_multipliers, uniqueness

T = 12
CART = lfo.LinearDynamics([[1, 0.2], [0, 1]], [[0.02], [0.2]])
SPEED = {"C": [[0.0, -1.0]], "D": None, "e": [0.35]}
BOX = lfo.Box(-0.6, 0.6)


def cart(**fields: Any) -> lfo.OptimalControlProblem:
    given = {"cost": lfo.QuadraticCost(Q=1.0, R=0.2), "control_set": BOX, "initial_state": [1.0, 0.0]}
    return lfo.OptimalControlProblem(CART, T, **(given | fields))


TWICE = {
    "the same rows under two names": (
        cart(stage_rows=lfo.StageRows(**SPEED, name="speed")),
        cart(stage_rows=[lfo.StageRows(**SPEED, name="speed"), lfo.StageRows(**SPEED, name="speed again")]),
        lambda u: 4,
    ),
    "a bound repeated by a polyhedron": (
        cart(),
        cart(control_set=BOX & lfo.sets.Polyhedron([[-1.0], [1.0]], [0.6, 0.6])),
        lambda u: int((np.abs(u) > 0.6 - 1e-6).sum()),
    ),
    "a bound repeated by a ball": (
        cart(),
        cart(control_set=BOX & lfo.sets.Ball(0.6)),
        lambda u: int((np.abs(u) > 0.6 - 1e-6).sum()),
    ),
    "a bound repeated by joint rows": (
        cart(),
        cart(stage_rows=lfo.StageRows(None, [[-1.0]], [0.6])),
        lambda u: int((u < -0.6 + 1e-6).sum()),
    ),
}


@pytest.mark.parametrize("name", TWICE)
def test_what_is_given_twice_counts_once(name):
    once, twice, repeated = TWICE[name]
    single, double = lfo.solve(once), lfo.solve(twice)
    assert double.cost == pytest.approx(single.cost, rel=1e-7)
    assert single.uniqueness.unique
    found = double.uniqueness
    assert not found.unique
    assert found.rank == single.uniqueness.rank
    assert found.active - found.rank == repeated(double.control) > 0
    assert "perhaps some of many" in str(found)
    assert str(single.uniqueness).startswith("unique")


@pytest.mark.parametrize("name", TWICE)
def test_what_is_given_twice_leaves_no_abnormal_multipliers(name):
    """Both pull the same way, so they cannot cancel; many normal ones there are, and each is accepted."""
    _, twice, _ = TWICE[name]
    result = lfo.solve(twice)
    assert abnormal_multipliers(twice, result.trajectory) is None
    certificate = lfo.certify(twice, result.trajectory)
    assert (certificate.pmp, certificate.normal) == ("satisfied", True)


def test_all_shares_of_two_equal_rows_are_accepted():
    problem = TWICE["the same rows under two names"][1]
    result = lfo.solve(problem)
    total = sum(result.multipliers.stage.values())
    assert total.max() > 1e-2
    for share in (0.0, 0.3, 1.0):
        stage = {"speed": share * total, "speed again": (1 - share) * total}
        assert judge(problem, result.trajectory, replace_stage(result.multipliers, stage)).pmp == "satisfied"
    stage = {"speed": total, "speed again": 0.1 * total}
    assert judge(problem, result.trajectory, replace_stage(result.multipliers, stage)).pmp == "violated"


def replace_stage(given: lfo.results.Multipliers, stage: dict[str, np.ndarray]) -> lfo.results.Multipliers:
    return lfo.results.Multipliers(given.eta_C, given.eta, given.mu, given.nu, given.rho_u, given.rho_x, stage)


def scaled(given: lfo.results.Multipliers, factor: float) -> lfo.results.Multipliers:
    parts = (factor * part for part in (given.eta, given.mu, given.nu, given.rho_u, given.rho_x))
    return lfo.results.Multipliers(given.eta_C, *parts, {name: factor * part for name, part in given.stage.items()})


@pytest.mark.parametrize("seed", seeds(range(11)))
def test_multipliers_of_generic_problems_are_unique_and_normal(seed):
    problem = problem_of(random_model(seed))
    result = lfo.solve(problem)
    assert result.uniqueness.unique
    assert abnormal_multipliers(problem, result.trajectory) is None


TWO = lfo.LinearDynamics(np.eye(2), np.eye(2))
LOWER = lfo.Box([0.5, None], None)


def degenerate(**fields: Any) -> lfo.OptimalControlProblem:
    """Return a problem whose first control has one value to take, and whose second one is free."""
    cost = lfo.QuadraticCost(Q=1.0, R=1.0)
    return lfo.OptimalControlProblem(TWO, T, cost, **({"initial_state": [1.0, 1.0], "control_set": LOWER} | fields))


DEGENERATE = {  # name: problem, the first control's only value
    "the end is reached by the lowest control alone": (
        degenerate(terminal_state=lfo.Box([None, None], [1.0 + 0.5 * T, None])),
        0.5,
    ),
    "a mask on the mean": (degenerate(control_spectrum=lfo.MagnitudeBound(0.5 * T, bins=[0], component=0)), 0.5),
    "a stop band on the mean": (
        degenerate(control_set=lfo.Box([0.0, None], None), control_spectrum=lfo.stop_band(bins=[0], component=0)),
        0.0,
    ),
    "a mask on an output": (
        degenerate(
            output_spectrum=lfo.spectrum.OutputSpectrum(None, [[2.0, 0.0]], lfo.MagnitudeBound(float(T), bins=[0]))
        ),
        0.5,
    ),
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_at_a_degenerate_point_abnormal_multipliers_exist_and_so_does_a_way_down(name):
    problem, value = DEGENERATE[name]
    u = np.tile([value, 0.3], (T, 1))
    point = lfo.simulate(problem, u)
    certificate = lfo.certify(problem, point)
    assert certificate.feasible
    assert (certificate.pmp, certificate.normal) == ("satisfied", False)
    assert certificate.bound is None  # abnormal multipliers say nothing of the cost
    assert not certificate.globally_optimal
    along = certificate.descent
    assert along.slope < 0
    np.testing.assert_allclose(along.u[:, 0], 0, atol=1e-6)
    step = 1e-4
    assert problem.value(point.x + step * along.x, u + step * along.u) < problem.value(point.x, u)
    assert not uniqueness(problem, point).unique


@pytest.mark.parametrize("name", DEGENERATE)
def test_where_normal_multipliers_exist_they_win(name):
    problem, value = DEGENERATE[name]
    result = lfo.solve(problem)
    np.testing.assert_allclose(result.control[:, 0], value, atol=1e-6)
    certificate = lfo.certify(problem, result.trajectory)
    assert (certificate.pmp, certificate.normal) == ("satisfied", True)
    assert certificate.descent is None
    assert certificate.globally_optimal
    assert abnormal_multipliers(problem, result.trajectory) is not None  # and yet there are some


@pytest.mark.parametrize("name", DEGENERATE)
@pytest.mark.parametrize("factor", [1e-20, 1e-6, 1e9])
def test_any_multiple_of_abnormal_multipliers_is_as_good(name, factor):
    problem, value = DEGENERATE[name]
    point = lfo.simulate(problem, np.tile([value, 0.3], (T, 1)))
    assert judge(problem, point, scaled(abnormal_multipliers(problem, point), factor)).pmp == "satisfied"


@pytest.mark.parametrize("size", [1e-20, 1e-9, 1.0])
@pytest.mark.parametrize("name", DEGENERATE)
def test_other_abnormal_multipliers_are_refused_however_small(name, size):
    """Without a unit of cost, nothing is small: rounding errors prove nothing."""
    problem, value = DEGENERATE[name]
    point = lfo.simulate(problem, np.tile([value, 0.3], (T, 1)))
    rng, zero = np.random.default_rng(0), abnormal_multipliers(problem, point)
    noise = lfo.results.Multipliers(
        0.0, size * rng.standard_normal((T, 2)), 0 * zero.mu, 0 * zero.nu, 0 * zero.rho_u, 0 * zero.rho_x, {}
    )
    certificate = judge(problem, point, noise)
    assert certificate.pmp == "violated"
    assert {"C-iii", "C-v"} <= {one.label for one in certificate.failed}


def test_rows_that_oppose_each_other_at_one_time_are_no_abnormal_extremal():
    """They are an equation: the sum of their multipliers is zero, and so is all that C-ii counts, but for rounding."""
    rows = [lfo.StageRows([[0.0, 1.0]], None, [-0.3], name="at most")]
    rows.append(lfo.StageRows([[0.0, -1.0]], None, [0.3], name="at least"))
    problem = lfo.OptimalControlProblem(
        CART, T, lfo.QuadraticCost(Q=1.0, R=0.2), control_set=BOX, initial_state=[1.0, -0.3], stage_rows=rows
    )
    u = np.zeros((T, 1))
    u[-1] = 0.4  # the last control moves the last state alone, which is free
    point = lfo.simulate(problem, u)
    found = abnormal_multipliers(problem, point)
    assert found is not None
    assert [one.label for one in judge(problem, point, found).failed] == ["C-ii"]
    certificate = lfo.certify(problem, point)
    assert (certificate.pmp, certificate.feasible, certificate.normal) == ("violated", True, True)
    assert certificate.descent.slope < 0
    best = lfo.certify(problem, lfo.solve(problem).trajectory)
    assert (best.pmp, best.normal) == ("satisfied", True)
    assert not lfo.solve(problem).uniqueness.unique


def test_the_radius_of_a_ball_alone_is_no_multiplier():
    """It is a constant of the program, and its own dual, the radius' price, a combination of nothing."""
    problem = cart(control_set=lfo.sets.Ball(0.6), terminal_state=lfo.sets.Ball(0.5, [0.1, -0.5]))
    other = lfo.solve(replace(problem, cost=lfo.QuadraticCost(R=1.0)))
    assert abnormal_multipliers(problem, other.trajectory) is None
    certificate = lfo.certify(problem, other.trajectory)
    assert (certificate.pmp, certificate.normal) == ("violated", True)
    assert certificate.descent.slope < 0


def test_without_a_trajectory_there_is_nothing_to_say():
    result = lfo.solve(lfo.library.pendulum(horizon=60, control_bound=1.0), throw=False)
    with pytest.raises(lfo.errors.SolveError, match="without a trajectory"):
        _ = result.uniqueness


def test_a_dense_rank_is_not_tried_for_too_many_gradients(monkeypatch):
    result = lfo.solve(cart())
    substitute(monkeypatch, "methods.MOST_GRADIENTS", 20)
    with pytest.raises(lfo.errors.UnsupportedError, match="29 active gradients; their rank is computed for up to 20"):
        _ = result.uniqueness


def test_in_words():
    assert str(Uniqueness(7, 7)) == "unique: the 7 active gradients are independent"
    assert str(Uniqueness(7, 5)) == "perhaps some of many: of 7 active gradients 5 are independent"
