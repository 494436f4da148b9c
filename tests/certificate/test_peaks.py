"""The proven largest value of a spectrum relative to its limit, against dense sampling and exact values."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.signal.windows import chebwin

from helpers.replacing import substitute
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import TERMS, Cells, certified_peak
from lin_freq_ocp.problem import limits_on

WHOLE = [(0.0, np.pi)]
ABOVE = 3e-10  # RATIO, and as much for rounding at -100 dB


def sampled(samples, limits, count=4000):
    """Return the largest ratio at many frequencies of each interval, those of the ends among them."""
    found = 0.0
    for low, high in zip(limits.low, limits.high, strict=True):
        w = np.linspace(low, high, count)
        values = np.abs(np.exp(-1j * np.outer(w, np.arange(len(samples)))) @ samples)
        found = max(found, float((values / limits.at(w)).max()))
    return found


@pytest.mark.parametrize("seed", seeds(range(60)))
def test_no_sampled_value_is_above_it_and_it_is_attained(seed):
    rng = np.random.default_rng(seed)
    N, ends = int(rng.integers(1, 200)), np.sort(rng.uniform(0, np.pi, 4))
    samples = rng.standard_normal(N) * (chebwin(N, 100) if seed % 3 == 0 and N > 3 else 1) * 10.0 ** rng.integers(-9, 9)
    intervals = WHOLE if seed % 2 else [(float(ends[0]), float(ends[1])), (float(ends[2]), float(ends[3]))]
    points = np.sort(rng.uniform(0, np.pi, 3))
    limits = limits_on(intervals, points, 10.0 ** rng.uniform(-6, 0, 3) * np.abs(samples).sum())
    peak = certified_peak(samples, limits)
    assert sampled(samples, limits) <= peak.ratio <= peak.found * (1 + ABOVE)
    exact = abs(np.exp(-1j * peak.frequency * np.arange(N)) @ samples) / limits.at(np.array([peak.frequency]))[0]
    assert peak.found == pytest.approx(exact, rel=1e-8)


@expensive
def test_the_peak_of_a_long_record_100_db_below_its_largest_value():
    N = 20_000
    samples = chebwin(N, 100) * np.cos(0.3 * np.arange(N))
    largest = np.abs(np.fft.rfft(samples, 16 * N)).max()
    limits = limits_on([(1.0, np.pi)], np.zeros(1), np.array([1e-5 * largest]))
    peak = certified_peak(samples, limits)
    assert peak.found <= peak.ratio <= peak.found * (1 + ABOVE)
    fine = np.abs(np.fft.rfft(samples, 2**20))
    assert fine[np.arange(len(fine)) * 2 * np.pi / 2**20 >= 1.0].max() <= peak.ratio * limits.at_low[0]


def test_values_that_are_known():
    impulse = np.eye(1, 9, 4)[0]  # |V| = 1 at all frequencies
    assert certified_peak(impulse, limits_on(WHOLE, np.zeros(1), np.array([2.0]))).ratio == pytest.approx(
        0.5, rel=ABOVE
    )
    ones = certified_peak(np.ones(7), limits_on(WHOLE, np.zeros(1), np.ones(1)))
    assert (ones.ratio, ones.frequency) == (pytest.approx(7, rel=ABOVE), pytest.approx(0, abs=1e-4))
    second = certified_peak(np.ones(7), limits_on([(2 * np.pi / 7, np.pi)], np.zeros(1), np.ones(1)))
    w = np.linspace(2 * np.pi / 7, np.pi, 1_000_001)
    dirichlet = np.abs(np.sin(3.5 * w) / np.sin(w / 2)).max()
    assert second.ratio == pytest.approx(dirichlet, rel=1e-9)


@expensive
@pytest.mark.parametrize("seed", range(9))
def test_the_peak_at_the_end_of_a_band_is_within_it(seed):
    """Where the limit is known: cells that end with a band, up to rounding, reach beyond it by rounding."""
    rng = np.random.default_rng(seed)
    for k in range(1, 64):
        samples = rng.choice([-1, 1]) ** np.arange(3) * rng.uniform(0.5, 1.0, 3)
        limits = limits_on([(np.pi * k / 64, np.pi * (k + 0.5) / 64)], np.zeros(1), np.ones(1))
        assert np.isfinite(limits.at(np.array([certified_peak(samples, limits).frequency])))


def test_zero_and_overflowing_signals():
    limits = limits_on(WHOLE, np.zeros(1), np.ones(1))
    assert certified_peak(np.zeros(5), limits).ratio == 0
    assert certified_peak(np.array([1.0, np.inf]), limits).ratio == np.inf
    assert certified_peak(np.full(3, 1e300), limits).ratio == pytest.approx(3e300, rel=ABOVE)


def test_it_is_a_bound_when_cells_are_not_halved_to_the_end(monkeypatch):
    samples = np.random.default_rng(1).standard_normal(50)
    limits = limits_on(WHOLE, np.zeros(1), np.ones(1))
    whole = certified_peak(samples, limits)
    substitute(monkeypatch, "certificate.HALVINGS", 1)
    assert whole.ratio <= certified_peak(samples, limits).ratio < 2 * whole.ratio


def test_halved_polynomials_differ_by_no_more_than_their_error():
    """Forty halvings, to the left and right in turns, against exact arithmetic."""
    rng = np.random.default_rng(0)
    a = rng.standard_normal((1, TERMS)) + 0j
    one = np.ones(1)
    part = Cells(a, 0 * one, one, one, 0 * one, 0 * one)
    exact = [Fraction(value) for value in a[0].real.tolist()]
    for halving in range(40):
        ends = (-one, 0 * one) if halving % 3 else (0 * one, one)
        part = part.part(*ends)
        middle = Fraction(float(part.middle[0]))
        value = sum(factor * middle**power for power, factor in enumerate(exact))
        assert abs(Fraction(float(part.a[0, 0].real)) - value) <= Fraction(float(part.error[0]))


def single_cell(a, limit, error=0.0):
    coefficients = np.zeros((1, TERMS), dtype=complex)
    coefficients[0, : len(a)] = a
    return Cells(coefficients, np.zeros(1), np.ones(1), np.array([limit]), np.zeros(1), np.array([error]))


@pytest.mark.parametrize("seed", range(5))
def test_a_cell_whose_end_exceeds_its_limit_by_rounding_is_not_proven(seed):
    """|g(1)|, the largest value, is above the limit by the part of a rounding: exact arithmetic tells."""
    a = np.random.default_rng(seed).uniform(0.1, 1.0, (5, 2)) @ [1.0, 1.0j]
    exact = sum(sum(map(Fraction, part.tolist())) ** 2 for part in (a.real, a.imag))
    limit = float(np.abs(a.sum()))
    while Fraction(limit) ** 2 >= exact:
        limit = float(np.nextafter(limit, 0.0))
    assert single_cell(a, limit).undecided(1.0).tolist() == [0]


def test_a_cell_is_proven_only_with_the_error_of_its_polynomial():
    """|g| = 1 and a limit of 1.05: |V| may be 1.04 or 1.06."""
    assert single_cell([1.0], 1.05, 0.04).undecided(1.0).tolist() == []
    assert single_cell([1.0], 1.05, 0.06).undecided(1.0).tolist() == [0]
