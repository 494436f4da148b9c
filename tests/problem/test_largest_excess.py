"""The price of the largest relative excess of several norms: value, conjugate, slopes and conic form."""

from __future__ import annotations

import cvxpy as cp
import numpy as np
import pytest

from helpers.seeds import seeds
from lin_freq_ocp.problem import LargestExcess


def sample(seed: int) -> tuple[LargestExcess, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    given = LargestExcess(rng.uniform(0.2, 3.0, 5), np.asarray(2.5))
    return given, rng.normal(size=(5, 2)) * 10.0 ** rng.uniform(-1, 1), rng.normal(size=(5, 2))


def value(given: LargestExcess, v: np.ndarray) -> float:
    return 2.5 * max(0.0, max(np.hypot(*row) / limit - 1 for row, limit in zip(v, given.limit, strict=True)))


@pytest.mark.parametrize("seed", seeds(range(8)))
def test_the_gap_is_that_of_fenchel_and_young(seed):
    given, v, direction = sample(seed)
    assert given.cost(v).sum() == pytest.approx(value(given, v), abs=1e-14)
    weights = given.subgradient(direction, 1.0)
    conjugate = (given.limit * np.hypot(*weights.T)).sum()
    assert conjugate <= 2.5 * (1 + 1e-12)
    expected = value(given, v) + conjugate - (weights * v).sum()
    assert given.gap(v, weights, 1.0).sum() == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert (given.gap(v, weights, 1.0) > -1e-12).all()
    worst = int(np.argmax(np.hypot(*v.T) / given.limit))
    best = np.zeros((5, 2))
    best[worst] = 2.5 / given.limit[worst] * v[worst] / np.hypot(*v[worst])
    if value(given, v) > 0:
        assert abs(given.gap(v, best, 1.0).sum()) < 1e-12 * (1 + value(given, v))
        assert given.gap(v, 0.999 * best, 1.0).sum() > 1e-4 * value(given, v)
    assert not given.subgradient(direction, 0.0).any()


@pytest.mark.parametrize("seed", seeds(range(8)))
def test_slopes_are_those_of_differences(seed):
    given, v, change = sample(seed)
    step = 1e-7
    expected = (value(given, v + step * change) - value(given, v)) / step
    assert given.slope(v, change, 1e-12) == pytest.approx(expected, rel=1e-4, abs=1e-4)
    far = (value(given, 1e8 * change) - value(given, 0 * change)) / 1e8
    assert given.unbounded(change) == pytest.approx((0.0, far), rel=1e-6)


def test_on_the_limit_only_a_rise_counts():
    given = LargestExcess(np.array([1.0, 2.0]), np.asarray(2.5))
    v = np.array([[1.0, 0.0], [0.0, 0.5]])
    assert given.slope(v, np.array([[1.0, 0.0], [0.0, 9.0]]), 1e-9) == pytest.approx(2.5)
    assert given.slope(v, np.array([[-1.0, 0.0], [0.0, 9.0]]), 1e-9) == 0.0
    assert given.slope(0 * v, v, 1e-9) == 0.0


@pytest.mark.parametrize("seed", seeds(range(4)))
def test_the_conic_form_has_the_same_minimum(seed):
    given, v, _ = sample(seed)
    form = given.conic(5, 2)
    s = cp.Variable(1)
    rows = (
        np.append(v.ravel(), 0.0)[form.entries] + form.slacks @ s - np.where(np.isfinite(form.lower), form.lower, 0.0)
    )
    cones = [cp.norm(rows[one.start + 1 : one.stop]) <= rows[one.start] for one in form.cones]
    program = cp.Problem(cp.Minimize(form.prices @ s), [*cones, rows[len(form.cones) * 3 :] >= 0])
    program.solve(solver="CLARABEL")
    assert program.value == pytest.approx(value(given, v), abs=1e-6)
    assert form.prices @ given.least_slacks(v) == pytest.approx(value(given, v), abs=1e-12)
