"""What frequency constraints of a loop say about the applied signal, and what they do not."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.compilers import needs_kernel
from helpers.loops import pendulum
from helpers.seeds import expensive


def test_a_constraint_of_each_plan_is_named():
    with pytest.warns(lfo.errors.ClosedLoopWarning, match="control_spectrum: holds for each plan.*Spectrogram"):
        lfo.RecedingHorizon(pendulum(20))


def test_windows_and_plain_loops_are_silent():
    quiet = lfo.spectrum.Spectrogram(lfo.MagnitudeBound(0.5, band=lfo.low_pass(1.0)), length=10)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lfo.RecedingHorizon(pendulum(20, None))
        lfo.RecedingHorizon(replace(pendulum(20, None), control_spectrum=quiet))


@expensive
@needs_kernel
def test_the_page_says_it_and_what_is_not_judged(blank, tmp_path):
    loop = lfo.RecedingHorizon(pendulum(20), certify="later")
    log = loop.run(np.array([0.02, 0.0, 0.0, 0.0]), 3)
    page = log.save(tmp_path).read_text()
    assert "implies nothing for the applied signal" in page
    assert "not judged" in page
    assert "not judged" not in (loop.certify().save(tmp_path)).read_text()


NOTCH, AMPLITUDE, SAMPLING = lfo.spectrum.notch(centre_hz=8, width_hz=5), 0.06, 0.02


def oscillating_mass(**fields) -> lfo.OptimalControlProblem:
    """Return a mass on a spring, with an actuator whose resonance at 8 Hz no model has."""
    dynamics = lfo.LinearDynamics.from_continuous([[0, 1], [-4.0, -0.1]], [[0], [1]], SAMPLING)
    cost = lfo.QuadraticCost(Q=np.diag([10.0, 1.0]), R=0.01, P=np.diag([50.0, 5.0]))
    return lfo.OptimalControlProblem(dynamics, 40, cost, lfo.Box(-1, 1), initial_state=[0.2, 0.0], **fields)


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


@expensive
def test_the_applied_control_keeps_its_amplitude_at_every_frequency_of_the_band():
    limit = lfo.spectrum.closed_loop(NOTCH, AMPLITUDE, SAMPLING, past=np.zeros(40))
    noise = np.random.default_rng(0).normal(scale=[1e-3, 1e-2], size=(45, 2))
    runs = {}
    for name, spectrum in {"plain": None, "of plans": NOTCH, "of the loop": limit}.items():
        problem = oscillating_mass(control_spectrum=spectrum)
        log = lfo.RecedingHorizon(problem, soft={"control_spectrum": 100.0}).run([0.2, 0.0], 45, disturbance=noise)
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
        ((lfo.spectrum.notch(centre_hz=1e4, width_hz=8), 0.1, SAMPLING), "band"),
        ((NOTCH, 0.1, SAMPLING, 20, 5, np.zeros(18)), r"past: got shape \(18,\); expected at least 19 samples"),
        ((NOTCH, 0.1, SAMPLING, 20, 5, np.full(19, np.nan)), "past"),
    ],
)
def test_what_does_not_fit_is_named(arguments, field):
    with pytest.raises(lfo.errors.ProblemError, match=f"closed_loop.{field}"):
        lfo.spectrum.closed_loop(*arguments)


@pytest.mark.parametrize(
    ("past", "words"), [("0", "got '0'; expected numbers"), (np.nan, "got nan; expected a finite")]
)
def test_a_past_that_is_no_number_is_named(past, words):
    with pytest.raises(lfo.errors.ProblemError, match=rf"Spectrogram\.past: {words}"):
        lfo.spectrum.closed_loop(NOTCH, 0.1, SAMPLING, past=past)


@pytest.mark.parametrize("controls", [1, 2])
def test_a_past_of_zero_is_that_of_all_controls_at_rest(controls):
    plant = lfo.LinearDynamics(np.eye(2), np.array([[1.0, 0.5], [0.0, 1.0]])[:, :controls], sampling_time=SAMPLING)
    found = {}
    for name, past in {"number": 0, "array": np.zeros((19, controls)), "none": None}.items():
        limit = lfo.spectrum.closed_loop(NOTCH, 0.02, SAMPLING, length=20, past=past)
        cost, box = lfo.QuadraticCost(Q=np.eye(2), R=0.1), lfo.Box(-1, 1)
        problem = lfo.OptimalControlProblem(plant, 22, cost, box, initial_state=[1, 1], control_spectrum=limit)
        loop = lfo.RecedingHorizon(lfo.rate_limited(problem, 0.5, previous=0.0), certify="later")
        found[name] = loop.run([1.0, 1.0], 8).controls
        assert set(loop.certify().statuses) == {"optimal"}
    np.testing.assert_array_equal(found["number"], found["array"])
    assert np.abs(found["number"] - found["none"]).max() > 0.01
    with pytest.raises(lfo.errors.ProblemError, match=r"12 to come; expected .* past=0 of closed_loop"):
        lfo.solve(replace(problem, horizon=12))


@cache
def noisy_and_soft():
    return noisy(oscillating_mass(control_spectrum=LIMIT.softened(1e-3)))


def noisy(problem, steps=45, **fields):
    """Return the record of a loop of the mass with strong disturbances."""
    noise = np.random.default_rng(1).normal(scale=[1e-3, 5e-2], size=(steps, 2))
    return lfo.RecedingHorizon(problem, **fields).run([0.2, 0.0], steps, disturbance=noise)


def windows_of(signal: np.ndarray, limit: lfo.spectrum.Spectrogram) -> np.ndarray:
    """Return |V| of the windows of a signal with its past, (windows, points), by a sum for each."""
    whole = np.concatenate([[] if limit.past is None else limit.past[:, 0], signal])
    points = 4 * limit.length
    waves = np.exp(-2j * np.pi * np.outer(np.arange(points // 2 + 1), np.arange(limit.length)) / points)
    starts = range(0, len(whole) - limit.length + 1, limit.hop)
    return np.array([np.abs(waves @ (np.hanning(limit.length) * whole[s : s + limit.length])) for s in starts])


LIMIT = lfo.spectrum.closed_loop(NOTCH, AMPLITUDE, SAMPLING).changed(past=np.zeros((10, 1)))


@expensive
def test_the_record_has_the_spectra_of_the_applied_windows():
    log = noisy_and_soft()
    (found,) = log.spectra()
    np.testing.assert_allclose(found.magnitudes, windows_of(log.controls[:, 0], LIMIT), atol=1e-9)
    np.testing.assert_array_equal(found.begins, -10 + LIMIT.hop * np.arange(len(found.begins)))
    bounded = found.amplitude * found.magnitudes[:, found.bins]
    assert (found.frequencies[found.bins] / (2 * np.pi * SAMPLING)).min() == pytest.approx(5.3125)
    np.testing.assert_allclose(found.ratios, bounded / AMPLITUDE)
    window, point = found.worst
    assert found.amplitude * found.magnitudes[window, point] == bounded.max()
    assert found.exceeded.any()  # the price is low
    assert found.exceeded.sum() == (bounded > AMPLITUDE * (1 + 1e-6)).sum()
    assert "above it" in repr(found)


@expensive
def test_windows_count_what_has_acted():
    """With a delay the first control is zero; a control that acted in place of a planned one counts."""
    problem = oscillating_mass(control_spectrum=LIMIT)
    loop = lfo.RecedingHorizon(problem, delay=1, soft={"control_spectrum": 100.0})
    for k in range(34):
        loop.step([0.1, 0.0], applied=[0.5] if k == 20 else None)
    log = loop.log
    acted = np.concatenate([[0.0], log.controls[:-1, 0]])
    acted[19] = 0.5
    np.testing.assert_array_equal(log.acted[:, 0], acted)
    np.testing.assert_allclose(log.spectra()[0].magnitudes, windows_of(acted, LIMIT), atol=1e-9)


def test_states_and_outputs_have_their_windows():
    plain = lfo.spectrum.closed_loop(NOTCH, 0.01, SAMPLING)
    log = noisy(oscillating_mass())
    both = log.spectra(
        state_spectrum=plain,
        output_spectrum=lfo.spectrum.OutputSpectrum(C=[[2.0, 0.0]], constraints=plain, output_names=["twice"]),
    )
    assert [one.name for one in both] == ["x_0", "x_1", "twice"]
    np.testing.assert_allclose(both[0].magnitudes, windows_of(log.states[:, 0], plain), atol=1e-9)
    np.testing.assert_allclose(both[2].magnitudes, 2 * both[0].magnitudes, atol=1e-9)


def test_an_energy_has_one_limit_for_each_window():
    energy = lfo.spectrum.Spectrogram(lfo.spectrum.EnergyBound(0.5, band=NOTCH), length=20, hop=5)
    log = noisy(oscillating_mass())
    (found,) = log.spectra(control_spectrum=energy)
    assert found.joint
    sums = (found.magnitudes[:, found.bins] ** 2).sum(axis=1)
    np.testing.assert_allclose(found.ratios[:, 0], np.sqrt(sums / 0.5))
    assert found.worst[0] == sums.argmax()


@expensive
def test_one_window_over_past_and_plan_slides_with_the_loop():
    bound = lfo.MagnitudeBound(0.5, band=NOTCH)
    whole = lfo.spectrum.Spectrogram(bound, past=np.zeros(10))
    log = noisy(oscillating_mass(control_spectrum=whole), soft={"control_spectrum": 10.0})
    (found,) = log.spectra()
    assert found.length == 50  # of the past and the horizon
    np.testing.assert_array_equal(found.begins, np.arange(-10, -4))  # the last ends with the last control


@expensive
def test_short_loops_have_no_windows_and_other_constraints_are_refused():
    problem = oscillating_mass(control_spectrum=LIMIT)
    assert noisy(problem, 20).spectra() == ()
    assert lfo.RecedingHorizon(problem).log.spectra() == ()
    assert noisy(oscillating_mass(), 3).spectra() == ()
    with pytest.raises(lfo.errors.ProblemError, match=r"control_spectrum: .*Spectrogram"):
        noisy(oscillating_mass(), 3).spectra(control_spectrum=NOTCH)
    limit = lfo.spectrum.Spectrogram(lfo.MagnitudeBound(1.0, band=NOTCH, component=3), length=2)
    with pytest.raises(lfo.errors.ProblemError, match="component"):
        noisy(oscillating_mass(), 3).spectra(control_spectrum=limit)


@expensive
def test_the_page_shows_the_worst_window_and_the_bins_above_the_level(blank, tmp_path):
    log = noisy_and_soft()
    (found,) = log.spectra()
    page = log.save(tmp_path).read_text()
    assert "Windows of the applied signals" in page
    assert f"{int(found.exceeded.any(axis=1).sum())} of {len(found.begins)}" in page
    assert "5.31 to 10.6 Hz" in page
    assert f"7.5 Hz and {int(found.exceeded.any(axis=0).sum()) - 8} more" in page
    assert len(log.plot().axes) == 9  # with two panels for the windows
    assert "Windows of the applied signals" not in noisy(oscillating_mass(), 12).save(tmp_path).read_text()


def test_a_loop_at_its_set_point_stays_optimal():
    """Within 3e-6 of it, J is 4e-10: rounding counts by distances from the reference, not by the states' values."""
    step = 0.1
    dynamics = lfo.LinearDynamics([[1.0, step], [0.0, 1.0]], [[step * step / 2], [step]], sampling_time=step)
    cost = lfo.QuadraticCost(Q=[10.0, 1.0] * np.eye(2), P=[100.0, 10.0] * np.eye(2), R=1.0, x_ref=[1.0, 0.0])
    problem = lfo.OptimalControlProblem(dynamics, 60, cost, lfo.Box(-2, 2), initial_state=[0.0, 0.0])
    controller = lfo.RecedingHorizon(problem)
    for state in ([0.0, 0.0], [1.0 - 3e-6, 0.0]):
        controller.step(state)
        assert controller.log.steps[-1].status == "optimal"
        assert controller.log.steps[-1].gap < 1e-7


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"cost": lfo.QuadraticCost(Q=1.0, R=1.0, x_ref=np.arange(6.0)[:, None])}, "cost.x_ref"),
        ({"cost": lfo.QuadraticCost(R=1.0, r=np.arange(5.0)[:, None])}, "cost.r"),
        ({"state_set": lfo.Box(np.full((6, 1), -9.0), np.arange(6.0)[:, None])}, "state_set"),
        ({"control_set": lfo.Box(-1, np.arange(1, 6.0)[:, None])}, "control_set"),
        ({"dynamics": lfo.LinearDynamics([[1.0]], [[1.0]], np.arange(5.0)[:, None])}, "dynamics.offset"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_loop_warns_of_data_that_begin_anew_at_every_step(fields, field):
    plain = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]]), 5, lfo.QuadraticCost(R=1.0), initial_state=[0.0]
    )
    lfo.RecedingHorizon(plain)
    with pytest.warns(lfo.errors.ClosedLoopWarning, match=f"^{field}: given per time; every step of a loop plans with"):
        lfo.RecedingHorizon(replace(plain, **fields))
