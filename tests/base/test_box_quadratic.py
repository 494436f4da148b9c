"""Minimisers of quadratics over boxes, by their first-order conditions: also where the Hessian is ill-conditioned."""

import numpy as np
import pytest

from lin_freq_ocp.base import box_minimiser


def problems(seed, count, k, condition):
    rng = np.random.default_rng(seed)
    turned, _ = np.linalg.qr(rng.standard_normal((count, k, k)))
    hessian = (turned * condition ** -rng.uniform(0, 1, (count, 1, k))) @ turned.swapaxes(1, 2)
    return rng.standard_normal((count, k)) / 3, hessian, *(rng.uniform(0, 1, (2, count, k)) * [[[-1]], [[1]]])


@pytest.mark.parametrize("k", [1, 2, 4])
@pytest.mark.parametrize("condition", [1e0, 1e4, 1e8])
def test_no_point_of_the_box_is_lower(k, condition):
    slope, hessian, low, high = problems(k, 300, k, condition)
    v = box_minimiser(slope, hessian, low, high)
    assert ((low <= v) & (v <= high)).all()
    gradient = slope + (hessian @ v[..., None])[..., 0]
    improvement = np.where(gradient > 0, gradient * (v - low), gradient * (v - high)).sum(axis=-1)
    assert improvement.max() < 1e-9


def test_boxes_side_by_side_are_broadcast_and_may_be_without_ends_or_curvature():
    hessian = np.array([[2.0, 0.0], [0.0, 0.0]])
    v = box_minimiser(np.array([[-2.0, 1.0], [4.0, 1.0]]), hessian, np.array([-1.0, 0.5]), np.array([np.inf, 3.0]))
    assert v.tolist() == [[1.0, 0.5], [-1.0, 0.5]]
