"""Measures of a trajectory and stated sizes, by hand and by definition."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lin_freq_ocp as lfo
from helpers.linear_problems import generator, problem
from helpers.seeds import examples
from lin_freq_ocp import Box, LinearDynamics, OptimalControlProblem, QuadraticCost, Trajectory, simulate
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem import measures
from lin_freq_ocp.transform import stated_sizes


@settings(max_examples=examples(15), derandomize=True, deadline=None)
@given(seed=st.integers(0, 10**6), size=st.integers(1, 4), times=st.integers(1, 30), varying=st.booleans())
def test_amplification_is_the_norm_of_the_product(seed, size, times, varying):
    A = generator(seed).normal(size=(times, size, size))
    A = A if varying else np.broadcast_to(A[0], A.shape)
    given_A = A if varying else A[0]
    made = OptimalControlProblem(LinearDynamics(given_A, np.ones((size, 1))), times, QuadraticCost())
    product = np.eye(size)
    for matrix in A:
        product = matrix @ product
    assert measures.amplification(made.linear, times) == pytest.approx(np.linalg.norm(product, 2), rel=1e-9)


@pytest.mark.parametrize(
    ("A", "times", "expected"),
    [
        ([[1e30]], 5, 1e150),
        ([[1e-30]], 5, 1e-150),  # needs rescaling on the way
        (np.array([[[1e200]], [[1e200]], [[1e-250]]]), 3, 1e150),  # overflows on the way, not at the end
        (np.array([[[1e-200]], [[1e-200]], [[1e250]]]), 3, 1e-150),
        ([[1e200]], 5, np.finfo(float).max),
        ([[0.0, 1.0], [0.0, 0.0]], 2, 0.0),  # nilpotent
        ([[0.0, -3.0], [3.0, 0.0]], 2, 9.0),
    ],
)
def test_amplification_at_the_ends_of_the_number_range(A, times, expected):
    dynamics = LinearDynamics(A, np.ones((np.shape(A)[-1], 1)))
    assert measures.amplification(dynamics, times) == pytest.approx(expected, rel=1e-9)


def test_a_replay_means_something_up_to_a_growth():
    assert measures.replay_is_meaningful(4.5e4)  # the pendulum at 0.01 s
    assert not measures.replay_is_meaningful(3e46)  # and at 0.1 s


@pytest.mark.parametrize("length", [11, 12])
def test_stopband_energy_is_the_energy_of_the_removed_part(length):
    """Parseval: the half spectrum counts a pair of bins once, the signal without the band the energy of both."""
    rng = generator(27)
    signal = rng.normal(size=(length, 2))
    stopped = rng.random((length // 2 + 1, 2)) < 0.5
    stopped[0], stopped[-1] = [True, False], [False, True]
    kept = np.fft.irfft(np.where(stopped, 0, np.fft.rfft(signal, axis=0)), n=length, axis=0)
    energy = np.zeros(2)
    for j in range(2):
        bins = np.flatnonzero(stopped[:, j])
        single = [k for k in bins if k == 0 or 2 * k == length]
        for k in bins:
            phase = np.exp(-2j * np.pi * k * np.arange(length) / length)
            energy[j] += abs(signal[:, j] @ phase) ** 2
        twice = energy[j] * 2 - sum(abs(np.fft.fft(signal[:, j])[k]) ** 2 for k in single)
        removed = (signal[:, j] ** 2).sum() - (kept[:, j] ** 2).sum()
        assert twice / length == pytest.approx(removed, rel=1e-10)
    assert measures.stopband_energy(signal, stopped) == pytest.approx(energy.sum(), rel=1e-12)
    assert measures.stopband_energy(kept, stopped) == pytest.approx(0, abs=1e-24)
    assert measures.stopband_energy(signal, np.zeros_like(stopped)) is None
    assert measures.stopband_peak(signal, np.zeros_like(stopped)) is None


@pytest.mark.parametrize("length", [15, 16])
def test_stopband_peak_is_the_largest_dtft_between_the_bins(length):
    rng = generator(28)
    signal = rng.normal(size=(length, 2))
    stopped = np.zeros((length // 2 + 1, 2), dtype=bool)
    stopped[2:5, 0] = stopped[6, 0] = stopped[5:, 1] = True
    time = np.arange(length)
    largest = 0.0
    for j, first, last in ((0, 2, 4), (0, 6, 6), (1, 5, length // 2)):
        omega = 2 * np.pi / length * np.linspace(first, last, measures.ZERO_PADDING * (last - first) + 1)
        largest = max(largest, np.abs(np.exp(-1j * np.outer(omega, time)) @ signal[:, j]).max())
    peak = measures.stopband_peak(signal, stopped)
    assert peak == pytest.approx(largest, rel=1e-12)
    assert peak >= np.abs(np.fft.rfft(signal, axis=0))[stopped].max() - 1e-12
    kept = np.fft.irfft(np.where(stopped, 0, np.fft.rfft(signal, axis=0)), n=length, axis=0)
    assert measures.stopband_peak(kept, stopped) > 1e-3  # zero bins are not zero energy between them


def test_stopped_runs_are_the_runs():
    mask = np.array([True, True, False, True, False, False, True])
    assert measures.stopped_runs(mask) == [(0, 1), (3, 3), (6, 6)]
    assert measures.stopped_runs(np.zeros(4, dtype=bool)) == []
    assert measures.stopped_runs(np.ones(4, dtype=bool)) == [(0, 3)]


def test_padded_spectrum_holds_the_bins():
    signal = generator(29).normal(size=(9, 2))
    omega, magnitude = measures.padded_spectrum(signal)
    step = measures.ZERO_PADDING
    np.testing.assert_allclose(magnitude[::step], np.abs(np.fft.rfft(signal, axis=0)), rtol=1e-12)
    np.testing.assert_allclose(omega[::step], 2 * np.pi * np.arange(5) / 9, rtol=1e-14)


def measured(changes: dict[str, Any], x: Any, u: Any) -> measures.Measures:
    return measures.measure(problem(**changes), Trajectory(x, u))


def test_measures_by_hand():
    x = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, -4.0], [0.0, 0.0], [1.5, 1.0]])
    u = np.array([[1.0], [-3.0], [0.0], [2.0]])
    found = measured(
        {
            "state_set": Box([-1, -1], [1, 1]),
            "control_set": Box(-2.5, 1.5),
            "terminal_state": Box([0.5, None], [1.0, None]),
            "initial_state": [1.0, 1.0],  # missed, which is no violation of the state set
            "control_spectrum": lfo.stop_band(bins=[2]),
        },
        x,
        u,
    )
    assert found.cost == pytest.approx(0.5 * (1 + 9 + 4))
    assert found.max_control == 3.0
    assert found.control_violation == 0.5  # 2 - 1.5 and -2.5 - (-3)
    assert found.state_violation == 3.0  # -1 - (-4)
    assert found.terminal_error == 0.5
    assert found.terminal_errors == (0.5, 0.0)
    assert found.stopband_energy == pytest.approx(abs(1 + 3 + 0 - 2) ** 2)  # sum of (-1)^t u_t
    assert found.stopband_peak == pytest.approx(2.0)
    assert found.state_stopband_energy is None
    assert found.state_stopband_peak is None
    assert found.amplification == pytest.approx(np.linalg.norm([[1, 0.4], [0, 1]], 2))


def test_a_free_end_has_no_error():
    found = measured({}, np.ones((5, 2)), np.ones((4, 1)))
    assert found.terminal_error is None
    assert found.terminal_errors is None
    assert found.control_violation == 0.0
    assert found.state_violation == 0.0


def test_one_step_residual_is_what_the_dynamics_miss():
    made = problem(initial_state=[0.0, 1.0])
    trajectory = simulate(made, np.ones((4, 1)))
    x = trajectory.x.copy()
    x[2, 1] += 0.25
    residual = measures.one_step_residual(made, Trajectory(x, trajectory.u))
    expected = np.zeros((4, 2))
    expected[1] = [0.0, 0.25]
    expected[2] = [-0.025, -0.25]  # A (0, 0.25) is missing in the next step
    np.testing.assert_allclose(residual, expected, atol=1e-14)


def test_a_trajectory_of_another_problem_is_not_measured():
    with pytest.raises(ProblemError):
        measures.measure(problem(), Trajectory(np.zeros((4, 2)), np.zeros((3, 1))))


def test_stated_sizes_come_from_ends_then_references_then_bounds():
    made = problem(
        state_set=Box([-9.0, -7.0], [5.0, 3.0]),
        initial_state=[0.0, 0.0],
        terminal_state=Box([-2.0, None], [1.0, None]),
        control_set=Box(-3.0, None),
    )
    states, controls = stated_sizes(made)
    np.testing.assert_array_equal(states, [2.0, 7.0])
    np.testing.assert_array_equal(controls, [3.0])
    cost = QuadraticCost(Q=1.0, R=1.0, x_ref=[0.25, -4.0], u_ref=[-5.0])
    states, controls = stated_sizes(problem(state_set=Box([-9, -7], [5, 3]), initial_state=[0.0, 0.0], cost=cost))
    np.testing.assert_array_equal(states, [0.25, 4.0])
    np.testing.assert_array_equal(controls, [5.0])
    for part in stated_sizes(problem()):  # nothing is said, but a size is a size
        assert (part > 0).all()
        assert np.isfinite(part).all()


def mass(B, start, units=(1.0, 1.0), **references):
    """Return a mass that comes to rest within ten steps, its states in these units, with an input matrix."""
    D = np.diag(units)
    dynamics = LinearDynamics(D @ [[1.0, 0.5], [0.0, 1.0]] @ np.linalg.inv(D), D @ np.reshape(B, (2, 1)))
    cost = QuadraticCost(Q=1.0, R=0.1, **references)
    return OptimalControlProblem(dynamics, 10, cost, initial_state=D @ start, terminal_state=[0, 0])


@pytest.mark.parametrize("B", [(0.125, 0.5), (0.0, 0.5)], ids=["sampled", "Euler"])
@pytest.mark.parametrize("units", [(1.0, 1.0), (1e9, 1e-9)], ids=["metres", "others"])
@pytest.mark.parametrize("small", [1e-300, 1e-17, 1e-9, 1e-3])
def test_numbers_that_are_small_next_to_what_moves_say_nothing(small, units, B):
    at_rest = np.concatenate(stated_sizes(mass(B, [1.5, 0.0], units)))
    for moving in (
        mass(B, [1.5, small], units),
        mass(B, [1.5, 0.0], units, u_ref=[small]),
        mass(B, [1.5, -small], units, x_ref=np.multiply(units, small), u_ref=[small]),
    ):
        np.testing.assert_allclose(np.concatenate(stated_sizes(moving)), at_rest, rtol=1e-6)


@pytest.mark.parametrize("units", [(1.0, 1.0), (1e9, 1e-9)])
def test_numbers_that_the_motion_may_have_are_its_sizes(units):
    states, controls = stated_sizes(mass((0.125, 0.5), [1.5, 0.2], units, u_ref=[0.3]))
    np.testing.assert_allclose(states, np.multiply(units, [1.5, 0.2]))
    np.testing.assert_allclose(controls, 0.3)


def test_a_reference_without_a_weight_says_nothing():
    unweighed = problem(state_set=Box(-9.0, 9.0), control_set=Box(-2.0, 2.0), cost=QuadraticCost(Q=1.0, u_ref=[1e-9]))
    np.testing.assert_array_equal(stated_sizes(unweighed)[1], [2.0])


@pytest.mark.parametrize("start", [[1e-12, 0.0], [0.0, 1e-12]])
def test_rows_that_the_origin_violates_say_how_far_a_state_moves(start):
    row = lfo.StageRows([[1.0, 0.0]], None, [-0.1], "row", penalty=0.3)
    at_rest, near = (
        stated_sizes(problem(initial_state=begin, stage_rows=[row], cost=QuadraticCost(Q=1.0, R=1.0)))
        for begin in ([0.0, 0.0], start)
    )
    np.testing.assert_allclose(np.concatenate(near), np.concatenate(at_rest), rtol=1e-6)
