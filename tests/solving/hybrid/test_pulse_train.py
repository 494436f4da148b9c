"""Optimal pulse patterns against published intervals, their bound, files, bad input, and trains that do not exist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp import Trajectory
from lin_freq_ocp.errors import ProblemError


# Miller, Karamanakos and Geyer, arXiv 2512.08201: distortion of moment relaxations, and of polished points
@pytest.mark.parametrize(
    ("modulation", "switches", "lower", "upper"), [(0.9, 8, 0.042201, 0.042206), (1.0, 8, 0.029132, 0.02916)]
)
def test_published_intervals_hold_the_optimum_and_the_bound(modulation, switches, lower, upper):
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp", modulation=modulation, switches=switches))
    assert result.status == "optimal"
    assert result.certificate.pmp == "satisfied"
    assert lower <= np.sqrt(result.cost) <= upper
    assert lower <= np.sqrt(result.lower_bound) <= np.sqrt(result.cost)
    assert result.gap <= 1e-6


def test_the_verdict_does_not_depend_on_the_unit_of_the_cost():
    problem = lfo.library.pulse_pattern(kind="opp")
    result = lfo.solve(replace(problem, cost=lfo.QuadraticCost(p=[0, 0, 0, 1e-9, 0, 0])))
    assert result.status == "optimal"
    assert result.cost == pytest.approx(1e-9 * lfo.solve(problem).cost, rel=1e-6)


def test_three_angles():
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp", modulation=0.8, switches=12), gap=1e-4)
    assert result.status == "optimal"
    assert 0.023661 <= np.sqrt(result.cost) <= 0.023664


def test_the_distortion_is_that_of_the_sampled_pattern():
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp"))
    x, u = result.trajectory.x, result.trajectory.u
    theta = (np.arange(200_000) + 0.5) * np.pi / 2 / 200_000
    level = x[np.searchsorted(np.cumsum(u[:, 0]), theta).clip(max=2), 1]
    current = np.cumsum(level[::-1])[::-1] * -(np.pi / 2 / 200_000)
    assert 4 / np.pi * (current**2).mean() * np.pi / 2 - 0.81 == pytest.approx(result.cost, abs=2e-5)
    assert 4 / np.pi * (level * np.sin(theta)).mean() * np.pi / 2 == pytest.approx(0.9, abs=1e-5)


def test_an_angle_that_is_moved_fails_the_end():
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp"))
    u = result.trajectory.u.copy()
    u[0, 0] += 1e-5
    moved = lfo.simulate(result.problem, u, result.trajectory.x[0])
    verdict = lfo.certify(result.problem, Trajectory(moved.x, moved.u), result.multipliers)
    assert not verdict.feasible
    assert "S-x" in {condition.label for condition in verdict.failed}


def test_without_enough_switches_there_is_none():
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp", switches=4), throw=False)
    assert result.status == "infeasible"
    assert "no box of angles" in result.message


def test_a_time_limit_keeps_what_was_found():
    result = lfo.solve(lfo.library.pulse_pattern(kind="opp", switches=16), time_limit=1e-9, throw=False)
    assert result.status == "limit"
    assert "time limit" in result.message


def test_files_hold_the_train(tmp_path):
    problem = lfo.library.pulse_pattern(kind="opp")
    lfo.write_problem(problem, tmp_path / "train.toml")
    again = lfo.read_problem(tmp_path / "train.toml")
    assert again.dynamics.orders == (1, 3)
    assert again.dynamics.step == 0.5
    assert lfo.solve(again).cost == lfo.solve(problem).cost


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"kind": "sheep"}, "kind"),
        ({"kind": "shep", "samples": 15}, "samples"),
        ({"kind": "shep", "tolerance": 0.0}, "tolerance"),
        ({"kind": "opp", "modulation": 1.3}, "modulation"),
        ({"kind": "opp", "modulation": 0.0}, "modulation"),
        ({"kind": "opp", "switches": 6}, "switches"),
    ],
)
def test_bad_parameters_are_named(given, field):
    with pytest.raises(ProblemError, match=field):
        lfo.library.pulse_pattern(**given)


@pytest.mark.parametrize("given", [{"step": 0.0, "orders": [1]}, {"step": 0.5, "orders": [2]}])
def test_bad_trains_are_named(given):
    with pytest.raises(ProblemError, match="PulseTrain"):
        lfo.dynamics.PulseTrain(**given)
