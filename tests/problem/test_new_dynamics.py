"""Dynamics of a user's own, defined here and nowhere in the package: solved, certified, described, replayed, saved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import turn
from lin_freq_ocp.base import assign
from lin_freq_ocp.pages import draw_figures, render_page
from lin_freq_ocp.problem import Dynamics, signal_labels
from lin_freq_ocp.solvers import Nonsmooth
from lin_freq_ocp.solving import FAMILIES, Family, Shorthand


@dataclass(frozen=True, eq=False, init=False)
class DelayedInput(Dynamics):
    """x_{t+1} = A x_t + B u_{t-1}, in the states (x_t, u_{t-1}): the methods are those of linear dynamics."""

    A: np.ndarray
    B: np.ndarray

    def __init__(self, A, B, sampling_time=None):
        A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
        n, m = B.shape
        assign(self, A=A, B=B, **signal_labels(n + m, m, sampling_time, None, None))

    @cached_property
    def standard_form(self):
        n, m = self.B.shape
        A = np.block([[self.A, self.B], [np.zeros((m, n + m))]])
        B = np.vstack([np.zeros((n, m)), np.eye(m)])
        return lfo.LinearDynamics(A, B, None, self.sampling_time, self.state_names, self.control_names)


@dataclass(frozen=True, eq=False, init=False)
class Bilinear(Dynamics):
    """x_{t+1} = A x_t + u_t N x_t + B u_t, with a single control."""

    A: np.ndarray
    N: np.ndarray
    B: np.ndarray

    def __init__(self, A, N, B):
        A, N, B = (np.asarray(part, dtype=float) for part in (A, N, B))
        assign(self, A=A, N=N, B=B, **signal_labels(len(B), 1, None, None, None))

    @cached_property
    def standard_form(self):
        def f(x, u):
            return [
                sum((a + c * u[0]) * one for a, c, one in zip(row, slope, x, strict=True)) + b * u[0]
                for row, slope, b in zip(self.A, self.N, self.B, strict=True)
            ]

        return lfo.PiecewiseSmoothDynamics.from_formulas(f, self.state_dim, 1)

    def facts(self, labels):
        return [("dynamics", "bilinear: (A + u N) x + B u")]

    def stepper(self, horizon):
        return lambda t, x, u: (self.A + u[0] * self.N) @ x + self.B * u[0]


@dataclass(frozen=True)
class FromRest:
    """A method for bilinear dynamics that leaves the work to the search over smooth pieces."""

    global_bound: bool = False

    shorthand: ClassVar[str] = "from_rest"
    takes_start: ClassVar[bool] = False

    def solve(self, problem, request):
        return replace(Nonsmooth(global_bound=self.global_bound).solve(problem, request), method="from_rest")


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
