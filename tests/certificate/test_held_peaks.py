"""The proven largest spectrum of a held signal: against dense sampling, far above Nyquist, and without end."""

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import seeds
from lin_freq_ocp.certificate import proven_peak
from lin_freq_ocp.problem import ZeroOrderHoldMap, ZeroOrderHoldMask, limits_on, peaks_above

ABOVE = 1e-9  # of the proven ratio over the largest value


def held(N, intervals, points=(0.0,), values=(1.0,)):
    plain = ZeroOrderHoldMap(None, np.ones(1), np.ones(N), np.zeros(0))
    return ZeroOrderHoldMask(plain, limits_on(intervals, np.array(points), np.array(values)))


def magnitude(samples, w):
    """By the integral of the held signal over time, sample by sample."""
    factor = np.where(w == 0, 1.0, np.sin(w / 2) / np.where(w == 0, 1, w / 2))
    return np.abs(factor * np.polyval(samples[::-1], np.exp(-1j * w)))


@pytest.mark.parametrize("seed", seeds(range(20)))
def test_nothing_is_above_the_proven_value(seed):
    rng = np.random.default_rng(seed)
    N = int(rng.integers(1, 120))
    first, last = np.sort(rng.uniform(0.0, 40.0, 2)) if seed % 4 else (0.0, 7.0)
    points = np.sort(rng.uniform(first, last, 4))
    everywhere = held(N, [(first, last)], points, 10.0 ** rng.uniform(-3, 1, 4))
    samples = rng.standard_normal(N) * 10.0 ** rng.uniform(-6, 6)
    peak = proven_peak(everywhere, samples)
    w = np.linspace(first, last, 20_001)
    assert (magnitude(samples, w) / everywhere.limits.at(w)).max() <= peak.ratio <= peak.found * (1 + ABOVE)
    at = np.array([peak.frequency])
    assert peak.found == pytest.approx((magnitude(samples, at) / everywhere.limits.at(at))[0], rel=ABOVE)
    peaks, ratios = peaks_above(everywhere, np.zeros((N + 1, 0)), samples[:, None], 0.5 * peak.found)
    assert ratios.max() == pytest.approx(peak.found, rel=1e-7)
    assert ratios == pytest.approx(magnitude(samples, peaks) / everywhere.limits.at(peaks), rel=1e-9)


def test_a_single_sample_is_a_box():
    """|S| alone: 1 at zero, and 2/(3 pi) about at its first side lobe."""
    assert proven_peak(held(1, [(0.0, 9.0)]), np.ones(1)).ratio == pytest.approx(1.0, rel=ABOVE)
    lobe = proven_peak(held(1, [(2 * np.pi, 4 * np.pi)]), np.ones(1))
    assert lobe.ratio == pytest.approx(0.21723362821122166, rel=ABOVE)
    assert lobe.frequency / 2 == pytest.approx(4.493409457909064, rel=1e-6)  # tan a = a


def test_one_period_after_the_last_point_is_enough():
    rng = np.random.default_rng(3)
    for first in (0.2, 2.0, 5.0, 11.0):
        samples = rng.standard_normal(30)
        peak = proven_peak(held(30, [(first, first + 2 * np.pi)]), samples)
        assert magnitude(samples, np.linspace(first, 120.0, 100_001)).max() <= peak.ratio
        shorter = proven_peak(held(30, [(first + 2 * np.pi, first + 8 * np.pi)]), samples)
        assert shorter.found < peak.found


def test_deep_images_of_a_smooth_signal():
    """Far below the largest value, the images of a slow signal are proven as closely."""
    N = 400
    samples = 1e3 * np.hanning(N) ** 2
    everywhere = held(N, [(2 * np.pi - 1.0, 2 * np.pi - 0.2)], values=(1e-3,))
    peak = proven_peak(everywhere, samples)
    w = np.linspace(2 * np.pi - 1.0, 2 * np.pi - 0.2, 20_001)
    largest = magnitude(samples, w).max() / 1e-3
    assert largest * (1 - 1e-6) <= peak.ratio <= largest * (1 + 1e-6)
    assert peak.found <= peak.ratio <= peak.found * (1 + 1e-7)


def test_zeros_and_what_is_not_finite():
    everywhere = held(5, [(1.0, 9.0)])
    assert proven_peak(everywhere, np.zeros(5)).ratio == 0
    assert proven_peak(everywhere, np.array([1.0, np.inf, 0, 0, 0])).ratio == np.inf


def test_the_band_of_a_problem_ends_a_period_after_its_last_point():
    """A tone at 0.8 pi has its next image above 1.6 pi at 2.8 pi: that is the largest value of the band."""
    N = 40
    mask = lfo.MagnitudeBound(2.0, band=lfo.low_pass(cutoff_hz=0.8), every_frequency=True, hold=True)
    plant = lfo.LinearDynamics([[1.0]], [[1.0]], sampling_time=1.0)
    problem = lfo.OptimalControlProblem(plant, N, lfo.QuadraticCost(R=1.0), control_spectrum=mask)
    samples = np.cos(0.8 * np.pi * np.arange(N))
    peak = proven_peak(problem.terms[0].semi_infinite, samples)
    assert magnitude(samples, np.linspace(1.6 * np.pi, 60.0, 20_001)).max() <= 2.0 * peak.ratio
    assert peak.frequency == pytest.approx(2.8 * np.pi, rel=1e-2)


def test_the_band_of_a_problem_ends_a_period_after_the_points_of_its_limit():
    """The limit is high up to 1.69 Hz and low from 1.7 Hz on: the image at 2.4 Hz is the worst."""
    N, points = 40, np.array([[0.8, 100.0], [1.69, 100.0], [1.7, 1.0]])
    mask = lfo.MagnitudeBound(points, band=lfo.low_pass(cutoff_hz=0.8), every_frequency=True, hold=True)
    plant = lfo.LinearDynamics([[1.0]], [[1.0]], sampling_time=1.0)
    problem = lfo.OptimalControlProblem(plant, N, lfo.QuadraticCost(R=1.0), control_spectrum=mask)
    peak = proven_peak(problem.terms[0].semi_infinite, np.cos(0.8 * np.pi * np.arange(N)))
    assert peak.frequency == pytest.approx(4.8 * np.pi, rel=1e-2)
