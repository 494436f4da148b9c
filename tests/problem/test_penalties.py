"""Penalties against plain formulas, and their multipliers against the Fenchel-Young inequality."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.seeds import examples
from lin_freq_ocp.problem import HalfSpaces, NormBall, Penalty, StandardCone

GROUPS, DIM = 7, 4
SEEDS = st.integers(0, 2**32 - 1)
quick = settings(max_examples=examples(60), deadline=None, derandomize=True)


def limits(rng: np.random.Generator, *shape: int) -> np.ndarray:
    """Return limits of which some are infinite."""
    return np.where(rng.random(shape) < 0.2, np.inf, rng.uniform(0.2, 2.0, shape))


def below(rng: np.random.Generator, soft: bool) -> HalfSpaces:
    weight = rng.uniform(0.1, 2.0, (GROUPS, 1)) if soft else np.asarray(np.inf)
    return HalfSpaces(limits(rng, DIM) - 1 if soft else limits(rng, GROUPS, DIM), weight)


def norm(order: float):
    def make(rng: np.random.Generator, soft: bool) -> NormBall:
        radius = np.zeros(()) if rng.random() < 0.3 else limits(rng, GROUPS)
        return NormBall(order, radius, rng.uniform(0.1, 2.0, GROUPS) if soft else np.asarray(np.inf))

    make.__name__ = f"norm {order}"
    return make


def cone(rng: np.random.Generator, soft: bool) -> StandardCone:
    return StandardCone()


KINDS = [
    (below, False),
    (below, True),
    (cone, False),
    *((norm(p), soft) for p in (1, 2, np.inf) for soft in (False, True)),
]
named = pytest.mark.parametrize(("make", "soft"), KINDS, ids=lambda value: getattr(value, "__name__", str(value)))


def inside(penalty: Penalty, v: np.ndarray) -> np.ndarray:
    """Return values as near zero as it takes for the hard part to hold."""
    if isinstance(penalty, StandardCone):
        v = v.copy()
        v[:, 0] = np.linalg.norm(v[:, 1:], axis=1) * (1 + np.abs(v[:, 0]))
        return v
    if isinstance(penalty, HalfSpaces):
        return np.minimum(v, np.where(np.isinf(penalty.weight), penalty.limit, np.inf))
    size = np.linalg.norm(v, penalty.order, axis=1)
    allowed = np.where(np.isinf(penalty.weight), penalty.radius, np.inf)
    return v * np.minimum(1.0, allowed / size)[:, None]


def h(penalty: Penalty, v: np.ndarray) -> np.ndarray:
    """Return the penalty of each group by its definition: infinity where a hard one does not hold."""
    if isinstance(penalty, StandardCone):
        return np.where(v[:, 0] >= np.linalg.norm(v[:, 1:], axis=1) * (1 - 1e-12), 0.0, np.inf)
    if isinstance(penalty, HalfSpaces):
        excess = np.maximum(v - penalty.limit, 0.0)
    else:
        excess = np.maximum(np.linalg.norm(v, penalty.order, axis=1) - penalty.radius, 0.0)[:, None]
    weight = penalty.weight if isinstance(penalty, HalfSpaces) else np.reshape(penalty.weight, (-1, 1))
    return np.where(excess > 1e-12, np.where(excess > 1e-12, excess, 1.0) * weight, 0.0).sum(1)


@named
@given(seed=SEEDS)
@quick
def test_cost_and_violation_are_those_of_the_definition(make, soft, seed):
    rng = np.random.default_rng(seed)
    penalty, v = make(rng, soft), 2 * rng.standard_normal((GROUPS, DIM))
    if soft:
        np.testing.assert_allclose(penalty.cost(v), h(penalty, v), atol=1e-12)
        assert not penalty.violation(v).any()
        return
    assert not penalty.cost(v).any()
    assert ((penalty.violation(v) > 0).any(1) == np.isinf(h(penalty, v))).all()
    assert penalty.violation(inside(penalty, v)).max() <= 1e-12


@named
@given(seed=SEEDS, eta_C=st.sampled_from([0.0, 1.0]))
@quick
def test_the_subgradient_of_a_subgradient_is_itself(make, soft, seed, eta_C):
    rng = np.random.default_rng(seed)
    penalty = make(rng, soft)
    fitting = penalty.subgradient(3 * rng.standard_normal((GROUPS, DIM)), eta_C)
    np.testing.assert_allclose(penalty.subgradient(fitting, eta_C), fitting, rtol=1e-14, atol=1e-15)
    if soft and eta_C == 0:
        assert not fitting.any()


@named
@given(seed=SEEDS, eta_C=st.sampled_from([0.0, 1.0]))
@quick
def test_the_gap_is_that_of_fenchel_and_young(make, soft, seed, eta_C):
    """h(v) + h*(lambda) - <lambda, v> is never negative, and bounds what any other point gains."""
    rng = np.random.default_rng(seed)
    penalty = make(rng, soft)
    multipliers = penalty.subgradient(2 * rng.standard_normal((GROUPS, DIM)), eta_C)
    v, w = (inside(penalty, scale * rng.standard_normal((GROUPS, DIM))) for scale in (2.0, rng.choice([0.1, 1, 10])))
    gap = penalty.gap(v, multipliers, eta_C).sum(1)
    assert (penalty.gap(v, multipliers, eta_C) >= -1e-12).all()
    gained = eta_C * (penalty.cost(v) - penalty.cost(w)) + (multipliers * (w - v)).sum(1)
    assert (gained <= gap + 1e-10).all()


@pytest.mark.parametrize("make", [below, norm(1), norm(2), norm(np.inf)], ids=["below", "1", "2", "inf"])
@given(seed=SEEDS)
@quick
def test_the_gap_of_the_gradient_is_zero(make, seed):
    rng = np.random.default_rng(seed)
    penalty, v, step = make(rng, True), 2 * rng.standard_normal((GROUPS, DIM)), 1e-6
    changes = np.array([penalty.cost(v + step * e) - penalty.cost(v - step * e) for e in np.eye(DIM)])
    gradient = changes.T / (2 * step)
    np.testing.assert_allclose(penalty.gap(v, gradient, 1.0), 0.0, atol=1e-7)
    np.testing.assert_allclose(penalty.subgradient(gradient, 1.0), gradient, atol=1e-7)


def normals(penalty: Penalty, v: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return points on the border of a hard penalty, and a normal of each."""
    size = rng.uniform(0.1, 3.0, GROUPS)[:, None]
    if isinstance(penalty, StandardCone):
        v[:, 0] = np.linalg.norm(v[:, 1:], axis=1)
        return v, size * np.column_stack([-v[:, 0], v[:, 1:]])
    if isinstance(penalty, HalfSpaces):
        active = np.isfinite(penalty.limit) & (rng.random(v.shape) < 0.5)
        return np.where(active, penalty.limit, np.minimum(v, penalty.limit)), np.where(active, size, 0.0)
    length = np.linalg.norm(v, penalty.order, axis=1)
    radius = np.broadcast_to(penalty.radius, GROUPS)
    v = v * np.where(np.isfinite(radius), radius / length, 1.0)[:, None]
    if penalty.order == 1:
        normal = np.sign(v)
    elif penalty.order == 2:
        normal = v.copy()
    else:
        normal = np.where(np.abs(v) == np.abs(v).max(1, keepdims=True), np.sign(v), 0.0)
    return v, size * np.where(np.isfinite(radius)[:, None], normal, 0.0)


@pytest.mark.parametrize("make", [below, cone, norm(1), norm(2), norm(np.inf)], ids=["below", "cone", "1", "2", "inf"])
@given(seed=SEEDS)
@quick
def test_the_gap_of_a_normal_is_zero_and_that_of_its_opposite_is_not(make, seed):
    rng = np.random.default_rng(seed)
    penalty = make(rng, False)
    v, normal = normals(penalty, rng.standard_normal((GROUPS, DIM)), rng)
    np.testing.assert_allclose(penalty.violation(v), 0.0, atol=1e-12)
    np.testing.assert_allclose(penalty.subgradient(normal, 1.0), normal, atol=1e-12)
    np.testing.assert_allclose(penalty.gap(v, normal, 1.0), 0.0, atol=1e-11)
    opposite = penalty.subgradient(-normal, 1.0)
    wrong = (np.abs(normal).max(1) > 0) & (np.abs(v).max(1) > 1e-9)
    refused = np.maximum(penalty.gap(v, opposite, 1.0).max(1), np.abs(opposite + normal).max(1))
    assert (refused[wrong] > 1e-6).all()


def test_what_lies_across_a_norm_is_gap_to_second_order():
    ball, v, angle = NormBall(2, np.ones(1), np.asarray(np.inf)), np.array([[1.0, 0.0]]), 1e-4
    turned = np.array([[np.cos(angle), np.sin(angle)]])
    assert ball.gap(v, turned, 1.0)[0, 0] == pytest.approx(angle**2 / 2, rel=1e-6)
