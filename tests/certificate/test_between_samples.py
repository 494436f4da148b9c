"""State bounds between the samples: a published table, dense sampling, and integration by another program."""

import re
from dataclasses import asdict, replace
from fractions import Fraction
from math import comb

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import lin_freq_ocp as lfo
from helpers.replacing import substitute
from helpers.schemas import RESULT, faults, printed
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import LARGEST_REACH, REACH, bounds_between_samples
from lin_freq_ocp.dynamics import ContinuousPlant
from lin_freq_ocp.files import certificate_summary, result_summary
from lin_freq_ocp.pages import finding_of
from lin_freq_ocp.results import BetweenSamples, BoundPeak

# Largest violation over half the width of the bounds, 2 digits: CONTINUOUS.md, section 2
FREE = {"notch_width_hz": None}
TABLE = [
    ("scanner", {}, 3.7e-2),
    ("scanner", {"sampling_time": 2.5e-4, "horizon": 100, "cutoff_hz": None}, 0.14),
    ("flexible_joint_arm", {}, 3.7e-6),
    ("flexible_joint_arm", {"sampling_time": 0.1, "horizon": 24, **FREE}, 1.5e-2),
    ("pendulum", {"sampling_time": 0.1, "horizon": 240}, 4.3e-4),
    ("pendulum", {"sampling_time": 0.2, "horizon": 120}, 2.3e-3),
    ("crane", {"sampling_time": 0.5, "horizon": 30, **FREE}, 5.9e-3),
]
KEPT = ("pendulum", "double_integrator", "two_mass_spring", "crane", "mass_chain", "printer_move")


def solved(name, keywords):
    return lfo.solve(lfo.library.by_name(name)(**keywords))


def dense_peaks(problem, trajectory, points=200):
    """Return the largest violation of each bound at many instants of every period, by matrix exponentials."""
    plant, h, boxes = problem.dynamics.plant, problem.sampling_time, problem.state_boxes
    n, peaks = len(plant.A), {}
    for s in np.linspace(0, h, points):
        A, B, d = plant.sampled(s)
        x = trajectory.x[:-1, :n] @ A.T + trajectory.u @ B.T + d
        for i in range(n):
            upper = np.maximum(boxes.upper[:-1, i], boxes.upper[1:, i])
            lower = np.minimum(boxes.lower[:-1, i], boxes.lower[1:, i])
            for side, values in (("upper", x[:, i] - upper), ("lower", lower - x[:, i])):
                peaks[side, i] = max(peaks.get((side, i), -np.inf), float(values.max()))
    return peaks


def state_at(problem, trajectory, time):
    """Return the state at a time in seconds by an integrator of another program."""
    plant, h, n = problem.dynamics.plant, problem.sampling_time, len(problem.dynamics.plant.A)
    k = min(int(time / h), problem.horizon - 1)
    drive = plant.B @ trajectory.u[k] + plant.offset
    span, start = (0.0, time - k * h), trajectory.x[k, :n]
    if span[1] <= 0:
        return start
    flow = solve_ivp(lambda t, x: plant.A @ x + drive, span, start, "DOP853", rtol=1e-12, atol=1e-14)
    return flow.y[:, -1]


def require_right(problem, trajectory):
    """Compare all peaks with dense sampling, and the state at their times with an integrator."""
    found, peaks = bounds_between_samples(problem, trajectory), dense_peaks(problem, trajectory)
    boxes = problem.state_boxes
    for bound in found.bounds:
        i, sign = bound.component, 1 if bound.side == "upper" else -1
        size = max(abs(bound.violation / (bound.relative or 1.0)), np.abs(trajectory.x[:, i]).max())
        assert peaks[bound.side, i] <= bound.at_most
        assert bound.violation <= bound.at_most <= bound.violation + 1e-8 * size
        assert bound.violation >= peaks[bound.side, i] - 2e-9 * size
        limit = (boxes.upper if sign > 0 else boxes.lower)[:, i]
        if (limit == limit[0]).all():
            value = sign * (state_at(problem, trajectory, bound.time)[i] - limit[0])
            assert value == pytest.approx(bound.violation, rel=1e-8, abs=2e-9 * size)
    return found


@pytest.mark.parametrize(("name", "keywords", "violation"), TABLE)
def test_violations_of_the_library_are_those_of_the_table(name, keywords, violation):
    result = solved(name, keywords)
    found = require_right(result.problem, result.trajectory)
    assert found.worst.relative == pytest.approx(violation, rel=0.04)
    assert not found.holds
    assert "its upper bound by" in str(found) or "its lower bound by" in str(found)


@pytest.mark.parametrize("name", seeds(KEPT))
def test_other_problems_of_the_library_hold_their_bounds_between_the_samples(name):
    result = solved(name, {})
    found = require_right(result.problem, result.trajectory)
    assert found.holds
    assert found.worst.violation < 1e-9
    assert str(found) == "all state bounds hold between the samples"


def two_masses(samples):
    """Return two masses with a spring, 6 rad/s, and a bound on the deflection, which is a state."""
    A = np.zeros((4, 4))  # states: position of the first mass, deflection, and their rates
    A[0, 2] = A[1, 3] = 1.0
    A[2, 1], A[3, 1] = -18.0, -36.0
    h = 5.0 / samples
    dynamics = lfo.LinearDynamics.from_continuous(A, [[0], [0], [1], [1]], h)
    return lfo.OptimalControlProblem(
        dynamics,
        samples,
        lfo.QuadraticCost(R=1.0),
        control_set=lfo.Box(-3, 3),
        state_set=lfo.Box([None, -0.0115, None, None], [None, 0.0115, None, None]),
        initial_state=np.zeros(4),
        terminal_state=[1.0, 0, 0, 0],
    )


@pytest.mark.parametrize(("samples", "violation"), [(20, 4.0e-2), (15, 0.35)])
def test_two_masses_near_the_sampling_of_their_resonance(samples, violation):
    problem = two_masses(samples)
    trajectory = lfo.solve(problem).trajectory
    assert require_right(problem, trajectory).worst.relative == pytest.approx(violation, rel=0.05)


def test_a_bound_on_one_side_is_relative_to_the_range_of_the_state():
    dynamics = lfo.LinearDynamics.from_continuous([[0, 1], [0, 0]], [[0], [1]], 0.1)
    problem = lfo.OptimalControlProblem(
        dynamics, 10, lfo.QuadraticCost(R=1.0), None, lfo.Box(None, [1 / 9, None]), initial_state=[0, 1],
        terminal_state=[0, -1],
    )  # fmt: skip
    trajectory = lfo.solve(problem).trajectory
    worst = require_right(problem, trajectory).worst
    assert (worst.component, worst.side) == (0, "upper")
    assert worst.violation == pytest.approx(1.5e-3 / 9, rel=0.04)  # Bryson-Denham, l = 1/9
    assert worst.relative == pytest.approx(2 * worst.violation / np.ptp(trajectory.x[:, 0]), rel=1e-9)


@pytest.mark.parametrize("seed", seeds(range(6)))
def test_random_plants_against_dense_sampling(seed):
    rng = np.random.default_rng(seed)
    n, m, T = rng.integers(1, 6), rng.integers(1, 3), 12
    A = rng.normal(size=(n, n)) * 10.0 ** rng.uniform(-1, 1)
    A -= np.linalg.eigvals(A).real.max() * np.eye(n)  # marginally stable
    dynamics = lfo.LinearDynamics.from_continuous(A, rng.normal(size=(n, m)), 0.3, rng.normal(size=n))
    lower = -rng.uniform(0, 1, n)
    bounds = lfo.Box(np.tile(lower, (T + 1, 1)), lower + rng.uniform(0.1, 1, (T + 1, n)))
    problem = lfo.OptimalControlProblem(dynamics, T, lfo.QuadraticCost(R=1.0), state_set=bounds)
    trajectory = lfo.simulate(problem, rng.normal(size=(T, m)), rng.normal(size=n))
    require_right(problem, trajectory)


def test_units_and_the_origin_change_no_verdict():
    result = solved("scanner", {})
    problem, (x, u) = result.problem, (result.trajectory.x, result.trajectory.u)
    plant, h = problem.dynamics.plant, problem.sampling_time
    first, units = bounds_between_samples(problem, result.trajectory), np.array([1e-6, 1e3])
    dynamics = lfo.LinearDynamics.from_continuous(
        units[:, None] * plant.A / units / 1e-3, units[:, None] * plant.B / 1e-3, 1e-3 * h
    )
    boxes = problem.state_boxes
    scaled = lfo.OptimalControlProblem(
        dynamics, problem.horizon, lfo.QuadraticCost(R=1.0), state_set=lfo.Box(boxes.lower * units, boxes.upper * units)
    )
    again = bounds_between_samples(scaled, lfo.Trajectory(x * units, u))
    for one, other in zip(first.bounds, again.bounds, strict=True):
        assert other.relative == pytest.approx(one.relative, rel=1e-7)
        assert other.time == pytest.approx(1e-3 * one.time, rel=1e-4)
    origin = np.array([3e4, 0.0])
    moved = lfo.OptimalControlProblem(
        problem.dynamics.translated(-origin, problem.horizon), problem.horizon, lfo.QuadraticCost(R=1.0),
        state_set=lfo.Box(boxes.lower + origin, boxes.upper + origin),
    )  # fmt: skip
    assert moved.dynamics.plant is not None
    far = bounds_between_samples(moved, lfo.Trajectory(x + origin, u))
    assert far.worst.relative == pytest.approx(first.worst.relative, rel=1e-6)


def test_rate_limits_leave_the_states_of_the_plant():
    problem = lfo.rate_limited(lfo.library.scanner(), 10.0)
    trajectory = lfo.solve(problem).trajectory
    found = require_right(problem, trajectory)
    assert {bound.component for bound in found.bounds} <= {0, 1}


def test_within_a_period_the_wider_bound_counts():
    problem = two_masses(20)
    trajectory = lfo.solve(problem).trajectory
    worst = bounds_between_samples(problem, trajectory).worst
    k = int(worst.time / problem.sampling_time)
    limits = np.full((21, 4), np.inf)
    limits[:, 1] = 0.0115
    limits[k, 1] = 1.0
    looser = replace(problem, state_set=lfo.Box(-limits, limits))
    again = require_right(looser, trajectory)
    assert all(int(bound.time / problem.sampling_time) not in (k - 1, k) for bound in again.bounds)


def test_the_plant_is_kept_by_what_keeps_the_dynamics():
    dynamics = lfo.library.scanner().dynamics
    assert isinstance(dynamics.plant, ContinuousPlant)
    assert replace(dynamics, state_names=["a", "b"]).plant is dynamics.plant
    for changed in (
        {"A": 1.001 * dynamics.A},
        {"B": 1.001 * dynamics.B},
        {"offset": [1e-3, 0]},
        {"sampling_time": 1.0},
    ):
        assert replace(dynamics, **changed).plant is None
    assert lfo.LinearDynamics(dynamics.A, dynamics.B, sampling_time=1e-4).plant is None
    control = pytest.importorskip("control")
    plant = control.ss(dynamics.plant.A, dynamics.plant.B, np.eye(2), np.zeros((2, 1)))
    assert np.array_equal(lfo.LinearDynamics.from_statespace(plant, 1e-4).plant.A, dynamics.plant.A)
    assert lfo.LinearDynamics.from_statespace(control.c2d(plant, 1e-4)).plant is None


def test_nothing_is_said_without_a_plant_with_held_controls_and_state_bounds():
    scanner = lfo.library.scanner()
    trajectory = lfo.solve(scanner).trajectory
    plain = lfo.LinearDynamics(scanner.dynamics.A, scanner.dynamics.B, sampling_time=1e-4)
    assert bounds_between_samples(replace(scanner, dynamics=plain), trajectory) is None
    assert bounds_between_samples(replace(scanner, state_set=None), trajectory) is None
    modulated = lfo.FiniteSet([-1.0, 0.0, 1.0], duty_cycles=True)
    assert bounds_between_samples(replace(scanner, control_set=modulated, control_spectrum=None), trajectory) is None
    steep = lfo.LinearDynamics.from_continuous([[-1.1 * LARGEST_REACH]], [[1.0]], 1.0)
    stiff = lfo.OptimalControlProblem(steep, 2, lfo.QuadraticCost(R=1.0), state_set=lfo.Box(-1, 1))
    assert bounds_between_samples(stiff, lfo.Trajectory(np.zeros((3, 1)), np.zeros((2, 1)))) is None


def test_a_stiff_plant_is_bounded_from_above():
    dynamics = lfo.LinearDynamics.from_continuous([[-50.0, 0.0], [0.0, -1.0]], [[50.0], [1.0]], 1.0)
    problem = lfo.OptimalControlProblem(dynamics, 4, lfo.QuadraticCost(R=1.0), state_set=lfo.Box(-1, 1))
    trajectory = lfo.simulate(problem, [[1.2], [-1.3], [0.5], [1.0]], [0.0, 0.0])
    assert require_right(problem, trajectory).worst.violation == pytest.approx(0.3, rel=1e-6)


def test_a_solve_does_not_compute_it(monkeypatch):
    def refuse(problem, trajectory):
        raise AssertionError("computed within a solve")

    substitute(monkeypatch, "certificate.bounds_between_samples", refuse)
    result = lfo.solve(lfo.library.scanner())
    certificate = lfo.certify(result.problem, result)
    for subject in (result, certificate):
        with pytest.raises(AssertionError, match="computed within a solve"):
            _ = subject.between_samples


def test_json_has_every_bound():
    result = solved("scanner", {})
    summaries = result_summary(result), certificate_summary(result.problem, lfo.certify(result.problem, result))
    for summary in summaries:
        assert faults(RESULT, printed(summary)) == []
        assert summary["between_samples"] == [asdict(bound) for bound in result.between_samples.bounds]
    silent = lfo.solve(lfo.library.quadcopter(horizon=20))
    assert "between_samples" not in result_summary(silent)


def test_a_report_says_where_a_bound_is_exceeded():
    """The scanner's move is symmetric: rounding decides whether the upper or the lower bound is named."""
    text = str(finding_of(lfo.compare(lfo.library.scanner())))
    assert re.search(r"at the samples \(between them speed (exceeds its upper|falls below its lower) bound by", text)
    assert "between them" not in str(finding_of(lfo.compare(lfo.library.pendulum())))


def test_of_equal_violations_the_first_is_named():
    """Rounding, by which the second is larger, depends on the processor."""
    upper = BoundPeak(0, "speed", "upper", 0.5, 0.5, 0.25, 1.0)
    lower = replace(upper, side="lower", relative=0.25 * (1 + 1e-12), time=0.5)
    assert BetweenSamples((upper, lower)).worst is upper
    assert BetweenSamples((upper, replace(lower, relative=0.26))).worst.side == "lower"


def test_results_and_certificates_say_it():
    result = solved("scanner", {})
    line = f"between   {result.between_samples}"
    assert "bound by 0.0349 mm/s (3.7 %) at 0.0" in line
    certificate = lfo.certify(result.problem, result.trajectory)
    assert str(result).count(line) == 1
    assert str(certificate).count(line) == 1
    assert certificate.between_samples.worst == result.between_samples.worst
    silent = lfo.solve(lfo.library.quadcopter(horizon=20))
    assert silent.between_samples is None
    assert "between " not in str(silent)


def use_degree(monkeypatch, degree):
    """Make the polynomials of another degree than 15, so that the rest of the series is above all rounding."""
    substitute(monkeypatch, "certificate.DEGREE", degree)
    powers = range(degree + 1)
    substitute(
        monkeypatch, "certificate.BERNSTEIN", np.array([[comb(k, j) / comb(degree, j) for j in powers] for k in powers])
    )


def single_bound(A, B, step, x, u, lower=None, upper=None):
    """Return the peak of the upper bound of a plant over one period."""
    plant, box = lfo.LinearDynamics.from_continuous(A, B, step), lfo.Box(lower, upper)
    problem = lfo.OptimalControlProblem(plant, 1, lfo.QuadraticCost(R=1.0), state_set=box)
    bounds = bounds_between_samples(problem, lfo.simulate(problem, [u], x)).bounds
    return next(bound for bound in bounds if bound.side == "upper")


@expensive
@pytest.mark.parametrize("cells", [1, 8])
def test_the_proven_value_covers_the_rest_of_the_series(monkeypatch, cells):
    """x' = x from 1: with four terms a cell, the polynomials are below the exponential, and their errors grow."""
    use_degree(monkeypatch, 4)
    bound = single_bound([[1.0]], [[1.0]], cells * REACH, [1.0], [0.0], upper=1.0)
    assert bound.violation < np.expm1(cells * REACH) - 1e-4
    assert bound.at_most >= np.expm1(cells * REACH)


def test_the_proven_value_covers_errors_before_the_state_comes_to_rest(monkeypatch):
    """x_1 = t exp(-t) is 1/e at most, at t = 1; 50 s later all errors are small."""
    use_degree(monkeypatch, 4)
    bound = single_bound([[-1.0, 1.0], [0.0, -1.0]], np.zeros((2, 1)), 50.0, [0.0, 1.0], [0.0], upper=[0.1, np.inf])
    assert bound.violation < np.exp(-1) - 0.1
    assert bound.at_most >= np.exp(-1) - 0.1


def test_the_proven_value_is_a_bound_when_cells_are_not_halved_to_the_end(monkeypatch):
    """The largest value of t exp(-t) lies within a cell, whose ends are below it."""
    substitute(monkeypatch, "certificate.LATEST_HALVING", 0)
    bound = single_bound([[-1.0, 1.0], [0.0, -1.0]], np.zeros((2, 1)), 3.1, [0.0, 1.0], [0.0], upper=[0.1, np.inf])
    assert bound.violation < np.exp(-1) - 0.1 - 1e-4
    assert bound.at_most >= np.exp(-1) - 0.1


@pytest.mark.parametrize(("frequency", "loose"), [(10.0, False), (200.0, True)])
def test_a_bound_far_above_the_simulation_is_told(frequency, loose):
    """Over 32 oscillations in a period, the errors of cells add up to more than any state."""
    plant = lfo.LinearDynamics.from_continuous([[0, frequency], [-frequency, 0]], [[0.0], [1.0]], 1.0)
    box = lfo.Box([-1, -9], [1, 9])
    problem = lfo.OptimalControlProblem(plant, 2, lfo.QuadraticCost(R=1.0), state_set=box)
    found = bounds_between_samples(problem, lfo.simulate(problem, np.zeros((2, 1)), [0.5, 0.5]))
    assert (max(bound.at_most for bound in found.bounds) > 10) == loose
    assert found.simulated == (("x_0", "x_1") if loose else ())
    assert str(found).startswith("all state bounds hold between the samples")
    assert ("by a simulation (the rigorous at_most of x_0 and x_1 is" in str(found)) == loose


@pytest.mark.parametrize(("start", "limit"), [(1e6, 1e6), (1 / 3, -1e6)])
@pytest.mark.parametrize("seed", range(6))
def test_the_proven_value_covers_rounding(start, limit, seed):
    """x' = u: x_0 + u h is the largest value, in exact arithmetic; states and limits are far larger than the motion."""
    x, u, h = start + np.random.default_rng(seed).uniform(0.0, 1e-6), 1e-6 / 3, 0.1
    bound = single_bound([[0.0]], [[1.0]], h, [x], [u], lower=limit - 1e-6 if start > 1 else None, upper=limit)
    assert Fraction(bound.at_most) >= Fraction(x) + Fraction(u) * Fraction(h) - Fraction(limit)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_within_a_period_the_wider_bound_of_both_samples_counts(side):
    """The state moves along its bounds, from 1 to 0 and back."""
    plant = lfo.LinearDynamics.from_continuous([[0.0]], [[1.0]], 1.0)
    limits = [side * value for value in (1.0, 0.0, 1.0)]
    boxes = [lfo.Box(None, limit) if side > 0 else lfo.Box(limit, None) for limit in limits]
    problem = lfo.OptimalControlProblem(plant, 2, lfo.QuadraticCost(R=1.0), state_set=boxes)
    (bound,) = bounds_between_samples(problem, lfo.simulate(problem, [[-side], [side]], [side])).bounds
    assert bound.violation <= 0
    (bound,) = bounds_between_samples(problem, lfo.simulate(problem, [[-side], [side]], [2 * side])).bounds
    assert bound.violation == pytest.approx(1.0)
