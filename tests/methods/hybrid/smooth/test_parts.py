"""The parts of the barrier method against differences."""

from __future__ import annotations

import numpy as np

from lin_freq_ocp import library, simulate
from lin_freq_ocp.methods.hybrid import Filter, Measure, SmoothModel


def test_a_filter_takes_what_improves_either_and_remembers_where_it_was():
    entries, here = Filter(1.0), Measure(1.0, 0.0)
    assert not entries.takes(here, Measure(1.0, 0.0), -1.0, 1.0)
    assert not entries.takes(here, Measure(np.nan, -1.0), -1.0, 1.0)
    assert not entries.takes(here, Measure(0.1, np.inf), -1.0, 1.0)
    assert not entries.entries
    assert entries.takes(here, Measure(0.5, 10.0), -1.0, 1.0)
    assert len(entries.entries) == 1
    assert not entries.accepts(Measure(1.0, 0.0))
    assert entries.accepts(Measure(1.1, -1.0))
    feasible = Measure(0.0, 0.0)
    assert not entries.takes(feasible, Measure(0.0, -1e-6), -1.0, 1.0)
    assert entries.takes(feasible, Measure(0.0, -0.5), -1.0, 1.0)
    assert len(entries.entries) == 1


def test_derivatives_in_units_of_stages_are_those_of_the_defects():
    problem = library.cart_pole(horizon=6)
    rng = np.random.default_rng(1)
    start = simulate(problem, rng.normal(size=(6, 1)))
    model = SmoothModel.at(problem, start)
    y = model.assembly.point(start)
    assert np.abs(model.defects(y)).max() <= 1e-12
    y = y + 0.1 * rng.normal(size=y.shape)
    found, step = model.derivatives(y), 1e-5
    for j in range(5):
        change = np.zeros_like(y)
        change[:-1, j] = step
        ahead, behind = model.derivatives(y + change), model.derivatives(y - change)
        slopes = (ahead.successors - behind.successors) / (2 * step)
        np.testing.assert_allclose(found.slopes[:, :, j], slopes, atol=1e-7)
        np.testing.assert_allclose(found.curvatures[..., j], (ahead.slopes - behind.slopes) / (2 * step), atol=1e-6)
    stages = model.linearised(y, found)
    rows = y[1:, :4] - np.einsum("tij,tj->ti", stages.A[:-1], y[:-1, :4])
    rows -= np.einsum("tij,tj->ti", stages.B[:-1], y[:-1, 4:]) + stages.d[:-1]
    np.testing.assert_allclose(rows, model.defects(y), atol=1e-12)


def test_a_control_between_equal_bounds_has_no_part():
    problem = library.pendulum_swing_up(horizon=4, torque_bound=0.0)
    start = simulate(problem, np.zeros((4, 1)))
    model = SmoothModel.at(problem, start)
    assert not model.derivatives(model.assembly.point(start)).slopes[:, :, 2].any()
