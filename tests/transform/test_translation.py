"""A problem with its states counted from elsewhere is the same problem."""

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.transform import Change, far_origin, translated_by, translation_of

ORIGIN = np.array([5.0, -3.0])


def everything(**changed):
    """Return a problem with all that moves along."""
    T, rng = 6, np.random.default_rng(1)
    given = {
        "dynamics": lfo.LinearDynamics(rng.standard_normal((2, 2)), [[0.0], [1.0]], [0.1, 0.2]),
        "horizon": T,
        "cost": lfo.QuadraticCost(
            Q=np.diag([1.0, 0.5]), R=1.0, S=[[0.1], [0.2]], q=[0.3, 0.0], p=[0.0, 0.7], x_ref=[1.0, 2.0]
        )
        + lfo.costs.L1Cost(x=[0.1, 0.0], terminal=0.2, x_ref=[0.5, 0.0])
        + lfo.costs.LInfCost(x=1.0, u=0.1),
        "control_set": lfo.Box(-2, 2),
        "state_set": [lfo.sets.Soft(lfo.Box(-1, 1), 3.0), *[lfo.sets.Ball(6.0)] * T],
        "initial_state": [1.0, 0.0],
        "terminal_state": lfo.sets.LinkedEnds([[1.0, 0.0]], [[0.0, 1.0]], [0.5]) & lfo.Box(-9, 9),
        "stage_rows": lfo.StageRows([[1.0, 1.0]], [[1.0]], [4.0], penalty=2.0),
    }
    return lfo.OptimalControlProblem(**{**given, **changed})


def test_costs_terms_and_residuals_are_the_same():
    given = everything()
    translation = translated_by(given, ORIGIN)
    assert translation.moves
    rng = np.random.default_rng(2)
    trajectory = lfo.Trajectory(3 * rng.standard_normal((7, 2)), rng.standard_normal((6, 1)))
    moved, problem = translation.start(trajectory), translation.problem
    cost = problem.value(moved.x, moved.u) + translation.cost
    assert cost == pytest.approx(given.value(trajectory.x, trajectory.u), rel=1e-13)
    assert [term.name for term in problem.terms] == [term.name for term in given.terms]
    for mine, theirs in zip(problem.terms, given.terms, strict=True):
        ours, others = (
            one.violation(x, u) for one, x, u in ((mine, moved.x, moved.u), (theirs, trajectory.x, trajectory.u))
        )
        np.testing.assert_allclose(ours, others, atol=1e-12)
    successors = problem.linear.successors(moved.x, moved.u), given.linear.successors(trajectory.x, trajectory.u)
    np.testing.assert_allclose(successors[0] + ORIGIN, successors[1], atol=1e-12)
    restored = translation.trajectory(moved)
    np.testing.assert_allclose(restored.x, trajectory.x, atol=1e-15 * 8)


def test_offsets_are_rounded_once():
    """A c + d - c, of numbers of 1e9, is right to the last digit of what is left."""
    dynamics = lfo.LinearDynamics([[1.0, 0.125], [0.0, 1.0]], [[0.0], [1.0]], [0.1, 0.0])
    moved = dynamics.translated(np.array([1e9, 8.0]), 1)
    np.testing.assert_array_equal(moved.offset, [1.1, 0.0])


def located(**changed):
    """Return where states of a problem are counted from."""
    at_rest = lfo.LinearDynamics(np.eye(2), [[0.0], [1.0]])
    given = {"dynamics": at_rest, "cost": lfo.QuadraticCost(R=1.0), "terminal_state": None}
    return far_origin(everything(**{**given, **changed}))


def test_states_count_from_where_the_data_say_that_they_are():
    np.testing.assert_array_equal(located(initial_state=[1e6, 0.0]), [1e6, 0.0])
    np.testing.assert_array_equal(located(initial_state=lfo.Box([1e6, 0], [1e6 + 2, 1])), [1e6 + 1, 0.0])
    free = {"initial_state": None, "state_set": None}
    np.testing.assert_array_equal(located(terminal_state=[0.0, 7e5], **free), [0.0, 7e5])
    tracking = lfo.QuadraticCost(Q=np.diag([1.0, 0.0]), R=1.0, x_ref=[2e6, 3e6])
    np.testing.assert_array_equal(located(cost=tracking, **free), [2e6, 0.0])
    bounded = lfo.Box([None, 4e6], [9.0, 4e6 + 1])
    np.testing.assert_array_equal(located(initial_state=None, state_set=bounded), [0.0, 4e6 + 0.5])


def test_states_that_move_from_afar_to_zero_count_from_zero():
    np.testing.assert_array_equal(located(initial_state=[1e6, 0.0], terminal_state=[0.0, 0.0]), [0.0, 0.0])
    driven = lfo.LinearDynamics(np.eye(2), [[1.0], [1.0]])
    free = {"dynamics": driven, "initial_state": [1e6, 0.0], "control_set": None, "state_set": None}
    for cost in (lfo.QuadraticCost(Q=1.0, R=1.0), lfo.costs.L1Cost(x=1.0)):
        np.testing.assert_array_equal(located(cost=cost, **free), [0.0, 0.0])


@pytest.mark.parametrize("cost", [lfo.QuadraticCost(Q=1.0, R=1.0), lfo.costs.L1Cost(x=1.0), lfo.costs.LInfCost(x=1.0)])
def test_a_reference_out_of_reach_keeps_no_zero(cost):
    for reach in (1.0, 1e3):
        given = {"initial_state": [1e6, 0.0], "control_set": lfo.Box(-reach, reach), "state_set": None, "cost": cost}
        np.testing.assert_array_equal(located(**given), [1e6, 0.0])


def test_a_bound_that_stands_for_none_places_no_state():
    for bound in (1e12, 1e19):
        free = located(initial_state=None, state_set=lfo.Box([-bound, -1.0], [bound, 1.0]))
        np.testing.assert_array_equal(free, [0.0, 0.0])


@pytest.mark.parametrize(
    "spectrum",
    [lfo.stop_band(bins=[0], component=0), lfo.MagnitudeBound(1e7, bins=[0, 1], component=0)],
    ids=["stop band", "mask"],
)
def test_a_state_whose_mean_is_limited_keeps_its_zero(spectrum):
    given = {"initial_state": [1e6, 1e6], "state_set": None}
    np.testing.assert_array_equal(located(state_spectrum=spectrum, **given), [0.0, 1e6])


def test_a_state_whose_other_bins_are_limited_moves_along():
    given = {"initial_state": [1e6, 0.0], "state_set": None, "state_spectrum": lfo.MagnitudeBound(1.0, bins=[2, 3])}
    np.testing.assert_array_equal(located(**given), [1e6, 0.0])


def test_a_cost_that_says_nothing_of_other_origins_keeps_the_problem():
    class Own(lfo.costs.L1Cost):
        def translated(self, origin):
            return None

    at_rest = lfo.LinearDynamics(np.eye(2), [[0.0], [1.0]])
    problem = everything(
        dynamics=at_rest, cost=lfo.QuadraticCost(R=1.0) + Own(u=0.1), initial_state=[1e6, 0.0], terminal_state=None
    )
    assert not translation_of(problem).moves
    assert translation_of(replace(problem, cost=lfo.QuadraticCost(R=1.0))).moves


def test_where_the_dynamics_move_a_state_by_themselves_it_counts_from_zero():
    """Decay from afar: the state comes near zero, or moves by much of its distance."""
    for growth in (0.1, 0.9, 1.1):
        dynamics = lfo.LinearDynamics(growth * np.eye(2), [[0.0], [1.0]])
        np.testing.assert_array_equal(located(dynamics=dynamics, initial_state=[1e6, 0.0]), [0.0, 0.0])
    about = lfo.LinearDynamics(0.1 * np.eye(2), [[0.0], [1.0]], [0.9e6, 0.0])  # decay to 1e6
    np.testing.assert_array_equal(located(dynamics=about, initial_state=[1e6, 0.0]), [1e6, 0.0])


def test_a_change_of_the_given_problem_is_one_of_the_translated_problem():
    given, origin = lfo.library.double_integrator(horizon=5), np.array([1e6, 0.0])
    change = Change(
        initial_state=np.add(origin, [1.0, 0.0]),
        terminal_state=np.add(origin, [2.0, 0.0]),
        references={"x_ref": np.add(origin, [3.0, 0.5])},
        bounds={"state_set": lfo.Box(origin - 4.0, origin + 4.0)},
    )
    given = replace(given, cost=lfo.QuadraticCost(Q=1.0, R=1.0))
    translation, changed = translated_by(given, origin), change.apply(given)
    moved = translation.change(change, changed).apply(translation.problem)
    x, u = np.arange(12.0).reshape(6, 2), np.ones((5, 1))
    assert moved.value(x, u) == pytest.approx(changed.value(x + origin, u))
    for field in ("initial_box", "terminal_box", "state_boxes"):
        assert (getattr(moved, field).lower + origin == getattr(changed, field).lower).all()
