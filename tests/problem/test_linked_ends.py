"""Equations on both ends: construction, bad input, words, the map and its adjoint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.errors import ProblemError

LinkedEnds = lfo.sets.LinkedEnds


def problem(terminal_state, **further) -> lfo.OptimalControlProblem:
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]])
    return lfo.OptimalControlProblem(dynamics, 8, lfo.QuadraticCost(R=1.0), terminal_state=terminal_state, **further)


@pytest.mark.parametrize(
    ("data", "field"),
    [
        (([1.0], [1.0]), "LinkedEnds.E_0"),
        (([[1.0]], [[1.0, 0.0]]), "LinkedEnds.E_T"),
        (([[1.0]], [[1.0]], [1.0, 2.0]), "LinkedEnds.e"),
        (([[0.0]], [[0.0]], [1.0]), "LinkedEnds.e"),
        (([[np.nan]], [[0.0]]), "LinkedEnds.E_0"),
    ],
)
def test_bad_matrices_name_the_field(data, field):
    with pytest.raises(ProblemError, match=field):
        LinkedEnds(*data)


@pytest.mark.parametrize(
    ("field", "given"),
    [
        ("initial_state", lfo.Periodic()),
        ("state_set", lfo.Periodic()),
        ("control_set", lfo.Periodic() & lfo.Box(0, 1)),
        ("state_set", [lfo.Periodic()] * 9),
        ("terminal_state", LinkedEnds(np.eye(3), np.eye(3))),
    ],
)
def test_it_is_a_terminal_state_of_this_dimension_only(field, given):
    with pytest.raises(ProblemError, match=field):
        replace(problem(None), **{field: given})


@pytest.mark.parametrize("horizon", [7, 8])
def test_spectra_of_states_with_periodic_ends_have_t_samples(horizon):
    band = {"state_spectrum": lfo.low_pass(1.0)}
    periodic, linked = lfo.Periodic(), LinkedEnds(-np.eye(2), np.eye(2))
    for ends, samples in ((periodic, horizon), (periodic & lfo.Box(-1, 1), horizon), (linked, horizon + 1)):
        given = replace(problem(ends, **band), horizon=horizon)
        assert given.state_samples == samples
        assert given.state_stop.shape == (samples // 2 + 1, 2)
    rho = np.zeros((horizon // 2 + 1, 2), complex)
    rho[1] = 1.0, 1j
    in_time = replace(problem(periodic, **band), horizon=horizon).in_time(rho)
    angle = 2 * np.pi * np.arange(horizon) / horizon
    np.testing.assert_allclose(in_time[:-1], np.column_stack([np.cos(angle), -np.sin(angle)]), atol=1e-15)
    assert not in_time[-1].any()


def test_a_horizon_of_one_has_the_rows_of_both_states():
    assert not LinkedEnds(np.eye(2), np.eye(2)).links(2, 1)[0].values.rows(1, 2, 0)[0].data.max() > 1


def test_words_and_added_states():
    facts = problem(lfo.Periodic())._repr_html_()
    assert "x_T = x_0: the trajectory is one period" in facts
    assert "periodic ends" in str(problem(lfo.Periodic()))
    linked = problem(LinkedEnds([[1.0, 0.0]], [[1.0, 0.0]], [2.0]))
    assert "1 equation on both ends, E_0 x_0 + E_T x_T = e, e = (2)" in linked._repr_html_()
    slow = lfo.rate_limited(linked, 0.5)
    assert slow.terms[-1].map.values(np.ones((9, 3)), np.zeros((8, 1))) == pytest.approx(np.zeros((1, 1)))


def test_other_ends_take_its_place():
    given = problem(lfo.Periodic())
    assert not given.with_ends(terminal_state=[0.0, 0.0]).terms
    other = problem([0.0, 0.0]).with_ends(terminal_state=lfo.Periodic())
    assert [term.name for term in other.terms] == ["periodic ends"]
