"""Soft stop bands in the Fourier-domain method: removed, where their prices exceed their multipliers; else refused."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.sets import Soft

BASE = lfo.library.double_integrator(horizon=80, sampling_time=0.05)


def soft_band(price: float, **where) -> lfo.MagnitudeBound:
    return lfo.MagnitudeBound(0.0, penalty=price, **(where or {"band": lfo.low_pass(1.0)}))


def problem(**changes) -> lfo.OptimalControlProblem:
    cost = lfo.QuadraticCost(Q=0.1, R=1.0, P=10.0)
    free = {"initial_state": [1.0, 0.0], "terminal_state": None, "control_spectrum": None, "state_set": None}
    return replace(BASE, cost=cost, **(free | changes))


CASES = {
    "controls": {"control_spectrum": soft_band(10.0)},
    "beside a band on some of the same bins": {
        "control_spectrum": [soft_band(10.0), lfo.stop_band(bins=range(30, 36))]
    },
    "states": {"state_spectrum": soft_band(10.0, bins=[3, 7], component=0)},
    "with soft bounds": {
        "control_spectrum": soft_band(10.0),
        "state_set": Soft(lfo.Box([None, -0.25], [None, 0.25]), 0.05),
        "stage_rows": lfo.StageRows([[1.0, 1.0]], None, [0.9], penalty=0.1),
    },
}


@expensive
@pytest.mark.parametrize("name", CASES)
def test_bins_are_zero_at_high_prices_and_their_multipliers_are_those_of_the_bound(name):
    given = problem(**CASES[name])
    ours, theirs = lfo.solve(given), lfo.solve(given, method="structured")
    assert ours.method == "spectral"
    assert ours.certificate.pmp == "satisfied"
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-8)
    assert set(ours.multipliers.stage) == {term.name for term in given.terms}
    (mask,) = (term for term in given.terms if "mask" in term.name)
    found = ours.multipliers.stage[mask.name]
    assert 1e-4 < np.linalg.norm(found, axis=1).max() < 10.0
    if name != "beside a band on some of the same bins":  # where the two share a multiplier
        used = ~np.stack([np.zeros(len(found), bool), mask.map.real], axis=1)  # the others are parts that are always 0
        np.testing.assert_allclose(found[used], theirs.multipliers.stage[mask.name][used], atol=1e-5)


def test_a_low_price_is_refused_with_the_reason_and_auto_goes_on():
    given = problem(control_spectrum=soft_band(1e-3))
    with pytest.raises(lfo.errors.UnsupportedError, match="a soft bin is not zero at its price"):
        lfo.solve(given, method="spectral")
    result = lfo.solve(given)
    assert result.method != "spectral"
    assert "a soft bin is not zero" in result.reason
    assert result.certificate.pmp == "satisfied"


@pytest.mark.parametrize(("share", "refused"), [(0.9, True), (1.1, False)])
def test_the_price_that_keeps_a_bin_zero_is_its_multiplier(share, refused):
    (multiplier,) = lfo.solve(problem(control_spectrum=soft_band(10.0, bins=[3]))).multipliers.stage.values()
    given = problem(control_spectrum=soft_band(share * float(np.linalg.norm(multiplier)), bins=[3]))
    with pytest.raises(lfo.errors.UnsupportedError, match="zero at its price") if refused else nullcontext():
        lfo.solve(given, method="spectral")


def test_what_is_infeasible_only_with_the_band_has_a_solution():
    given = problem(control_set=lfo.Box(0.05, 1.0), control_spectrum=soft_band(10.0, bins=[0]))
    assert lfo.solve(given).status == "optimal"
    assert lfo.solve(replace(given, control_spectrum=lfo.stop_band(bins=[0])), throw=False).status == "infeasible"


@pytest.mark.parametrize("unit", [1.0, 1e12])
def test_an_end_that_needs_the_bins_is_refused_in_any_units_of_the_states(unit):
    most = soft_band(10.0, bins=range(1, 41))
    dynamics = lfo.LinearDynamics(BASE.dynamics.A, BASE.dynamics.B / unit, sampling_time=0.05)
    given = problem(dynamics=dynamics, initial_state=[1 / unit, 0.0], terminal_state=[0.0, 0.0], control_spectrum=most)
    given = replace(given, cost=lfo.QuadraticCost(R=1.0))
    with pytest.raises(lfo.errors.UnsupportedError, match="a soft bin is not zero at its price"):
        lfo.solve(given, method="spectral")


def test_what_is_infeasible_without_the_band_is_proven_so():
    given = problem(control_set=lfo.Box(-0.01, 0.01), terminal_state=[0.0, 0.0], control_spectrum=soft_band(10.0))
    result = lfo.solve(given, throw=False)
    assert result.status == "infeasible"


def test_a_loop_with_softened_blocks_stays_in_the_fourier_domain():
    bounds = lfo.Box([None, -0.25], [None, 0.25])
    given = problem(state_set=bounds, control_spectrum=lfo.low_pass(1.0), control_set=lfo.Box(-1, 1))
    prices = {"state_set": 5.0, "control_spectrum": 50.0}
    controller = lfo.RecedingHorizon(given, soft=prices)
    x, step = np.array([1.0, -0.4]), given.dynamics.stepper(80)
    for _ in range(6):
        x = step(0, x, controller.step(x))
    log = controller.log
    assert "softened problem" in log.sources
    assert {one.method for one in log.steps} <= {"spectral", "condensed"}
    assert log.satisfied.all()


def test_a_window_or_a_finer_grid_is_refused():
    for bound in (
        soft_band(10.0, band=lfo.low_pass(1.0), window="hann"),
        soft_band(10.0, band=lfo.low_pass(1.0), oversampling=2),
    ):
        with pytest.raises(lfo.errors.UnsupportedError, match="only boxes"):
            lfo.solve(problem(control_spectrum=bound), method="spectral")
