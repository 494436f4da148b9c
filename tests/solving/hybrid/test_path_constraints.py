"""Problems with path constraints, solved and judged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.path_constraints import disc, mass, way_around
from helpers.seeds import expensive
from lin_freq_ocp.certificate import judge
from lin_freq_ocp.methods import zero_multipliers

AROUND = {"initial_state": [-0.6, 0.77, 0.3, 0.9], "terminal_state": [0.6, 0.77, 0, 0]}
BALL = "x_0**2 + x_1**2 - 0.99"


@pytest.fixture
def around():
    return way_around()


@expensive
def test_the_way_around_a_disc_touches_it_with_a_multiplier(around):
    certificate, x, price = around.certificate, around.trajectory.x, around.multipliers.stage["path"]
    assert (around.status, certificate.pmp, certificate.second_order.passed) == ("locally_optimal", "satisfied", True)
    assert price.shape == (13, 1)
    assert price.max() > 1.0
    assert (disc(x.T, None)[price[:, 0] > 1e-3] > -1e-7).all()  # complementary
    assert disc(x.T, None).max() <= 1e-9
    assert certificate.worst.relative < 1e-9


@expensive
def test_both_sides_of_an_obstacle_are_tried():
    symmetric = mass(initial_state=[-1, 0, 0, 0])  # a straight line leads through the centre
    result = lfo.solve(symmetric, "nonsmooth")
    assert result.certificate.pmp == "satisfied"
    low, high = (lfo.solve(mass(initial_state=[-1, side, 0, 0]), "nonsmooth") for side in (-0.3, 0.3))
    assert low.cost == pytest.approx(high.cost)
    assert low.trajectory.x[6, 1] < 0 < high.trajectory.x[6, 1]


@expensive
def test_a_wrong_multiplier_or_another_trajectory_is_noticed(around):
    problem, at, price = around.problem, around.trajectory, around.multipliers.stage["path"]
    for changed, label in ((1.01 * price, "C-iii"), (price + 0.1 * price.max(), "N-z")):
        found = judge(problem, at, replace(around.multipliers, stage={"path": changed}))
        assert label in {condition.label for condition in found.failed}, label
    straight = mass("x_0 - 5", name="path")
    found = lfo.certify(problem, lfo.solve(straight).trajectory)
    assert [condition.label for condition in found.failed if condition.on_feasibility] == ["S-z"]
    assert "rows hold: path" in {condition.name for condition in found.failed}


@expensive
@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_a_factor_of_h_changes_no_verdict(around, factor):
    scaled = mass(lambda x, u: factor * disc(x, u))
    far = lfo.Trajectory(around.trajectory.x * [1, 1.5, 1, 1.5], around.trajectory.u)
    result = lfo.solve(scaled, "nonsmooth", start=far)
    assert (result.status, result.certificate.pmp) == ("locally_optimal", "satisfied")
    assert result.cost == pytest.approx(around.cost, rel=1e-8)
    prices = result.multipliers.stage["path"] * factor
    assert np.allclose(prices, around.multipliers.stage["path"], atol=1e-5 * prices.max())
    moved = lfo.Trajectory(around.trajectory.x * [1, 0.999, 1, 1], around.trajectory.u)  # into the disc
    assert not lfo.certify(scaled, moved).feasible


def test_a_factor_of_a_degenerate_h_changes_no_verdict():
    for factor in (1e-6, 1e6):
        certificate = lfo.solve(mass(f"{factor} * x_1**2", initial_state=[-1, 0, 0, 0])).certificate
        assert certificate.pmp == "not_applicable", factor


@expensive
def test_a_convex_one_is_proven_globally_optimal():
    result = lfo.solve(mass(BALL, **AROUND))
    assert (result.status, result.certificate.pmp, result.certificate.bound.kind) == (
        "optimal",
        "satisfied",
        "rigorous",
    )
    assert result.multipliers.stage["path"].max() > 1e-2
    free = lfo.solve(mass("x_0 - 5", **AROUND))
    assert free.cost < result.lower_bound <= result.cost
    by_norm = lfo.solve(mass("norm(x_0, x_1) - sqrt(0.99)", **AROUND))
    assert by_norm.status == "optimal"
    assert by_norm.cost == pytest.approx(result.cost, rel=1e-7)


@expensive
def test_with_costs_by_formulas_and_soft():
    cost = lfo.QuadraticCost(R=1.0) + lfo.costs.SmoothCost(stage="exp(x_0)", terminal="x_2**2")
    assert lfo.solve(mass(BALL, cost=cost, **AROUND)).status == "optimal"
    soft, hard = (lfo.solve(mass(BALL, **AROUND, **given)) for given in ({"price": 1.0}, {}))
    assert soft.status == "optimal"
    assert soft.cost < hard.cost
    assert soft.problem.stage_rows[0].violation(soft.trajectory.x, soft.trajectory.u).max() > 1e-3
    assert soft.multipliers.stage["path"].max() == pytest.approx(1.0)  # the price, where it is violated


@expensive
def test_a_declaration_proves_nothing_but_is_checked(around):
    problem = mass("tanh(0.1 * (x_0**2 + x_1**2 - 0.99))", convex=True, **AROUND)
    result = lfo.solve(problem, "nonsmooth")
    bound = result.certificate.bound
    assert (result.status, bound.kind) == ("locally_optimal", "numerical")
    assert bound.sets.endswith("'path' is convex, as declared")
    assert result.lower_bound == pytest.approx(result.cost, rel=1e-6)
    convex = lfo.certify(mass(convex=True), around.trajectory, around.multipliers)
    assert convex.bound is None  # its Hessian is negative


@expensive
def test_few_states_have_a_global_bound_around_obstacles():
    line = lfo.LinearDynamics([[1.0]], [[1.0]])
    problem = lfo.OptimalControlProblem(
        line, 3, lfo.QuadraticCost(R=1.0), control_set=lfo.Box(-2, 2), state_set=lfo.Box(-2, 2),
        initial_state=[-1.1], terminal_state=[1.1], stage_rows=lfo.sets.PathConstraint("0.25 - x_0**2"),
    )  # fmt: skip
    result = lfo.solve(problem)
    assert result.status == "optimal"
    # the middle step crosses the obstacle, from -0.5 to 0.5
    assert result.cost == pytest.approx(0.5 * (2 * 0.6**2 + 1.0), rel=1e-6)
    nowhere = replace(problem, stage_rows=lfo.sets.PathConstraint("9 - x_0**2"))
    assert lfo.solve(nowhere, throw=False).status == "infeasible"


@expensive
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_an_obstacle_out_of_the_way_leaves_a_proven_optimum(size):
    """The move is along one axis: the other one has no data, and its values are what iterations leave."""
    ends = {"initial_state": [-size, 0, 0, 0], "terminal_state": [size, 0, 0, 0]}
    far = mass(lambda x, u: 0.01 * size**2 - x[0] ** 2 - (x[1] - 3 * size) ** 2, **ends)
    far = replace(far, control_set=lfo.Box(-30 * size, 30 * size))
    result, free = lfo.solve(far), lfo.solve(replace(far, stage_rows=()))
    assert (result.status, result.certificate.pmp, result.bound) == ("optimal", "satisfied", "rigorous")
    assert result.cost == pytest.approx(free.cost, rel=1e-9)
    assert result.certificate.bound.sets.endswith("without path")


@expensive
@pytest.mark.parametrize("price", [None, 1e3])
def test_the_problem_without_obstacles_and_with_what_is_convex_bounds_the_cost(price):
    post = lfo.sets.PathConstraint("0.25 - x_0**2 - x_1**2", name="post", price=price)
    slow = lfo.sets.PathConstraint("x_2**2 + x_3**2 - 0.64", name="slow")
    both = replace(mass(), horizon=30, stage_rows=[post, slow])
    result, without = lfo.solve(both), lfo.solve(replace(both, stage_rows=slow))
    assert without.status == "optimal"
    assert result.cost > 1.001 * without.cost
    assert result.lower_bound == pytest.approx(without.cost, rel=1e-4)
    assert (result.status, result.bound) == ("locally_optimal", "rigorous")


@expensive
def test_a_fixed_end_that_violates_it_is_infeasible():
    result = lfo.solve(mass(terminal_state=[0.2, 0.1, 0, 0]), throw=False)
    assert (result.status, result.primal) == ("infeasible", False)
    assert result.message == "the path constraint 'path' does not hold at the fixed state of t = 12"
    assert lfo.solve(mass(terminal_state=[0.5, 0, 0, 0]), "nonsmooth").certificate.pmp == "satisfied"  # on the disc


@expensive
def test_of_convex_ones_those_in_conflict_are_named():
    free, thrust = (
        lfo.sets.PathConstraint(h, name=name) for h, name in (("x_0**2 - 9", "free"), ("u_0**2 + 1", "thrust"))
    )
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]])
    problem = lfo.OptimalControlProblem(
        dynamics, 5, lfo.QuadraticCost(R=1.0), lfo.Box(-1, 1), initial_state=[0, 0], stage_rows=[free, thrust]
    )
    message = lfo.solve(problem, throw=False).message
    assert message == "proven by a ray: no trajectory satisfies tangents of convex path constraints ('thrust')"


@expensive
def test_convex_ones_that_leave_no_trajectory_are_infeasible_by_a_ray():
    slow = lfo.solve(mass("x_2**2 + x_3**2 - 1"), throw=False)  # 2 m in 1.2 s
    assert slow.status == "infeasible"
    assert slow.message == "proven by a ray: no trajectory satisfies tangents of convex path constraints ('path')"
    assert lfo.solve(mass("x_2**2 + x_3**2 - 1", price=9.0), throw=False).status == "optimal"


@expensive
def test_ones_that_are_not_convex_and_leave_no_trajectory_are_not_proven_infeasible():
    around = lfo.solve(mass(lambda x, u: [disc(x, u), -disc(x, u) - 0.9, x[2] ** 2 + x[3] ** 2 - 1]), throw=False)
    assert around.status == "numerical_error"  # a disc is not convex


def test_dependent_gradients_are_named_with_their_place():
    result = lfo.solve(mass("x_1**2", initial_state=[-1, 0, 0, 0]))
    facts = result.certificate.borders
    assert result.certificate.pmp == "not_applicable"
    assert facts.unqualified[0] == ("path", 1)  # x_0 is fixed
    assert "the active gradients of 'path' at t = 1 to 11 are dependent or zero" in str(facts)

    def both(x, u):  # at x = 0, the gradients are opposite
        return [x[1] - 0.1 * x[0] ** 2, -x[1] - 0.1 * x[0] ** 2]

    crossed = lfo.Trajectory(np.zeros((13, 4)), np.zeros((12, 2)))
    rest = {"initial_state": [0, 0, 0, 0], "terminal_state": [0, 0, 0, 0]}
    assert lfo.certify(mass(both, **rest), crossed).borders.unqualified[0] == ("path", 1)
    assert lfo.certify(mass(lambda x, u: both(x, u)[:1], **rest), crossed).borders.unqualified == ()
    floor = lfo.Box([-9.0, 0.0, -9.0, -9.0], 9.0)  # whose normal is opposite to the gradient
    under = lfo.certify(replace(mass(lambda x, u: both(x, u)[:1], **rest), state_set=floor), crossed)
    assert under.borders.unqualified[0] == ("path", 1)


@expensive
@pytest.mark.parametrize(("limit", "kept"), [(5.00005e-13, True), (4.9e-13, False)])
def test_rounding_inside_a_formula_violates_nothing(limit, kept):
    """log(cosh(1e-6)) is 5e-13 - 8e-26, in double precision 5.0004e-13."""
    dynamics, row = lfo.LinearDynamics([[1.0]], [[1.0]]), lfo.sets.PathConstraint("log(cosh(x_0))", upper=limit)
    problem = lfo.OptimalControlProblem(dynamics, 2, lfo.QuadraticCost(R=1.0), initial_state=[1e-6], stage_rows=[row])
    rest = lfo.certify(problem, np.zeros((2, 1)))
    assert (rest.pmp, rest.feasible) == ("satisfied" if kept else "violated", kept)
    assert lfo.solve(problem, throw=False).status == ("optimal" if kept else "infeasible")


def test_the_second_order_test_has_the_curvature_of_h():
    """At rest on top of h = 0 with a price on the height: no minimum on a disc, a minimum in a bowl."""
    cost = lfo.QuadraticCost(R=0.01, q=[0.0, 1.0, 0.0, 0.0], p=[0.0, 1.0, 0.0, 0.0])
    at = lfo.Trajectory(np.tile([0.0, 0.5, 0.0, 0.0], (13, 1)), np.zeros((12, 2)))
    for h, passed in ((disc, False), ("0.5 - x_1 + x_0**2", True)):
        problem = mass(h, cost=cost, initial_state=[0, 0.5, 0, 0], terminal_state=lfo.Box(-9, 9))
        certificate = judge(problem, at, replace(zero_multipliers(problem, 1.0), stage={"path": np.ones((13, 1))}))
        assert (certificate.pmp, certificate.second_order.passed) == ("satisfied", passed)


@expensive
def test_kinked_dynamics_take_it():
    drag = lfo.PiecewiseSmoothDynamics.from_formulas(
        lambda x, u: [x[0] + 0.1 * x[1], x[1] + 0.1 * u[0] - 0.02 * abs(x[1]) * x[1]], 2, 1
    )
    rows = lfo.sets.PathConstraint(lambda x, u: x[0] ** 2 + x[1] ** 2, upper=1.3, name="speed")
    problem = lfo.OptimalControlProblem(
        drag, 5, lfo.QuadraticCost(R=1.0), control_set=lfo.Box(-40, 40), initial_state=[0, 0], terminal_state=[0.4, 0],
        stage_rows=rows,
    )  # fmt: skip
    result = lfo.solve(problem, lfo.solvers.Nonsmooth(global_bound=False))
    assert result.certificate.pmp == "satisfied"
    assert result.multipliers.stage["speed"].max() > 1e-2


@expensive
def test_obstacles_that_are_larger_than_the_data_say_are_passed_accurately():
    """The data state a height of 0.1 and a force of 30; the way around the disc needs 0.5 and 0.3."""
    A, B = np.eye(4) + 0.1 * np.eye(4, k=2), 0.1 * np.eye(4, 2, k=-2)
    result = lfo.solve(mass(horizon=60, dynamics=lfo.LinearDynamics(A, B)), "nonsmooth")
    assert result.status == "locally_optimal"
    assert result.certificate.worst.relative < 1e-9


@expensive
def test_what_rests_far_from_h_is_certified():
    along = mass("x_0**2 + x_1**2 - 9", initial_state=[-0.6, 0, 0, 0], terminal_state=[0.6, 0, 0, 0])  # x_1 is at rest
    assert lfo.solve(along).status == "optimal"
    still = mass("x_0**2 + x_1**2 - 9", horizon=3, initial_state=[0.5, 0.2, 0, 0], terminal_state=lfo.Box(-9, 9))
    result = lfo.solve(still)
    assert (result.status, result.cost) == ("optimal", 0.0)


def test_a_point_where_h_is_no_number_is_refused():
    with pytest.raises(lfo.errors.ProblemError, match=r"'path', component 0: got nan .* at t = 0; expected finite"):
        lfo.certify(mass("log(x_0) - 1"), np.zeros((12, 2)))
    result = lfo.solve(mass("log(x_0) - 1"), "nonsmooth", throw=False)
    assert "where the dynamics or path constraints are not defined" in result.message


@expensive
@pytest.mark.parametrize("h", ["0.04 - (x_0 - 0.5)**2", "x_0**2 + u_0**2 - 1.5"])
def test_a_price_that_nothing_costs_leaves_multipliers_of_zero(h):
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.8]], [[1.0]]),
        2,
        lfo.QuadraticCost(R=0.0),
        initial_state=[0.0],
        control_set=lfo.Box(-1, 1),
        stage_rows=[lfo.sets.PathConstraint(h, price=5.0)],
    )
    result = lfo.solve(problem, lfo.solvers.Nonsmooth(global_bound=False))
    assert (result.cost, result.certificate.pmp) == (0.0, "satisfied")


@expensive
@pytest.mark.parametrize("away", [0.0, 1e-10, 1e-6])
def test_what_begins_at_its_reference_or_near_is_globally_optimal(away):
    """An iteration leaves a cost of rounding at rest, next to which no gap is small; the rest itself costs nothing."""
    problem = lfo.OptimalControlProblem(
        dynamics=lfo.LinearDynamics([[1.0, 1.0], [0.0, 1.0]], [[0.5], [1.0]], sampling_time=1.0),
        horizon=6,
        cost=lfo.QuadraticCost(Q=0.5, R=0.2, P=1.0, x_ref=[0.6, 0.0]),
        initial_state=[0.6 + away, 0.0],
        control_set=lfo.Box(-1, 1),
        state_set=lfo.Box(-5, 5),
        stage_rows=[lfo.sets.PathConstraint("x_1**2 + u_0**2", "convex path", 0.2)],
    )
    result = lfo.solve(problem, global_bound=False)
    assert result.status == "optimal"
    assert result.cost <= away**2 * 10
