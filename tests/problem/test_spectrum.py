"""Which DFT bins a band removes, against exact fractions, numpy.fft and the sums of the definition."""

from __future__ import annotations

import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lin_freq_ocp as lfo
from helpers.seeds import examples
from lin_freq_ocp import LinearDynamics, OptimalControlProblem, QuadraticCost, low_pass, stop_band
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.problem import Band, band_remarks, stopped_bins, time_signal
from lin_freq_ocp.spectrum import band_pass, high_pass, notch

LENGTHS = [1, 2, 3, 8, 9, 240, 241]


def removed(band: Band | list[Band] | None, length: int, sampling_time: float | None = None) -> list[int]:
    """Return the removed bins 0 .. N//2 of a signal of one component."""
    return np.flatnonzero(stopped_bins("band", band, length, ["u"], sampling_time)[:, 0]).tolist()


def half(length: int) -> range:
    return range(length // 2 + 1)


# ------------------------------------------------------------------------------- which bins, in exact arithmetic

EDGES = [Fraction(p, q) for p, q in ((1, 3), (2, 5), (1, 2), (4, 5), (7, 12), (119, 120))]  # of pi


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("edge", EDGES, ids=str)
def test_low_and_high_pass_keep_what_exact_fractions_say(length, edge):
    """Bin k has the frequency 2 k / N of pi: it is kept by a low pass iff 2 k / N <= edge."""
    cutoff = float(edge) * np.pi
    assert removed(low_pass(cutoff), length) == [k for k in half(length) if Fraction(2 * k, length) > edge]
    assert removed(high_pass(cutoff), length) == [k for k in half(length) if Fraction(2 * k, length) < edge]


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize(("low", "high"), [(EDGES[0], EDGES[2]), (EDGES[1], EDGES[3]), (EDGES[4], EDGES[5])])
def test_band_pass_and_notch_are_closed_and_open_intervals(length, low, high):
    lower, upper = float(low) * np.pi, float(high) * np.pi
    inside = [k for k in half(length) if low <= Fraction(2 * k, length) <= high]
    assert removed(band_pass(lower, upper), length) == [k for k in half(length) if k not in inside]
    strictly = [k for k in half(length) if low < Fraction(2 * k, length) < high]
    assert removed(notch((lower + upper) / 2, upper - lower), length) == strictly


def test_band_of_one_bin():
    assert removed(band_pass(np.pi / 4, np.pi / 4), 8) == [0, 2, 3, 4]
    assert removed(notch(np.pi / 4, 0.1), 8) == [1]
    assert removed(notch(0.0, 0.1), 8) == [0]  # DC alone
    assert removed(notch(np.pi, 0.1), 8) == [4]  # Nyquist alone
    assert removed(notch(np.pi, 0.1), 9) == []  # an odd length has no bin at Nyquist
    (remark,) = band_remarks([("band", notch(np.pi, 0.1))], 9, ["u"], None)
    assert "no bin of a signal of 9 samples; its bins are 2 pi / 9 rad/sample" in remark


@pytest.mark.parametrize("length", [5, 12, 60, 97, 240, 1000, 4096])
@pytest.mark.parametrize("sampling_time", [0.01, 0.1, 1 / 3, 0.0007, 25.0])
def test_a_cutoff_computed_to_lie_on_a_bin_keeps_it_however_it_was_rounded(length, sampling_time):
    inner = range(1, (length - 1) // 2, max(1, length // 37))
    for k in inner:
        above = list(range(k + 1, length // 2 + 1))
        for cutoff in (2 * np.pi * k / length, k * (2 * np.pi / length), np.pi * (2 * (k / length))):
            assert removed(low_pass(cutoff), length) == above
            assert removed(high_pass(cutoff), length) == list(range(k))
        for cutoff_hz in (k / (length * sampling_time), k / length / sampling_time, k * (1 / sampling_time / length)):
            assert removed(low_pass(cutoff_hz=cutoff_hz), length, sampling_time) == above
            assert removed(high_pass(cutoff_hz=cutoff_hz), length, sampling_time) == list(range(k))
        assert removed(notch(2 * np.pi * k / length, 4 * np.pi / length), length) == [k]  # neighbours are on its edges


@pytest.mark.parametrize("length", [60, 241])
def test_a_cutoff_next_to_a_bin_is_not_on_it(length):
    for k in (1, 7, length // 3):
        step = 2 * np.pi / length
        assert removed(low_pass((k - 1e-6) * step), length) == list(range(k, length // 2 + 1))
        assert removed(low_pass((k + 1e-6) * step), length) == list(range(k + 1, length // 2 + 1))
        assert removed(high_pass((k + 1e-6) * step), length) == list(range(k + 1))
        assert removed(high_pass((k - 1e-6) * step), length) == list(range(k))


def test_the_pendulum_of_the_paper():
    """The paper's passed set {1..96, 144..240}, read 0-based mod 240, has the stop band 97 .. 143."""
    listed = set(range(1, 97)) | set(range(144, 241))
    passed = {k % 240 for k in listed}
    assert passed == {-k % 240 for k in passed}  # closed under conjugation
    stopped = sorted(set(range(240)) - passed)
    assert stopped == list(range(97, 144))
    assert removed(stop_band(bins=stopped), 240) == list(range(97, 121))
    assert removed(low_pass(0.8 * np.pi), 240) == list(range(97, 121))
    assert removed(low_pass(96 * 2 * np.pi / 240), 240) == list(range(97, 121))
    one_based = {k - 1 for k in listed}
    assert one_based != {-k % 240 for k in one_based}


@settings(max_examples=examples(60), derandomize=True, deadline=None)
@given(
    length=st.integers(2, 400),
    sampling_time=st.sampled_from([0.01, 0.1, 1 / 3, 2.0]),
    fractions=st.tuples(st.floats(0.02, 0.98), st.floats(0.02, 0.98)),
)
def test_hertz_and_radians_agree(length, sampling_time, fractions):
    low, high = sorted(fractions)
    hz = np.array([low, high]) * 0.5 / sampling_time
    rad = np.array([low, high]) * np.pi
    pairs = [
        (low_pass(rad[0]), low_pass(cutoff_hz=hz[0])),
        (high_pass(rad[0]), high_pass(cutoff_hz=hz[0])),
        (band_pass(*rad), band_pass(lower_hz=hz[0], upper_hz=hz[1])),
    ]
    if high > low:
        pairs.append((notch(rad[0], rad[1] - rad[0]), notch(centre_hz=hz[0], width_hz=hz[1] - hz[0])))
    for radians, hertz in pairs:
        assert removed(radians, length) == removed(hertz, length, sampling_time)


def test_a_notch_may_reach_past_nyquist_in_either_unit():
    centre, width, sampling_time = 0.95 * np.pi, 0.2 * np.pi, 0.1
    assert removed(notch(centre, width), 40) == [18, 19, 20]
    factor = 1 / (2 * np.pi * sampling_time)
    assert removed(notch(centre_hz=centre * factor, width_hz=width * factor), 40, sampling_time) == [18, 19, 20]


def test_a_notch_may_reach_below_zero():
    assert removed(notch(0.02, 0.5), 40) == [0, 1]
    assert removed(notch(centre_hz=0.1, width_hz=1.0), 40, 0.1) == [0, 1, 2]


# ---------------------------------------------------------------------------------------------- bins given as bins


@settings(max_examples=examples(80), derandomize=True, deadline=None)
@given(data=st.data(), length=st.integers(1, 60))
def test_listed_bins_are_closed_under_conjugation(data, length):
    bins = data.draw(st.lists(st.integers(-length, length), min_size=1, max_size=8))
    full = {k % length for k in bins} | {-k % length for k in bins}
    if len(full) == length:
        return  # removes everything, see below
    found = removed(stop_band(bins=bins), length)
    assert found == sorted(k for k in full if k <= length // 2)
    assert {k % length for k in found} | {-k % length for k in found} == full
    assert removed(stop_band(bins=[-k for k in bins]), length) == found
    assert removed(stop_band(bins=np.array(bins)), length) == found


@pytest.mark.parametrize("length", [7, 8])
def test_a_real_signal_without_the_half_spectrum_has_no_conjugate_bins_either(length):
    signal = np.random.default_rng(1).normal(size=length)
    bins = [0, 3, length - 1]
    mask = stopped_bins("band", stop_band(bins=bins), length, ["u"], None)[:, 0]
    filtered = np.fft.irfft(np.where(mask, 0, np.fft.rfft(signal)), n=length)
    spectrum = np.abs(np.fft.fft(filtered))
    closed = sorted({k for k in bins} | {-k % length for k in bins})
    np.testing.assert_allclose(spectrum[closed], 0, atol=1e-13)
    others = [k for k in range(length) if k not in closed]
    np.testing.assert_allclose(spectrum[others], np.abs(np.fft.fft(signal))[others], rtol=1e-12)


@pytest.mark.parametrize("bins", [[8 + 1], [-9], [3, 100], [10**12], [10**30]])
def test_bins_that_the_signal_does_not_have_are_refused(bins):
    with pytest.raises(ProblemError, match=r"bins 0 \.\. 7") as caught:
        removed(stop_band(bins=bins), 8)
    assert caught.value.field == "band.bins"


# ------------------------------------------------------------------------------------- several bands and components

NAMES = ["position [m]", "speed [m/s]", "speed of light"]


@pytest.mark.parametrize(
    ("component", "columns"),
    [
        (None, [0, 1, 2]),
        (1, [1]),
        (np.int64(2), [2]),
        ("position [m]", [0]),
        ("position", [0]),
        ("speed", [1]),
        ("speed of light", [2]),
    ],
)
def test_components_by_index_name_and_name_without_unit(component, columns):
    mask = stopped_bins("band", stop_band(bins=[1, 4], component=component), 10, NAMES, None)
    expected = np.zeros((6, 3), dtype=bool)
    expected[np.ix_([1, 4], columns)] = True
    np.testing.assert_array_equal(mask, expected)
    assert not mask.flags.writeable


@pytest.mark.parametrize("component", [3, -1, True, "velocity", "speed [m]", "", 1.0])
def test_components_that_do_not_exist_are_refused(component):
    with pytest.raises(ProblemError) as caught:
        stopped_bins("band", [low_pass(1.0), low_pass(1.0, component=component)], 10, NAMES, None)
    assert caught.value.field == "band[1].component"
    assert "'speed of light'" in caught.value.expected


def test_a_name_without_unit_must_be_unique():
    with pytest.raises(ProblemError):
        stopped_bins("band", low_pass(1.0, component="speed"), 10, ["speed [m/s]", "speed [rad/s]"], None)


def test_bands_are_united_per_component():
    bands = [low_pass(0.8 * np.pi, component=0), stop_band(bins=[1, 9]), notch(np.pi / 2, 0.1, component="speed")]
    mask = stopped_bins("band", bands, 40, NAMES, None)
    assert np.flatnonzero(mask[:, 0]).tolist() == [1, 9, 17, 18, 19, 20]
    assert np.flatnonzero(mask[:, 1]).tolist() == [1, 9, 10]
    assert np.flatnonzero(mask[:, 2]).tolist() == [1, 9]
    np.testing.assert_array_equal(mask, stopped_bins("band", bands[::-1], 40, NAMES, None))
    np.testing.assert_array_equal(mask, stopped_bins("band", [*bands, bands[1]], 40, NAMES, None))
    assert not stopped_bins("band", None, 40, NAMES, None).any()
    assert not stopped_bins("band", [], 40, NAMES, None).any()


def test_a_state_has_one_sample_more_than_a_control():
    """The same band in Hz is other bins of a state: its DFT has length T + 1."""
    problem = OptimalControlProblem(
        LinearDynamics([[1.0]], [[1.0]], sampling_time=0.1),
        8,
        QuadraticCost(R=1.0),
        control_spectrum=low_pass(cutoff_hz=2.6),
        state_spectrum=low_pass(cutoff_hz=2.6),
    )
    assert problem.control_stop.shape == (5, 1)
    assert problem.state_stop.shape == (5, 1)
    assert np.flatnonzero(problem.control_stop).tolist() == [3, 4]  # bins k / 0.8 Hz: 2 * 1.25 = 2.5 <= 2.6
    assert np.flatnonzero(problem.state_stop).tolist() == [3, 4]  # bins k / 0.9 Hz: 2 * 1.11, 3 * 1.11 = 3.3
    longer = OptimalControlProblem(problem.dynamics, 9, problem.cost, state_spectrum=stop_band(bins=[5]))
    assert np.flatnonzero(longer.state_stop).tolist() == [5]  # the Nyquist bin of 10 samples


# --------------------------------------------------------------------------------------- nothing, everything, nonsense


@pytest.mark.parametrize(
    ("band", "words"),
    [
        (low_pass(np.pi), "removes no bin"),
        (low_pass(cutoff_hz=5.0), "removes no bin"),
        (high_pass(0.0), "removes no bin"),
        (band_pass(0.0, np.pi), "removes no bin"),
        (notch(0.5, 1e-3), "removes no bin"),  # between bins 0 and 1
        (band_pass(0.4, 0.41), "removes every bin"),
        (stop_band(bins=range(8)), "removes every bin"),
        (stop_band(bins=[0, 1, 2, 3, 4]), "removes every bin"),
    ],
)
def test_a_band_that_removes_nothing_or_everything_says_so(band, words):
    mask = stopped_bins("control_spectrum", band, 8, ["u"], 0.1)
    assert mask.all() == ("every" in words)
    assert mask.any() == ("every" in words)
    (remark,) = band_remarks([("control_spectrum", band)], 8, ["u"], 0.1)
    assert words in remark
    assert "control_spectrum" in remark
    assert "8 samples" in remark


@pytest.mark.parametrize("band", [low_pass(0.0), high_pass(np.pi), stop_band(bins=[4]), notch(np.pi / 2, 0.1)])
def test_a_band_that_removes_something_says_nothing(band):
    assert 0 < len(removed(band, 8)) < 5  # warnings are errors here


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: low_pass(), "low_pass.cutoff"),
        (lambda: low_pass(1.0, cutoff_hz=1.0), "low_pass.cutoff"),
        (lambda: low_pass(3.2), "low_pass.cutoff"),  # above pi: probably Hz
        (lambda: low_pass(-0.1), "low_pass.cutoff"),
        (lambda: low_pass(np.nan), "low_pass.cutoff"),
        (lambda: low_pass(cutoff_hz=np.inf), "low_pass.cutoff_hz"),
        (lambda: low_pass("fast"), "low_pass.cutoff"),
        (lambda: low_pass([1.0, 2.0]), "low_pass.cutoff"),
        (lambda: high_pass(4.0), "high_pass.cutoff"),
        (lambda: band_pass(1.0), "band_pass.upper"),
        (lambda: band_pass(2.0, 1.0), "band_pass"),
        (lambda: band_pass(1.0, upper_hz=2.0), "band_pass"),
        (lambda: notch(1.0), "notch.width"),
        (lambda: notch(1.0, 0.0), "notch.width"),
        (lambda: notch(1.0, width_hz=1.0), "notch"),
        (lambda: notch(5.0, 1.0), "notch.centre"),
        (lambda: stop_band(bins=[]), "stop_band.bins"),
        (lambda: stop_band(bins=[1.5]), "stop_band.bins"),
        (lambda: stop_band(bins=[True]), "stop_band.bins"),
        (lambda: stop_band(bins="12"), "stop_band.bins"),
        (lambda: stop_band(bins=None), "stop_band.bins"),
        (lambda: stop_band(), "stop_band.bins"),
        (lambda: stop_band([5, 7]), "stop_band.bins"),
        (lambda: removed(low_pass(cutoff_hz=2.0), 8), "band"),  # no sampling time
        (lambda: removed(low_pass(cutoff_hz=5.1), 8, 0.1), "band.low_pass"),
        (lambda: removed([low_pass(1.0), high_pass(cutoff_hz=5.1)], 8, 0.1), "band[1].high_pass"),
        (lambda: removed(band_pass(lower_hz=1.0, upper_hz=50.0), 8, 0.1), "band.band_pass"),
        (lambda: removed(notch(centre_hz=5.5, width_hz=1.0), 8, 0.1), "band.notch"),  # its centre is beyond
        (lambda: removed([1.0], 8), "band[0]"),
    ],
)
def test_bands_that_are_none_are_refused_by_name(make, field):
    with pytest.raises(ProblemError) as caught:
        make()
    assert caught.value.field == field


def test_the_nyquist_frequency_itself_is_allowed():
    for sampling_time in (0.1, 0.3, 1 / 7, 0.007):
        assert removed(high_pass(cutoff_hz=0.5 / sampling_time), 8, sampling_time) == [0, 1, 2, 3]
        assert removed(high_pass(cutoff_hz=1 / (2 * sampling_time)), 8, sampling_time) == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("band", "shown"),
    [
        (low_pass(1.5), "low_pass(0 .. 1.5 rad/sample)"),
        (high_pass(cutoff_hz=3), "high_pass(3 Hz)"),
        (notch(1.0, 0.5, component="speed"), "notch(0.75 .. 1.25 rad/sample) on 'speed'"),
        (stop_band(bins=[3, 4]), "stop_band([3, 4])"),
    ],
)
def test_a_band_is_shown_as_it_was_asked_for(band, shown):
    assert str(band) == shown


# --------------------------------------------------------------------------------------------- multipliers as signals


@pytest.mark.parametrize("length", [1, 2, 3, 6, 7, 240, 241])
def test_time_signal_is_the_sum_of_the_definition(length):
    """(R' rho)_t = sum_k Re(rho_k exp(2 pi i k t / N)) over k = 0 .. N//2."""
    rng = np.random.default_rng(2)
    rho = rng.normal(size=(length // 2 + 1, 2)) + 1j * rng.normal(size=(length // 2 + 1, 2))
    phase = np.exp(2j * np.pi * np.outer(np.arange(length), half(length)) / length)
    found = time_signal(rho, length)
    assert found.shape == (length, 2)
    np.testing.assert_allclose(found, (phase @ rho).real, atol=1e-12)


@pytest.mark.parametrize("length", [6, 7])
def test_time_signal_is_the_adjoint_of_the_spectrum(length):
    """<R' rho, v> = Re sum_k conj(rho_k) vhat_k, which is how rho prices the bins of v."""
    rng = np.random.default_rng(3)
    bins = length // 2 + 1
    rho = rng.normal(size=(bins, 1)) + 1j * rng.normal(size=(bins, 1))
    v = rng.normal(size=(length, 1))
    price = (np.conj(rho) * np.fft.rfft(v, axis=0)).real.sum()
    assert (time_signal(rho, length) * v).sum() == pytest.approx(price, rel=1e-12)


def test_time_signal_of_one_bin():
    rho = np.zeros((5, 1), dtype=complex)
    rho[3] = 2 - 1j
    t = np.arange(8)
    expected = 2 * np.cos(2 * np.pi * 3 * t / 8) + np.sin(2 * np.pi * 3 * t / 8)
    np.testing.assert_allclose(time_signal(rho, 8)[:, 0], expected, atol=1e-14)


def test_bands_that_together_remove_everything_say_so():
    bands, signal = [low_pass(1.0), high_pass(2.0, component=1)], (40, ["a", "b"], None)
    assert stopped_bins("bands", bands, *signal).all(axis=0).tolist() == [False, True]
    (remark,) = band_remarks([(f"bands[{i}]", band) for i, band in enumerate(bands)], *signal)
    assert re.match(r"bands\[1\]: high_pass.* that the bands before it keep", remark)


def free_control(T, constraint, **fields):
    plant = lfo.LinearDynamics([[0.0]], [[1.0]])
    return lfo.OptimalControlProblem(plant, T, control_spectrum=constraint, initial_state=[0.0], **fields)


def test_a_mask_between_its_points_holds_at_every_frequency():
    """The control with the largest V half way between two points of the grid."""
    T, q = 8, 2
    mask = lfo.MagnitudeBound(1.0, bins=range(5), oversampling=q, between=True)
    half_way = 2 * np.pi * 3.5 / (q * T)
    cost = lfo.QuadraticCost(r=-np.cos(half_way * (np.arange(T) - 3.5))[:, None])
    u = lfo.solve(free_control(T, mask, cost=cost)).control[:, 0]
    largest = np.abs(np.fft.rfft(u, 4096)).max()
    assert 0.75 < largest <= 1 + 1e-6


@pytest.mark.parametrize(("share", "holds"), [(1 + 1e-6, True), (1 - 1e-6, False)])
@pytest.mark.parametrize("q", [1, 3])
def test_an_energy_on_a_finer_grid_is_divided_by_its_fineness(q, share, holds):
    T, u = 8, np.random.default_rng(0).standard_normal((8, 1))
    energy = float((np.abs(np.fft.rfft(u[:, 0], q * T)) ** 2).sum()) / q
    bound = lfo.spectrum.EnergyBound(share * energy, bins=range(5), oversampling=q)
    problem = free_control(T, bound, cost=lfo.QuadraticCost(R=1.0))
    there = lfo.simulate(problem, u)
    assert bool(problem.terms[0].violation(there.x, there.u).max() == 0) is holds


def test_a_limit_that_begins_within_its_band_is_refused():
    points = np.array([[1.5, 1.0], [np.pi, 1.0]])
    mask = lfo.MagnitudeBound(points, band=lfo.low_pass(cutoff=1.0), every_frequency=True)
    with pytest.raises(lfo.errors.ProblemError, match=r"points from 1\.5"):
        _ = free_control(8, mask, cost=lfo.QuadraticCost(R=1.0)).terms
