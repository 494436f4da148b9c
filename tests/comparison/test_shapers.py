"""Input shapers: their impulses against the vibration that they are made for."""

import numpy as np
import pytest

from helpers.seeds import expensive
from lin_freq_ocp.comparison import INSENSITIVITY, SHAPERS, impulse_text, impulses, shape_controls
from lin_freq_ocp.problem import VibrationLimit, VibrationMap

H = 1e-3  # half a period of 10 Hz is 50 samples


def box_of(damping, h=H, hertz=10.0):
    plain = VibrationMap(None, np.ones(1), np.ones(5), np.zeros((0, 2)), h)
    frequency = hertz / np.sqrt(1 - damping**2)  # of the damped vibration: ``hertz``
    return VibrationLimit(plain, np.array([frequency, damping]), np.array([frequency, damping]), 1.0, h)


def left(name, damping, ratio=1.0):
    """What impulses leave of the vibration of a single impulse at the end, for a mode whose frequency differs."""
    given, w = impulses(name, [box_of(damping)]), ratio * 2 * np.pi * 10.0 / np.sqrt(1 - damping**2)
    s = w * (-damping + 1j * np.sqrt(1 - damping**2))
    z = np.exp(s * H * np.arange(len(given))[::-1])
    return abs((given * z).sum()) / abs(z[0])


@pytest.mark.parametrize("name", SHAPERS)
@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_impulses_are_positive_and_sum_to_one(name, damping):
    given = impulses(name, [box_of(damping)])
    assert given.sum() == pytest.approx(1.0)
    assert (given >= 0).all()
    assert len(given) == {"ZV": 51, "MZV": 76, "ZVD": 101, "EI": 101, "2HUMP_EI": 151, "3HUMP_EI": 201}[name]


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_zero_vibration_and_zero_derivative(damping):
    assert left("ZV", damping) < 1e-12
    assert left("ZVD", damping) < 1e-12
    assert left("ZV", damping, 1.001) > 1e-3
    assert left("ZVD", damping, 1.001) < 1e-4


@expensive
def test_extra_insensitive_leaves_its_share_and_is_zero_on_both_sides():
    assert left("EI", 0.0) == pytest.approx(INSENSITIVITY)
    ratios = np.linspace(0.8, 1.2, 4001)
    values = np.array([left("EI", 0.0, ratio) for ratio in ratios])
    below, above = (values[ratios < 1].min(), values[ratios > 1].min())
    assert max(below, above) < 1e-3
    insensitive = np.ptp(ratios[values <= 1.001 * INSENSITIVITY])
    of_zvd = np.ptp(ratios[np.array([left("ZVD", 0.0, ratio) for ratio in ratios]) <= INSENSITIVITY])
    assert insensitive > 1.3 * of_zvd


def test_a_shaped_control_is_longer_and_has_the_same_sum():
    box, u = box_of(0.1), np.random.default_rng(0).standard_normal((20, 2))
    found = shape_controls(impulses("ZVD", [box]), u)
    assert found.shape == (120, 2)
    np.testing.assert_allclose(found.sum(0), u.sum(0), atol=1e-12)
    assert impulse_text(impulses("ZV", [box_of(0.0)])) == "0.5 at t = 0, 0.5 at t = 50"


def test_impulses_that_share_a_sample_are_one():
    assert impulses("ZVD", [box_of(0.0, h=1.0)]) == pytest.approx([1.0])


@pytest.mark.parametrize("name", SHAPERS)
def test_impulses_for_several_modes_are_those_of_each_convolved(name):
    slow, fast = box_of(0.05), box_of(0.02, hertz=25.0)
    both = impulses(name, [slow, fast, slow])  # two controls may have the same box
    np.testing.assert_allclose(both, np.convolve(impulses(name, [slow]), impulses(name, [fast])), atol=1e-15)
    assert both.sum() == pytest.approx(1.0)


def test_a_shaper_for_two_modes_leaves_neither_vibrating():
    weights = impulses("ZV", [box_of(0.0), box_of(0.0, hertz=25.0)])
    for hertz in (10.0, 25.0):
        residue = (weights * np.exp(2j * np.pi * hertz * H * np.arange(len(weights)))).sum()
        assert abs(residue) < 1e-12
    assert abs((weights * np.exp(2j * np.pi * 17.0 * H * np.arange(len(weights)))).sum()) > 0.1
