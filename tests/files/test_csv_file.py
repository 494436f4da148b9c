"""Trajectories as CSV: names, units and every digit."""

from __future__ import annotations

import csv

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp import LinearDynamics, OptimalControlProblem, QuadraticCost, Trajectory
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.files import save_csv
from lin_freq_ocp.library import pendulum


def test_the_csv_has_names_units_and_every_digit(tmp_path):
    problem = pendulum(horizon=10, cutoff=None)
    rng = np.random.default_rng(1)
    trajectory = Trajectory(rng.normal(size=(11, 4)), rng.normal(size=(10, 1)))
    save_csv(tmp_path / "run.csv", problem, trajectory)
    with (tmp_path / "run.csv").open(newline="", encoding="utf-8") as stream:
        head, *rows = csv.reader(stream)
    assert head == [
        *("t", "time [s]", "position [m]", "angle [rad]", "speed [m/s]", "angular speed [rad/s]", "force [N]")
    ]
    assert [int(row[0]) for row in rows] == list(range(11))
    assert float(rows[10][1]) == pytest.approx(0.1)
    assert (np.array([row[2:6] for row in rows], dtype=float) == trajectory.x).all()
    assert [float(row[6]) for row in rows[:-1]] == trajectory.u[:, 0].tolist()
    assert rows[-1][6] == ""


def test_the_csv_has_no_clock_without_a_sampling_time(tmp_path):
    dynamics = LinearDynamics([[1.0]], [[1.0]])
    problem = OptimalControlProblem(dynamics=dynamics, horizon=1, cost=QuadraticCost())
    save_csv(tmp_path / "run.csv", problem, Trajectory([[1.0], [1.5]], [[0.5]]))
    assert (tmp_path / "run.csv").read_text().split() == ["t,x_0,u_0", "0,1.0,0.5", "1,1.5,"]
    with pytest.raises(ProblemError, match="trajectory"):
        save_csv(tmp_path / "run.csv", problem, Trajectory([[1.0], [1.5], [1.0]], [[0.5], [0.5]]))


def test_a_table_of_many_columns_is_told_in_a_short_message(tmp_path):
    problem, path = lfo.library.double_integrator(horizon=4), tmp_path / "wide.csv"
    path.write_text(",".join(f"n{i}" for i in range(20_000)) + "\n")
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.read_csv(path, problem)
    assert len(str(caught.value)) < 1000
    assert str(caught.value).endswith("expected a column of this name.")


def test_a_long_name_of_a_method_is_told_in_a_short_message():
    with pytest.raises(lfo.errors.UnsupportedError, match=r"method: got 'xxx.*or 'nonsmooth'") as caught:
        lfo.solve(lfo.library.double_integrator(horizon=4), "x" * 10_000)
    assert len(str(caught.value)) < 1000
