"""Trajectories strictly inside all inequalities."""

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.proof import interior_trajectory, interpolate, least_distance, share_of_way, tighten


def problem_with_rows(limits):
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]])
    rows = lfo.StageRows(C=[[0.0, 1.0], [0.0, -1.0]], e=limits)
    ends = {"initial_state": [0.0, 0.0], "terminal_state": [1.0, 0.0]}
    return lfo.OptimalControlProblem(
        dynamics, 24, lfo.QuadraticCost(R=1.0), stage_rows=rows, control_set=lfo.Box(-3.0, 3.0), **ends
    )


def test_limits_are_tighter_and_ends_stay():
    problem = problem_with_rows([0.5, 0.5])
    found = tighten(problem, 1e-3, (np.array([1.0, 2.0]), np.array([4.0])))
    assert found.stage_rows[0].e == pytest.approx([0.498, 0.498])
    assert found.control_tube.upper[0] == pytest.approx([2.996])
    assert found.fixed_ends[24].tolist() == [1.0, 0.0]


def test_two_rows_that_are_an_equation_are_not_tightened():
    found = tighten(problem_with_rows([0.5, -0.5]), 1e-3, (np.ones(2), np.ones(1)))
    assert found.stage_rows[0].e.tolist() == [0.5, -0.5]


def test_a_small_share_of_the_way_inside_gives_room():
    problem = problem_with_rows([0.5, 0.5])
    result = lfo.solve(problem)
    inner = interior_trajectory(result, problem, result.trajectory)
    assert least_distance(problem, result.trajectory) < 1e-9
    assert least_distance(problem, inner) > 1e-4
    share = share_of_way(problem, result.trajectory, inner, 1e-10)
    assert share < 1e-4
    assert least_distance(problem, interpolate(result.trajectory, inner, share)) >= 0.99e-10


def test_without_an_interior_there_is_none():
    dynamics = lfo.LinearDynamics([[1.0]], [[1.0]])
    rows = lfo.StageRows(D=[[1.0]], e=[1.0])
    problem = lfo.OptimalControlProblem(
        dynamics, 4, lfo.QuadraticCost(R=1.0), stage_rows=rows, initial_state=[0.0], terminal_state=[4.0]
    )
    result = lfo.solve(problem)
    assert interior_trajectory(result, problem, result.trajectory) is None
    assert result.enclosure.upper == np.inf
    assert "no trajectory strictly inside" in str(result.enclosure)
    assert 2.0 - 1e-6 < result.enclosure.lower <= 2.0
