"""Filters do what they say, and the paper's Figure 3 comes out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.comparison import FILTERS, apply_filter, filter_stop


@pytest.fixture(scope="module")
def pendulum():
    return lfo.compare(lfo.library.pendulum())


def one(comparison, name):
    return next(entry for entry in comparison.filtered if entry.name == name)


def test_the_papers_figure_3(pendulum):
    """Filtering exceeds the bound at both ends, leaves the state bounds and misses the end; the constraint does not."""
    brick = one(pendulum, "brickwall").replay
    assert pendulum.classical_measures.max_control == pytest.approx(5.0, abs=1e-6)
    assert brick.measures.max_control == pytest.approx(5.857, abs=1e-3)
    u = np.abs(brick.trajectory.u[:, 0])
    assert sorted(np.argsort(u)[-2:]) == [1, 238]
    assert brick.measures.terminal_errors[:2] == pytest.approx((0.813, 16.72), abs=5e-3)
    assert brick.measures.state_violation > 1
    constrained = pendulum.constrained_measures
    assert max(constrained.control_violation, constrained.state_violation, constrained.terminal_error) < 1e-8
    assert constrained.stopband_energy < 1e-12
    assert constrained.stopband_peak == pytest.approx(2.4, abs=0.05)
    assert pendulum.classical_measures.stopband_peak == pytest.approx(5.2, abs=0.05)
    ratio = pendulum.constrained.cost / pendulum.classical.cost
    assert ratio == pytest.approx(1.121, abs=5e-4)


def test_energy_in_the_band_falls_thirtyfold(pendulum):
    """The zero-padded spectrum between bins 97 and 120: small, not zero."""

    def energy(u):
        return (np.abs(np.fft.rfft(u[:, 0], n=16 * 240)[16 * 97 :]) ** 2).sum()

    assert energy(pendulum.classical.control) / energy(pendulum.constrained.control) == pytest.approx(30, rel=0.2)


def test_a_replay_that_means_nothing_is_not_made():
    comparison = lfo.compare(lfo.library.pendulum(sampling_time=0.1), filters=["brickwall"])
    assert not comparison.replay_is_meaningful
    replay = comparison.filtered[0].replay
    assert replay.measures.terminal_error is None
    assert replay.measures.cost is None
    assert replay.measures.amplification > 1e46
    planned, B = comparison.classical, comparison.problem.dynamics.B
    missed = np.abs((planned.control - replay.trajectory.u) @ B.T).max(0)
    assert replay.one_step_residual == pytest.approx(missed, abs=1e-9)


def test_classical_forgets_state_bands_too():
    problem = lfo.library.two_mass_spring()
    comparison = lfo.compare(problem, filters=["brickwall"])
    assert comparison.classical.cost < comparison.constrained.cost
    assert comparison.classical_measures.state_stopband_energy > 1e-6
    assert comparison.constrained_measures.state_stopband_energy < 1e-9


def test_an_infeasible_constraint_is_a_finding():
    problem = lfo.library.pendulum(control_bound=4.5)
    comparison = lfo.compare(problem, filters=["brickwall"])
    assert comparison.classical.status == "optimal"
    assert comparison.constrained.status == "infeasible"
    assert comparison.constrained_measures is None


def test_a_comparison_in_a_few_lines(pendulum):
    lines = str(pendulum).splitlines()
    assert len(lines) == 3 + len(pendulum.filtered)
    assert lines[0] == str(pendulum.problem)
    assert lines[1].startswith("classical ")
    assert "optimal, cost 2852.71, end missed by 0" in lines[1]
    assert lines[-1].startswith("constrained ")
    assert "optimal, cost 3199.19" in lines[-1]
    for line, one in zip(lines[2:-1], pendulum.filtered, strict=True):
        assert line.split()[:2] == [one.name, "simulated,"]
        assert f"end missed by {one.replay.measures.terminal_error:.2g}" in line
    assert max(map(len, lines)) < 200
    assert "brickwall" in repr(pendulum)
    assert repr(pendulum.constrained) in repr(pendulum)
    assert len(repr(pendulum)) < 400


@expensive
def test_what_has_no_trajectory_or_replay_says_so():
    comparison = lfo.compare(lfo.library.pendulum(control_bound=4.5), filters=["brickwall"])
    assert str(comparison).splitlines()[-1] == "constrained  infeasible"
    assert repr(comparison.constrained) == "Result(infeasible by spectral, no trajectory)"
    unstable = lfo.compare(lfo.library.pendulum(horizon=1500, parameters="physical"), filters=["brickwall"])
    assert not unstable.replay_is_meaningful
    assert "not simulated: that would amplify rounding errors" in str(unstable)


def test_unknown_filter_is_refused_before_any_work():
    with pytest.raises(lfo.errors.ProblemError, match="filters: got 'magic'"):
        lfo.compare(lfo.library.pendulum(), filters=["brickwall", "magic"])


class TestFilters:
    problem = lfo.library.pendulum()
    noise = np.random.default_rng(3).standard_normal((240, 1))

    def test_brick_wall_removes_the_bins_and_no_others(self):
        u = apply_filter("brickwall", self.problem, self.noise).u
        before, after = np.fft.rfft(self.noise[:, 0]), np.fft.rfft(u[:, 0])
        stop = self.problem.control_stop[:, 0]
        assert np.abs(after[stop]).max() < 1e-12
        assert after[~stop] == pytest.approx(before[~stop])

    def test_clipped_is_the_brick_wall_within_bounds(self):
        wall = apply_filter("brickwall", self.problem, 5 * self.noise).u
        assert apply_filter("clipped", self.problem, 5 * self.noise).u == pytest.approx(np.clip(wall, -5, 5))

    def test_butterworth_meets_its_design(self):
        """3 dB down at most at the last kept bin, 20 dB down half way into the stop band; causal."""
        impulse = np.zeros((240, 1))
        impulse[0] = 1
        response = np.abs(np.fft.rfft(apply_filter("butterworth", self.problem, impulse).u[:, 0], n=2400))
        assert -20 * np.log10(response[960]) <= 3.0 + 1e-6
        assert -20 * np.log10(response[1080]) >= 20.0 - 1e-6
        late = np.zeros((240, 1))
        late[100] = 1
        assert not np.any(apply_filter("butterworth", self.problem, late).u[:100])

    def test_zero_phase_is_symmetric(self):
        impulse = np.zeros((241, 1))
        impulse[120] = 1
        u = apply_filter("zero_phase", replace(self.problem, horizon=241), impulse).u[:, 0]
        assert u == pytest.approx(u[::-1], abs=1e-10)

    def test_moving_average_is_one(self):
        problem = replace(self.problem, control_spectrum=lfo.low_pass(0.2))
        entry = apply_filter("moving_average", problem, self.noise)
        length = int(entry.description.split()[4])
        expected = signal.lfilter(np.ones(length) / length, 1, self.noise[:, 0])
        assert entry.u[:, 0] == pytest.approx(expected)
        assert length == round(240 / 8)

    @pytest.mark.parametrize("name", FILTERS)
    @pytest.mark.parametrize(
        "band",
        [
            lfo.spectrum.high_pass(0.5),
            lfo.spectrum.notch(1.0, 0.4),
            lfo.stop_band(bins=[0]),
            lfo.stop_band(bins=[1, 60, 120]),
            None,
        ],
        ids=str,
    )
    def test_every_filter_takes_every_band(self, name, band):
        entry = apply_filter(name, replace(self.problem, control_spectrum=band), self.noise)
        assert np.isfinite(entry.u).all()
        if band is None and name != "clipped":
            assert entry.u == pytest.approx(self.noise)
            assert "nothing to remove" in entry.description or name == "brickwall"

    def test_a_state_band_is_filtered_out_of_the_controls(self):
        problem = lfo.library.two_mass_spring()
        stop = filter_stop(problem)
        T = problem.horizon
        frequencies = np.flatnonzero(stop[:, 0]) / T
        wanted = np.flatnonzero(problem.state_stop.any(axis=1)) / (T + 1)
        assert frequencies.min() == pytest.approx(wanted.min(), abs=1 / T)
        assert frequencies.max() == pytest.approx(wanted.max(), abs=1 / T)


def test_without_a_frequency_constraint_both_are_the_same_solve():
    comparison = lfo.compare(lfo.library.pulse_pattern(kind="opp", switches=8))
    assert comparison.constrained.status == "optimal"
    assert comparison.classical is comparison.constrained


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ({"rms": 0.1}, " of force: 0.1 of 0.1 N RMS"),
        ({"amplitude": 0.2}, " of force: 0.2 of 0.2 N"),
        ({"limit": 5.0}, " of force: 5 of 5 N, sum of samples"),
    ],
)
def test_rows_show_limited_spectra_in_the_unit_of_their_limit(limit, words):
    mask = lfo.MagnitudeBound(**limit, bins=range(3, 10))
    dynamics = lfo.LinearDynamics.from_continuous([[-5.0]], [[10.0]], 1e-2, control_names=["force [N]"])
    problem = lfo.OptimalControlProblem(
        dynamics, 100, lfo.QuadraticCost(R=1.0), initial_state=[0.0], terminal_state=[3.0], control_spectrum=mask
    )
    rows = dict(lfo.compare(problem).rows)
    assert rows["constrained"].endswith(words)
    assert not rows["classical"].endswith(words)
    assert not any("energy" in text for text in rows.values())
    banded = dict(lfo.compare(replace(problem, control_spectrum=lfo.stop_band(bins=[5]))).rows)
    assert "energy in control bands" in banded["classical"]
