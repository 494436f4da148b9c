"""Constraints that give way at a price, exact above their multipliers."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.loop import checked_penalties, excess, soften
from lin_freq_ocp.transform import translation_of

DYNAMICS = lfo.LinearDynamics([[1.0, 0.5], [0.0, 1.0]], [[0.125], [0.5]])
MASK = lfo.MagnitudeBound(0.2, bins=[2, 3])
FIELDS = {
    "state_set": lfo.Box([-1.0, -0.1], [1.0, 0.1]) & lfo.sets.Ball(1.0),
    "terminal_state": [0.1, 0.0],
    "stage_rows": lfo.StageRows([[0.0, -1.0]], None, [0.1]),
    "control_spectrum": [lfo.stop_band(bins=[4]), MASK, lfo.spectrum.Spectrogram(MASK, 8)],
    "state_spectrum": lfo.spectrum.EnergyBound(8.0, bins=[0], component=0),
    "output_spectrum": lfo.spectrum.OutputSpectrum([[1.0, 1.0]], None, lfo.MagnitudeBound(1.5, bins=[1])),
}


def problem(**fields) -> lfo.OptimalControlProblem:
    cost = lfo.QuadraticCost(Q=0.5, R=1.0)
    given = {"dynamics": DYNAMICS, "horizon": 10, "cost": cost, "initial_state": [0.8, 0.0]}
    return lfo.OptimalControlProblem(**(given | fields))


@pytest.mark.parametrize("field", FIELDS)
def test_a_large_penalty_is_exact_and_a_small_one_is_not(field):
    hard = problem(**{field: FIELDS[field]})
    best, without = lfo.solve(hard), lfo.solve(problem())
    assert best.cost > without.cost + 1e-3  # the constraint costs something
    exact = lfo.solve(soften(hard, {field: 1e3}))
    assert exact.cost == pytest.approx(best.cost, rel=1e-6)
    assert excess(translation_of(exact.problem), exact.trajectory) == {}
    cheap = lfo.solve(soften(hard, {field: 1e-3}))
    assert without.cost <= cheap.cost < best.cost
    assert sum(excess(translation_of(cheap.problem), cheap.trajectory).values()) > 1e-3


def test_what_is_soft_already_keeps_its_price():
    soft = problem(
        state_set=lfo.sets.Soft(lfo.Box(-0.5, 0.5), 0.2),
        control_spectrum=lfo.MagnitudeBound(0.2, bins=[2], penalty=0.3),
        stage_rows=lfo.StageRows([[1.0, 1.0]], None, [0.5], penalty=0.4),
    )
    again = soften(soft, {"state_set": 9.0, "control_spectrum": 9.0, "stage_rows": 9.0})
    x, u = np.random.default_rng(0).standard_normal((11, 2)), np.random.default_rng(1).standard_normal((10, 1))
    assert again.value(x, u) == pytest.approx(soft.value(x, u))


def test_bounds_per_time_become_soft_at_their_times():
    upper = np.full((11, 2), np.inf)
    upper[3] = 0.1
    soft = soften(problem(state_set=lfo.Box(None, upper)), {"state_set": 2.0})
    x, u = np.ones((11, 2)), np.zeros((10, 1))
    assert soft.value(x, u) == pytest.approx(problem().value(x, u) + 2 * 2 * 0.9)
    assert len({id(one) for one in soft.state_set}) == 3  # bounds that repeat stay one set, whose terms are made once


@pytest.mark.parametrize(
    ("given", "field"),
    [({"control_set": 1.0}, "soft.control_set"), ({"state_set": 0.0}, "soft.state_set"), (["state_set"], "soft")],
)
def test_bad_penalties_are_refused_by_the_field(given, field):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        checked_penalties(given)
    assert caught.value.field == field
