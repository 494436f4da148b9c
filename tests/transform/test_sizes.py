"""Sizes of states and controls from the data of a problem."""

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.transform import stated_sizes


@pytest.mark.parametrize(
    "cost",
    [
        lfo.QuadraticCost(Q=1e-12, R=1.0, q=[1.0]),
        lfo.QuadraticCost(R=1.0) + lfo.costs.SmoothCost(stage="x_0 + 1e-12*x_0**2"),
    ],
    ids=["quadratic", "formula"],
)
def test_a_slope_takes_a_state_to_its_bounds_at_most(cost):
    dynamics = lfo.LinearDynamics([[1.0]], [[1.0]])
    problem = lfo.OptimalControlProblem(dynamics, 6, cost, lfo.Box(-1, 1), lfo.Box(-5, 5), [1e-9])
    assert np.concatenate(stated_sizes(problem)) == pytest.approx([5.0, 1.0])
