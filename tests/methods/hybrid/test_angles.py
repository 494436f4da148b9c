"""The proof near an optimum, and parts without a train: against sums of harmonics, random trains, and known limits."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.hybrid import Quarter, bound_near, local_angles, nearest_train

END = np.pi / 2


def pattern(switches: int = 12, **changes) -> lfo.OptimalControlProblem:
    return replace(lfo.library.pulse_pattern(kind="opp", modulation=0.9, switches=switches), **changes)


def random_limits(rng: np.random.Generator) -> tuple[Quarter, np.ndarray, np.ndarray]:
    """Return limits that a random train of two to four steps meets, one amplitude fixed, and that train."""
    count = int(rng.integers(2, 5))
    steps = 0.5 * np.array([1.0, *rng.choice([1, -1], count - 1)])
    dwells = rng.choice([0.0, 0.03]) * np.ones(count + 1)
    angles = np.sort(rng.uniform(0, END - dwells.sum(), count)) + np.cumsum(dwells[:-1])
    orders = (1, 3, 5)[: int(rng.integers(1, 3))]
    loose = Quarter(0.5, -4, 4, dwells, orders, -np.ones(len(orders)), np.ones(len(orders)), 1.0, 0.0)
    values, _ = loose.amplitudes(steps, angles)
    wide = np.where(np.arange(len(orders)) == 0, 0.0, rng.choice([0.0, 0.01]))
    return replace(loose, low=values - wide, high=values + wide), steps, angles


def feasible_near(quarter: Quarter, steps: np.ndarray, angles: np.ndarray) -> np.ndarray | None:
    """Return angles that meet the limits, from steps of least norm; None if these fail."""
    for _ in range(8):
        values, slopes = quarter.amplitudes(steps, angles)
        over = values - np.clip(values, quarter.low, quarter.high)
        angles = angles - np.linalg.lstsq(slopes, over, rcond=None)[0]
    values, _ = quarter.amplitudes(steps, angles)
    dwells = np.diff(np.concatenate([[0.0], angles, [END]]))
    met = (values >= quarter.low - 1e-12).all() and (values <= quarter.high + 1e-12).all()
    return angles if met and (dwells >= quarter.dwells).all() else None


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


def optima(quarter: Quarter, steps: np.ndarray, rng: np.random.Generator) -> list[tuple[np.ndarray, float]]:
    """Return local optima from random angles, the cheapest first."""
    room = END - quarter.dwells.sum()
    starts = [np.sort(rng.uniform(0, room, len(steps))) + np.cumsum(quarter.dwells[:-1]) for _ in range(6)]
    found = [local_angles(quarter, steps, start) for start in starts]
    return sorted((one for one in found if one is not None), key=lambda one: one[1])


@pytest.mark.parametrize("first", seeds(range(0, 30, 10)))
def test_no_train_near_an_optimum_is_below_its_bound(first):
    """Boxes around it of all sizes up to the largest that is proven, and boxes that hold a better optimum."""
    proven = 0
    for seed in range(first, first + 10):
        rng = np.random.default_rng(seed)
        quarter, steps, _ = random_limits(rng)
        found = optima(quarter, steps, rng)
        for c, _ in found:
            for better, energy in found:
                low, high = np.minimum(c, better) - 1e-3, np.maximum(c, better) + 1e-3
                assert bound_near(quarter, steps, c, low, high) <= energy + 1e-12
        for radius in (0.4, 0.2, 0.1, 0.05, 0.02) if found else ():
            c = found[0][0]
            low, high = c - radius * rng.uniform(0.2, 1, len(c)), c + radius * rng.uniform(0.2, 1, len(c))
            bound = bound_near(quarter, steps, c, low, high)
            proven += bound > -np.inf
            for _ in range(20 if bound > -np.inf else 0):
                train = feasible_near(quarter, steps, np.sort(rng.uniform(low, high)))
                if train is not None and (train >= low).all() and (train <= high).all():
                    assert quarter.energy(steps, train)[0] >= bound
    assert proven >= 5


@pytest.mark.parametrize("first", seeds(range(0, 3000, 500)))
def test_no_corner_of_a_box_around_any_train_is_below_its_bound(first):
    """Of trains that are no optimum, with one-sided limits that they meet: the slope is paid for, at each corner."""
    proven, met = 0, 0
    for seed in range(first, first + 500):
        rng = np.random.default_rng(seed)
        count, orders = int(rng.integers(1, 4)), ((), (1,), (3,), (1, 5))[int(rng.integers(4))]
        steps, c = 0.5 * rng.choice([1, -1], count), np.sort(rng.uniform(0, END, count))
        dwells = rng.choice([0.0, 1.0], count + 1) * np.diff(np.concatenate([[0.0], c, [END]]))
        loose = Quarter(0.5, -3, 3, dwells, orders, np.full(len(orders), -np.inf), np.full(len(orders), np.inf), 1, 0.0)
        values, side = loose.amplitudes(steps, c)[0], rng.choice([-1, 1], len(orders))
        low, high = np.where(side < 0, values, -np.inf), np.where(side > 0, values, np.inf)
        quarter, radius = replace(loose, low=low, high=high), 10 ** rng.uniform(-2, -0.2)
        low, high = np.maximum(c - radius * rng.random(count), 0.0), np.minimum(c + radius * rng.random(count), END)
        bound = bound_near(quarter, steps, c, low, high)
        proven += bound > -np.inf
        trains = [*product(*zip(low, high, strict=True)), *rng.uniform(low, high, (40, count))]
        for train in map(np.array, trains if bound > -np.inf else []):
            values = quarter.amplitudes(steps, train)[0]
            ordered = (np.diff(np.concatenate([[0.0], train, [END]])) >= dwells - 1e-12).all()
            if ordered and (values >= quarter.low).all() and (values <= quarter.high).all():
                met += 1
                assert quarter.energy(steps, train)[0] >= bound
    assert proven >= 50
    assert met >= 500


def test_no_bound_is_given_where_the_energy_or_the_amplitudes_bend_too_much():
    """E of one step is convex from pi/4 on; d/3 of a box reaches there. An amplitude moves by v, its second order."""
    free = Quarter(0.5, -2, 2, np.zeros(2), (), np.zeros(0), np.zeros(0), 1.0, 0.0)
    steps, c = np.array([0.5]), np.array([1.0])
    reached = 3 * (END / 2 - c) + c  # where c + d/3 is pi/4
    assert bound_near(free, steps, c, reached + 1e-3, c) > -np.inf
    assert bound_near(free, steps, c, reached - 1e-3, c) == -np.inf
    loose, c = replace(free, orders=(3,)), np.array([0.13])
    (b, _) = loose.amplitudes(steps, c)
    fixed = replace(loose, low=b, high=b)
    assert bound_near(fixed, steps, c, c - 0.1, c + 0.1) == pytest.approx(fixed.energy(steps, c)[0], rel=1e-12)
    assert bound_near(fixed, steps, c, c - 0.2, c + 0.2) == -np.inf


@pytest.mark.parametrize("shift", [1e-3, 1e-2, 0.1])
@pytest.mark.parametrize("c", [1.1, 1.4])
def test_where_c_is_no_optimum_the_bound_pays_for_the_slope(c, shift):
    """Without limits, the energy of one step falls with its angle, and is convex after pi/4."""
    quarter, steps = Quarter(0.5, -2, 2, np.zeros(2), (), np.zeros(0), np.zeros(0), 1.0, 0.0), np.array([0.5])
    bound = bound_near(quarter, steps, np.array([c]), np.array([c - shift]), np.array([c + shift]))
    least = quarter.energy(steps, np.array([c + shift]))[0]
    assert least - 4 * shift**2 < bound <= least < quarter.energy(steps, np.array([c]))[0]


@pytest.mark.parametrize(("modulation", "switches"), [(0.9, 8), (1.1, 16), (0.7, 32)])
def test_the_bound_near_an_optimum_is_its_cost(modulation, switches):
    """The box may lie on one side of it; the optima are at a vertex of the limits, at least dwells, of eight angles."""
    dwell = 0.01 * np.pi
    problem = lfo.library.pulse_pattern("opp", modulation, switches, least_dwell=dwell, unipolar=True, exactly=True)
    trajectory = lfo.solve(problem).trajectory
    quarter = Quarter.of_problem(problem, problem.dynamics)
    steps = quarter.step * np.sign(np.diff(trajectory.x[:-1, 1]))
    near = local_angles(quarter, steps, trajectory.x[1:-1, 0])
    assert near is not None
    energy = quarter.energy(steps, near[0])[0]
    for low, high in ((-0.004, 0.004), (0.001, 0.003)):
        assert bound_near(quarter, steps, near[0], near[0] + low, near[0] + high) == pytest.approx(energy, abs=8e-11)
    moved = near[0] + np.array([3e-4, *np.zeros(len(steps) - 1)])  # no optimum: its slope costs as much as it may
    bound = bound_near(quarter, steps, moved, moved - 0.004, moved + 0.004)
    assert bound <= energy


@pytest.mark.parametrize("first", seeds(range(0, 50, 10)))
def test_a_part_with_a_train_is_never_excluded(first):
    for seed in range(first, first + 10):
        rng = np.random.default_rng(seed)
        quarter, steps, angles = random_limits(rng)
        sign = np.sign(steps).astype(int) * (rng.random(len(steps)) < 0.5)
        low, high = angles - rng.choice([0.0, 1e-3, 0.3]), angles + rng.choice([0.0, 1e-3, 0.3])
        found = nearest_train(quarter, low, high, sign)
        assert found.excluded_by is None
        values, _ = quarter.amplitudes(found.steps, found.angles)
        assert found.missed == pytest.approx(max(0.0, (quarter.low - values).max(), (values - quarter.high).max()))
        assert ((sign == 0) | (sign == np.sign(found[0]))).all()


def test_sums_lose_no_train_between_angles_of_their_lattice():
    """One train alone has the least b_3: pi/3 is no multiple of the step. Another has the least dwells."""
    least = np.array([-0.5 * 4 / (3 * np.pi)])
    quarter = Quarter(0.5, -2, 2, np.zeros(2), (3,), least, least, 1.0, 0.0)
    assert nearest_train(quarter, np.array([0.9]), np.array([1.2]), np.array([1])).excluded_by is None
    angles = np.array([0.3, 0.33, 0.36])
    quarter = Quarter(0.5, -2, 2, np.array([0.0, 0.03, 0.03, 0.0]), (), np.zeros(0), np.zeros(0), 1.0, 0.0)
    assert nearest_train(quarter, angles, angles, np.array([1, -1, 1])).excluded_by is None
    assert nearest_train(quarter, angles, angles - [0, 0, 0.01], np.array([1, -1, 1])).excluded_by is not None


@pytest.mark.parametrize("first", seeds(range(0, 50, 10)))
def test_a_part_whose_amplitudes_miss_their_limits_is_excluded(first):
    """Limits just outside of the largest sum of all trains, by ten times what the lattice loses."""
    for seed in range(first, first + 10):
        rng = np.random.default_rng(seed)
        quarter, steps, angles = random_limits(rng)
        radius, sign = 0.01, np.sign(steps).astype(int)
        low, high = np.maximum(angles - radius, 0.0), np.minimum(angles + radius, END)
        values, slopes = quarter.amplitudes(steps, angles)
        k = np.array(quarter.orders)
        reach = np.abs(slopes).sum(axis=1) * (radius + END / 4000) + 2 * len(steps) * k * radius**2 + 1e-4
        outside = replace(quarter, low=values + reach, high=values + reach + 0.1)
        assert nearest_train(outside, low, high, sign).excluded_by is not None
        assert nearest_train(quarter, low, high, sign).excluded_by is None


def test_dwells_narrow_ranges_of_angles():
    quarter = Quarter(0.5, -2, 2, np.array([0.1, 0.2, 0.3, 0.4]), (), np.zeros(0), np.zeros(0), 1.0, 0.0)
    low, high = quarter.apart(np.array([0.0, 0.5, 0.0]), np.array([9.0, 9.0, 0.9]))
    assert low == pytest.approx([0.1, 0.5, 0.8])
    assert high == pytest.approx([0.4, 0.6, 0.9])


@pytest.mark.parametrize("low", [0.9, 0.5, -1.0])
def test_the_cost_is_not_below_the_squares_of_the_amplitudes_that_are_asked_for(low):
    """The cost is (b_1^2 - M^2) + (b_3 / 3)^2 + .."""
    given = pattern(20).terminal_state
    lower, upper = given.lower.copy(), given.upper.copy()
    lower[4], lower[5], upper[5] = low, -2.0, -0.06
    problem = pattern(20, terminal_state=lfo.Box(lower, upper))
    quarter = Quarter.of_problem(problem, problem.dynamics)
    assert quarter.least_cost == pytest.approx(max(low, 0.0) ** 2 + 0.02**2 - 0.81, abs=1e-15)


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
        Quarter.of_problem(problem, problem.dynamics)
