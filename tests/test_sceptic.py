"""What a sceptic tried, and once got past: each is refused, solved or proven now."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo

SUM = lfo.LinearDynamics([[1.0]], [[1.0]])


def at_rest(cost, **given) -> lfo.Certificate:
    problem = lfo.OptimalControlProblem(SUM, 5, cost, initial_state=[0.0], **given)
    return lfo.certify(problem, np.zeros((5, 1)))


def test_a_numerical_bound_that_looks_nowhere_proves_nothing():
    behind_a_row = at_rest(lfo.QuadraticCost(p=[-1.0]), state_set=lfo.Polyhedron([[1.0]], [1.0]))
    behind_a_mask = at_rest(lfo.QuadraticCost(r=[-1.0]), control_spectrum=lfo.MagnitudeBound(1.0, bins=[0, 1, 2]))
    for certificate in (behind_a_row, behind_a_mask):
        assert not certificate.globally_optimal
        assert certificate.pmp == "violated"
    assert behind_a_row.lower_bound <= -1.0 + 1e-9


def test_a_linear_cost_does_not_make_units_that_hide_violations():
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0, 1.0]], [[0.0], [1.0]])
    given = {"initial_state": [1.0, 0.0], "control_set": lfo.Box([-1.0], [1.0]), "terminal_state": lfo.Ball(1.0)}
    result = lfo.solve(lfo.OptimalControlProblem(dynamics, 12, lfo.QuadraticCost(r=[10.0]), **given))
    assert result.cost == pytest.approx(-10.0)
    assert result.certificate.globally_optimal
    faster = lfo.LinearDynamics([[1.2, 0.1], [0, 1.0]], [[0.0], [1.0]])
    end = lfo.OptimalControlProblem(faster, 5, lfo.QuadraticCost(q=[1.0, 0]), **given)
    assert lfo.solve(end, throw=False).status == "infeasible"


def test_a_numerical_ray_does_not_outweigh_a_trajectory():
    weak = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.3]], [[1.0]]),
        11,
        lfo.QuadraticCost(R=1.0),
        terminal_state=lfo.Box([10.0], [11.0]),
        control_set=lfo.Box([-0.3], [0.3]),
    )
    result = lfo.solve(weak)
    assert result.primal
    assert result.certificate.globally_optimal


def test_blocks_of_one_field_are_taken_away_together():
    def problem(spectrum):
        return lfo.OptimalControlProblem(
            SUM, 10, lfo.QuadraticCost(R=1.0), initial_state=[0.0], terminal_state=[5.0], control_spectrum=spectrum
        )

    def mask(k):
        return lfo.MagnitudeBound(1.0, bins=[k])

    assert lfo.explain(problem([mask(0), mask(1)])).family == ("initial state", "terminal state", "mask on u_0")
    found = lfo.explain(problem([mask(4), mask(5), lfo.stop_band(bins=[0])]))
    assert found.family == ("initial state", "terminal state", "control stop band on u_0")
    assert found.irreducible


def test_a_direction_through_rounding_is_verified():
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.7]], [[1.0, 1.0]], [0.1]),
        8,
        lfo.QuadraticCost(r=[-0.9, 0.5]),
        initial_state=[1.0],
        state_set=lfo.Ball(3.0),
    )
    result = lfo.solve(problem, throw=False)
    assert result.status == "unbounded"
    assert result.direction is not None


def test_an_optimum_at_kinks_is_not_proven_wrong():
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.5, 0.3], [-0.2, 0.8]], [[1.0], [0.6]]),
        8,
        lfo.L1Cost(x=1.0, u=1.0, terminal=1.0) + lfo.LInfCost(x=0.3, u=0.2),
        initial_state=[1.0, 0.3],
    )
    result = lfo.solve(problem)
    assert result.certificate.pmp == "satisfied"
    assert lfo.certify(problem, result.trajectory).descent is None


@pytest.mark.parametrize(
    "bound",
    [
        lambda by: lfo.MagnitudeBound(0.5 + by, bins=[1, 2, 3], oversampling=4, between=True),
        lambda by: lfo.EnergyBound((1.2 + by) ** 2, bins=range(2, 9), oversampling=4),
    ],
    ids=["between", "energy"],
)
def test_derivatives_are_by_the_limits_that_were_given(bound):
    def solved(by):
        dynamics = lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]])
        given = {"initial_state": [0, 0], "terminal_state": [1, 0], "control_spectrum": bound(by)}
        return lfo.solve(lfo.OptimalControlProblem(dynamics, 40, lfo.QuadraticCost(R=1.0), **given), tolerance=1e-11)

    (found,) = solved(0.0).sensitivities.limits.values()
    difference = (solved(1e-4).cost - solved(-1e-4).cost) / 2e-4
    assert difference == pytest.approx(float(found.sum()), rel=1e-4)
    assert difference < -1e-3


def test_the_grid_of_bins_reaches_the_nyquist_frequency_of_an_odd_horizon():
    mask = lfo.MagnitudeBound(0.1, bins=range(8, 16), oversampling=4)
    assert mask.bins(31, None, "mask")[-1] == 4 * 31 // 2
