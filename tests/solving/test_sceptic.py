"""What a sceptic tried, and once got past: each is refused, solved or proven now."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.random.mixed import problem_of, random_model
from helpers.seeds import expensive

SUM = lfo.LinearDynamics([[1.0]], [[1.0]])


def at_rest(cost, **given) -> lfo.results.Certificate:
    problem = lfo.OptimalControlProblem(SUM, 5, cost, initial_state=[0.0], **given)
    return lfo.certify(problem, np.zeros((5, 1)))


def test_a_numerical_bound_that_looks_nowhere_proves_nothing():
    behind_a_row = at_rest(lfo.QuadraticCost(p=[-1.0]), state_set=lfo.sets.Polyhedron([[1.0]], [1.0]))
    behind_a_mask = at_rest(lfo.QuadraticCost(r=[-1.0]), control_spectrum=lfo.MagnitudeBound(1.0, bins=[0, 1, 2]))
    for certificate in (behind_a_row, behind_a_mask):
        assert not certificate.globally_optimal
        assert certificate.pmp == "violated"
    assert behind_a_row.lower_bound <= -1.0 + 1e-9


def test_a_linear_cost_does_not_make_units_that_hide_violations():
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0, 1.0]], [[0.0], [1.0]])
    given = {"initial_state": [1.0, 0.0], "control_set": lfo.Box([-1.0], [1.0]), "terminal_state": lfo.sets.Ball(1.0)}
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


@expensive
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
        state_set=lfo.sets.Ball(3.0),
    )
    result = lfo.solve(problem, throw=False)
    assert result.status == "unbounded"
    assert result.direction is not None


@expensive
def test_an_optimum_at_kinks_is_not_proven_wrong():
    problem = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[0.5, 0.3], [-0.2, 0.8]], [[1.0], [0.6]]),
        8,
        lfo.costs.L1Cost(x=1.0, u=1.0, terminal=1.0) + lfo.costs.LInfCost(x=0.3, u=0.2),
        initial_state=[1.0, 0.3],
    )
    result = lfo.solve(problem)
    assert result.certificate.pmp == "satisfied"
    assert lfo.certify(problem, result.trajectory).descent is None


@pytest.mark.parametrize(
    "bound",
    [
        lambda by: lfo.MagnitudeBound(0.5 + by, bins=[1, 2, 3], oversampling=4, between=True),
        lambda by: lfo.spectrum.EnergyBound((1.2 + by) ** 2, bins=range(2, 9), oversampling=4),
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


def with_stage(multipliers: lfo.results.Multipliers, stage) -> lfo.results.Multipliers:
    names = ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x")
    return lfo.results.Multipliers(**{name: getattr(multipliers, name) for name in names}, stage=stage)


@expensive
def test_multipliers_of_terms_that_are_not_the_best_give_a_lower_bound_and_never_a_higher():
    rng = np.random.default_rng(3)
    lower = 0
    for seed in range(7):
        problem = problem_of(random_model(seed))
        result = lfo.solve(problem)
        for scale in (0.3, 1.0):
            stage = {
                name: part * (1 + scale * rng.standard_normal(part.shape))
                for name, part in result.multipliers.stage.items()
            }
            found = lfo.certify(problem, result.trajectory, with_stage(result.multipliers, stage)).lower_bound
            if found is not None:
                assert found <= result.cost + 1e-7 * max(1.0, abs(result.cost)), seed
                lower += found < result.cost - 1e-6
    assert lower >= 6


def test_a_multiplier_of_a_ball_that_points_elsewhere_is_seen_to_first_order():
    dynamics = lfo.LinearDynamics(np.eye(2), np.eye(2))
    problem = lfo.OptimalControlProblem(
        dynamics, 4, lfo.QuadraticCost(Q=1.0, R=0.1), initial_state=[3.0, 1.0], control_set=lfo.sets.Ball(0.5)
    )
    result = lfo.solve(problem)
    turn = 5e-4
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = {"control set": result.multipliers.stage["control set"] @ rotation.T}
    failed = lfo.certify(problem, result.trajectory, with_stage(result.multipliers, turned)).failed
    assert "Hamiltonian stationary in u" in [one.name for one in failed]


def test_the_bound_of_a_point_far_from_the_optimum_is_what_the_multipliers_say():
    """D = min u^2/2 + l (u - 1) = -l^2/2 - l, which is below zero: what the cost is at least."""
    rows = lfo.StageRows(None, [[1.0]], [1.0])
    problem = lfo.OptimalControlProblem(SUM, 1, lfo.QuadraticCost(R=1.0), initial_state=[0.0], stage_rows=rows)
    zero = lfo.solve(problem).multipliers
    given = lfo.results.Multipliers(
        1.0, [[0.0]], np.zeros((2, 1)), [[0.0]], zero.rho_u, zero.rho_x, {"stage rows": [[0.5]]}
    )
    bounds = [lfo.certify(problem, lfo.Trajectory([[0.0], [u]], [[u]]), given).lower_bound for u in (-2.0, 0.0, 0.9)]
    assert bounds == [0.0, 0.0, 0.0]
