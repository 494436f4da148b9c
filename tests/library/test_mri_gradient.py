"""Gradient pulses: moments as sums, the published least number of samples, forbidden bands."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.library import StimulatedAxis, mri_gradient

BANDS = ((560, 620), (960, 1310), (1860, 1950))  # Hz


def moment(result, order):
    g = result.control[:, 0]
    return 0.01 * np.sum(g * (0.01 * np.arange(len(g))) ** order)


@expensive
def test_the_bipolar_pulse_has_132_samples_as_published():
    found = lfo.minimum_time(mri_gradient, horizons=(128, 136))
    assert (found.horizon, found.monotone, found.proven) == (132, True, True)
    assert found.rays.keys() >= {131}
    g = found.result.control[:, 0]
    assert np.abs(g[[0, -1]]).max() <= 1e-9
    assert np.abs(g).max() <= 40 + 1e-9
    assert np.abs(np.diff(g)).max() <= 2 + 1e-9
    assert moment(found.result, 0) == pytest.approx(0, abs=1e-3 + 1e-8)
    assert moment(found.result, 1) == pytest.approx(11.74, abs=1e-3 + 1e-8)


@expensive
def test_the_shortest_prephaser_is_a_trapezoid():
    """Its area is at most that of a trapezoid with the slew rate and the amplitude: a sum that is known."""

    def largest(samples):
        ramps = 2.0 * np.minimum(np.arange(samples), np.arange(samples)[::-1])
        return 0.01 * np.minimum(ramps, 40).sum()

    least = next(T for T in range(2, 200) if largest(T) >= 11.0 - 1e-3)
    found = lfo.minimum_time(partial(mri_gradient, zeroth_moment=11.0, first_moment=None), horizons=(20, 60))
    assert (found.horizon, found.proven) == (least, True)


@expensive
def test_bands_are_held_at_every_frequency_and_without_them_are_not():
    def largest(result):
        w = 2 * np.pi * 1e-5 * np.concatenate([np.linspace(*band, 41) for band in BANDS])
        return np.abs(np.exp(-1j * np.outer(w, np.arange(260))) @ result.control[:, 0]).max()

    assert largest(lfo.solve(mri_gradient(260))) > 1.5 * 145.17
    masked = lfo.solve(mri_gradient(260, forbidden_bands_hz=BANDS))
    assert largest(masked) <= 145.17 * (1 + 1e-6)
    assert masked.certificate.globally_optimal


def stimulation(g, axis, after=1000):
    """Return the largest stimulation of a waveform, also after its end, sample by sample, in the words of the model."""
    tau, weights, limit, scale = {
        "x": ((0.2, 0.03, 3.0), (0.4, 0.1, 0.5), 30.0, 0.35),
        "y": ((1.5, 2.5, 0.15), (0.55, 0.15, 0.3), 15.0, 0.31),
        "z": ((2.0, 0.12, 1.0), (0.42, 0.4, 0.18), 25.0, 0.25),
    }[axis]
    filtered, largest = [0.0, 0.0, 0.0], 0.0
    for slew in np.diff([0.0, *g, *[0.0] * after]) / 0.01:
        for i, value in enumerate((slew, abs(slew), slew)):
            filtered[i] += 0.01 / (tau[i] + 0.01) * (value - filtered[i])
        felt = sum(weight * abs(value) for weight, value in zip(weights, filtered, strict=True))
        largest = max(largest, felt * scale / limit)
    return largest


@expensive
@pytest.mark.parametrize(
    ("axis", "share", "least"),
    [
        *(("x", 1.0, 132), ("x", 0.8, 133), ("x", 0.5, 148)),
        *(("y", 1.0, 135), ("y", 0.8, 145), ("y", 0.5, 173)),
        *(("z", 1.0, 132), ("z", 0.8, 132), ("z", 0.5, 145)),
    ],
)
def test_the_least_pulse_that_nerves_take_is_proven(axis, share, least):
    """All shorter horizons are proven by one of them: after a pulse within the limit, zeros stay within it."""
    stated = partial(mri_gradient, stimulation=share, hardware=axis)
    found = lfo.minimum_time(stated, horizons=(least - 30, least + 20))
    assert (found.horizon, found.monotone, found.proven) == (least, True, True)
    g = found.result.control[:, 0]
    assert stimulation(g, axis) <= share * (1 + 1e-6)
    assert moment(found.result, 1) == pytest.approx(11.74, abs=1e-3 + 1e-8)
    assert np.abs(np.diff(g)).max() <= 2 + 1e-9
    if share == 0.5:
        assert stimulation(lfo.solve(mri_gradient(least)).control[:, 0], axis) > 0.5


def test_hardware_of_ones_own_is_that_of_its_numbers():
    own = StimulatedAxis((1.5, 2.5, 0.15), (0.55, 0.15, 0.3), limit=15.0, scale=0.31)
    given, named = (mri_gradient(140, stimulation=0.9, hardware=hardware) for hardware in (own, "y"))
    assert lfo.solve(given).cost == lfo.solve(named).cost


@pytest.mark.parametrize("field", ["time_constants", "weights", "limit", "scale"])
def test_bad_numbers_of_hardware_are_named(field):
    good = {"time_constants": (1.0, 1.0, 1.0), "weights": (1.0, 0.0, 1.0), "limit": 1.0, "scale": 1.0}
    StimulatedAxis(**good)
    for bad in (-1.0, (1.0, -1.0, 1.0), (1.0, 1.0)):
        with pytest.raises(lfo.errors.ProblemError, match=f"^{field}"):
            StimulatedAxis(**good | {field: bad})


@expensive
@pytest.mark.parametrize("samples", [246, 250])
def test_pulses_with_bands_are_proven_where_the_peak_is_at_the_end_of_a_band(samples):
    masked = lfo.solve(mri_gradient(samples, forbidden_bands_hz=BANDS))
    assert masked.certificate.globally_optimal


def test_the_level_is_a_twentieth_of_the_peak_without_bands():
    V = np.abs(np.fft.rfft(lfo.solve(mri_gradient()).control[:, 0], 2**16))
    assert mri_gradient(forbidden_bands_hz=BANDS).control_spectrum[0].limit == pytest.approx(V.max() / 20, rel=1e-4)


@pytest.mark.parametrize(
    ("field", "given"),
    [
        ("horizon", {"horizon": 1}),
        ("moment_tolerance", {"moment_tolerance": -1.0}),
        ("amplitude", {"amplitude": 0}),
        ("forbidden_bands_hz", {"forbidden_bands_hz": [(620, 560)]}),
        ("forbidden_bands_hz", {"forbidden_bands_hz": [5]}),
        ("first_moment", {"first_moment": "x"}),
        ("second_moment", {"second_moment": [1.0, 2.0]}),
        ("stimulation", {"stimulation": 0.0}),
        ("stimulation", {"stimulation": -1.0}),
        ("hardware", {"stimulation": 1.0, "hardware": "w"}),
        ("hardware", {"stimulation": 1.0, "hardware": 3.0}),
    ],
)
def test_bad_parameters_are_named(field, given):
    with pytest.raises(lfo.errors.ProblemError, match=f"^{field}"):
        mri_gradient(**given)


def test_it_is_known_by_its_name():
    assert lfo.library.by_name("mri_gradient") is lfo.library.WAVEFORMS["mri_gradient"] is mri_gradient
    assert mri_gradient().name == "mri_gradient"
