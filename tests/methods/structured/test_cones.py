"""Orthants and second-order cones: scalings, products, steps to the boundary."""

import numpy as np
import pytest

from lin_freq_ocp.methods.structured.cones import Cone

SIZES = (3, 2)


def cone_and_points(seed=0, near=0.0):
    """A cone of 3 orthant entries and two second-order cones in 4 stages, some absent, with two interior points."""
    rng = np.random.default_rng(seed)
    present = np.ones((4, 3 + sum(SIZES)), dtype=bool)
    present[0, 1] = False
    present[1, 3:6] = False
    cone = Cone(present, SIZES)
    points = []
    for _ in range(2):
        v = rng.uniform(0.1, 2.0, present.shape)
        for block in cone.blocks:
            tail = rng.standard_normal((4, block.stop - block.start - 1))
            v[:, block.start + 1 : block.stop] = tail
            v[:, block.start] = np.linalg.norm(tail, axis=1) * (1 + near + 10.0 ** rng.uniform(-6, 1, 4))
        points.append(v * present)
    return cone, *points


def test_the_scaling_maps_both_points_to_the_same():
    cone, s, z = cone_and_points()
    cone.scale(s, z)
    np.testing.assert_allclose(cone.scaled(s, -1), cone.lam, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(cone.scaled(cone.scaled(z, 1), 1), s, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("power", [1, 2])
def test_powers_invert_each_other(power):
    cone, s, z = cone_and_points(1)
    cone.scale(s, z)
    np.testing.assert_allclose(cone.scaled(cone.scaled(s, power), -power), s, rtol=1e-8, atol=1e-10)


def test_the_quotient_inverts_the_product():
    cone, s, z = cone_and_points(2)
    cone.scale(s, z)
    np.testing.assert_allclose(cone.product(cone.lam, cone.quotient(s)), s, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(cone.product(cone.identity, s), s)


def test_squares_of_blocks_are_those_of_the_scaling():
    cone, s, z = cone_and_points(3)
    cone.scale(s, z)
    for i, block in enumerate(cone.blocks):
        expected = cone.scaled(z, 2)[:, block]
        found = np.einsum("nij,nj->ni", cone.block_squares(i), z[:, block])
        inside = cone.present[:, block.start]
        np.testing.assert_allclose(found[inside], expected[inside], rtol=1e-9)


@pytest.mark.parametrize("offset", [-1e3, 0.0, 1e3])
def test_spectral_values_come_between_the_limits(offset):
    cone, s, _ = cone_and_points(8)
    low, high = 1.0, 5.0
    v = s + offset * cone.identity
    change = cone.clip_change(v, low, high)
    assert not change[~cone.present].any()
    alone = v[:, cone.orthant][cone.present[:, cone.orthant]]
    moved = (v + change)[:, cone.orthant][cone.present[:, cone.orthant]]
    assert np.allclose(moved, np.maximum(np.clip(alone, low, high), alone - high))
    for block in cone.blocks:
        inside = cone.present[:, block.start]
        for sign in (1, -1):
            before, after = (
                w[inside, block.start] + sign * np.linalg.norm(w[inside, block][:, 1:], axis=1) for w in (v, v + change)
            )
            expected = np.maximum(np.clip(before, low, high), before - high)
            assert np.allclose(after, expected, rtol=0, atol=1e-9 * np.abs(v).max())


def test_the_longest_step_ends_on_the_boundary():
    cone, s, z = cone_and_points(4)
    cone.scale(s, z)
    rng = np.random.default_rng(5)
    ds, dz = (rng.standard_normal(s.shape) * cone.present for _ in range(2))
    for point, step, scaled in ((s, ds, cone.scaled(ds, -1)), (z, dz, cone.scaled(dz, 1))):
        length = cone.longest(scaled)
        assert 0 < length < np.inf
        assert abs(cone.margin(point + length * step)) < 1e-8
        assert cone.margin(point + 0.99 * length * step) > 0


def test_a_direction_within_the_cone_has_no_end():
    cone, s, z = cone_and_points(6)
    cone.scale(s, z)
    assert cone.longest(cone.scaled(s, -1)) == np.inf


def test_absent_rows_stay_zero_and_count_for_nothing():
    cone, s, z = cone_and_points(7)
    cone.scale(s, z)
    for found in (cone.scaled(s, -1), cone.scaled(z, 2), cone.quotient(s), cone.lam):
        assert not found[~cone.present].any()
    assert cone.degree == cone.identity.sum() == 4 * 3 - 1 + 4 * 2 - 1
