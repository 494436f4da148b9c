"""The suite of affine maps: values by the definition, adjoint, rows, magnitudes and forms of every class."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from helpers.instances import classes_of
from helpers.instances.maps import MAPS, M, N, plain_values, signals
from helpers.seeds import examples
from lin_freq_ocp.problem import AffineMap, OutputMap

NOT_AFFINE = {"FormulaMap"}  # of path constraints: it has values, and neither rows nor an adjoint

each_map = pytest.mark.parametrize("name", MAPS)
random_data = given(seed=st.integers(0, 2**32 - 1), T=st.integers(1, 12))
quick = settings(max_examples=examples(60), deadline=None, derandomize=True)


def sample(name: str, seed: int, T: int) -> tuple[AffineMap, np.ndarray, np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return MAPS[name](rng, T), *signals(rng, T), rng


def constant_of(one: AffineMap, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return one.values(np.zeros_like(x), np.zeros_like(u))


def test_every_class_of_the_package_is_here():
    kinds = {type(MAPS[name](np.random.default_rng(0), 4)) for name in MAPS}
    assert {kind.__name__ for kind in classes_of(AffineMap) - kinds} == NOT_AFFINE


@each_map
@random_data
@quick
def test_values_are_those_of_the_definition_and_of_rows_and_forms(name, seed, T):
    one, x, u, rng = sample(name, seed, T)
    v, constant = one.values(x, u), constant_of(one, x, u)
    assert v.shape == one.shape
    assert one.additions > 0
    np.testing.assert_allclose(v, plain_values(one, x, u), atol=1e-11)
    matrix, offset = one.rows(T, N, M)
    values = matrix @ np.concatenate([x.ravel(), u.ravel()]) + offset
    np.testing.assert_allclose(values.reshape(one.shape), v, atol=1e-11)
    np.testing.assert_allclose(values_of_stages(one, x, u), v, atol=1e-11)
    np.testing.assert_allclose(values_of_bins(one, x, u), (v - constant).ravel(), atol=1e-11)
    if one.takes_batches:
        parts = [signals(rng, T) for _ in range(3)]
        several = one.values(*(np.stack(part) for part in zip(*parts, strict=True)))
        np.testing.assert_allclose(several, [one.values(*part) for part in parts], atol=1e-14)


def values_of_stages(one: AffineMap, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the values of the stage form; those of the map if it has none."""
    form = one.stage_form(N, M)
    if form is None:
        return one.values(x, u)
    both = np.hstack([x, np.vstack([u, np.zeros((1, M))])])[one.positions]
    return (form[0] @ both[:, :, None])[:, :, 0] + form[1]


def values_of_bins(one: AffineMap, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the kept (Re, Im) of the spectrum form; the values of the map without its constant if it has none."""
    form = one.spectrum_form(N, M)
    if form is None:
        return (one.values(x, u) - constant_of(one, x, u)).ravel()
    longer = np.vstack([u, np.zeros((1, M))])  # only a row without controls has the sample of x_T
    signal = (np.hstack([x, longer]) @ form.row)[: len(form.window)]
    bins = np.exp(-2j * np.pi * np.outer(form.bins, np.arange(len(signal))) / form.points) @ (form.window * signal)
    return np.column_stack([bins.real, bins.imag]).ravel()[form.kept]


@each_map
@random_data
@quick
def test_pull_back_is_the_adjoint_and_sizes_bound_the_absolute_values(name, seed, T):
    """The size of a bin is the norm of the signal: a value is at most that times the root of the samples."""
    one, x, u, rng = sample(name, seed, T)
    multipliers, shapes = rng.standard_normal(one.shape), (x.shape, u.shape)
    of_x, of_u = one.pull_back(multipliers, shapes)
    assert (of_x.shape, of_u.shape) == shapes
    change = one.values(x, u) - constant_of(one, x, u)
    assert (multipliers * change).sum() == pytest.approx((of_x * x).sum() + (of_u * u).sum(), abs=1e-10)
    longest = max(part.samples if isinstance(part, OutputMap) else 1 for part in getattr(one, "parts", (one,)))
    assert (np.abs(one.values(x, u)) <= one.sizes(x, u) * np.sqrt(longest) * (1 + 1e-12)).all()
    for pulled, size in zip((of_x, of_u), one.pulled_sizes(multipliers, shapes), strict=True):
        assert (np.abs(pulled) <= size * (1 + 1e-12) + 1e-12).all()
    if one.takes_batches:
        prices = np.stack([multipliers, -2.0 * multipliers])
        for part, several in zip((of_x, of_u), one.pull_back(prices, ((2, *x.shape), (2, *u.shape))), strict=True):
            np.testing.assert_allclose(several, [part, -2.0 * part], atol=1e-14)


@each_map
def test_rows_do_not_depend_on_constants_and_extended_precision_stays(name):
    one, x, u, _ = sample(name, 0, 9)
    copy, other = deepcopy(one), sample(name, 1, 9)[0]
    for field in one.constants:
        object.__setattr__(copy, field, getattr(one, field) + 1.0)
    assert one.same_rows(copy if one.constants else one)
    assert not one.same_rows(other)
    assert (one.rows(9, N, M)[0] != copy.rows(9, N, M)[0]).nnz == 0
    assert one.values(x.astype(np.longdouble), u.astype(np.longdouble)).dtype == np.longdouble
    pulled = one.pull_back(np.ones(one.shape, dtype=np.longdouble), (x.shape, u.shape))
    assert all(part.dtype == np.longdouble for part in pulled)
