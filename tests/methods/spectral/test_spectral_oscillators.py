"""Oscillators on horizons of many periods: what is hard at a bin follows from decay over the horizon, not from T."""

from __future__ import annotations

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.oscillator import oscillator
from helpers.seeds import expensive
from lin_freq_ocp.methods import SolveOptions, solve_convex
from lin_freq_ocp.methods.spectral import BinSpaces, lti_problem, natural_units

DAMPING = (0.05, 0.3, 1.0, 0.0, -0.05)
"""Damping ratios; the last two are undamped and unstable."""


def spaces_of(problem: lfo.OptimalControlProblem) -> BinSpaces:
    return BinSpaces(lti_problem(problem, natural_units(problem)))


def driven_by_a_lag(horizon: int) -> lfo.OptimalControlProblem:
    """Return the oscillator behind an actuator of 0.05 s, of whose state nothing is stated."""
    one = oscillator(horizon)
    A = [[0, 1, 0], [-4, -0.2, 1], [0, 0, -20]]
    return lfo.OptimalControlProblem(
        dynamics=lfo.LinearDynamics.from_continuous(A, [[0], [0], [20]], 0.01),
        horizon=horizon,
        cost=lfo.QuadraticCost(Q=np.diag([10, 0.1, 0]), R=0.1),
        control_set=one.control_set,
        initial_state=(1, 0, 0),
        control_spectrum=one.control_spectrum,
    )


def masses(horizon: int) -> lfo.OptimalControlProblem:
    """Return five masses between springs, the first one pushed: of one position something is stated."""
    k = 5
    stiffness = 4 * (2 * np.eye(k) - np.eye(k, k=1) - np.eye(k, k=-1))
    A = np.block([[np.zeros((k, k)), np.eye(k)], [-stiffness, -0.001 * stiffness]])
    one = oscillator(horizon)
    return lfo.OptimalControlProblem(
        dynamics=lfo.LinearDynamics.from_continuous(A, np.eye(2 * k)[:, k : k + 1], 0.01),
        horizon=horizon,
        cost=lfo.QuadraticCost(Q=np.eye(2 * k), R=0.1),
        control_set=one.control_set,
        initial_state=np.eye(2 * k)[0],
        control_spectrum=one.control_spectrum,
    )


@expensive
@pytest.mark.parametrize("damping", DAMPING)
def test_oscillators_are_solved_like_by_the_sparse_program(damping: float) -> None:
    problem = oscillator(200, damping)
    result = lfo.solve(problem, method="spectral")
    reference = solve_convex(problem, "clarabel", SolveOptions(tolerance=1e-11))
    assert reference.trajectory is not None
    assert result.certificate is not None
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.globally_optimal
    expected = problem.value(reference.trajectory.x, reference.trajectory.u)
    assert result.certificate.cost == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("damping", DAMPING)
def test_oscillators_are_proven_on_longer_horizons(damping: float) -> None:
    result = lfo.solve(oscillator(6000, damping))
    assert result.method == "spectral"
    assert result.certificate is not None
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.globally_optimal


@pytest.mark.parametrize("make", [oscillator, driven_by_a_lag, masses])
@pytest.mark.parametrize("horizon", [1000, 20_000])
def test_no_bin_that_controls_reach_is_a_border_direction(make: object, horizon: int) -> None:
    assert callable(make)
    assert len(spaces_of(make(horizon)).bordering_bin) == 0


@pytest.mark.parametrize("damping", [*DAMPING, 1e-5])
def test_the_number_of_border_directions_does_not_grow_with_the_horizon(damping: float) -> None:
    counts = [len(spaces_of(oscillator(horizon, damping)).bordering_bin) for horizon in (1000, 10_000, 100_000)]
    assert max(counts) <= 4


def test_masses_on_springs_are_solved_although_only_one_size_is_stated() -> None:
    result = lfo.solve(masses(1500), method="spectral")
    assert result.certificate is not None
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.globally_optimal


@expensive
def test_an_undamped_oscillator_beyond_its_band_has_few_border_directions() -> None:
    """No control moves it at its own frequency: bins next to that are singular, however long the horizon."""
    problem = lfo.OptimalControlProblem(
        dynamics=lfo.LinearDynamics.from_continuous([[0, 1], [-2500, 0]], [[0], [1]], 0.01),
        horizon=500_000,
        cost=lfo.QuadraticCost(Q=np.diag([10, 0.1]), R=0.1),
        control_set=lfo.Box(-400, 400),
        initial_state=(1, 0),
        control_spectrum=lfo.low_pass(2 * np.pi * 5 * 0.01),
    )
    assert 1 <= len(spaces_of(problem).bordering_bin) <= 6
