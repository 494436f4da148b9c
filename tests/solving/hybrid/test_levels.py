"""Controls with levels: the relaxation with few samples between levels, whole levels against enumeration, the judge."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.seeds import expensive, seeds
from lin_freq_ocp import simulate
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.certificate.hybrid import tree_bound
from lin_freq_ocp.problem.hybrid import cost_unit
from lin_freq_ocp.transform import rows_of_levels

T = 6
LEVELS, COSTS = [-1.0, 0.0, 1.0], [0.3, 0.1, 0.4]


def switched(state=1.0, cost=1.0, **further) -> lfo.OptimalControlProblem:
    """Return a double integrator with three levels, in units ``state`` and ``cost``."""
    h = 0.5
    dynamics = lfo.LinearDynamics([[1.0, h], [0.0, 1.0]], state * np.array([[h * h / 2], [h]]))
    weights = cost / state**2
    return lfo.OptimalControlProblem(
        dynamics,
        T,
        lfo.QuadraticCost(Q=weights * np.diag([1.0, 0.1]), P=weights * np.diag([5.0, 5.0])),
        control_set=lfo.FiniteSet(LEVELS, cost * np.array(COSTS)),
        state_set=lfo.Box(-9 * state, 9 * state),
        initial_state=[1.3 * state, 0.4 * state],
        **further,
    )


@pytest.fixture(scope="module")
def solved() -> lfo.results.Result:
    return lfo.solve(switched())


def by_enumeration(problem: lfo.OptimalControlProblem) -> float:
    """Return the least cost, by hand: levels and their costs are written out here."""
    best = np.inf
    for u in product(range(3), repeat=T):
        control = np.array(LEVELS)[list(u)][:, None]
        x = simulate(problem, control).x
        best = min(best, float(problem.quadratic.value(x, control)) + sum(COSTS[i] for i in u))
    return best


@expensive
def test_whole_levels_are_those_of_enumeration(solved):
    assert solved.status == "optimal"
    assert solved.cost == pytest.approx(by_enumeration(solved.problem), rel=1e-9)
    assert abs(solved.gap) <= 1e-6
    assert solved.certificate.pmp == "not_applicable"  # a level is a region by itself
    assert "levels of controls are isolated: the theorem does not apply" in str(solved.certificate)
    assert not solved.certificate.failed
    assert np.isin(np.round(solved.control, 9), LEVELS).all()
    assert solved.level_use.fractional == 0
    assert "levels    0 of 6 samples between levels" in str(solved)
    assert np.array_equal(solved.level_use.duty_cycles[0].argmax(axis=1), solved.sequence)


@pytest.mark.parametrize(("state", "cost"), seeds([(1e6, 1.0), (1.0, 1e-9), (1e-6, 1e9)]))
def test_verdicts_do_not_depend_on_units(solved, state, cost):
    other = lfo.solve(switched(state, cost))
    assert other.status == "optimal"
    assert other.cost == pytest.approx(cost * solved.cost, rel=1e-6)
    assert other.sequence.tolist() == solved.sequence.tolist()
    assert not other.certificate.failed


def seeded_levels(seed: int, unit: float) -> lfo.OptimalControlProblem:
    """Return a problem with irregular levels in this unit of u; the optimum of even seeds is 0 at all times."""
    rng = np.random.default_rng(seed)
    n, horizon = 1 + seed % 2, int(rng.integers(3, 7))
    A = np.linalg.qr(rng.normal(size=(n, n)))[0] * rng.uniform(0.5, 1.0)
    levels = np.array([[-1.0, 0.0, 0.75], [0.1, 1 / 3], [0.0, 1 / 7, 0.9], [-0.3, 0.1, 1 / 3]][seed % 4])
    weight, slope = rng.uniform(1, 20) / unit**2, rng.uniform(-0.2, 0.2, 1) / unit
    return lfo.OptimalControlProblem(
        lfo.LinearDynamics(A, rng.normal(size=(n, 1)) / unit, 0.01 * rng.normal(size=n)),
        horizon,
        lfo.QuadraticCost(Q=np.diag(rng.choice([0.0, 1.0], n)), R=weight, r=slope),
        control_set=lfo.FiniteSet(unit * levels),
        state_set=lfo.Box(-9, 9),
        initial_state=0.3 * rng.normal(size=n) if seed < 4 else lfo.Box(np.full(n, -0.2), np.full(n, 0.4)),
    )


@pytest.mark.parametrize("seed", seeds(range(6)))
def test_controls_are_exactly_at_levels_in_every_unit_also_where_all_are_zero(seed):
    plain = lfo.solve(seeded_levels(seed, 1.0))
    assert plain.control.any() == bool(seed % 2)
    for unit in (1e-8, 1.0, 1e8):
        problem = seeded_levels(seed, unit)
        result = lfo.solve(problem)
        assert result.status == "optimal"
        assert result.certificate.feasible
        assert np.isin(result.control, problem.control_set.levels).all()
        assert np.array_equal(result.trajectory.x, simulate(problem, result.control, result.trajectory.x[0]).x)
        assert result.sequence.tolist() == plain.sequence.tolist()
        assert result.cost == pytest.approx(plain.cost, rel=1e-9)


@pytest.mark.parametrize("unit", seeds([1e-8, 1.0, 1e8]))
def test_an_optimum_that_costs_nothing_is_proven_to_the_rounding_of_what_levels_cost(unit):
    cost = lfo.QuadraticCost(R=10 / unit**2, r=[0.01 / unit])
    result = lfo.solve(replace(seeded_levels(0, unit), cost=cost, initial_state=[0.1], horizon=6))
    assert result.status == "optimal"
    assert result.cost == 0.0


def test_rounding_of_a_control_that_rests_is_measured_by_its_levels():
    problem = seeded_levels(0, 1.0)
    rest = np.zeros((problem.horizon, 1))
    for distance, feasible in ((0.0, True), (1e-15, True), (5e-7, True), (3e-6, False)):
        certificate = lfo.certify(problem, simulate_linear(problem, rest + distance))
        assert certificate.feasible is feasible


def simulate_linear(problem: lfo.OptimalControlProblem, u: np.ndarray) -> lfo.Trajectory:
    """Return the trajectory of controls that need not be at levels."""
    x, dynamics = [problem.initial_box.lower], problem.dynamics
    for now in u:
        x.append(dynamics.A @ x[-1] + dynamics.B @ now + dynamics.offset)
    return lfo.Trajectory(x, u)


def test_a_control_between_levels_fails_at_its_label(solved):
    u = solved.control.copy()
    u[2] += 3e-6 if u[2] < 1 else -3e-6
    verdict = lfo.certify(solved.problem, simulate_linear(solved.problem, u), solved.multipliers)
    assert not verdict.feasible
    assert {"S-u", "S-f"} <= {condition.label for condition in verdict.failed}


def test_a_leaf_that_is_missing_proves_nothing(solved):
    tree = solved.tree
    assert tree_bound(solved.problem, tree).covers
    leaves = sorted(set(range(len(tree.nodes))) - {node.parent for node in tree.nodes})
    last = leaves[-1]
    assert last == len(tree.nodes) - 1
    shorter = type(tree)(tree.nodes[:last])
    found = tree_bound(solved.problem, shorter)
    assert not found.covers
    assert found.value == -np.inf


def test_other_costs_of_levels_are_another_problem(solved):
    dearer = replace(solved.problem, control_set=lfo.FiniteSet(LEVELS, [0.3, 0.1 + 1e-3, 0.4]))
    verdict = lfo.certify(dearer, solved)
    assert verdict.cost == pytest.approx(solved.cost + 1e-3 * (np.abs(solved.control) < 0.5).sum(), abs=1e-9)
    assert not verdict.globally_optimal


def test_the_relaxation_needs_as_few_samples_between_levels_as_rows():
    result = lfo.solve(lfo.library.pulse_pattern(kind="shep", samples=128))
    assert result.status == "optimal"
    assert result.cost == pytest.approx(1.25898269, abs=1e-7)
    use = result.level_use
    assert use.rows == 8
    assert 0 < use.fractional <= 8
    assert "no more than 8 are needed" in str(result)
    angle = 2 * np.pi * np.arange(128) / 128
    u = result.control[:, 0]
    for k, amplitude in ((1, 1.5), (3, 0.0), (5, 0.0), (7, 0.0)):
        assert 2 / 128 * u @ np.sin(k * angle) == pytest.approx(amplitude, abs=1e-7)
        assert 2 / 128 * u @ np.cos(k * angle) == pytest.approx(0.0, abs=1e-7)
    shares = use.duty_cycles[0]
    assert (shares @ np.array([4, 1, 0, 1, 4])).mean() == pytest.approx(result.cost, abs=1e-7)


def test_a_wrong_cost_of_duty_cycles_fails_at_its_label():
    problem = lfo.library.pulse_pattern(samples=32)
    result = lfo.solve(problem)
    levels = np.array(problem.control_set.levels)
    dearer = replace(problem, control_set=lfo.FiniteSet(levels, (1 + 1e-4) * levels**2 / 32, duty_cycles=True))
    verdict = lfo.certify(dearer, result)
    assert "N-u" in {condition.label for condition in verdict.failed}
    assert not verdict.globally_optimal


@pytest.mark.parametrize(
    "change",
    [
        {"cost": lfo.QuadraticCost(R=1.0)},
        {"cost": lfo.costs.L1Cost(u=1.0)},
        {"initial_state": lfo.Box(-1, 1)},
        {"state_set": lfo.Box(-2, 2)},
        {"control_spectrum": lfo.MagnitudeBound(0.1, bins=[3])},
    ],
)
def test_where_the_conditions_fail_nothing_is_said_of_rows(change):
    problem = replace(lfo.library.pulse_pattern(samples=32), **change)
    assert rows_of_levels(problem) is None
    assert lfo.solve(problem, throw=False).level_use.rows is None


@expensive
def test_a_search_uses_its_time_and_says_how_much_of_it_the_proof_took():
    """At first, 60 % of the time are for the search; the proof needs less than the rest, and the search goes on."""
    with use_clock(Clock(0.02)):
        result = lfo.solve(lfo.library.pulse_pattern(samples=16, tolerance=0.1), time_limit=6.0, throw=False)
    assert result.status == "limit"
    assert result.certificate.feasible
    said = re.fullmatch(r"time limit of 6 s: (\S+) s of search, (\S+) s of proof", result.message)
    search, proof = (float(one) for one in said.groups())
    assert search > 0.7 * 6.0
    assert 0 < proof < 6.0 - search


def test_the_result_says_where_a_quadratic_cost_counts_means_only():
    problem = replace(lfo.library.pulse_pattern(samples=32), cost=lfo.QuadraticCost(R=1.0))
    relaxed = lfo.solve(problem)
    assert relaxed.level_use.fractional > 0
    assert relaxed.level_use.means
    assert "the quadratic cost counts the mean over the sample" in str(relaxed)
    plain = lfo.solve(lfo.library.pulse_pattern(samples=32))
    assert not plain.level_use.means
    assert "quadratic cost" not in str(plain)


def oscillator_with_thrusters(horizon, costs):
    """Return a mass on a spring that thrusters move away and stop again, nearly."""
    dynamics = lfo.LinearDynamics([[0.995, 0.1], [-0.1, 0.995]], [[0.005], [0.1]])
    end = lfo.Box([0.04, -0.02], [0.16, 0.02])
    thrusters = lfo.FiniteSet([-1, 0, 1], costs=costs)
    states = lfo.Box([-9, -9], [9, 9])
    return lfo.OptimalControlProblem(dynamics, horizon, lfo.QuadraticCost(), thrusters, states, [0, 0], end)


@pytest.mark.parametrize("costs", [[0.1, 0, 0.1]])
def test_a_bound_is_raised_to_the_next_cost_that_levels_can_have(costs):
    """The relaxation switches within samples: its cost is no whole number, and only its root is needed."""
    result = lfo.solve(oscillator_with_thrusters(16, costs), node_limit=1)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(costs[0])
    assert result.cost * (1 - 1e-9) < result.lower_bound < result.cost


@pytest.mark.parametrize("costs", seeds([[1, 0, 2], [0.5, 0, 0.75], [0.1, 0, 0.3]]))
def test_no_bound_is_raised_above_the_least_cost_of_all_sequences(costs):
    problem = oscillator_with_thrusters(6, costs)
    problem = replace(problem, terminal_state=lfo.Box([0.02, -0.12], [0.06, 0.12]))
    prices, least = dict(zip((-1, 0, 1), costs, strict=True)), np.inf
    for levels in product((-1, 0, 1), repeat=6):
        x = np.zeros(2)
        for u in levels:
            x = problem.dynamics.A @ x + problem.dynamics.B[:, 0] * u
        if (problem.terminal_box.lower <= x).all() and (x <= problem.terminal_box.upper).all():
            least = min(least, sum(prices[u] for u in levels))
    result = lfo.solve(problem)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(least)
    assert result.lower_bound <= least


def test_costs_of_states_and_controls_are_no_multiples():
    problem = oscillator_with_thrusters(4, [1, 0, 1])
    assert cost_unit(problem)[0] == 1.0
    for change in ({"cost": lfo.QuadraticCost(R=1.0)}, {"control_set": lfo.FiniteSet([-1, 0, 1])}):
        assert cost_unit(replace(problem, **change))[0] == 0.0
    soft = replace(problem, state_set=lfo.sets.Soft(lfo.Box([-9, -9], [9, 9]), 1.0))
    assert cost_unit(soft)[0] == 0.0


def tanks(unit=1.0, **further) -> lfo.OptimalControlProblem:
    """Return two tanks with a pump into the upper and a valve with three positions out of the lower one."""
    dynamics = lfo.LinearDynamics(
        [[0.9, 0.0], [0.1, 0.95]], np.diag([0.1, -0.05]) / unit, state_names="upper, lower", control_names="pump, valve"
    )
    cost = lfo.QuadraticCost(Q={"lower": 1.0}, R={"pump": 0.1 / unit**2}, x_ref={"lower": 0.5})
    levels = lfo.FiniteSet({"pump": lfo.Box(0, 3 * unit), "valve": [0, unit, 2 * unit]})
    fields = {"cost": cost, "control_set": levels, "initial_state": [0.1, 0.9], "state_set": lfo.Box(0, 2)}
    return lfo.OptimalControlProblem(dynamics, 3, **(fields | further))


@expensive
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_a_control_next_to_one_with_levels_is_optimal_over_all_sequences_of_levels(unit):
    problem = tanks(unit, terminal_state=lfo.Box({"upper": (0.15, None), "lower": (None, 0.75)}))
    result = lfo.solve(problem)
    linear = [lfo.solve(problem.with_modes(sequence), throw=False) for sequence in product(range(3), repeat=3)]
    least = min(one.cost for one in linear if one.status == "optimal")
    assert result.status == "optimal"
    assert result.cost == pytest.approx(least, rel=1e-5)
    assert set(result["valve"] / unit) <= {0, 1, 2}  # exactly
    assert result["pump"].max() > 0.1 * unit
    assert lfo.certify(problem, result.trajectory).feasible
    between = lfo.Trajectory(result.trajectory.x, np.add(result.control, [0, 0.01 * unit]))
    assert "S-f" in [condition.label for condition in lfo.certify(problem, between).failed]


def test_duty_cycles_leave_a_control_without_levels_free():
    costs = {"valve": [0.0, 0.1, 0.2]}
    hull = lfo.FiniteSet({"valve": [0, 1, 2]}, costs, duty_cycles=True)
    box = lfo.Box({"valve": (0, 2)})
    priced = tanks(control_set=box, cost=tanks().cost + lfo.costs.L1Cost(u={"valve": 0.1}))
    assert lfo.solve(tanks(control_set=hull)).cost == pytest.approx(lfo.solve(priced).cost, rel=1e-7)
    sparse = lfo.solve(
        tanks(control_set=hull, cost=lfo.QuadraticCost(), terminal_state=lfo.Box({"lower": (None, 0.7)}))
    )
    assert (sparse.status, sparse.level_use) == ("optimal", None)  # nothing is known of how few samples lie between


def test_a_filter_leaves_a_control_without_stopped_bins_at_its_levels():
    comparison = lfo.compare(tanks(control_spectrum=lfo.stop_band(bins=[2], component="pump")), filters=["brickwall"])
    replay = comparison.filtered[0].replay
    assert set(replay.trajectory.u[:, 1]) <= {0, 1, 2}
    assert not replay.between_levels
