"""Whole levels near a relaxed control: error feedback, descent by flips, and the search that begins with them."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp import simulate
from lin_freq_ocp.methods.hybrid import level_rounding, neighbouring_levels

PERIOD = 200


def sine(amplitude: float) -> np.ndarray:
    return amplitude * np.sin(2 * np.pi * np.arange(PERIOD) / PERIOD)[:, None]


@pytest.fixture(scope="module")
def inverter() -> lfo.OptimalControlProblem:
    return lfo.library.pulse_pattern(samples=PERIOD, tolerance=0.02)


@expensive
def test_an_inverter_of_200_samples_has_a_feasible_pattern_at_the_first_node(inverter):
    result = lfo.solve(inverter, node_limit=1, throw=False)
    assert result.certificate.feasible
    assert np.isin(result.control, inverter.control_set.levels).all()
    assert result.cost <= 1.25  # the bound of the relaxation is 1.2234
    angle = 2 * np.pi * np.arange(PERIOD) / PERIOD
    u = result.control[:, 0]
    for k, amplitude in ((1, 1.5), (3, 0.0), (5, 0.0), (7, 0.0)):
        harmonic = 2 / PERIOD * u @ np.exp(1j * k * angle)
        assert abs(harmonic - amplitude * 1j) <= 0.02 * (np.sqrt(2) if k == 1 else 1) + 1e-9


def test_error_feedback_keeps_the_error_out_of_the_limited_harmonics(inverter):
    control = sine(1.5)
    levels = np.array(inverter.control_set.levels)
    shaped = levels[level_rounding(inverter).shape(control)]
    nearest = levels[np.abs(control - levels).argmin(axis=1)]

    def worst_harmonic(u: np.ndarray) -> float:
        return np.abs(np.fft.rfft(u - control[:, 0])[[3, 5, 7]]).max() * 2 / PERIOD

    assert worst_harmonic(shaped) < 0.05
    assert worst_harmonic(shaped) < 0.5 * worst_harmonic(nearest)


def test_no_flip_of_an_improved_sequence_is_feasible_and_cheaper():
    """The descent ends where neither one flip nor two decrease the cost, checked by enumeration of all of them."""
    dynamics = lfo.LinearDynamics([[1.0, 0.5], [0.0, 1.0]], [[0.1, 0.0], [0.5, 0.3]])
    problem = lfo.OptimalControlProblem(
        dynamics,
        5,
        lfo.QuadraticCost(Q=np.diag([1.0, 0.2]), R=0.1 * np.eye(2)),
        control_set=lfo.FiniteSet([[-1, 0, 1], [-2, 0, 3]], [[0.1, 0, 0.1], [0.2, 0, 0.3]]),
        state_set=lfo.Box(-2, 2),
        initial_state=[1.0, 0.4],
        terminal_state=lfo.Box([-0.6, -0.6], [0.6, 0.6]),
    )
    points = problem.form.choices

    def judged(sequence: tuple[int, ...]) -> tuple[bool, float]:
        found = simulate(problem, points[list(sequence)])
        within = (np.abs(found.x) <= 2 + 1e-9).all() and (np.abs(found.x[-1]) <= 0.6 + 1e-9).all()
        return bool(within), problem.value(found.x, found.u)

    sequence, violation, cost = level_rounding(problem).improve(np.zeros(5, dtype=int), np.array([1.0, 0.4]), np.inf)
    assert violation == 0.0
    assert judged(tuple(sequence)) == (True, pytest.approx(cost))
    step = neighbouring_levels(points)
    moves = [(t, mode) for t in range(5) for mode in step[sequence[t]] if mode >= 0]
    for first, second in product(moves, moves):
        other = sequence.copy()
        other[first[0]], other[second[0]] = first[1], second[1]
        feasible, value = judged(tuple(other))
        assert not feasible or value >= cost - 1e-7


def test_neighbouring_levels_are_the_next_of_one_component():
    steps = neighbouring_levels(np.array(list(product([-1.0, 0.0, 2.0], [0.0, 5.0]))))
    assert steps.tolist() == [
        [-1, 2, -1, 1],
        [-1, 3, 0, -1],
        [0, 4, -1, 3],
        [1, 5, 2, -1],
        [2, -1, -1, 5],
        [3, -1, 4, -1],
    ]


def test_rounding_does_not_depend_on_units():
    def thruster(state: float, control: float) -> lfo.OptimalControlProblem:
        return lfo.OptimalControlProblem(
            lfo.LinearDynamics([[1.0, 0.5], [0.0, 1.0]], np.array([[0.125], [0.5]]) * state / control),
            20,
            lfo.QuadraticCost(R=1 / control**2),
            control_set=lfo.FiniteSet(control * np.array([-1.0, 0.0, 1.0])),
            state_set=lfo.Box(-9 * state, 9 * state),
            initial_state=[1.3 * state, 0.4 * state],
            terminal_state=lfo.Box(np.full(2, -0.2 * state), np.full(2, 0.2 * state)),
        )

    relaxed = np.linspace(-0.8, 0.7, 20)[:, None]
    expected = None
    for state, control in ((1.0, 1.0), (1e6, 1.0), (1.0, 1e-6)):
        start = np.array([1.3, 0.4]) * state
        found = level_rounding(thruster(state, control)).sequence_near(control * relaxed, start, np.inf)
        expected = found if expected is None else expected
        assert found.tolist() == expected.tolist()


def test_problems_without_levels_have_no_rounding():
    assert level_rounding(lfo.library.pendulum_with_wall(horizon=4)) is None
