"""Limits on spectra in the unit of the field: their sums of samples, by sinusoids, and how values are shown."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.signal import get_window, periodogram

import lin_freq_ocp as lfo
from helpers.schemas import PROBLEM
from helpers.schemas import faults as faults_of_schema
from lin_freq_ocp.comparison import controls_of
from lin_freq_ocp.files import result_summary
from lin_freq_ocp.loop import excess
from lin_freq_ocp.pages import answer_data, comparison_rows, faults, held_panels, result_data, spectra_figure
from lin_freq_ocp.transform import all_limits, translation_of

N, STEP, HZ = 20, 1e-3, 50.0  # one period of 50 Hz: order k is bin k
T = np.arange(N)
Mask, Energy, HIGH = lfo.MagnitudeBound, lfo.spectrum.EnergyBound, lfo.spectrum.high_pass(cutoff_hz=120)
WANTED = 3 * np.cos(2 * np.pi * T / N) + np.cos(2 * np.pi * 5 * T / N) + 0.8 * np.sin(2 * np.pi * 7 * T / N)


def problem(constraint: Any, step: float | None = STEP) -> lfo.OptimalControlProblem:
    """Return the problem to follow WANTED, whose DFT has the bins 1, 5 and 7, by a control in A."""
    names = {"state_names": ["charge [A s]"], "control_names": ["i [A]"], "sampling_time": step}
    cost = lfo.QuadraticCost(R=1.0, u_ref=WANTED[:, None])
    dynamics = lfo.LinearDynamics([[1.0]], [[STEP]], **names)
    return lfo.OptimalControlProblem(dynamics, N, cost, initial_state=[0.0], control_spectrum=constraint)


def radii(constraint: Any) -> list[float]:
    """Return the largest sums of samples that a constraint allows."""
    (term,) = problem(constraint).terms
    return np.ravel(term.penalty.radius).tolist()


def sinusoid(order: int) -> Any:
    """Return a sinusoid of amplitude 1, at bins 0 and N/2 a constant and an alternating signal."""
    return np.cos(2 * np.pi * order * T / N + (0.3 if 0 < order < N // 2 else 0.0))


@pytest.mark.parametrize("window", [None, "hann"])
@pytest.mark.parametrize("order", [0, 5, N // 2])
def test_a_limit_is_the_sum_of_a_signal_of_that_size(order, window):
    taper = np.ones(N) if window is None else get_window(window, N, fftbins=False)
    level, at, v = 0.7, {"bins": [order], "window": window}, 0.7 * sinusoid(order)
    rms = level if order in (0, N // 2) else np.sqrt((v**2).mean())
    sums = level * taper.sum() / (1 if order in (0, N // 2) else 2)
    if window is None:
        assert sums == pytest.approx(abs(np.fft.rfft(v)[order]), rel=1e-12)
    density = periodogram(v, 1 / STEP, window=taper, detrend=False)[1][order]
    assert radii(Mask(amplitude=level, **at)) == pytest.approx([sums], rel=1e-12)
    assert radii(Mask(rms=rms, **at)) == pytest.approx([sums], rel=1e-12)
    assert radii(Mask(percent=35, of=2.0, **at)) == pytest.approx([sums], rel=1e-12)
    assert radii(Mask(db=20 * np.log10(level / 2), reference=2.0, **at)) == pytest.approx([sums], rel=1e-12)
    of_v = abs(np.fft.rfft(taper * v)[order])
    assert radii(Mask(density=density, **at)) == pytest.approx([of_v], rel=1e-12)
    assert radii(Mask(level, **at)) == [level]


def test_a_band_is_bounded_by_its_rms_value_as_parseval_counts():
    v = 3 * sinusoid(2) + 0.4 * sinusoid(5) + 0.3 * sinusoid(8)
    inside = np.fft.rfft(v) * np.isin(np.arange(N // 2 + 1), [5, 8])
    rms = np.sqrt((np.fft.irfft(inside, N) ** 2).mean())
    root = np.sqrt((np.abs(inside) ** 2).sum())
    assert radii(Energy(rms=rms, bins=[5, 8])) == pytest.approx([root], rel=1e-12)
    assert radii(Energy(amplitude=0.5, harmonics=[8, 5], fundamental_hz=HZ)) == pytest.approx([root], rel=1e-12)
    assert radii(Energy(percent=50, of=1.0, bins=[5, 8])) == pytest.approx([root], rel=1e-12)


def test_points_are_in_hz_and_linear_between_them():
    low = Mask(amplitude=[[0, 5.0], [100, 1.0], [500, 0.2]], band=HIGH)  # at bins 0, 1 and 2: 0, 50 and 100 Hz
    assert radii(low) == pytest.approx([5.0 * N, 3.0 * N / 2, 1.0 * N / 2], rel=1e-12)
    steep = Mask(db=[[50, 0.0], [5000, -40.0]], reference=1.0, band=lfo.spectrum.notch(centre_hz=500, width_hz=200))
    allowed = np.array([450, 500]) / 50  # 20 dB a decade
    assert radii(steep) == pytest.approx((N / allowed * [0.5, 1.0]).tolist(), rel=1e-12)
    dense = Mask(density=[[100, 2.0], [200, 4.0]], band=lfo.spectrum.notch(centre_hz=150, width_hz=20))
    assert radii(dense) == pytest.approx([np.sqrt(3.0 * N / STEP / 2)], rel=1e-12)


def test_at_every_frequency_an_amplitude_counts_alike_up_to_both_ends():
    (term,) = problem(Mask(amplitude=[[0, 2.0], [200, 1.0]], band=HIGH, every_frequency=True)).terms
    assert term.semi_infinite.limits.at(np.array([0.0, 2 * np.pi * 100 * STEP])) == pytest.approx([N, 1.5 * N / 2])
    (term,) = problem(Mask(density=[[0, 1.0], [200, 9.0]], band=HIGH, every_frequency=True)).terms
    middle = term.semi_infinite.limits.at(np.array([2 * np.pi * 100 * STEP]))
    assert middle == pytest.approx([np.sqrt(5.0 * N / STEP / 2)], rel=1e-4)
    fine = problem(Mask(amplitude=1.0, bins=[0, 1], oversampling=4, between=True)).terms[0]
    assert fine.penalty.radius == pytest.approx(np.cos(np.pi / 8) * N / 2)


def test_a_plan_is_that_of_the_sum():
    by_order = lfo.solve(problem(Mask(harmonics={7: 0.4, 5: 0.25}, fundamental_hz=HZ)))
    by_sum = lfo.solve(problem(Mask([0.25 * N / 2, 0.4 * N / 2], bins=[5, 7])))
    np.testing.assert_array_equal(by_order.control, by_sum.control)
    assert np.abs(np.fft.rfft(by_order.control[:, 0]))[[5, 7]] * 2 / N == pytest.approx([0.25, 0.4], rel=1e-6)
    assert [str(reading) for reading in by_order.readings] == [
        "5th harmonic of i: 0.25 of 0.25 A",
        "7th harmonic of i: 0.4 of 0.4 A",
    ]
    assert "5th harmonic of i: 0.25 of 0.25 A" in str(by_order)
    prices = by_order.sensitivities.limits["mask on i [A]"][:, 0]
    moved = lfo.solve(problem(Mask(harmonics={5: 0.25 + 1e-4, 7: 0.4}, fundamental_hz=HZ)))
    assert prices[0] == pytest.approx((moved.cost - by_order.cost) / 1e-4, rel=1e-3)


@pytest.mark.parametrize("phase", [0.0, 0.4])
def test_a_part_of_the_fundamental_is_one_of_its_component_with_that_phase(phase):
    part = {"of": "fundamental", "phase": phase, "fundamental_hz": HZ}
    result = lfo.solve(problem(Mask(percent={5: 10, 7: 20}, **part)))
    u = 2 / N * np.fft.rfft(result.control[:, 0])
    along = (u[1] * np.exp(-1j * phase)).real
    assert np.abs(u[[5, 7]]) == pytest.approx([0.1 * along, 0.2 * along], rel=1e-6)
    assert str(result.readings[0]) == "5th harmonic of i: 10 of 10 % of fundamental"
    total = lfo.solve(problem(Energy(percent=15, harmonics=range(2, 10), **part)))
    u = 2 / N * np.fft.rfft(total.control[:, 0])
    assert np.linalg.norm(u[2:10]) == pytest.approx(0.15 * (u[1] * np.exp(-1j * phase)).real, rel=1e-6)
    assert result.status == total.status == "optimal"
    for control, value in ((np.zeros((N, 1)), 0.0), (-result.control, np.inf)):  # no fundamental, and an opposite one
        (reading, _) = (one for term in result.problem.terms for one in term.readings(np.zeros((N + 1, 1)), control))
        assert reading.value == value


def test_a_price_is_per_unit_of_the_limit():
    soft = problem(Mask(amplitude=0.1, bins=[0, 5], penalty=2.0))
    control = WANTED[:, None] + 0.3
    x = np.zeros((N + 1, 1))
    assert sum(term.cost(x, control).sum() for term in soft.terms) == pytest.approx(2.0 * (0.2 + 0.9), rel=1e-12)


def test_a_band_shows_its_value_nearest_to_the_limit():
    result = lfo.solve(problem(Mask(rms=0.1, band=lfo.low_pass(cutoff_hz=120))))
    (reading,) = result.readings
    assert str(reading).startswith("i, above 120 Hz: 0.1 of 0.1 A RMS at ")
    assert reading.place in (" at 250 Hz", " at 350 Hz")
    (term,) = problem(Mask(amplitude=0.5, band=lfo.low_pass(cutoff_hz=200), every_frequency=True)).terms
    (peak,) = term.readings(np.zeros((N + 1, 1)), WANTED[:, None])
    w = np.linspace(2 * np.pi * 0.2, np.pi, 40001)
    padded = 2 / N * np.abs(np.exp(-1j * np.outer(w, T)) @ WANTED)
    assert peak.value == pytest.approx(padded.max(), rel=1e-6)
    assert peak.place == f" at {w[padded.argmax()] / (2 * np.pi * STEP):.4g} Hz"
    (rest,) = term.readings(np.zeros((N + 1, 1)), np.zeros((N, 1)))
    assert (rest.value, rest.limit) == (0.0, 0.5)
    window = lfo.spectrum.Spectrogram(Mask(amplitude=0.2, bins=[5]), length=N, past=np.zeros(3))
    assert "bin 5 of i, in a window" in [reading.label for reading in lfo.solve(problem(window)).readings]


@pytest.mark.parametrize(
    ("bound", "amount", "words"),
    [
        (Mask(amplitude=0.5, bins=[0, 5]), 0.25, "limit 0.5 A -> 0.75 A"),
        (Mask(density=4.0, bins=[5]), 1.0, "limit 4 A²/Hz -> 9 A²/Hz"),
        (Mask(db=0.0, reference=2.0, bins=[5]), 9.0, "limit 0 dB re 2 A -> 20 dB re 2 A"),
        (
            Mask(percent=[3, 4], of="fundamental", phase=0, bins=[5, 7], fundamental_hz=HZ),
            1.0,
            "limit 4 % of fundamental",
        ),
        (Mask([3.0, 4.0], bins=[5, 7]), 1.0, "limit 4 -> 5"),
        (Energy(4.0, bins=[5, 7]), 1.0, "limit 4 -> 9"),
    ],
)
def test_a_repair_is_in_the_unit_of_the_limit(bound, amount, words):
    given = problem(bound)
    (limit,) = (limit for limit in all_limits(given) if limit.field == "control_spectrum" and limit.constrains)
    relaxed = limit.relaxed(given, amount)
    assert limit.words(relaxed, amount, np.zeros(0)).startswith(words)
    assert relaxed.control_spectrum[0].highest == pytest.approx(bound.highest + amount)


def test_a_record_without_whole_periods_is_told_which_would_do():
    with pytest.raises(
        lfo.errors.ProblemError, match=r"got 20 samples.*1\.2 periods of 60 Hz.*50 samples are 3 periods"
    ):
        problem(Mask(harmonics={5: 1.0}, fundamental_hz=60))
    with pytest.raises(lfo.errors.ProblemError, match="With a sampling time of"):
        problem(Mask(harmonics={5: 1.0}, fundamental_hz=np.sqrt(3)))
    with pytest.raises(lfo.errors.ProblemError, match="a whole number of periods"):
        problem(Mask(harmonics={5: 1.0}, fundamental_hz=HZ * (1 + 1e-7)))


BAD = {
    "nothing": ({}, "MagnitudeBound.limit", "amplitude= is that of a sinusoid"),
    "two": ({"rms": 1, "amplitude": 1}, "MagnitudeBound.limit", "amplitude and rms"),
    "nan": ({"amplitude": np.nan}, "MagnitudeBound.amplitude", "nan"),
    "negative": ({"rms": -1}, "MagnitudeBound.rms", "zero or above"),
    "text": ({"density": "1 A"}, "MagnitudeBound.density", "no units"),
    "percent of nothing": ({"percent": 2}, "MagnitudeBound.of", "a value with percent"),
    "percent of zero": ({"percent": 2, "of": 0}, "MagnitudeBound.of", "above zero"),
    "percent of numbers": ({"percent": 2, "of": np.ones(2)}, "MagnitudeBound.of", "one number"),
    "a fundamental below zero": (
        {"percent": 2, "of": "fundamental", "phase": 0, "fundamental_hz": -50.0},
        "MagnitudeBound.fundamental_hz",
        "above zero",
    ),
    "percent of a name": ({"percent": 2, "of": "i"}, "MagnitudeBound.of", "or 'fundamental'"),
    "an idle of": ({"rms": 2, "of": 3}, "MagnitudeBound.of", "only with it"),
    "no phase": ({"percent": 2, "of": "fundamental", "fundamental_hz": HZ}, "MagnitudeBound.phase", "is not convex"),
    "an idle phase": ({"percent": 2, "of": 1, "phase": 0}, "MagnitudeBound.phase", "of='fundamental'"),
    "no fundamental": ({"percent": 2, "of": "fundamental", "phase": 0}, "MagnitudeBound.fundamental_hz", "Hz"),
    "an idle fundamental": ({"rms": 2, "fundamental_hz": 50}, "MagnitudeBound.fundamental_hz", "None without"),
    "no reference": ({"db": 2}, "MagnitudeBound.reference", "db or limit_db"),
    "a zero reference": ({"db": 2, "reference": 0}, "MagnitudeBound.reference", "above zero"),
    "points of bins": ({"amplitude": [[1, 2], [3, 4]]}, "MagnitudeBound.amplitude", "a band of frequencies"),
    "a soft part": (
        {"percent": 2, "of": "fundamental", "phase": 0, "fundamental_hz": HZ, "penalty": 1.0},
        "MagnitudeBound.percent",
        "State of= as a number",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_wrong_limit_is_refused_by_its_keyword(case):
    fields, field, words = BAD[case]
    with pytest.raises(lfo.errors.ProblemError) as caught:
        Mask(bins=[5], **fields)
    assert caught.value.field == field
    assert words in str(caught.value)


ORDERS = {
    "an order of zero": ({0: 1.0}, "MagnitudeBound.harmonics", "from 1"),
    "half an order": ({2.5: 1.0}, "MagnitudeBound.harmonics", "whole numbers"),
    "no order": ({}, "MagnitudeBound.harmonics", "different orders"),
    "no limit": ({5: None}, "MagnitudeBound.harmonics", "None"),
    "above Nyquist": ({11: 1.0}, "control_spectrum.harmonics", "orders up to 10"),
}


@pytest.mark.parametrize("case", ORDERS)
def test_wrong_orders_are_refused(case):
    limits, field, words = ORDERS[case]
    with pytest.raises(lfo.errors.ProblemError) as caught:
        problem(Mask(harmonics=limits, fundamental_hz=HZ))
    assert caught.value.field == field
    assert words in str(caught.value)


def test_what_a_problem_lacks_is_named():
    for wrong, step, words in (
        (Mask(density=1.0, bins=[5]), None, "no sampling time"),
        (Mask(harmonics={5: 1.0}, fundamental_hz=HZ), None, "dynamics.sampling_time"),
        (Mask(amplitude=1.0, bins=[5], window=-np.ones(N)), STEP, "a sum above zero"),
        (Mask(amplitude=[[0, 1.0], [50, 2.0]], band=HIGH), STEP, "points from 0 to 100 Hz"),
        (Mask(amplitude=[1.0, 2.0], bins=[5]), STEP, "control_spectrum.amplitude"),
        (Energy(rms=1.0, band=HIGH), STEP, "bins between 0 and N/2"),
    ):
        with pytest.raises(lfo.errors.ProblemError, match=words.replace(".", r"\.")):
            problem(wrong, step)
    for make, words in (
        (lambda: Energy(rms=1.0, bins=[5], window="hann"), "the record itself"),
        (lambda: Energy(percent={5: 1.0}, of=1.0, fundamental_hz=HZ), "one number"),
        (lambda: Mask(amplitude={5: 1.0}, harmonics=[5], fundamental_hz=HZ), "orders only once"),
        (lambda: Mask(rms=[1.0, 2.0, 3.0], harmonics=[5, 7], fundamental_hz=HZ), "one per harmonic"),
        (lambda: Mask(rms=1.0, harmonics=[5, 5], fundamental_hz=HZ), "different orders"),
        (lambda: Mask(rms=1.0, harmonics=[5], fundamental_hz=HZ, every_frequency=True), "a band of frequencies"),
        (lambda: Mask(rms=1.0, harmonics=[5], fundamental_hz=HZ, bins=[5]), "exactly one of them"),
    ):
        with pytest.raises(lfo.errors.ProblemError, match=words):
            make()
    part = Mask(percent={5: 1.0}, of="fundamental", phase=0.0, fundamental_hz=HZ)
    with pytest.raises(lfo.errors.ProblemError, match="a window has no fundamental"):
        lfo.spectrum.Spectrogram(part, length=10)
    assert part.softened(2.0) is part


def test_comparisons_and_figures_are_in_the_unit_of_the_limit():
    bound = Mask(harmonics={5: 0.25, 7: 0.5}, fundamental_hz=HZ)
    comparison = lfo.compare(problem(bound), filters=[])
    groups = {group.title: group for group in comparison_rows(comparison).groups}
    rows = groups["Limited spectra"].rows
    assert [(row.label, row.unit) for row in rows] == [
        ("5th harmonic of i", "A, limit 0.2500"),
        ("7th harmonic of i", "A, limit 0.5000"),
    ]
    assert [(cell.text, cell.passed) for cell in rows[0].cells] == [("1.000", False), ("0.2500", True)]
    assert not any(row.label.startswith("mask") for group in groups.values() for row in group.rows)
    without = comparison.trajectories[0]
    (fault,) = (fault for fault in faults(without, comparison) if "mask" in fault)
    assert fault == "violates mask on i (5th harmonic of i: 1 of 0.25 A)"


AXES = {
    "amplitude": (Mask(amplitude=0.3, bins=[0, 5]), "amplitude of i [A]", [[0.3], [0.3]]),
    "density": (Mask(density=0.02, bins=[5]), "power spectral density of i [A²/Hz]", [[0.02]]),
    "db": (Mask(db=-20, reference=2.0, bins=[5]), "amplitude of i [dB re 2 A]", [[0.1]]),
    "sums": (Mask(2.0, bins=[5]), "|DFT of i| [A]", [[2.0]]),
    "two units": ([Mask(2.0, bins=[5]), Mask(rms=2.0, bins=[7])], "|DFT of i| [A]", [[2.0], [2.0 * N / 2**0.5]]),
    "part": (Mask(percent={5: 9}, of="fundamental", phase=0, fundamental_hz=HZ), "amplitude of i [A]", []),
    "every frequency": (Mask(rms=0.3, band=HIGH, every_frequency=True), "RMS value of i [A RMS]", [[0.3, 0.3]]),
}


@pytest.mark.parametrize("case", AXES)
def test_the_axis_of_a_spectrum_has_the_unit_of_its_limits(case):
    bound, label, limits = AXES[case]
    (signal,) = controls_of(problem(bound))
    assert signal.axis.label == label
    levels = [line.values.tolist() for line in signal.levels]
    assert levels == [pytest.approx(limit, rel=1e-12) for limit in limits]
    sums = np.array([N * 0.3 * (0.5 if case == "every frequency" else 1.0), N / 2 * 0.3])
    drawn = {"density": 0.09 * N * STEP / 2, "db": 0.15, "every frequency": 0.3 / 2**0.5}.get(case, 0.3)
    if "|DFT" not in label:
        shown = signal.axis.of_sums(np.array([0.0, 0.3]), sums)
        assert shown[1] == pytest.approx(drawn, rel=1e-12)
        assert shown[0] == pytest.approx(drawn * (2 if case == "density" else 1), rel=1e-12)


def test_the_tables_of_the_standards_are_rms_values_by_order():
    class_a = lfo.spectrum.iec_61000_3_2_class_a(orders=[3, 2, 5, 15, 40, 39, 8])
    assert class_a.quantity.keyword == "rms"
    assert class_a.limit.tolist() == pytest.approx([1.08, 2.30, 1.14, 0.23, 0.15, 0.15 * 15 / 39, 0.23 * 8 / 40])
    assert len(lfo.spectrum.iec_61000_3_2_class_a().limit) == 39
    for ratio, low, total in ((19.9, 4.0, 5.0), (20, 7.0, 8.0), (999, 12.0, 15.0), (1000, 15.0, 20.0)):
        each, demand = lfo.spectrum.ieee_519(200.0, ratio, orders=[5, 4])
        assert each.limit.tolist() == pytest.approx([2 * low / 4, 2 * low])
        assert demand.limit == pytest.approx(2 * total)
    each, _ = lfo.spectrum.ieee_519(100.0, 30, orders=[9, 11, 16, 17, 23, 35, 50], component=0)
    assert each.limit.tolist() == pytest.approx([7.0, 3.5, 3.5 / 4, 2.5, 1.0, 0.5, 0.5 / 4])
    assert (each.component, each.fundamental_hz) == (0, 60.0)
    for make in (
        lambda: lfo.spectrum.iec_61000_3_2_class_a(orders=[1, 3]),
        lambda: lfo.spectrum.ieee_519(1, 1, 60, [51]),
    ):
        with pytest.raises(lfo.errors.ProblemError, match="orders from 2 to"):
            make()


FILES = {
    "harmonics": Mask(rms={7: 0.1, 5: 0.3}, fundamental_hz=HZ, component="i"),
    "points in decibels": Mask(
        db=[[100.0, -3.0], [500.0, -40.0]], reference=0.3, band=lfo.low_pass(cutoff_hz=80), penalty=2.0
    ),
    "a part": Mask(percent=[3.0, 4.0], bins=[5, 7], of="fundamental", phase=-0.5, fundamental_hz=HZ),
    "a density": Mask(density=1 / 3, band=HIGH, every_frequency=True),
    "a demand": Energy(percent=5.0, of=3.0, harmonics=range(2, 10), fundamental_hz=HZ),
}


@pytest.mark.parametrize("case", FILES)
def test_a_file_keeps_what_was_stated(case, tmp_path):
    given, path = FILES[case], tmp_path / "problem.toml"
    lfo.write_problem(problem(given), path)
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    assert faults_of_schema(PROBLEM, tables) == []
    (table,) = tables["control_spectrum"]
    assert given.quantity.keyword in table
    again = lfo.read_problem(path)
    (read,) = again.control_spectrum
    assert (read.quantity, read.band, read.fundamental_hz) == (given.quantity, given.band, given.fundamental_hz)
    np.testing.assert_array_equal(read.limit, given.limit)
    assert again.terms[0].name == problem(given).terms[0].name


def test_a_file_states_limits_by_order(tmp_path):
    path = tmp_path / "problem.toml"
    lfo.write_problem(problem(None), path)
    tables = {"kind": "magnitude_bound", "harmonics": {"7": 0.4, "5": 0.25}, "fundamental_hz": 50}
    read = lfo.read_problem(path, {"control_spectrum": tables}).control_spectrum
    assert (read.band.orders, read.limit.tolist()) == ([5, 7], [0.25, 0.4])


def test_pages_draw_values_in_the_unit_of_the_limit():
    result = lfo.solve(problem(Mask(amplitude=[0.25, 0.5], bins=[5, 7])))
    data = result_data(result)
    (ax,) = spectra_figure(data, data.controls).axes
    drawn = np.concatenate([np.column_stack(line.get_data()) for line in ax.lines])
    at_order_5 = drawn[np.isclose(drawn[:, 0], 250)]
    assert (ax.get_ylabel(), np.unique(at_order_5[:, 1].round(6)).tolist()) == ("amplitude of i [A]", [0.25])
    shown = answer_data(result)
    (spectrum,) = shown["frame"]["spectra"]
    assert spectrum["label"] == "amplitude of i [A]"
    assert [limit["values"] for limit in spectrum["limits"]] == [[0.25], [0.5]]
    assert shown["trajectory"]["spectra"][0][5:8:2] == pytest.approx([0.25, 0.5], rel=1e-4)
    readings = result_summary(result)["spectra"]
    assert [(one["label"], one["unit"], one["limit"]) for one in readings] == [
        ("bin 5 of i", "A", 0.25),
        ("bin 7 of i", "A", 0.5),
    ]


def test_a_held_spectrum_is_drawn_in_the_unit_of_its_limit():
    held = problem(Mask(rms=0.2, band=lfo.low_pass(cutoff_hz=200), every_frequency=True, hold=True))
    (panel,) = held_panels(result_data(replace(lfo.solve(problem(None)), problem=held)))  # its control is WANTED
    ax = Figure().add_subplot()
    panel(ax)
    assert ax.get_ylabel() == "RMS value of i [A RMS]"
    drawn, limit = (np.column_stack(line.get_data()) for line in ax.lines[:2])
    assert limit[:, 1] == pytest.approx([0.2, 0.2])
    nearest = drawn[np.abs(drawn[:, 0] - 250).argmin(), 1]
    assert nearest == pytest.approx(np.sinc(0.25) / np.sqrt(2), rel=0.05)  # between two bins


def test_an_excess_of_a_loop_is_in_the_unit_of_the_limit():
    soft = problem(Mask(amplitude=0.1, bins=[0, 5], penalty=2.0))
    moved = translation_of(soft)
    plan = lfo.Trajectory(np.zeros((N + 1, 1)), WANTED[:, None] + 0.3)
    assert excess(moved, plan) == {"mask on i [A]": pytest.approx(0.2 + 0.9)}


def test_a_comparison_states_each_limit_where_limits_differ_in_a_band():
    """The averaged current is nearest to the limit of another bin than the classical one."""
    bound = Mask(amplitude=[[200.0, 1.2], [400.0, 0.1]], band=lfo.spectrum.notch(centre_hz=300, width_hz=200))
    comparison = lfo.compare(problem(bound), filters=["moving_average"])
    (row,) = {group.title: group for group in comparison_rows(comparison).groups}["Limited spectra"].rows
    readings = [line.limited_spectra[row.label][0] for line in comparison.trajectories]
    assert len({reading.limit for reading in readings}) == 2
    assert row.unit == "A"
    for cell, reading in zip(row.cells, readings, strict=True):
        value, limit = map(float, cell.text.split(" of "))
        assert (value, limit) == pytest.approx((reading.value, reading.limit), rel=1e-3)
        assert cell.passed == (value <= limit * (1 + 1e-3))
