"""The bound on a lattice of angles, and the cells it leaves: against trains, a finer lattice, without a compiler."""

from __future__ import annotations

import numpy as np
import pytest
from flint import arb, ctx

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp.methods.hybrid import AngleLattice, AngleRange, Quarter, local_angles, local_prices

END = np.pi / 2


def random_quarter(rng: np.random.Generator) -> tuple[Quarter, np.ndarray, np.ndarray]:
    """Return limits that a random train of one to three steps meets, some of them without room, and that train."""
    count, highest, lowest = int(rng.integers(1, 4)), int(rng.integers(1, 3)), -int(rng.integers(0, 3))
    signs = [1.0]
    while len(signs) < count:
        level = sum(signs)
        signs.append(float(rng.choice([s for s in (1, -1) if lowest <= level + s <= highest])))
    dwells = rng.choice([0.0, 0.03, 0.2]) * np.ones(count + 1)
    dwells[[0, -1]] /= 2
    free = np.sort(rng.uniform(0, END - dwells.sum(), count))
    step, angles = float(rng.choice([0.5, 1.0])), free + np.cumsum(dwells[:-1])
    orders = tuple(rng.choice([1, 3, 5], size=int(rng.integers(1, 4)), replace=False).tolist())
    loose = Quarter(step, lowest, highest, dwells, orders, -np.ones(len(orders)), np.ones(len(orders)), 1.0, 0.0)
    steps = step * np.array(signs)
    values, _ = loose.amplitudes(steps, angles)
    low, high = (values + s * rng.choice([0.0, 0.01, np.inf], len(orders), p=[0.5, 0.4, 0.1]) for s in (-1, 1))
    return Quarter(step, lowest, highest, dwells, orders, low, high, 1.0, 0.0), steps, angles


def whole(quarter: Quarter) -> AngleRange:
    count = len(quarter.dwells) - 1
    return AngleRange(np.zeros(count), np.full(count, END), np.zeros(count, dtype=int))


def allowed(quarter: Quarter, r: np.ndarray) -> np.ndarray:
    """Return prices whose bound is finite."""
    lower, upper = np.where(np.isfinite(quarter.high), -1.0, 0.0), np.where(np.isfinite(quarter.low), 1.0, 0.0)
    return np.clip(r, lower, upper)


@pytest.mark.parametrize("seed", seeds(range(25)))
@pytest.mark.parametrize("share", [0.3, 1.1, np.inf])
def test_no_bound_is_above_a_train_and_no_cell_of_one_is_closed(seed, share):
    """Whatever the prices, and however narrow the tube; also of a part that holds the train."""
    rng = np.random.default_rng(seed)
    quarter, steps, angles = random_quarter(rng)
    near = local_angles(quarter, steps, angles)
    energy = quarter.energy(steps, angles)[0]
    cost, enough = min(energy, np.inf if near is None else near[1]), share * energy
    part = AngleRange(
        angles - rng.uniform(0, 0.3, len(steps)), angles + rng.uniform(0, 0.3, len(steps)), np.sign(steps)
    )
    lattice = AngleLattice(quarter, 150)
    first = np.clip(0.0, quarter.low, quarter.high) / np.array(quarter.orders)
    for r in (first, rng.normal(size=len(quarter.orders)), np.zeros(len(quarter.orders))):
        assert lattice.bound(allowed(quarter, r), whole(quarter), enough).bound <= cost
        for trains in (whole(quarter), part):
            point = lattice.bound(allowed(quarter, r), trains, enough)
            assert point.bound <= energy
            if share > 1:
                narrow = lattice.narrow(trains, point.open)
                assert narrow is not None
                assert ((narrow.low <= angles) & (angles <= narrow.high)).all()
                assert ((narrow.sign == 0) | (narrow.sign == np.sign(steps))).all()
                cells = np.floor(angles / lattice.h).astype(int).clip(0, lattice.count - 1)
                assert point.open[np.arange(len(steps)), (steps < 0).astype(int), cells].all()
    points = list(lattice.best(whole(quarter), first, np.inf))
    assert max(point.bound for point in points) <= cost
    assert max(point.bound for point in points) >= points[0].bound


def test_the_prices_of_the_best_optimum_leave_a_narrow_part_around_it():
    problem = lfo.library.pulse_pattern(kind="opp", modulation=0.7, switches=16)
    trajectory = lfo.solve(problem).trajectory
    quarter = Quarter.of_problem(problem, problem.dynamics)
    steps, angles = quarter.step * np.sign(np.diff(trajectory.x[:-1, 1])), trajectory.x[1:-1, 0]
    energy, lattice = quarter.energy(steps, angles)[0], AngleLattice(quarter, 1000)
    point = lattice.bound(local_prices(quarter, steps, angles), whole(quarter), energy)
    narrow = lattice.narrow(whole(quarter), point.open)
    assert energy - 2 * point.loss <= point.bound <= energy
    assert (narrow.sign == np.sign(steps)).all()
    assert (narrow.high - narrow.low).max() < 0.1
    again = lattice.bound(point.r, narrow, energy)  # in the band of the part, which is narrower than the tube
    assert point.bound <= again.bound <= energy
    assert lattice.narrow(narrow, np.zeros_like(again.open)) is None


def test_parts_are_halved_by_a_free_sign_then_by_the_widest_range():
    part = AngleRange(np.array([0.0, 0.5]), np.array([0.5, 1.5]), np.array([1, 0]))
    up, down = part.halves()
    assert (up.sign.tolist(), down.sign.tolist()) == ([1, 1], [1, -1])
    early, late = up.halves()
    assert early.high.tolist() == [0.5, 1.0]
    assert late.low.tolist() == [0.0, 1.0]
    assert up.is_near(np.array([0.5, 0.5]), np.array([0.6, 1.0]))
    assert not up.is_near(np.array([0.5, 0.5]), np.array([0.9, 1.0]))
    assert not up.is_near(np.array([0.5, -0.5]), np.array([0.2, 1.0]))


@pytest.mark.parametrize("seed", seeds(range(10)))
def test_a_lattice_less_its_loss_is_below_one_ten_times_as_fine(seed):
    """The finer one without its own loss: L_r of some train whose dwells are shorter by a step at most."""
    rng = np.random.default_rng(seed)
    quarter, _, _ = random_quarter(rng)
    r = allowed(quarter, rng.uniform(-1, 1, len(quarter.orders)))
    coarse, fine = AngleLattice(quarter, 40), AngleLattice(quarter, 400)
    point = fine.bound(r, whole(quarter))
    k, b = np.array(quarter.orders), quarter.amplitudes(point.steps, point.angles)[0]
    least = quarter.energy(point.steps, point.angles)[0] - 2 * r @ (b / k) + r @ r
    dwells = np.diff(np.concatenate([[0.0], point.angles, [END]]))
    if (dwells >= quarter.dwells - 1e-12).all():  # it is a train of the problem
        assert coarse.bound(r, whole(quarter)).bound <= least + quarter.shift(r)
    assert point.bound == pytest.approx(least + quarter.shift(r), abs=1e-3)
    assert point.bound <= least + quarter.shift(r)


@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
def test_an_angle_anywhere_in_its_cell_costs_no_less_than_the_bound_and_leaves_the_cell_open(share):
    """Of one step whose amplitudes are given: the nearest angles of the lattice cost what is lost, and one end more."""
    orders, h = tuple(range(1, 40, 2)), END / 40
    steps, angles = np.ones(1), np.array([(15 + share) * h])
    loose = Quarter(1.0, 0, 1, np.zeros(2), orders, -np.ones(20), np.ones(20), 1.0, 0.0)
    b = loose.amplitudes(steps, angles)[0]
    quarter = Quarter(1.0, 0, 1, np.zeros(2), orders, b, b, 1.0, 0.0)
    energy, lattice = quarter.energy(steps, angles)[0], AngleLattice(quarter, 40)
    assert lattice.h == h
    point = lattice.bound(b / np.array(orders), whole(quarter), energy * (1 + 1e-9))
    assert energy - 2 * point.loss <= point.bound <= energy
    assert point.open[0, 0, 15]


@pytest.mark.parametrize("seed", seeds(range(4)))
def test_without_a_compiler_the_recursion_is_the_same(seed, no_compiler):
    rng = np.random.default_rng(seed)
    quarter, _, _ = random_quarter(rng)
    r = allowed(quarter, rng.uniform(-1, 1, len(quarter.orders)))
    enough = AngleLattice(quarter, 100).bound(r, whole(quarter)).bound + 0.02
    expected = AngleLattice(quarter, 100).bound(r, whole(quarter), enough)
    with no_compiler("lattice.c could not be compiled"):
        found = AngleLattice(quarter, 100).bound(r, whole(quarter), enough)
    assert found.bound == pytest.approx(expected.bound, abs=1e-13)
    assert found.angles == pytest.approx(expected.angles)
    assert (found.steps == expected.steps).all()
    assert (found.open == expected.open).all()


@pytest.mark.parametrize(("dwell", "lost"), [(0.01 * np.pi, 0.021), (0.05, 0.023), (0.02, 0.51), (0.1, 0.018)])
def test_a_lattice_is_one_that_keeps_nearly_all_of_each_dwell(dwell, lost):
    """In parts of a step of the lattice, at both ends too; 1000 angles would lose a whole step of the first."""
    dwells = np.array([dwell / 2, dwell, dwell, dwell / 2])
    lattice = AngleLattice(Quarter(1.0, 0, 1, dwells, (1,), -np.ones(1), np.ones(1), 1.0, 0.0), 1000)
    steps = dwells / lattice.h
    assert 1000 <= lattice.count < 1100
    assert (steps - np.floor(steps)).max() <= lost


def exact_tracking(quarter: Quarter, r: np.ndarray, steps: np.ndarray, angles: np.ndarray, count: int) -> arb:
    """Return L_r of a train of the lattice in balls of 200 bits, by the sums of quarter.py."""
    with ctx.workprec(200):
        a = [arb.pi() / 2 * arb(round(one * count / END)) / count for one in angles]
        c, s = [arb.pi() / 2 - one for one in a], [arb(one) for one in steps]
        pairs = [(i, j, *sorted((c[i], c[j]), key=float)) for i in range(len(c)) for j in range(len(c))]
        kernel = [s[i] * s[j] * (x * y * arb.pi() / 2 - x**3 / 6 - x * y**2 / 2) for i, j, x, y in pairs]
        total = 4 / arb.pi() * sum(kernel, arb(0))
        for k, price in zip(quarter.orders, r, strict=True):
            b = 4 / arb.pi() / k * sum((si * (k * ai).cos() for si, ai in zip(s, a, strict=True)), arb(0))
            total += arb(price) ** 2 - 2 * arb(price) * b / k
        return total


@pytest.mark.parametrize("count", [1000, 64000])
def test_rounding_of_the_recursion_is_less_than_what_is_subtracted(count):
    """Of the least L_r: 1e-13, and 2^-52 for each of its sums, which leaves the bound below the exact one and close."""
    rng = np.random.default_rng(count)
    for _ in range(5):
        steps, orders = np.tile([1.0, -1.0], 4), (1, 3)
        angles, r = np.sort(rng.uniform(0.1, 1.5, 8)), rng.normal(size=2)
        quarter = Quarter(1.0, -1, 1, np.zeros(9), orders, -np.ones(2), np.ones(2), 1.0, 0.0)
        lattice = AngleLattice(quarter, count)
        part = AngleRange(angles - 1e-5, angles + 1e-5, np.sign(steps).astype(int))
        point = lattice.bound(r, part)
        exact = exact_tracking(quarter, r, point.steps, point.angles, lattice.count)
        lost = float(exact - arb(point.bound - quarter.shift(r) + point.loss))
        assert 0 < lost < 2 * (1e-13 + lattice.count * 2.0**-52 * float(exact))


def test_parts_without_a_train_have_an_infinite_bound():
    quarter, steps, _ = random_quarter(np.random.default_rng(1))
    count = len(steps)
    late = AngleRange(np.full(count, 1.2), np.full(count, 1.1), np.zeros(count, dtype=int))
    assert AngleLattice(quarter, 100).bound(np.zeros(len(quarter.orders)), late).bound == np.inf
