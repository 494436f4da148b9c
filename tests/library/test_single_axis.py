"""Double integrator and scanner against their physics."""

from __future__ import annotations

import numpy as np

from helpers.library_physics import frequencies, solved
from lin_freq_ocp import library

# --- double integrator


def test_double_integrator_has_the_textbook_map():
    h = 0.3
    dynamics = library.double_integrator(sampling_time=h, cutoff_hz=None).dynamics
    np.testing.assert_allclose(dynamics.A, [[1, h], [0, 1]], atol=1e-15)
    np.testing.assert_allclose(dynamics.B, [[h**2 / 2], [h]], atol=1e-15)


def test_double_integrator_rests_on_its_speed_limit_only_without_the_low_pass():
    touches = {}
    for cutoff in (None, 5.0):
        problem = library.double_integrator(cutoff_hz=cutoff)
        speed = solved(problem)[1][:, 1]
        touches[cutoff] = np.diff(np.flatnonzero(speed > 0.3 - 1e-6))
    assert len(touches[None]) > 90
    assert (touches[None] == 1).all()
    assert 10 < len(touches[5.0]) < 50
    assert (touches[5.0] > 1).any()


# --- scanner


def test_scanner_resonates_where_it_says_and_stands_where_it_is_driven():
    problem = library.scanner(resonance_hz=900.0)
    np.testing.assert_allclose(frequencies(problem), [2 * np.pi * 900], rtol=1e-10)
    np.testing.assert_allclose(problem.dynamics.A @ [3.0, 0.0] + problem.dynamics.B @ [3.0], [3.0, 0.0], atol=1e-12)


def test_scanner_follows_one_period_of_a_triangle():
    reference = library.scanner().cost.x_ref[:, 0]
    assert reference[[0, 125, 250]].tolist() == [-5, 5, -5]
    slopes = np.diff(reference) * 10  # um per 0.1 ms is 10 mm/s
    np.testing.assert_allclose(np.abs(slopes), 0.8, rtol=1e-12)
    spectrum = np.abs(np.fft.rfft(reference[:-1]))
    np.testing.assert_allclose(spectrum[::2], 0, atol=1e-10)  # odd harmonics only


def test_scanner_unites_its_two_bands():
    united = library.scanner().control_stop
    parts = library.scanner(cutoff_hz=None).control_stop, library.scanner(notch_width_hz=None).control_stop
    assert (united == parts[0] | parts[1]).all()
    assert parts[0].any()
    assert parts[1].any()
    assert not (parts[0] & parts[1]).any()
