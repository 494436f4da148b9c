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
