"""Sets of finitely many levels: construction, bad input, the convex hull of levels and costs, the modes they become."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem import problem_facts
from lin_freq_ocp.transform import Change

LINEAR = lfo.LinearDynamics([[1.0]], [[1.0]])


def problem(control_set, dynamics=LINEAR, **further) -> lfo.OptimalControlProblem:
    return lfo.OptimalControlProblem(dynamics, 4, lfo.QuadraticCost(Q=1.0), control_set=control_set, **further)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        (([],), "FiniteSet.levels: got none"),
        ((3.0,), "FiniteSet.levels"),
        ((["a", "b"],), "FiniteSet.levels"),
        (([1.0],), "FiniteSet.levels: got 1 level"),
        (([0.0, np.nan],), "FiniteSet.levels"),
        (([0.0, np.inf],), "FiniteSet.levels"),
        (([0.0, 1.0, 0.0],), "FiniteSet.levels: got 0 twice"),
        (([[0.0, 1.0], 2.0],), "FiniteSet.levels"),
        (([[0.0, 1.0], [2.0]],), r"FiniteSet.levels\[1\]"),
        (([0.0, 1.0], [1.0]), "FiniteSet.costs: got shape"),
        (([0.0, 1.0], [[1.0, 1.0]]), "FiniteSet.costs"),
        (([[0.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]]), "FiniteSet.costs: got 2 sequences"),
        (([0.0, 1.0], [1.0, np.nan]), "FiniteSet.costs"),
        (([0.0, 1.0], [1.0, -1.0]), "FiniteSet.costs: got -1"),
        (([0.0, 1.0, 2.0], [0.0, 2.0, 1.0]), "FiniteSet.costs: got 2 for the level 1, 1.5 above"),
        (([0.0, 1.0], None, 3), "FiniteSet.duty_cycles"),
        (([None, None],), "FiniteSet.levels: got no levels; expected levels of one component"),
        (([None, [0.0, 1.0]], [[1.0], [0.0, 1.0]]), r"FiniteSet.costs\[0\]: .*expected none"),
        (([lfo.Box([0, 0], 1), [0.0, 1.0]],), r"FiniteSet.levels\[0\]: got bounds for 2 components"),
        (([{"lowest": 1}, [0.0, 1.0]],), r"FiniteSet.levels\[0\].lowest: got an unknown key"),
        (({},), "FiniteSet.levels: got none"),
        (({"valve": [0.0]},), r"FiniteSet.levels\['valve'\]: got 1 level"),
        (({"valve": [0.0, 1.0]}, {"valv": [0.0, 1.0]}), "FiniteSet.costs.valv: got an unknown key"),
    ],
)
def test_bad_input_names_the_field(given, field):
    with pytest.raises(ProblemError, match=field):
        lfo.FiniteSet(*given)


@pytest.mark.parametrize(
    "control_set",
    [
        [lfo.FiniteSet([0, 1])] * 4,
        lfo.FiniteSet([0, 1]) & lfo.Box(0, 1),
        lfo.FiniteSet([[0, 1], [0, 1]]),
        lfo.FiniteSet(np.arange(300.0)),
    ],
)
def test_levels_are_one_control_set_for_all_times(control_set):
    with pytest.raises(ProblemError, match="control_set"):
        problem(control_set)


def test_modes_of_their_own_are_refused():
    right, left = (lfo.AffineMode([[0.5]], [[1.0]], G=[[g]], h=[0.0]) for g in (-1.0, 1.0))
    with pytest.raises(ProblemError, match="levels with PiecewiseAffineDynamics"):
        problem(lfo.FiniteSet([0, 1]), lfo.PiecewiseAffineDynamics([right, left]), state_set=lfo.Box(-1, 1))


@pytest.mark.parametrize("seed", seeds(range(20)))
def test_the_cost_of_the_hull_is_the_lower_envelope(seed):
    rng = np.random.default_rng(seed)
    levels, costs = rng.normal(size=5), rng.uniform(size=5)
    hull = lfo.FiniteSet(levels, costs, duty_cycles=True)
    given = problem(hull)
    u = rng.uniform(levels.min(), levels.max(), 4)
    pairs = [(levels[i], costs[i], levels[j], costs[j]) for i in range(5) for j in range(5) if levels[i] < levels[j]]
    lines = [np.where((a <= u) & (u <= c), b + (d - b) * (u - a) / (c - a), np.inf) for a, b, c, d in pairs]
    least = np.min(lines, axis=0)
    assert sum(term.cost(np.zeros((5, 1)), u[:, None]).sum() for term in given.terms) == pytest.approx(least.sum())
    shares = hull.shares(u[:, None])[0]
    order = np.argsort(levels)
    assert shares.min() >= 0
    assert shares.sum(1) == pytest.approx(1)
    assert shares @ levels[order] == pytest.approx(u)
    assert shares @ costs[order] == pytest.approx(least)


def test_a_problem_keeps_what_was_given_and_has_a_mode_for_each_level():
    levels, plant = lfo.FiniteSet([[1, -1], [0, 2, 5]]), lfo.LinearDynamics([[1.0]], [[1.0, 2.0]])
    given = problem(levels, plant, state_set=lfo.Box(-99, 99))
    assert (given.dynamics, given.control_set) == (plant, levels)
    assert len(given.mode_names) == 6
    assert given.control_tube.lower[0].tolist() == [-1, 0]
    assert given.control_tube.upper[0].tolist() == [1, 5]
    assert given.with_modes([0, 1, 5, 2]).control_set.duty_cycles
    assert "2 controls, 6 modes" in str(given)
    other = replace(given, control_set=lfo.FiniteSet([0, 1]))
    assert len(other.mode_names) == 4
    sequence = np.array([0, 1, 5, 2])
    assert given.form.choices[sequence].tolist() == [[-1, 0], [-1, 2], [1, 5], [-1, 5]]


PUMP_AND_VALVE = lfo.LinearDynamics([[1.0]], [[1.0, 2.0]], control_names="pump, valve [turns]")


def test_a_control_without_levels_next_to_one_with_levels_has_bounds_and_no_modes():
    given = problem(lfo.FiniteSet([lfo.Box(0, 3), [2, 0, 5]]), PUMP_AND_VALVE, state_set=lfo.Box(-99, 99))
    assert given.mode_names == ("valve = 0", "valve = 2", "valve = 5")
    assert given.control_tube.bounds[0][0].tolist() == [0, 0]
    assert given.control_tube.bounds[1][0].tolist() == [3, 5]
    assert np.array_equal(given.form.choices, [[np.nan, 0], [np.nan, 2], [np.nan, 5]], equal_nan=True)
    assert given.level_sizes.tolist() == [0, 5]
    assert dict(problem_facts(given))["levels"] == "pump from 0 to 3; valve in (0, 2, 5); 3 modes"


def test_levels_by_name_are_those_of_components():
    named = lfo.FiniteSet({"valve": [0, 1, 2], "pump": lfo.Box(0, 3)}, costs={"valve": [0, 1, 2]})
    given = problem(named, PUMP_AND_VALVE, state_set=lfo.Box(-99, 99)).control_set
    assert (given.levels[1], given.costs) == ([0, 1, 2], [[], [0, 1, 2]])
    assert given.levels[0].upper == 3
    assert named.describe(["pump", "valve"], "u") == "pump from 0 to 3; valve in (0, 1, 2) at the costs (0, 1, 2)"
    unnamed = problem(lfo.FiniteSet({"valve": [0, 1]}, duty_cycles=True), PUMP_AND_VALVE)
    assert unnamed.control_tube.upper[0].tolist() == [np.inf, 1]
    for wrong, text in (
        ({"valv": [0, 1]}, "Did you mean 'valve'"),
        ({"valve": [0, 1], "valve [turns]": [0, 1]}, "once"),
    ):
        with pytest.raises(ProblemError, match=text):
            problem(lfo.FiniteSet(wrong), PUMP_AND_VALVE)
    with pytest.raises(ProblemError, match="levels by name of 'valve'"):
        lfo.FiniteSet({"valve": [0, 1]}).points(1)


def test_a_rate_limit_keeps_the_levels():
    given = lfo.rate_limited(problem(lfo.FiniteSet([0, 1, 2]), state_set=lfo.Box(-9, 9)), 1.0)
    assert len(given.mode_names) == 3
    assert given.state_dim == 2


def test_levels_stay_within_the_bounds_of_a_change():
    given = problem(lfo.FiniteSet([0, 1, 2]), state_set=lfo.Box(-9, 9))
    changed = Change(bounds={"control_set": lfo.Box(0.5, 1.5)}).apply(given)
    assert changed.mode_names == given.mode_names
    assert changed.control_tube.upper.max() == 1.5


def test_the_costs_of_levels_are_what_is_minimised():
    facts = dict(problem_facts(lfo.library.pulse_pattern(samples=16)))
    assert facts["minimise"] == "the costs of the control set"
    assert "at the costs (0.25, 0.0625, 0, 0.0625, 0.25), switching within samples" in facts["control set"]


def test_levels_cannot_be_soft():
    """The price of a soft set would take the place of the levels' costs."""
    for duty_cycles in (False, True):
        with pytest.raises(ProblemError, match=r"Soft: got FiniteSet.*expected a Box"):
            lfo.sets.Soft(lfo.FiniteSet([-1, 0, 1], [1, 0, 1], duty_cycles), 2.0)


@pytest.mark.parametrize("entry", [None, lfo.Box(0, 3), lfo.Box(None, 3)])
def test_a_file_keeps_a_control_without_levels(tmp_path, entry):
    given = problem(lfo.FiniteSet([entry, [0, 1, 2]], [None, [0, 1, 2]], duty_cycles=True), PUMP_AND_VALVE)
    lfo.write_problem(given, tmp_path / "tanks.toml")
    read = lfo.read_problem(tmp_path / "tanks.toml").control_set
    assert (read.levels[1], read.costs, read.duty_cycles) == ([0, 1, 2], [[], [0, 1, 2]], True)
    assert np.array_equal(read.bounds, given.control_set.bounds)
