"""One small sweep, and when two are the same."""

from __future__ import annotations

from functools import partial

import pytest

import lin_freq_ocp as lfo

SHORT = partial(lfo.library.double_integrator, horizon=60, sampling_time=0.1, cutoff_hz=1.0)
GRID = {"cutoff_hz": [None, 0.2, 1.0, 3.0], "control_bound": [0.2, 1.0]}
"""Eight points, two of them infeasible."""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return tmp_path_factory.mktemp("sweep") / "sweep.jsonl"


@pytest.fixture(scope="module")
def serial(file):
    return lfo.sweep(SHORT, GRID, path=file)


def assert_same(one: lfo.results.Sweep, other: lfo.results.Sweep) -> None:
    """The same points in the same order, with the same answers to 1e-9."""
    assert [row["parameters"] for row in one.rows] == [row["parameters"] for row in other.rows]
    assert one.column("status") == other.column("status")
    assert one.column("proven") == other.column("proven")
    for mine, yours in zip(one.column("cost"), other.column("cost"), strict=True):
        assert mine == yours if mine is None or yours is None else mine == pytest.approx(yours, rel=1e-9, abs=1e-12)


def broken_builder(horizon: int) -> lfo.OptimalControlProblem:
    if horizon == 2:
        raise ZeroDivisionError("no such horizon")
    return SHORT(horizon=60 if horizon > 2 else horizon)
