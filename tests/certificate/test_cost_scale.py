"""S, the unit of the gap: each term of the cost counts at most by what bounds and dynamics let it vary."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo

STEPS = 8
CONTROLS = lfo.Box(-1.0, 1.0)
COSTS = {
    "squares": lambda far, unit: lfo.QuadraticCost(Q=unit**-2, R=0.01, x_ref=far * unit),
    "at the end": lambda far, unit: lfo.QuadraticCost(R=0.01, P=unit**-2, x_ref=far * unit),
    "norm": lambda far, unit: lfo.QuadraticCost(R=0.01) + lfo.costs.L1Cost(x=1 / unit, x_ref=far * unit),
}


def problem_of(cost, start=0.0, growth=1.0, offset=0.0, bounds=CONTROLS, gain=1.0):
    dynamics = lfo.LinearDynamics([[growth]], [[gain]], [offset])
    return lfo.OptimalControlProblem(dynamics, STEPS, cost, bounds, initial_state=[start])


@pytest.mark.parametrize("far", [1e3, 1e6])
@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_a_reference_out_of_reach_makes_no_trajectory_optimal(cost, far, unit):
    """The price of the way that is left all the same is 1e12, and says nothing of the controls."""
    problem = problem_of(COSTS[cost](far, unit), gain=unit)
    result = lfo.solve(problem)
    assert result.certificate.globally_optimal
    tenth = lfo.certify(problem, 0.9 * result.control)
    assert not tenth.globally_optimal
    assert tenth.pmp == "violated"


@pytest.mark.parametrize("bounds", [CONTROLS, lfo.Box(-1e9, 1e9), None])
def test_a_linear_cost_of_a_state_counts_by_what_controls_change_it_by(bounds):
    """Far from zero, an error of 0.15 in the last step is 1.5e-7 of the value of the state, and a tenth of the cost."""
    cost, found = lfo.QuadraticCost(R=1.0, p=[1.0]), []
    for shift in (0.0, 1e6):
        problem = problem_of(cost, 1e6 - shift, 0.1, -0.9 * shift, bounds)
        result = lfo.solve(problem)
        x = result.trajectory.x.copy()
        x[-1] -= 0.15
        broken = lfo.certify(problem, lfo.Trajectory(x, result.control))
        assert result.certificate.globally_optimal
        assert broken.pmp == "violated"
        found.append(result.certificate.cost_scale)
    assert found[1] == pytest.approx(found[0], rel=0.5)


def test_a_cost_that_no_control_changes_does_not_count():
    dynamics = lfo.LinearDynamics(np.diag([0.5, 1.0]), [[1.0], [0.0]])
    cost = lfo.QuadraticCost(Q=np.eye(2), R=1.0)
    problem = lfo.OptimalControlProblem(dynamics, STEPS, cost, CONTROLS, initial_state=[1.0, 1e4])
    certificate = lfo.solve(problem).certificate
    assert certificate.globally_optimal
    assert certificate.cost_scale < 100 < 1e-6 * certificate.cost


@pytest.mark.parametrize(
    "cost", [lfo.QuadraticCost(R=10.0, q=[1.0]), lfo.QuadraticCost(R=10.0) + lfo.costs.L1Cost(x=1.0)]
)
def test_a_start_far_away_makes_no_trajectory_stationary(cost):
    """A state of the size of the start costs 1e7, but no control changes it by more than 2."""
    dynamics = lfo.LinearDynamics([[0.3]], [[1.0]])
    problem = lfo.OptimalControlProblem(dynamics, 14, cost, CONTROLS, initial_state=[1e7])
    result = lfo.solve(problem)
    assert result.certificate.globally_optimal
    certificate = lfo.certify(problem, 0.99 * result.control)
    assert certificate.gap > 3e-6
    assert certificate.pmp == "violated"


def test_a_reference_out_of_reach_is_no_size_of_the_state():
    """An error of 1e-3 in a state that moves by 8 is a millionth of a millionth of the reference."""
    problem = problem_of(COSTS["squares"](1e9, 1.0))
    result = lfo.solve(problem)
    x = result.trajectory.x.copy()
    x[4:] += 1e-3
    broken = lfo.certify(problem, lfo.Trajectory(x, result.control))
    assert "state equation" in [condition.name for condition in broken.failed]
