"""A new benchmark is one function and one entry in a table: list, show and solve know it by its name."""

from __future__ import annotations

import json

import pytest

import lin_freq_ocp as lfo
from helpers.command_line import run


def toy(horizon: int = 4, goal: float = 1.0) -> lfo.OptimalControlProblem:
    """Move a point by its steps, all of them small.

    Parameters
    ----------
    horizon : int
        T.
    goal : float
        Where the point ends.
    """
    return lfo.OptimalControlProblem(
        dynamics=lfo.LinearDynamics([[1.0]], [[1.0]]),
        horizon=horizon,
        cost=lfo.QuadraticCost(R=2.0),
        initial_state=[0.0],
        terminal_state=[goal],
        name="toy",
    )


def test_a_registered_benchmark_is_listed_shown_and_solved(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(lfo.library.PROBLEMS, "toy", toy)
    assert "toy" in run("list")[1]
    status, out, _ = run("show", "toy", "--json")
    assert (status, json.loads(out)["about"]) == (0, "Move a point by its steps, all of them small.")
    assert [one["name"] for one in json.loads(out)["parameters"]] == ["horizon", "goal"]
    status, out, _ = run("solve", "toy", "--set", "goal=2.0", "--json")
    assert (status, json.loads(out)["cost"]) == (0, pytest.approx(1.0))
