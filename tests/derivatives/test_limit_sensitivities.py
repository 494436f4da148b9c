"""Derivatives of the optimal cost by the limits of sets, masks and energies, against differences of re-solves."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.derivatives import bin_prices

T, STEP = 40, 1e-4
PLANT = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]], sampling_time=0.1)
BINS = [1, 2, 3, 20]


def problem(**given) -> lfo.OptimalControlProblem:
    ends = {"initial_state": [0, 0], "terminal_state": [1, 0], **given}
    return lfo.OptimalControlProblem(PLANT, T, lfo.QuadraticCost(R=1.0), **ends)


def mask(change=0.0, bins=BINS, **given) -> lfo.OptimalControlProblem:
    limits = np.array([4.0, 0.8, 0.35, 0.1])
    return problem(control_spectrum=lfo.MagnitudeBound(limits + change, bins=bins, **given))


CASES = {  # by name of the term: the problem as a function of the change of its limit, and which derivative that is
    "control set": (lambda by: problem(control_set=lfo.sets.Ball(0.3 + by)), lambda found: found.sum()),
    "state set": (
        lambda by: problem(state_set=lfo.sets.Polyhedron([[0.2, 1.0]], [0.45 + by])),
        lambda found: found.sum(),
    ),
    "terminal state": (lambda by: problem(terminal_state=lfo.sets.Ball(0.1 + by, [1, 0])), lambda found: found[0, 0]),
    "energy bound on u_0": (
        lambda by: problem(control_spectrum=lfo.spectrum.EnergyBound((1.2 + by) ** 2, bins=range(2, 9))),
        lambda found: found[0, 0],
    ),
    "mask on u_0": (lambda by: mask(by * np.eye(4)[1]), lambda found: found[1, 0]),
    "mask on y_0": (
        lambda by: problem(
            output_spectrum=lfo.spectrum.OutputSpectrum(
                [[0, 1.0]], constraints=lfo.MagnitudeBound(3.0 + by, bins=[1, 2])
            )
        ),
        lambda found: found.sum(),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_a_derivative_by_a_limit_is_a_difference_of_costs(name):
    made, part = CASES[name]
    found = float(part(lfo.solve(made(0.0), tolerance=1e-11).sensitivities.limits[name]))
    higher, lower = (lfo.solve(made(by), tolerance=1e-11).cost for by in (STEP, -STEP))
    assert found < -1e-3
    assert (higher - lower) / (2 * STEP) == pytest.approx(found, rel=1e-4)


def test_the_price_of_a_masked_bin_is_that_of_its_limit():
    masked = mask()
    result = lfo.solve(masked)
    prices = bin_prices(masked, result.multipliers)[0]
    np.testing.assert_allclose(prices[BINS, 0], -result.sensitivities.limits["mask on u_0"][:, 0], rtol=1e-12)
    assert not np.delete(prices[:, 0], BINS).any()
    assert prices[2, 0] > 1e-3


def test_points_between_bins_are_priced_at_the_nearest():
    band = lfo.stop_band(bins=[2, 3])
    finer = problem(control_spectrum=lfo.MagnitudeBound(0.3, band=band, oversampling=4))
    result = lfo.solve(finer)
    prices = bin_prices(finer, result.multipliers)[0][:, 0]
    assert np.flatnonzero(prices > 1e-6).tolist() == [2, 3]
    weights = result.multipliers.stage["mask on u_0"]
    assert prices.sum() == pytest.approx(np.linalg.norm(weights, axis=1).sum())


def test_prices_of_a_mask_that_holds_between_its_points_are_those_of_its_own_limit():
    """The points have a lower limit than the mask: all prices together are the difference of costs by the mask's."""

    def between(limit):
        band = lfo.stop_band(bins=[2, 3])
        return problem(control_spectrum=lfo.MagnitudeBound(limit, band=band, oversampling=2, between=True))

    prices, _ = bin_prices(between(0.3), lfo.solve(between(0.3), tolerance=1e-11).multipliers)
    higher, lower = (lfo.solve(between(0.3 + by), tolerance=1e-11).cost for by in (STEP, -STEP))
    assert prices.sum() == pytest.approx((lower - higher) / (2 * STEP), rel=1e-4)


def test_costs_have_no_limits():
    priced = lfo.OptimalControlProblem(
        PLANT, T, lfo.QuadraticCost(R=1.0) + lfo.costs.L1Cost(u=0.1), initial_state=[0, 0], terminal_state=[1, 0]
    )
    assert not lfo.solve(priced).sensitivities.limits
