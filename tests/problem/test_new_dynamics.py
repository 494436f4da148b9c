"""Dynamics of a user's own with a method of their own: errors name both, reports show both."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.own_kinds import Bilinear, DelayedInput, FromRest
from helpers.seeds import expensive
from lin_freq_ocp.pages import draw_figures, render_page
from lin_freq_ocp.solving import FAMILIES, Family, Shorthand


@pytest.fixture
def registered(monkeypatch):
    shorthands = {"auto": Shorthand(FromRest()), "from_rest": Shorthand(FromRest())}
    monkeypatch.setitem(FAMILIES, Bilinear, Family("bilinear", shorthands))


def problem(dynamics, **further):
    n = dynamics.state_dim
    cost = lfo.QuadraticCost(Q=np.eye(n), R=0.1)
    given = {"initial_state": [1.0, -0.5, 0.0][:n], "control_set": lfo.Box(-1, 1)} | further
    return lfo.OptimalControlProblem(dynamics, 8, cost, **given)


DELAYED = DelayedInput([[1.0, 0.2], [0, 0.9]], [[0.0], [0.2]], 0.1)
BILINEAR = Bilinear([[1.0, 0.2], [0, 0.9]], [[0.0, 0.1], [-0.1, 0.0]], [0.0, 0.2])


def test_it_describes_itself_and_its_methods(registered):
    given = problem(BILINEAR)
    assert "bilinear: (A + u N) x + B u" in given._repr_html_()
    assert "linear: A x + B u" in problem(DELAYED)._repr_html_()
    with pytest.raises(lfo.errors.UnsupportedError, match="'from_rest' for bilinear dynamics"):
        lfo.solve(given, "spectral")
    with pytest.raises(lfo.errors.UnsupportedError, match="for bilinear dynamics"):
        lfo.solve(problem(DELAYED), "from_rest")
    with pytest.raises(lfo.errors.UnsupportedError, match=r"got Bilinear; expected LinearDynamics"):
        _ = given.linear


@expensive
def test_it_is_reported_and_compared(registered):
    given = problem(BILINEAR, control_spectrum=lfo.stop_band(bins=[3]))
    comparison = lfo.compare(given)
    assert comparison.constrained.certificate.pmp == "satisfied"
    assert "bilinear" in render_page(comparison, draw_figures(comparison))
