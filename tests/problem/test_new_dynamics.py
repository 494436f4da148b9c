"""Dynamics of a user's own, defined here and nowhere in the package: solved, certified, described, replayed, saved."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.own_kinds import Bilinear, DelayedInput, FromRest
from helpers.seeds import turn
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


def test_linear_dynamics_of_another_class_have_the_methods_of_linear_ones(tmp_path):
    given, same = problem(DELAYED), problem(DELAYED.standard_form)
    for method in ("auto", "spectral", "convex"):
        result = lfo.solve(given, method)
        assert result.certificate.globally_optimal
        assert result.cost == lfo.solve(same, method).cost
    assert lfo.certify(given, result.trajectory).globally_optimal
    x = lfo.simulate(given, result.trajectory.u).x
    assert np.allclose(x[1:, :2], x[:-1, :2] @ DELAYED.A.T + x[:-1, 2:] @ DELAYED.B.T)
    assert np.array_equal(x[1:, 2:], result.trajectory.u)
    assert lfo.solve(lfo.rate_limited(given, 0.3)).certificate.globally_optimal
    lfo.write_problem(given, tmp_path / "delayed.toml")
    assert lfo.solve(lfo.read_problem(tmp_path / "delayed.toml")).cost == pytest.approx(result.cost, rel=1e-8)


def test_smooth_dynamics_of_another_class_are_solved_by_the_method_registered_for_them(registered):
    given = problem(BILINEAR)
    result = lfo.solve(given)
    assert (result.method, result.status) == ("from_rest", "locally_optimal")
    assert result.certificate.pmp == "satisfied"
    assert result.cost == pytest.approx(lfo.solve(problem(BILINEAR.standard_form), "nonsmooth").cost, rel=1e-9)
    assert lfo.certify(given, result.trajectory).pmp == "satisfied"
    assert lfo.certify(given, result.trajectory.u).pmp == "satisfied"  # replayed by its own step
    worse = lfo.simulate(given, 0.5 * result.trajectory.u)
    assert lfo.certify(given, worse).pmp == "violated"


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


@turn(0)
def test_it_is_reported_and_compared(registered):
    given = problem(BILINEAR, control_spectrum=lfo.stop_band(bins=[3]))
    comparison = lfo.compare(given)
    assert comparison.constrained.certificate.pmp == "satisfied"
    assert "bilinear" in render_page(comparison, draw_figures(comparison))


def test_without_a_registration_the_methods_are_those_of_the_standard_form():
    result = lfo.solve(problem(BILINEAR), "nonsmooth")
    assert result.certificate.pmp == "satisfied"
