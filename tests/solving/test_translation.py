"""Verdicts, controls and costs do not depend on where zero is.

The long check is scripts/verify.py --part translation.
"""

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks import pairs, translation
from helpers.rounded_products import exact_optimum
from helpers.seeds import expensive, seeds

SEEDS = {"solve": [0, 5, 8, 10, 14, 21], "certify": [1, 3], "step": [2, 9], "minimum time": [4, 7]}
UTM = 5.4e6  # a northing in metres
METHODS = ("auto", "spectral", "structured", "convex")
WITHOUT_BOUNDS = {"control_set": lfo.Box(-np.inf, np.inf), "state_set": lfo.Box(-np.inf, np.inf)}


@pytest.mark.parametrize(
    ("question", "seed"),
    seeds(((question, seed) for question, given in SEEDS.items() for seed in given), always=[(None, 384)]),
)
def test_the_same_problem_far_from_zero_has_the_same_answer(question, seed):
    outcome = translation.check(seed, question)
    assert outcome.passed, outcome


def test_the_sample_has_every_class():
    assert len({translation.kind_of(seed) for seed in SEEDS["solve"]}) >= 4


def move(origin, distance=1.0, T=20, **changed):
    """Return a double integrator that moves from an origin."""
    given = {"cost": lfo.QuadraticCost(R=1.0), "control_set": lfo.Box(-1, 1), **changed}
    dynamics = lfo.LinearDynamics([[1, 1.0], [0, 1]], [[0.5], [1.0]], sampling_time=1.0)
    ends = {"initial_state": [origin, 0], "terminal_state": [origin + distance, 0]}
    return lfo.OptimalControlProblem(dynamics, T, **{**given, **ends})


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("origin", seeds([1e4, 1e6, 1e9]))
@pytest.mark.parametrize("band", [None, lfo.stop_band(bins=[8, 9, 10])], ids=["plain", "band"])
def test_a_move_costs_the_same_from_everywhere(method, origin, band):
    near, far = (lfo.solve(move(place, control_spectrum=band), method) for place in (0.0, origin))
    assert far.status == near.status == "optimal"
    assert far.certificate.globally_optimal
    assert far.certificate.pmp == "satisfied"
    np.testing.assert_allclose(far.cost, near.cost, rtol=1e-12)
    np.testing.assert_allclose(far.control, near.control, atol=1e-9)
    np.testing.assert_allclose(far.trajectory.x[-1], [origin + 1.0, 0.0], atol=1e-15 * origin)


def test_a_state_that_never_moves_is_not_blamed():
    cost = lfo.QuadraticCost() + lfo.costs.SmoothCost(stage="u_0 - 0.2*u_0**2")
    dynamics, ends = lfo.LinearDynamics([[1.0]], [[1.0]]), {"initial_state": [1.0]}
    problem = lfo.OptimalControlProblem(dynamics, 1, cost, lfo.Box(0, 1), lfo.Box(-3, 3), **ends)
    result = lfo.solve(problem, throw=False, global_bound=False)
    assert result.message.startswith("no global bound was asked for")


@expensive
def test_the_bound_of_a_search_tree_is_that_of_the_given_cost():
    """A price on the position costs more where zero is farther away: the tree's bounds are raised by as much."""
    levels, cost = lfo.FiniteSet([-1, 0, 1]), lfo.QuadraticCost(R=1.0, q=[1e-3, 0.0])
    near, far = (lfo.solve(move(place, T=4, control_set=levels, cost=cost)) for place in (0.0, 1e6))
    raised = 4 * 1e-3 * 1e6
    assert far.status == near.status == "optimal"
    assert far.tree_bound.value == pytest.approx(near.tree_bound.value + raised, abs=1e-5)
    np.testing.assert_allclose(far.tree_bound.bounds, near.tree_bound.bounds + raised, atol=1e-5)


def test_a_state_that_misses_its_end_is_not_feasible_however_far_from_zero():
    certificate = lfo.certify(move(UTM, 4.0), np.zeros((20, 1)))
    assert not certificate.feasible
    assert not certificate.globally_optimal


@pytest.mark.parametrize("gain", [1e-4, 1e-8, 1e-9])
@pytest.mark.parametrize("method", METHODS)
def test_a_small_gain_on_a_state_that_is_not_small(gain, method):
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[gain]]),
        20,
        lfo.QuadraticCost(R=1.0),
        lfo.Box(-10, 10),
        initial_state=[1.0],
        terminal_state=[1.0 + 20 * gain],
    )
    result = lfo.solve(problem, method)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(10.0, rel=1e-6)


@pytest.mark.parametrize("gain", seeds([1e6, 1e10, 1e14, 1e100]))
def test_what_large_gains_make_of_a_state_is_no_scale_of_its_residuals(gain):
    """x_1 - x_2 changes by B u alone, by 5e-2 at most: no control leads to (1, 0).

    At 1e20, a trajectory ends there whose every equation holds to half a rounding error of its terms.
    """
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[gain, gain], [gain, gain]], [[5e-5], [0.01]]),
        10,
        lfo.QuadraticCost(R=1.0),
        lfo.Box(-5, 5),
        initial_state=[0, 0],
        terminal_state=[1, 0],
    )
    result = lfo.solve(problem, throw=False)
    assert not result.status.solved
    assert not lfo.certify(problem, np.zeros((10, 1))).feasible


@pytest.mark.parametrize(
    ("origin", "reference", "price"),
    seeds([(1e6, 1e3, 0.2), (1e6, 1e3, 0.02), (1e6, -1e3, 0.02), (1e8, 1e3, 0.2), (1e8, -1e6, 0.2), (1e8, 1e6, 0.02)]),
)
def test_limits_that_meet_in_a_point_prove_as_much_far_from_zero(origin, reference, price):
    """At the end 0.3, more limits meet than variables can reach once 1e6 + 0.3 is rounded, but for 1e-11."""
    near, far = (
        lfo.solve(
            lfo.OptimalControlProblem(
                lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0], [0.1]]),
                30,
                lfo.QuadraticCost(R=0.1) + lfo.costs.L1Cost(x=[1, price], x_ref=[place + reference, 0]),
                lfo.Box(-1, 1),
                initial_state=[place, 0],
                terminal_state=[place + 0.3, 0],
                control_spectrum=lfo.low_pass(2.0),
            )
        )
        for place in (0.0, origin)
    )
    assert far.status == near.status == "optimal"
    np.testing.assert_allclose(far.control, near.control, atol=1e-6)


@pytest.mark.parametrize("origin", [0.0, 1e3])
def test_a_trajectory_at_rest_needs_no_repair_that_controls_cannot_make(origin):
    """One bin of controls passes, and cannot reach two ends."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]]),
        20,
        lfo.QuadraticCost(R=1e-3) + lfo.costs.LInfCost(x=[1.0, 0.0], x_ref=[origin, 0.0]),
        lfo.Box(-1, 1),
        initial_state=[origin, 0.0],
        terminal_state=[origin, 0.0],
        control_spectrum=lfo.low_pass(0.15),
    )
    assert lfo.solve(problem).status == "optimal"


@pytest.mark.parametrize("origin", [0.0, 1e6, 1e9])
def test_at_rest_nothing_moves_and_this_is_optimal(origin):
    result = lfo.solve(move(origin, 0.0))
    assert result.status == "optimal"
    assert result.cost == 0.0
    assert result.certificate.globally_optimal


def test_where_nothing_moves_rounding_is_no_residual():
    """Rotations about a point far away: in double precision, the point that rests there wanders by its last digits."""
    A, centre = np.array([[0.6, -0.8], [0.8, 0.6]]), np.array([1e9 + 0.3, -7e8 / 3])
    dynamics = lfo.LinearDynamics(A, [[0.0], [1.0]], centre - A @ centre)
    ends = {"initial_state": centre, "terminal_state": centre}
    problem = lfo.OptimalControlProblem(dynamics, 20, lfo.QuadraticCost(R=1.0), lfo.Box(-1, 1), **ends)
    trajectory = lfo.simulate(problem, np.zeros((20, 1)))
    assert (trajectory.x != centre).any()
    assert lfo.certify(problem, trajectory).feasible


@pytest.mark.parametrize(("origin", "distance"), [(1e15, 0.125), (1e14, 1.0), (1e14, 1 / 64), (1e6, 2.0**-30)])
def test_rounding_of_states_hides_no_cost(origin, distance):
    """At 1e14 neighbouring numbers are 1/64 apart; the controls, and what they cost, are as exact as anywhere."""
    problem = move(origin, distance)
    assert lfo.solve(problem).cost == pytest.approx(lfo.solve(move(0.0, distance)).cost, rel=1e-9)
    resting = lfo.certify(problem, lfo.simulate(problem, np.zeros((20, 1))))
    assert not resting.globally_optimal


@expensive
@pytest.mark.parametrize("features", [("linear dynamics",), ("mask",), ("levels",)], ids=", ".join)
@pytest.mark.parametrize("deviation", [1e-16, 1e-14, 1e-12, 1e-10])
def test_a_loop_that_comes_to_its_set_point_is_optimal_at_every_step(deviation, features):
    problem = pairs.problem_of(*features)  # with the reference (0.6, 0)
    for start in ([0.6, deviation], [0.6 + deviation, 0.0]):
        result = lfo.solve(problem.with_ends(initial_state=start), throw=False)
        assert result.status == "optimal"
        assert result.cost < 100 * deviation**2 + 1e-30


@pytest.mark.parametrize("features", [("linear dynamics",), ("low pass",)], ids=", ".join)
def test_what_is_proven_within_rounding_of_the_data_is_certified_as_that(features):
    problem = pairs.problem_of(*features).with_ends(initial_state=[0.6 + 1e-12, 0.0])
    result = lfo.solve(problem)
    assert result.certificate.data_rounding > 0
    for certificate in (lfo.certify(problem, result), lfo.certify(problem, result.trajectory)):
        assert certificate.globally_optimal
    assert not lfo.certify(problem, 1.01 * result.trajectory.u).globally_optimal


@pytest.mark.parametrize(
    ("features", "moves"),
    [
        (
            {"stage_rows": [lfo.sets.PathConstraint("0.1 - x_1 - 0.01*sin(x_0)", upper=[[np.inf]] * 3 + [[0.0]] * 3)]},
            True,
        ),
        (
            {
                "stage_rows": [lfo.sets.PathConstraint("0.1 - x_1", upper=[[np.inf]] * 3 + [[0.0]] * 3)],
                **WITHOUT_BOUNDS,
            },
            True,
        ),
        ({"cost": lfo.costs.SmoothCost(stage="cos(x_0 - 0.6)")}, True),
        ({"cost": lfo.costs.SmoothCost(stage="0.1*sin(3*x_0)")}, True),
        ({"cost": lfo.costs.SmoothCost(terminal="-(x_1 - 0.3)**3")}, True),
        ({"cost": lfo.costs.SmoothCost(stage="sin(x_0 - 0.6)**2 + x_1**2")}, False),
    ],
    ids=["path", "path without bounds", "maximum", "slope", "terminal slope", "minimum"],
)
@pytest.mark.parametrize("deviation", seeds([1e-8, 1e-12, 1e-15]))
def test_formulas_that_move_a_state_away_from_its_set_point_say_how_far(deviation, features, moves):
    tracking = lfo.QuadraticCost(Q=0.05, R=0.2, x_ref=[0.6, 0.0])
    cost = tracking + features["cost"] if "cost" in features else tracking
    problem = replace(pairs.problem_of(), **{**features, "cost": cost})
    costs = []
    for start in ([0.6, 0.0], [0.6 + deviation, 0.0]):
        result = lfo.solve(problem.with_ends(initial_state=start), lfo.solvers.Nonsmooth(global_bound=False))
        assert result.status in ("locally_optimal", "optimal")
        costs.append(result.cost)
    assert costs[1] == pytest.approx(costs[0], abs=10 * deviation)
    assert (np.ptp(result.trajectory.x[:, 0]) > 1e-3) == moves


@expensive
@pytest.mark.parametrize("deviation", [1e-14, 1e-11, 1e-9])
def test_a_smooth_plant_near_its_set_point_is_solved(deviation):
    problem = pairs.problem_of("smooth dynamics")
    costs = [lfo.solve(problem.with_ends(initial_state=[0.6 + d, 0.0]), "nonsmooth").cost for d in (0.0, deviation)]
    assert costs[1] == pytest.approx(costs[0], abs=1e-10 + deviation)


def test_multipliers_of_zero_prove_nothing_of_an_end_that_is_missed_by_a_little():
    """Decay to 1e-6 where 0.9e-6 is asked: within the tolerance of conditions, and not at rounding."""
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.1]], [[1.0]]), 6, lfo.QuadraticCost(R=1.0), initial_state=[1.0], terminal_state=[0.9e-6]
    )
    none = lfo.results.Multipliers(
        1.0, np.zeros((6, 1)), np.zeros((7, 1)), np.zeros((6, 1)), np.zeros((4, 1)), np.zeros((4, 1))
    )
    at_rest = lfo.certify(problem, lfo.simulate(problem, np.zeros((6, 1))), none)
    assert at_rest.feasible
    assert not at_rest.globally_optimal
    result = lfo.solve(problem)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(0.5 * 1e-14 / sum(0.01**k for k in range(6)), rel=1e-6)


def test_a_loop_moves_far_from_zero_as_near_it():
    near, far = (lfo.RecedingHorizon(move(place, 4.0)).run([place, 0.0], 6) for place in (0.0, UTM))
    np.testing.assert_allclose(far.controls, near.controls, atol=1e-7)
    assert set(far.statuses) == {"optimal"}


def test_a_loop_that_was_set_up_elsewhere_begins_where_it_is_measured():
    near = lfo.RecedingHorizon(move(0.0)).step([0.0, 0.0], references=None)
    controller = lfo.RecedingHorizon(replace(move(UTM), initial_state=np.zeros(2)))
    np.testing.assert_allclose(controller.step([UTM, 0.0]), near, atol=1e-9)


def test_a_loop_that_travels_stays_accurate():
    """1e7 m in steps of references: after them, a step is that from zero."""
    tracking = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1, 1.0], [0, 1]], [[0.5], [1.0]], sampling_time=1.0),
        10,
        lfo.QuadraticCost(Q=1.0, R=1.0, P=1.0),
        lfo.Box(-1, 1),
    )
    controller, fresh = lfo.RecedingHorizon(tracking), lfo.RecedingHorizon(tracking)
    expected = fresh.step([0.0, 0.0], references={"x_ref": [3.0, 0.0]})
    for place in (0.0, 1e3, 1e5, 1e7):
        found = controller.step([place, 0.0], references={"x_ref": [place + 3.0, 0.0]})
        np.testing.assert_allclose(found, expected, atol=1e-7)
    assert set(controller.log.statuses) == {"optimal"}


def test_many_problems_far_from_zero():
    starts = np.array([[0.0, 0.0], [0.1, 0.0], [-0.2, 0.05]])
    origin = np.array([UTM, 0.0])
    costs = [lfo.QuadraticCost(Q=0.1, R=1.0, P=0.1, x_ref=[place, 0.0]) for place in (0.0, UTM)]
    near = lfo.solve_many(move(0.0, cost=costs[0]), starts)
    far = lfo.solve_many(move(UTM, cost=costs[1]), starts + origin)
    assert far.proven
    np.testing.assert_allclose(far.controls, near.controls, atol=1e-8)
    np.testing.assert_allclose(far.states, near.states + origin, atol=1e-8)
    np.testing.assert_allclose(far.costs, near.costs, rtol=1e-8)


def test_a_solver_takes_other_ends_and_references_far_from_zero():
    cost = lfo.QuadraticCost(Q=np.diag([0.1, 0.0]), R=1.0)
    near = lfo.Solver(move(0.0, cost=replace(cost, x_ref=[1.0, 0.0])))
    far = lfo.Solver(move(UTM, cost=replace(cost, x_ref=[UTM + 1.0, 0.0])))
    for start, end, reference in ((0.0, 1.0, 1.0), (0.5, 2.0, 0.0), (-1.0, 0.0, 3.0)):
        answers = [
            solver.solve([place + start, 0.0], [place + end, 0.0], {"x_ref": [place + reference, 0.0]})
            for solver, place in ((near, 0.0), (far, UTM))
        ]
        assert [one.status for one in answers] == ["optimal", "optimal"]
        assert answers[1].cost == pytest.approx(answers[0].cost, rel=1e-9)
        np.testing.assert_allclose(answers[1].control, answers[0].control, atol=1e-7)


def test_a_linear_cost_far_from_zero_counts_what_it_costs_there():
    """max x_T: the cost is that at the origin, plus that of the move."""
    problem = {place: replace(move(place), cost=lfo.QuadraticCost(R=1.0, p=[-0.1, 0.0])) for place in (0.0, UTM)}
    free = {place: replace(one, terminal_state=None) for place, one in problem.items()}
    near, far = (lfo.solve(one) for one in free.values())
    assert far.cost - near.cost == pytest.approx(-0.1 * UTM, rel=1e-12)
    assert far.lower_bound <= far.cost
    assert far.gap == pytest.approx(near.gap, abs=1e-8)
    np.testing.assert_allclose(far.control, near.control, atol=1e-8)


@expensive
def test_the_cure_of_an_infeasible_move_does_not_depend_on_zero():
    cures = []
    for place in (0.0, UTM):
        with pytest.raises(lfo.errors.InfeasibleError) as caught:
            lfo.solve(move(place, 9.0, T=4))
        cures.append({cure.block: cure.amount for cure in caught.value.result.explanation.cures})
    assert cures[0].keys() == cures[1].keys()
    assert [cures[1][block] for block in cures[0]] == pytest.approx(list(cures[0].values()), rel=1e-4)


def test_an_enclosure_far_along_a_null_space_contains_the_optimal_cost():
    """The checker sees a Hessian that is raised to be semidefinite; what this costs so far away is charged."""
    pytest.importorskip("flint")
    direction = np.array([0.3, -0.7])
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics(np.eye(2), np.zeros((2, 1))),
        3,
        lfo.QuadraticCost(Q=np.outer(direction, direction), R=1.0),
        lfo.Box(-1, 1),
        initial_state=[7e6, 3e6],
    )
    result, exact = lfo.solve(problem), exact_optimum(problem)
    assert exact == pytest.approx(-6.245e-4, rel=1e-3)
    assert result.lower_bound <= exact
    assert result.enclosure.lower <= exact <= result.enclosure.upper
    wrong = replace(result, certificate=replace(result.certificate, cost=1.0))
    with pytest.raises(lfo.errors.SolveError, match="outside of the proven interval"):
        _ = wrong.enclosure
