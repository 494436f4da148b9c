"""What frequency constraints of a loop say about the applied signal, and what they do not."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.loops import pendulum


def test_a_constraint_of_each_plan_is_named():
    with pytest.warns(lfo.errors.ClosedLoopWarning, match="control_spectrum: holds for each plan.*Spectrogram"):
        lfo.RecedingHorizon(pendulum(20))


def test_windows_and_plain_loops_are_silent():
    quiet = lfo.spectrum.Spectrogram(lfo.MagnitudeBound(0.5, band=lfo.low_pass(1.0)), length=10)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lfo.RecedingHorizon(pendulum(20, None))
        lfo.RecedingHorizon(replace(pendulum(20, None), control_spectrum=quiet))


def test_the_page_says_it_and_what_is_not_judged(tmp_path):
    loop = lfo.RecedingHorizon(pendulum(20), certify="later")
    log = loop.run(np.array([0.02, 0.0, 0.0, 0.0]), 6)
    page = log.save(tmp_path).read_text()
    assert "nothing follows for the applied signal" in page
    assert "not judged" in page
    assert "not judged" not in (loop.certify().save(tmp_path)).read_text()


NOTCH, AMPLITUDE, SAMPLING = lfo.spectrum.notch(centre_hz=8, width_hz=5), 0.06, 0.02


def oscillating_mass(**fields) -> lfo.OptimalControlProblem:
    """Return a mass on a spring, with an actuator whose resonance at 8 Hz no model has."""
    dynamics = lfo.LinearDynamics.from_continuous([[0, 1], [-4.0, -0.1]], [[0], [1]], SAMPLING)
    cost = lfo.QuadraticCost(Q=np.diag([10.0, 1.0]), R=0.01, P=np.diag([50.0, 5.0]))
    return lfo.OptimalControlProblem(dynamics, 50, cost, lfo.Box(-1, 1), initial_state=[0.2, 0.0], **fields)


def largest_amplitude(control: np.ndarray, limit: lfo.spectrum.Spectrogram) -> float:
    """Return the largest amplitude in the notch, over a fine grid, of windows that begin at multiples of the hop."""
    taper, frequencies = (
        np.hanning(limit.length),
        np.linspace(5.625, 10.3125, 400),
    )  # from the first point of its grid to the last
    starts = range(0, len(control) - limit.length + 1, limit.hop)
    windows = np.array([control[first : first + limit.length] for first in starts])
    waves = np.exp(-2j * np.pi * SAMPLING * np.outer(frequencies, np.arange(limit.length)))
    return float(2 * np.abs(waves @ (windows * taper).T).max() / taper.sum())


def test_the_applied_control_keeps_its_amplitude_at_every_frequency_of_the_band():
    limit = lfo.spectrum.closed_loop(NOTCH, AMPLITUDE, SAMPLING, past=np.zeros(40))
    noise = np.random.default_rng(0).normal(scale=[1e-3, 1e-2], size=(90, 2))
    runs = {}
    for name, spectrum in {"plain": None, "of plans": NOTCH, "of the loop": limit}.items():
        problem = oscillating_mass(control_spectrum=spectrum)
        log = lfo.RecedingHorizon(problem, soft={"control_spectrum": 100.0}).run([0.2, 0.0], 90, disturbance=noise)
        runs[name] = largest_amplitude(np.concatenate([np.zeros(40), log.controls[:, 0]]), limit)
        if name == "of the loop":
            softened = [source for source in log.sources if source != "plan"]
            between = 0.33 * np.abs(log.controls).max() / 4**2
            assert not softened
            assert runs[name] <= AMPLITUDE + between
    assert runs["plain"] > 1.5 * AMPLITUDE
    assert runs["of plans"] > 1.5 * AMPLITUDE  # a notch of each plan says nothing of the loop


@pytest.mark.parametrize(
    ("band", "length"),
    [
        (lfo.spectrum.notch(centre_hz=8, width_hz=4), 50),
        (lfo.low_pass(cutoff_hz=5), 20),
        (lfo.spectrum.notch(1.0, 0.5), 51),
        (lfo.spectrum.high_pass(cutoff_hz=10), 20),
    ],
)
def test_a_window_is_as_long_as_its_band_asks_for(band, length):
    assert lfo.spectrum.closed_loop(band, 0.1, SAMPLING).length == length


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ((lfo.spectrum.stop_band(bins=[3]), 0.1, SAMPLING), "band"),
        ((NOTCH, 0.0, SAMPLING), "amplitude"),
        ((NOTCH, 0.1), "sampling_time"),
    ],
)
def test_what_does_not_fit_is_named(arguments, field):
    with pytest.raises(lfo.errors.ProblemError, match=f"closed_loop.{field}"):
        lfo.spectrum.closed_loop(*arguments)
