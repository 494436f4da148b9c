"""A seeded sample of the trials cancellation, cost_units, small_ends, weights and jumps of ``scripts/verify.py``."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from helpers.checks import cancellation, cost_units, jumps, small_ends, weights
from helpers.seeds import expensive, seeds
from lin_freq_ocp.loop import ControlLimits


@pytest.mark.parametrize("seed", seeds([2, 3, 5, 9, 13, 14]))
def test_formulas_that_cancel_make_no_claim_that_balls_refute(seed):
    assert cancellation.check(seed).passed, cancellation.check(seed)


@pytest.mark.parametrize("seed", seeds([0, 2, 3, 4, 7, 9]))
def test_units_of_the_cost_and_constants_in_it_change_no_status(seed):
    assert cost_units.check(seed).passed, cost_units.check(seed)


@pytest.mark.parametrize("seed", seeds([14, 51, 115, 120, 145, 359, 492, 549, 590, 599, 796]))
def test_small_ends_and_references_change_no_status(seed):
    assert small_ends.check(seed).passed, small_ends.check(seed)


@pytest.mark.parametrize("seed", seeds([1, 2, 5, 6, 7, 12]))
def test_large_weights_make_nothing_optimal_that_balls_refute(seed):
    assert weights.check(seed).passed, weights.check(seed)


@expensive
@pytest.mark.parametrize("seed", [28, 83])
def test_rest_at_a_saddle_is_no_answer_where_a_start_leads_to_less(seed):
    assert weights.check(seed).statuses == ("locally_optimal",)


@pytest.mark.parametrize("seed", seeds([3, 5, 6]))
def test_controls_keep_hard_limits_exactly_where_the_state_jumps(seed):
    assert jumps.check(seed).passed, jumps.check(seed)


@expensive
@pytest.mark.parametrize("seed", [2, 3])
def test_bounds_and_infeasibility_that_balls_refute_are_found_out(seed, monkeypatch):
    honest = cancellation.lfo.solve

    def claim_more(*given, **options):
        result = honest(*given, **options)
        above = np.nextafter(result.cost, np.inf) * (1 + 1e-9)
        return SimpleNamespace(
            status="infeasible", bound="rigorous", message="", lower_bound=above, cost=result.cost,
            control=result.control, trajectory=result.trajectory,
        )  # fmt: skip

    monkeypatch.setattr(cancellation.lfo, "solve", claim_more)
    assert not cancellation.check(seed).passed


def test_a_point_that_descent_leaves_and_a_saddle_are_found_out():
    saddle = weights.Trial(4)
    exact, rest = saddle.reduced(saddle.heavy, *saddle.terms), np.zeros(saddle.T * saddle.m)
    assert weights.least_curvature(exact, rest) < -0.1
    assert weights.descent(exact, rest) < 1e-12
    assert weights.descent(exact, weights.keep_heavy(saddle, rest + 0.1)) > 1e-4


@expensive
def test_a_control_outside_its_limits_is_found_out(monkeypatch):
    monkeypatch.setattr(ControlLimits, "clip", lambda limits, x, u: 2 * u)
    assert any("Python" in words for words in jumps.check(0).wrong)


def test_a_status_that_changes_is_found_out():
    small = small_ends.Outcome(0, ("mask", "L1 cost"), "convex", 1e-9, ("optimal", "optimal"), (1.0, 1.0))
    assert small.passed
    assert not replace(small, statuses=("optimal", "numerical_error")).passed
    assert not replace(small, costs=(1.0, 1.001)).passed
    right = cost_units.Outcome(0, "linear", 1.0, ("optimal",) * 4, 0.0)
    assert right.passed
    assert not replace(right, statuses=("optimal", "optimal", "locally_optimal", "optimal")).passed
    assert not replace(right, apart=1e-3).passed
