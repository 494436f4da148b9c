"""Masks on a signal as it is held between its samples: images above Nyquist, what is judged, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.errors import ProblemError

H, LIMIT, FROM = 0.04, 1.0, 3.0  # s, and Hz; Nyquist is 12.5 Hz
FREE = lfo.library.double_integrator(horizon=100, sampling_time=H, cutoff_hz=None)


def masked(limit=LIMIT, band=None, problem=FREE, **fields):
    band = lfo.low_pass(cutoff_hz=FROM) if band is None else band
    bound = lfo.MagnitudeBound(limit, band=band, every_frequency=True, hold=True, **fields)
    return replace(problem, control_spectrum=bound)


def held(u, f):
    return np.abs(np.sinc(f * H) * np.polyval(u[::-1], np.exp(-2j * np.pi * H * f)))


@pytest.fixture(scope="module")
def solved():
    return lfo.solve(masked())


@pytest.fixture(scope="module")
def imaged():
    """About the first images of what the move needs: 25 Hz is 1/h."""
    return lfo.solve(masked(0.2, lfo.spectrum.notch(centre_hz=26.0, width_hz=1.6)))


def peak_of(result):
    (peak,) = [condition.peak for condition in result.certificate.conditions if condition.peak is not None]
    return peak


def failed_labels(problem, trajectory, multipliers):
    return {condition.label for condition in lfo.certify(problem, trajectory, multipliers).failed}


@expensive
def test_the_held_spectrum_stays_below_the_limit_without_end(solved):
    assert (solved.status, solved.certificate.pmp) == ("optimal", "satisfied")
    assert abs(solved.gap) < 1e-7
    above = held(solved.control[:, 0], np.linspace(FROM, 300.0, 200_001)).max()
    assert LIMIT * (1 - 1e-5) < above <= LIMIT * peak_of(solved).ratio
    assert peak_of(solved).ratio - 1 < 1e-7
    plain = lfo.MagnitudeBound(LIMIT, band=lfo.low_pass(cutoff_hz=FROM), every_frequency=True)
    of_samples = lfo.solve(replace(FREE, control_spectrum=plain))
    assert lfo.solve(FREE).cost < solved.cost < of_samples.cost * (1 - 1e-5)


@expensive
def test_images_above_nyquist_are_held(imaged):
    f = np.linspace(25.2, 26.8, 20_001)
    assert held(lfo.solve(FREE).control[:, 0], f).max() > 0.22
    assert (imaged.status, imaged.certificate.pmp) == ("optimal", "satisfied")
    assert 0.2 * (1 - 1e-6) < held(imaged.control[:, 0], f).max() <= 0.2 * peak_of(imaged).ratio
    ((_, atoms),) = imaged.multipliers.frequencies.items()
    assert (atoms > 2 * np.pi).all()


def test_an_image_almost_a_period_after_the_edge_counts():
    """Above 30 Hz, a wave of 3 Hz has its largest image at 2/h - 3 Hz = 47 Hz."""
    wave = np.hanning(100) * np.cos(2 * np.pi * 3.0 * H * np.arange(100))
    level = held(wave, np.linspace(46.0, 48.0, 2001)).max()
    assert held(wave, np.linspace(30.0, 46.0, 2001)).max() < 0.9 * level
    none = lfo.solve(FREE).multipliers
    for limit, passes in ((1.01 * level, True), (0.99 * level, False)):
        certificate = lfo.certify(masked(limit, lfo.low_pass(cutoff_hz=30.0)), lfo.simulate(FREE, wave[:, None]), none)
        (mask,) = [one for one in certificate.conditions if one.label == "C-vii" and one.peak is not None]
        assert mask.passed is passes


@expensive
@pytest.mark.parametrize("method", ["convex", "structured"])
def test_methods_find_the_same(imaged, method):
    assert lfo.solve(imaged.problem, method).cost == pytest.approx(imaged.cost, rel=1e-8)


@expensive
@pytest.mark.parametrize(
    ("limit", "band"),
    [
        ([[3, 2.0], [8, 0.5], [40, 0.45]], lfo.low_pass(cutoff_hz=3.0)),
        (0.45, lfo.low_pass(cutoff_hz=20.0)),
        (0.7, lfo.spectrum.band_pass(lower_hz=0.0, upper_hz=6.0)),
        (29.0, lfo.spectrum.high_pass(cutoff_hz=30.0)),
    ],
    ids=["points", "beyond Nyquist", "band pass", "high pass"],
)
def test_limits_and_bands(limit, band):
    result = lfo.solve(masked(limit, band))
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    f = (
        np.linspace(0.0, 30.0, 30_001)
        if band.kind == "high_pass"
        else np.linspace(max(band.edges[0], band.edges[1]), 150.0, 100_001)
    )
    levels = np.interp(f, *np.array(limit).T) if isinstance(limit, list) else limit
    assert (held(result.control[:, 0], f) / levels).max() <= peak_of(result).ratio < 1 + 5e-7


def test_a_moved_or_turned_atom_fails(imaged):
    given = imaged.multipliers
    ((name, atoms),) = given.frequencies.items()
    heaviest = int(np.argmax(np.linalg.norm(given.stage[name], axis=1)))
    moved = atoms.copy()
    moved[heaviest] += 0.01 if atoms[heaviest] < 6.6 else -0.01
    assert "N-uhat" in failed_labels(imaged.problem, imaged.trajectory, replace(given, frequencies={name: moved}))
    folded = replace(given, frequencies={name: atoms - 2 * np.pi})
    assert {"C-v", "N-uhat"} <= failed_labels(imaged.problem, imaged.trajectory, folded)
    turned = given.stage[name].copy()
    turned[heaviest] = turned[heaviest] @ [[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]]
    labels = failed_labels(imaged.problem, imaged.trajectory, replace(given, stage={name: turned}))
    assert labels >= {"N-uhat", "C-v"}


@expensive
@pytest.mark.parametrize("which", ["solved", "imaged"])
def test_a_limit_lower_by_a_millionth_fails(which, request):
    result = request.getfixturevalue(which)
    limit, band = result.problem.control_spectrum.limit, result.problem.control_spectrum.band
    found = peak_of(result).found
    lower = masked(float(limit) * found / (1 + 1e-6), band)
    assert "C-vii" in failed_labels(lower, result.trajectory, result.multipliers)
    same = masked(float(limit) * found / (1 + 1e-7), band)
    assert "C-vii" not in failed_labels(same, result.trajectory, result.multipliers)


@expensive
def test_any_atoms_bound_the_optimum(imaged):
    given, rng = imaged.multipliers, np.random.default_rng(0)
    ((name, atoms),) = given.frequencies.items()
    for spread in (1e-4, 1e-2, 1.0):
        moved = np.abs(atoms + spread * rng.standard_normal(len(atoms)))
        certificate = lfo.certify(imaged.problem, imaged.trajectory, replace(given, frequencies={name: moved}))
        assert certificate.bound.value <= imaged.cost * (1 + 1e-9)


@expensive
def test_multipliers_are_found_for_a_trajectory_alone(solved):
    certificate = lfo.certify(solved.problem, solved.trajectory)
    assert (certificate.pmp, certificate.globally_optimal) == ("satisfied", True)


def test_infeasible_masks_are_proven():
    result = lfo.solve(masked(1e-3, lfo.low_pass(cutoff_hz=20.0)), throw=False)
    assert (result.status, result.message) == ("infeasible", "proven by a rigorous ray")
    assert any("held mask" in conflict.block for conflict in result.conflict)


@expensive
def test_scale_does_not_matter(imaged):
    unit = 1e6
    dynamics = lfo.LinearDynamics(FREE.linear.A, FREE.linear.B / unit, sampling_time=H)
    box = FREE.control_tube
    other = replace(
        FREE,
        dynamics=dynamics,
        cost=lfo.QuadraticCost(R=1e-9 * FREE.quadratic.R / unit**2),
        control_set=lfo.Box(box.lower[0] * unit, box.upper[0] * unit),
    )
    result = lfo.solve(masked(0.2 * unit, imaged.problem.control_spectrum.band, other))
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    assert result.cost == pytest.approx(1e-9 * imaged.cost, rel=1e-7)


@expensive
def test_minimum_time_is_monotone():
    problem = masked(2.0, problem=replace(FREE, state_set=None))
    found = lfo.minimum_time(problem, horizons=(48, 54))
    assert (found.monotone, found.proven) == (True, True)
    assert found.horizon > lfo.minimum_time(replace(problem, control_spectrum=None), horizons=(48, 54)).horizon


def test_problems_and_solutions_are_written_and_read(imaged, tmp_path):
    imaged.save(tmp_path / "run.npz")
    lfo.write_problem(imaged.problem, tmp_path / "problem.toml")
    read = lfo.read_problem(tmp_path / "problem.toml")
    assert read.control_spectrum[0].hold
    assert lfo.certify(read, lfo.load(tmp_path / "run.npz")).globally_optimal


def test_it_is_described():
    words = masked().control_spectrum.describe(["force [N]"])
    assert words.startswith("mask of force: |sinc(f h) V|, as it is held, ≤ 1 at every frequency")


@pytest.mark.parametrize(
    ("make", "field", "words"),
    [
        (lambda: masked(band=lfo.low_pass(1.0)), "hold", "a band in Hz"),
        (lambda: lfo.MagnitudeBound(1.0, band=lfo.low_pass(cutoff_hz=3.0), hold=True), "hold", "every_frequency=True"),
        (lambda: lfo.MagnitudeBound(1.0, band=lfo.low_pass(cutoff_hz=3.0), every_frequency=True, hold=1),
         "hold", "True or False"),
        (lambda: masked(0.0), "limit", "above zero"),
        (lambda: masked([[5, 1.0], [9, 2.0]]), "limit", "points from 3 Hz"),
        (lambda: masked(band=lfo.spectrum.high_pass(cutoff_hz=0.0)), "band", "removes frequencies"),
        (lambda: masked(problem=replace(FREE, dynamics=lfo.LinearDynamics(FREE.linear.A, FREE.linear.B))),
         "control_spectrum", "sampling_time"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(make, field, words):
    with pytest.raises(ProblemError) as raised:
        make()
    assert field in str(raised.value)
    assert words in str(raised.value)
