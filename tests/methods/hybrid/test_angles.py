"""The bound over boxes of angles: against sums of harmonics, against random trains, and what it does not know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.seeds import expensive, seeds
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.hybrid import AngleBound, AngleBoxes, Quarter

M = 0.9
ANY = Quarter(0.5, -2, 2, np.zeros(4), (), np.zeros(0), np.zeros(0), 1.0, 0.0)


def pattern(switches: int = 12, **changes) -> lfo.OptimalControlProblem:
    return replace(lfo.library.pulse_pattern(kind="opp", modulation=M, switches=switches), **changes)


def loose(switches: int) -> AngleBound:
    """Return the bound of a problem that every train satisfies."""
    free = lfo.Box([np.pi / 2, -1, 0, -M * M, -2, -2], [np.pi / 2, 1, 0, 4, 2, 2])
    problem = pattern(switches, terminal_state=free)
    return AngleBound(Quarter.of_problem(problem, problem.dynamics))


def loose_cost(steps: np.ndarray, angles: np.ndarray) -> float:
    """Return the cost of a train of any problem here."""
    return ANY.energy(steps, angles)[0] - M**2


def test_cost_and_amplitudes_are_those_of_the_fourier_series():
    angles = np.array([0.2, 0.7, 1.3])
    steps = np.array([0.5, 0.5, -0.5])
    k = np.arange(1, 20001, 2)
    b = 4 / (np.pi * k) * (steps[:, None] * np.cos(k * angles[:, None])).sum(0)
    problem = pattern(12)
    quarter = Quarter.of_problem(problem, problem.dynamics)
    cost, slope = quarter.energy(steps, angles)
    amplitudes, slopes = quarter.amplitudes(steps, angles)
    assert amplitudes == pytest.approx(b[:2], abs=1e-14)
    assert cost == pytest.approx(((b / k) ** 2).sum(), abs=1e-10)
    for i in range(3):
        near = [angles + sign * 1e-6 * np.eye(3)[i] for sign in (1, -1)]
        above, below = (quarter.energy(steps, at)[0] for at in near)
        up, down = (quarter.amplitudes(steps, at)[0] for at in near)
        assert slope[i] == pytest.approx((above - below) / 2e-6, abs=1e-8)
        assert slopes[:, i] == pytest.approx((up - down) / 2e-6, abs=1e-8)


@pytest.mark.parametrize("third", seeds([(-np.inf, 0.02), (-0.02, np.inf), (-np.inf, np.inf)]))
def test_amplitudes_may_have_no_limit(third):
    """No box is lost: the trains with fewer switches, and both limits, are no cheaper than the bound."""
    given = pattern(16)
    end = [
        np.append(part[:-1], last)
        for part, last in zip((given.terminal_state.lower, given.terminal_state.upper), third, strict=True)
    ]
    states = [
        np.append(part[:-1], sign * np.inf)
        for part, sign in zip((given.state_set.lower, given.state_set.upper), (-1, 1), strict=True)
    ]
    problem = replace(given, terminal_state=lfo.Box(*end), state_set=lfo.Box(*states))
    bound = AngleBound(Quarter.of_problem(problem, problem.dynamics))
    for _ in range(8):
        bound.halve(np.inf)
    assert bound.value <= lfo.solve(pattern(8)).cost
    trajectory = lfo.solve(replace(pattern(8), terminal_state=lfo.Box(*end), state_set=lfo.Box(*states))).trajectory
    assert pattern(8).value(trajectory.x, trajectory.u) <= lfo.solve(pattern(8)).cost + 1e-9


@pytest.mark.parametrize("seed", seeds(range(5)))
def test_no_train_of_a_box_is_cheaper_than_its_bound(seed):
    rng, bound = np.random.default_rng(seed), loose(12)
    count = 100
    steps = np.array([[0.5, 0.5, -0.5], [0.5, -0.5, 0.5]])[rng.integers(2, size=count)]
    centre = np.sort(rng.uniform(0.05, 1.5, (count, 3)), axis=1)
    radius = np.minimum(rng.uniform(0, 0.05, (count, 3)), 0.05)
    bound.boxes = AngleBoxes(steps, centre, radius, np.full(count, -np.inf))
    assert bound.halve(np.inf)
    boxes, count = bound.boxes, 2 * count
    assert len(boxes.bound) == count
    least = np.full(count, np.inf)
    for _ in range(50):
        inside = np.clip(boxes.centre + boxes.radius * rng.uniform(-1, 1, (count, 3)), 0, np.pi / 2)
        least = np.minimum(least, [loose_cost(s, a) for s, a in zip(boxes.steps, inside, strict=True)])
    assert (boxes.bound <= least).all()
    assert np.median(least - boxes.bound) < 0.2


@pytest.mark.parametrize("low", [0.9, 0.5, -1.0])
def test_no_bound_is_below_the_squares_of_the_amplitudes_that_are_asked_for(low):
    """The cost is (b_1^2 - M^2) + (b_3 / 3)^2 + ..; with d = 5 boxes are wide for long."""
    given = pattern(20).terminal_state
    lower, upper = given.lower.copy(), given.upper.copy()
    lower[4], lower[5], upper[5] = low, -2.0, -0.06
    problem = pattern(20, terminal_state=lfo.Box(lower, upper))
    bound, least = AngleBound(Quarter.of_problem(problem, problem.dynamics)), max(low, 0.0) ** 2 + 0.02**2 - M**2
    for _ in range(3):
        assert bound.value == pytest.approx(least, abs=1e-15)
        bound.halve(np.inf)


@expensive
def test_boxes_whose_turn_comes_after_the_end_stay_whole_and_every_train_remains_in_one():
    rng, bound = np.random.default_rng(0), loose(12)
    for _ in range(14):
        bound.boxes = bound.boxes.halved()
    with use_clock(Clock(1.0)):
        bound.halve(np.inf, end=1.0)
    boxes = bound.boxes
    assert np.ptp(np.log2(boxes.radius.prod(axis=1))) == pytest.approx(1.0)  # both halves, and whole ones
    for angles in np.sort(rng.uniform(0, np.pi / 2, (100, 3)), axis=1):
        inside = (np.abs(boxes.centre - angles) <= boxes.radius + 1e-12).all(axis=1)
        patterns = {tuple(row) for row in boxes.steps[inside]}
        assert len(patterns) == len({tuple(row) for row in boxes.steps})
        costs = [loose_cost(s, angles) for s in boxes.steps[inside]]
        assert (boxes.bound[inside] <= costs).all()


def test_orders_of_steps_that_do_not_fit_into_memory_are_refused():
    problem = pattern(4 * 40)
    with pytest.raises(UnsupportedError, match="more than 100,000 orders of 40 steps"):
        AngleBound(Quarter.of_problem(problem, problem.dynamics))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"cost": lfo.QuadraticCost(p=[0, 0, 0, 1.0, 0.1, 0])}, "a cost other"),
        ({"cost": lfo.QuadraticCost(R=1.0)}, "a cost other"),
        ({"initial_state": None}, "another start"),
        ({"terminal_state": None}, "another end"),
        ({"control_set": None}, "dwells that may be below zero"),
        ({"control_set": lfo.Box([0, -1], [2, 1]) & lfo.sets.Ball(3.0)}, "terms beyond boxes"),
    ],
)
def test_what_it_does_not_know_is_refused(change, words):
    problem = pattern(**change)
    with pytest.raises(UnsupportedError, match=words):
        AngleBound(Quarter.of_problem(problem, problem.dynamics))
