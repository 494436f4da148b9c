"""The suite of convex functions h: value, slopes, conjugate, conic form and limits of every class."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.instances import classes_of
from helpers.instances.penalties import DIM, HARD_KINDS, KINDS, OF_ONE_GROUP, SOFT_KINDS, h, inside, normal
from helpers.seeds import examples, seeds
from lin_freq_ocp.problem import HARD, ConicForm, NormBall, Penalty, Within
from lin_freq_ocp.program import Claim, Program, backend

each_kind = pytest.mark.parametrize("name", KINDS)
random_data = given(seed=st.integers(0, 2**32 - 1))
both_multipliers = given(seed=st.integers(0, 2**32 - 1), eta_C=st.sampled_from([0.0, 1.0]))
quick = settings(max_examples=examples(60), deadline=None, derandomize=True)


def sample(name: str, seed: int) -> tuple[Penalty, np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return KINDS[name].make(rng), 2 * rng.standard_normal(KINDS[name].shape), rng


def test_every_class_of_the_package_is_here():
    assert classes_of(Penalty) <= {type(kind.make(np.random.default_rng(0))) for kind in KINDS.values()}


@each_kind
@random_data
@quick
def test_values_and_slopes_are_those_of_the_definition(name, seed):
    """Slopes between kinks are those of differences; at infinity the limits no longer matter."""
    penalty, v, rng = sample(name, seed)
    change, step, far = rng.standard_normal(v.shape), 1e-7, 1e8
    assert penalty.hard == KINDS[name].hard
    assert penalty.cost(v).sum() == pytest.approx(0.0 if penalty.hard else h(penalty, v), abs=1e-12)
    assert (penalty.violation(v) > 0).any() == np.isinf(h(penalty, v))
    assert penalty.violation(inside(penalty, v)).max() <= 1e-12
    rise = (penalty.cost(v + step * change).sum() - penalty.cost(v).sum()) / step
    assert penalty.slope(v, change, 0.0) == pytest.approx(rise, rel=1e-4, abs=1e-4)
    limited = np.isfinite(penalty.excess(v))
    rises = (penalty.excess(v + step * change)[limited] - penalty.excess(v)[limited]) / step
    slopes = np.broadcast_to(penalty.excess_slope(v, change, 0.0), limited.shape)
    np.testing.assert_allclose(slopes[limited], rises, atol=1e-4)
    violations, cost = penalty.unbounded(change)
    assert cost == pytest.approx(penalty.cost(far * change).sum() / far, rel=1e-6, abs=1e-6)
    np.testing.assert_allclose(violations, penalty.violation(far * change) / far, rtol=1e-6, atol=1e-6)
    if penalty.takes_batches:
        several = np.stack([v, change])
        for method in (penalty.cost, penalty.violation):
            np.testing.assert_allclose(method(several), [method(v), method(change)], atol=1e-14)


@each_kind
@both_multipliers
@quick
def test_the_gap_is_that_of_fenchel_and_young(name, seed, eta_C):
    """h(v) + h*(lambda) - <lambda, v> is never negative, and bounds what any other point gains."""
    penalty, v, rng = sample(name, seed)
    multipliers = penalty.subgradient(2 * rng.standard_normal(v.shape), eta_C)
    np.testing.assert_allclose(penalty.subgradient(multipliers, eta_C), multipliers, rtol=1e-14, atol=1e-15)
    assert eta_C or penalty.hard or not multipliers.any()
    v, w = (inside(penalty, scale * rng.standard_normal(v.shape)) for scale in (2.0, rng.choice([0.1, 1, 10])))
    gap = penalty.gap(v, multipliers, eta_C)
    assert (gap >= -1e-12).all()
    gain = eta_C * (penalty.cost(v).sum() - penalty.cost(w).sum()) + (multipliers * (w - v)).sum()
    assert gain <= gap.sum() + 1e-10


@pytest.mark.parametrize("name", SOFT_KINDS)
@random_data
@quick
def test_the_gap_of_the_gradient_is_zero_and_that_of_less_is_not(name, seed):
    penalty, v, _ = sample(name, seed)
    step, gradient = 1e-6, np.zeros(v.shape)
    for index in np.ndindex(*v.shape):
        change = np.zeros(v.shape)
        change[index] = step
        gradient[index] = (penalty.cost(v + change).sum() - penalty.cost(v - change).sum()) / (2 * step)
    assert penalty.gap(v, gradient, 1.0).sum() == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(penalty.subgradient(gradient, 1.0), gradient, atol=1e-6)
    if penalty.cost(v).sum() > 0.1:
        assert penalty.gap(v, 0.9 * gradient, 1.0).sum() > 1e-3 * penalty.cost(v).sum()


@pytest.mark.parametrize("name", HARD_KINDS)
@random_data
@quick
def test_the_gap_of_a_normal_is_zero_and_that_of_its_opposite_is_not(name, seed):
    penalty, v, rng = sample(name, seed)
    v, outward = normal(penalty, v, rng)
    np.testing.assert_allclose(penalty.violation(v), 0.0, atol=1e-12)
    np.testing.assert_allclose(penalty.subgradient(outward, 1.0), outward, atol=1e-12)
    np.testing.assert_allclose(penalty.gap(v, outward, 1.0), 0.0, atol=1e-11)
    opposite = penalty.subgradient(-outward, 1.0)
    wrong = (np.abs(outward).max(1) > 0) & (np.abs(v).max(1) > 1e-9)
    refused = np.maximum(penalty.gap(v, opposite, 1.0).max(1), np.abs(opposite + outward).max(1))
    assert (refused[wrong] > 1e-6).all()


@each_kind
def test_the_conic_form_has_the_value_as_its_minimum(name):
    """The least price of slacks is found by Clarabel; the least slacks that the class states have the same price."""
    for seed in seeds(range(6)):
        penalty, v, _ = sample(name, seed)
        form, price = penalty.conic(*v.shape), h(penalty, v)
        assert least_price(form, v) == pytest.approx(price, abs=1e-6)
        assert least_price(form, inside(penalty, v)) < np.inf
        assert penalty.hard or form.prices @ penalty.least_slacks(v) == pytest.approx(price, abs=1e-12)


def least_price(form: ConicForm, v: np.ndarray) -> float:
    """Return the least price of slacks with which values fit into a conic form; infinity if they fit with none.

    A further variable without a row gives a form without slacks a program that is not empty.
    """
    values, count = np.append(v.ravel(), 0.0)[form.entries], len(form.prices)
    A = sp.csc_array(sp.hstack([form.slacks, sp.csc_array((len(values), 1))]))
    P, prices = sp.csc_array(sp.diags_array(np.eye(count + 1)[-1])), np.append(form.prices, 0.0)
    program = Program(P, prices, A, form.lower - values - 1e-9, form.upper - values + 1e-9, cones=form.cones)
    solution = backend("clarabel")(program, 1e-9, None)
    return prices @ solution.z if solution.claim is Claim.SOLVED else np.inf


@pytest.mark.parametrize("name", OF_ONE_GROUP)
def test_penalties_of_several_times_are_stacked_with_their_limits_or_not_at_all(name):
    """Sets per time make one term of those with the same signature."""
    rng = np.random.default_rng(3)
    one, other = OF_ONE_GROUP[name](rng), OF_ONE_GROUP[name](rng)
    assert (one.signature == other.signature) == one.stackable
    both, v = one.stacked([one, other] if one.stackable else [one, one]), 2 * rng.standard_normal((2, DIM))
    parts = [(one, v[:1]), (other if one.stackable else one, v[1:])]
    np.testing.assert_allclose(both.cost(v), np.concatenate([part.cost(values) for part, values in parts]))
    np.testing.assert_allclose(both.violation(v), np.vstack([part.violation(values) for part, values in parts]))


def test_multipliers_across_a_norm_have_a_gap_of_second_order():
    ball, v, angle = NormBall(2, np.ones(1), HARD), np.array([[1.0, 0.0]]), 1e-4
    turned = np.array([[np.cos(angle), np.sin(angle)]])
    assert ball.gap(v, turned, 1.0)[0, 0] == pytest.approx(angle**2 / 2, rel=1e-6)


def test_an_equation_gets_an_interval_where_it_is_relaxed():
    assert Within(0.0).relaxed(np.zeros(2), 2.0)[1].sizes() == pytest.approx(2.0)
