"""Leaves of the search over modes: a sequence is the best one only if its trajectory is feasible."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.modes import brute_force, random_problem, two_sides
from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.certificate.hybrid import IntervalReach, tree_bound
from lin_freq_ocp.methods.hybrid import NodeSolution, solve_path_relaxation, solve_relaxation
from lin_freq_ocp.program.hybrid import PathRelaxation
from lin_freq_ocp.transform.hybrid import ModeReach

SEEDS = range(4)


def two_modes(rows, limits, seed):
    """Return a problem on the unit square whose mode 0, which leads to the origin, has an empty region."""
    turned = np.eye(2)[[0, 1] if seed % 2 else [1, 0]]  # which state comes first does not matter
    rows = np.array(rows, dtype=float) @ turned
    to_origin = lfo.AffineMode(np.zeros((2, 2)), [[1.0], [0.0]], None, G=rows, h=limits)
    rest = lfo.AffineMode(np.eye(2), [[1.0], [0.0]], None, G=[[1.0, 1.0]], h=[2.0])
    start = np.array([0.0, 0.3 + 0.03 * seed]) @ turned
    return lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics([to_origin, rest]),
        2,
        lfo.QuadraticCost(R=1.0, P=np.eye(2)),
        control_set=lfo.Box(-1, 1),
        state_set=lfo.Box(0, 1),
        initial_state=lfo.Box(start, 1),
    )


def reached(problem, sequence):
    """Return the relaxations of a problem, and the reach of a sequence."""
    relaxation = PathRelaxation(problem)
    return relaxation, relaxation.reach.from_start(np.array(sequence)[:, None] == np.arange(2))


@pytest.mark.parametrize("seed", seeds(SEEDS))
def test_rows_that_leave_room_one_by_one_and_none_together_leave_none(seed):
    """x <= 0.4 and x >= 0.6: the bounds that they cut cross, for the search and for the judge."""
    problem = two_modes([[1, 0], [-1, 0]], [0.4, -0.6], seed)
    everything = np.ones((2, 2), dtype=bool)
    assert ModeReach(problem).from_start(everything).allowed.tolist() == [[False, True]] * 2
    assert IntervalReach(problem).whole.modes.tolist() == [[False, True]] * 2
    result = lfo.solve(problem)
    assert result.status == "optimal"
    assert result.sequence.tolist() == [1, 1]


@pytest.mark.parametrize("seed", seeds(SEEDS))
def test_a_row_that_no_point_of_a_box_satisfies_is_not_dropped(seed):
    """x - y <= -1 leaves a corner of the square, which y - x <= 1/2 excludes: boxes show none of it."""
    problem = two_modes([[1, -1], [-1, 1]], [-1.0, 0.5], seed)
    for sequence in ((0, 1), (1, 0)):
        relaxation, reach = reached(problem, sequence)
        assert reach is not None
        assert solve_relaxation(relaxation, reach).bound == np.inf
    result = lfo.solve(problem)
    assert result.status == "optimal"
    assert result.sequence.tolist() == [1, 1]
    assert result.tree_bound.covers


@expensive
@pytest.mark.parametrize("seed", [2, 7, 22])
def test_a_solver_that_calls_an_infeasible_point_solved_costs_no_optimum(monkeypatch, seed):
    """Of every single sequence it claims the relaxed point without its dynamics."""
    problem, honest = random_problem(seed, horizon=3, n=1), solve_path_relaxation
    best = brute_force(problem)[0]

    def claims(relaxation, reach, *given):
        answer = honest(relaxation, reach, *given)
        if answer is None or answer.sequence is None or answer.trajectory is None:
            return answer
        x = answer.trajectory.x.copy()
        x[1:] *= 0.5
        return replace(answer, bound=answer.bound - 1.0, trajectory=lfo.Trajectory(x, answer.trajectory.u))

    substitute(monkeypatch, "methods.hybrid.solve_path_relaxation", claims)
    result = lfo.solve(problem)
    assert result.status == "optimal"
    assert result.cost == pytest.approx(best, rel=1e-6, abs=1e-7)


def test_the_violation_of_a_trajectory_counts_every_constraint():
    band = lfo.stop_band(bins=[1])
    problem = random_problem(0, horizon=3, control_spectrum=band)
    result = lfo.solve(problem)
    relaxation, x, u = PathRelaxation(problem), result.trajectory.x, result.trajectory.u
    assert relaxation.violation(result.trajectory, result.sequence) < 1e-7
    for t, i in product(range(4), range(2)):
        moved = x.copy()
        moved[t, i] += 0.1
        assert relaxation.violation(lfo.Trajectory(moved, u), result.sequence) > 1e-3
    shaken = np.array([[0.1], [-0.1], [0.0]])  # in the removed bin
    free = replace(problem, control_spectrum=None)
    driven = lfo.simulate(free, u + shaken)
    sequence = problem.dynamics.sequence_of(driven.x, driven.u)
    assert relaxation.violation(driven, sequence) > 1e-2
    assert PathRelaxation(free).violation(driven, sequence) < 1e-9


def test_the_violation_of_a_trajectory_counts_its_regions():
    problem = two_sides()
    relaxation, at_rest = PathRelaxation(problem), lfo.simulate(problem, [[0.0]])
    assert relaxation.violation(at_rest, np.array([0])) == 0
    assert relaxation.violation(at_rest, np.array([1])) > 0.1


def test_a_leaf_that_is_not_solved_in_time_is_a_limit():
    """One sequence is left from the start, so that the search has no node to split."""
    problem = two_modes([[1, 0], [-1, 0]], [0.4, -0.6], 0)
    with use_clock(Clock(0.01)):
        result = lfo.solve(problem, time_limit=0.005, throw=False)
    assert result.status == "limit"
    assert "time limit" in result.message


def test_nodes_that_reach_nothing_are_proven_by_the_judge():
    problem = two_modes([[1, 0], [-1, 0]], [0.4, -0.6], 0)
    result = lfo.solve(replace(problem, terminal_state=[5.0, 0.0]), throw=False)
    assert result.status == "infeasible"
    assert tree_bound(result.problem, result.tree).value == np.inf
    relaxation, reach = reached(problem, (1, 1))
    assert solve_relaxation(relaxation, reach).trajectory is not None


def test_leaves_that_their_solver_does_not_solve_are_no_limit_of_time(monkeypatch):
    """No sequence is left to split, and time is left: the search ends without a proof, and names no limit."""
    substitute(monkeypatch, "methods.hybrid.solve_relaxation", lambda _, reach, *given: NodeSolution(reach, -np.inf))
    result = lfo.solve(random_problem(2, horizon=3, n=1), "branch_and_bound", throw=False)
    assert result.status == "numerical_error"
    assert result.message == "no trajectory was found, and infeasibility is not proven"
