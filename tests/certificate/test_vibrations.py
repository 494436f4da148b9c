"""The proven largest residual vibration over a box of modes: against dense sampling inside and on the edges."""

import numpy as np
import pytest

from helpers.seeds import seeds
from lin_freq_ocp.certificate import certified_vibration
from lin_freq_ocp.problem import VibrationLimit, VibrationMap

ABOVE = 5e-8  # of the proven ratio over the largest value: 2e-8 of the chord


def box_of(N, frequency, damping, limit=1.0, h=0.01, relative=False):
    plain = VibrationMap(None, np.ones(1), np.ones(N), np.zeros((0, 2)), h, relative)
    return VibrationLimit(plain, *np.stack([frequency, damping], axis=1), limit, h)


def amplitude(samples, modes, h=0.01, relative=False):
    """By the sums themselves, (modes,)."""
    frequency, damping = np.asarray(modes).T
    root = np.sqrt(1 - damping**2)
    z = np.exp(2 * np.pi * frequency * (-damping + 1j * root) * h)
    return np.abs((1 if relative else (z - 1) / root) * np.polyval(samples, z))


def grid(box, count):
    axes = [np.linspace(low, high, count if low < high else 1) for low, high in zip(box.low, box.high, strict=True)]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("seed", seeds(range(30)))
def test_nothing_is_above_the_proven_value(seed, relative):
    rng = np.random.default_rng(seed)
    N = int(rng.integers(1, 100))
    frequency, damping = np.sort(rng.uniform(0.2, 70.0, 2)), np.sort(rng.uniform(0.0, 0.9, 2) ** 2)
    if seed % 3 == 1:
        damping[1] = damping[0]
    if seed % 3 == 2:
        frequency[0] = 0.99 * frequency[1]
    box = box_of(N, frequency, damping, 10.0 ** rng.uniform(-3, 1), relative=relative)
    samples = rng.standard_normal(N) * 10.0 ** rng.uniform(-6, 6)
    peak = certified_vibration(samples, box)
    assert (
        amplitude(samples, grid(box, 80), relative=relative).max() / box.limit <= peak.ratio <= peak.found * (1 + ABOVE)
    )
    at = np.array([[peak.frequency, peak.damping]])
    assert np.isfinite(box.limit_at(at)).all()
    assert peak.found == pytest.approx(amplitude(samples, at, relative=relative)[0] / box.limit, rel=ABOVE)


def test_a_single_mode_and_a_step():
    """A step of length N leaves 2 |sin(w N h / 2)| without damping."""
    box = box_of(25, [1.0, 1.0], [0.0, 0.0])
    peak = certified_vibration(np.full(25, 3.0), box)
    assert peak.ratio == pytest.approx(6 * np.sin(np.pi * 0.25), rel=1e-9)
    assert (peak.frequency, peak.damping) == (1.0, 0.0)


def test_two_impulses_half_a_period_apart_cancel():
    """The zero of a ZV shaper within the box: only the deviation from it counts."""
    samples = np.zeros(51)
    samples[[0, 50]] = 1.0
    peak = certified_vibration(samples, box_of(51, [0.9, 1.1], [0.0, 0.0]))
    expected = 2 * np.abs(np.cos(np.pi * 0.9 / 2)) * 2 * np.sin(np.pi * 0.9 * 0.01)
    other = 2 * np.abs(np.cos(np.pi * 1.1 / 2)) * 2 * np.sin(np.pi * 1.1 * 0.01)
    assert peak.ratio == pytest.approx(max(expected, other), rel=1e-8)


def test_zeros_and_what_is_not_finite():
    box = box_of(5, [1.0, 2.0], [0.0, 0.1])
    assert certified_vibration(np.zeros(5), box).ratio == 0
    assert certified_vibration(np.array([1.0, np.inf, 0, 0, 0]), box).ratio == np.inf
    assert certified_vibration(np.full(5, 1e300), box).ratio > 1e299
