"""Masks at every frequency: published figures, what is judged, and every method by the same exchange."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.clocks import Clock
from helpers.replacing import substitute
from helpers.seeds import expensive, whole_sample
from lin_freq_ocp import Trajectory
from lin_freq_ocp.base import use_clock
from lin_freq_ocp.comparison import ProblemSignal, measured_solution
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.files import result_summary
from lin_freq_ocp.problem import peaks_above
from lin_freq_ocp.results import Multipliers, Status
from lin_freq_ocp.solving import LinearAuto, judge_candidate

MASK = lfo.MagnitudeBound
PEAK_OF_CLASSICAL = 29.343  # of the double integrator's bang-off-bang control, at frequency 0


def masked(limit=1.5, band=None, problem=None, **fields):
    problem = lfo.library.double_integrator(horizon=100, sampling_time=0.04) if problem is None else problem
    bound = MASK(limit, band=lfo.low_pass(0.6) if band is None else band, every_frequency=True, **fields)
    return replace(problem, control_spectrum=bound)


@pytest.fixture(scope="module")
def solved():
    return lfo.solve(masked())


def spectrum(signal, w):
    return np.polynomial.polynomial.polyval(np.exp(-1j * w), signal).T


def peaks_of(result):
    return [condition.peak for condition in result.certificate.conditions if condition.peak is not None]


# Level and band from shared figures on the pendulum; cost to 1e-7, as two independent programs found it
@pytest.mark.parametrize(
    ("level", "bin_of_240", "step", "cost"),
    [(0.5, 90, 0.1, 339.591322), pytest.param(0.2, 80, 0.01, 3670.032556, marks=whole_sample)],
)
def test_published_costs_of_the_pendulum(level, bin_of_240, step, cost):
    pendulum = lfo.library.pendulum(sampling_time=step)
    result = lfo.solve(masked(level, lfo.low_pass(2 * np.pi * bin_of_240 / 240), pendulum))
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    assert result.cost == pytest.approx(cost, rel=1e-7)
    (peak,) = peaks_of(result)
    assert abs(result.gap) < 1e-6
    assert peak.ratio - 1 < 1e-7


@expensive
@pytest.mark.parametrize("interrupted", [False, True])
def test_a_proof_that_is_cut_short_leaves_the_answer_of_the_rounds(solved, interrupted, monkeypatch):
    """If the claim is not proven, the last grid is solved once more: at a limit of time or Ctrl-C, the claim counts."""
    run, judgements = LinearAuto.solve, iter([Status.LOCALLY_OPTIMAL])

    def judge_at_first_unproven(*given):
        outcome = judge_candidate(*given)
        return replace(outcome, status=next(judgements, outcome.status))

    def cut_short(self, problem, request):
        outcome = run(self, problem, request)
        if not request.proof:
            return outcome
        return replace(outcome, status=Status.LIMIT, trajectory=None, multipliers=None, interrupted=interrupted)

    monkeypatch.setattr(LinearAuto, "solve", cut_short)
    substitute(monkeypatch, "solving.judge_candidate", judge_at_first_unproven)
    result = lfo.solve(masked(), throw=False)
    assert (result.status, result.interrupted) == ("optimal", interrupted)
    assert result.cost == pytest.approx(solved.cost, rel=1e-8)


def test_ctrl_c_in_a_later_round_of_a_search_is_told(monkeypatch):
    run, solves = lfo.solvers.BranchAndBound.solve, list[lfo.OptimalControlProblem]()

    def interrupted_later(self, problem, request):
        solves.append(problem)
        outcome = run(self, problem, request)
        gone = {"status": Status.LIMIT, "trajectory": None, "multipliers": None, "interrupted": True}
        return outcome if len(solves) == 1 else replace(outcome, **gone)

    def slightly_above(*given):
        points, ratios = peaks_above(*given)
        return points, np.append(ratios, 1 + 1e-7)  # enough for another round, too little to spoil the answer

    monkeypatch.setattr(lfo.solvers.BranchAndBound, "solve", interrupted_later)
    substitute(monkeypatch, "problem.peaks_above", slightly_above)
    integrator = lfo.LinearDynamics([[1.0]], [[1.0]])
    problem = lfo.OptimalControlProblem(
        integrator, 5, lfo.QuadraticCost(R=1.0), lfo.FiniteSet([-1, 0, 1]), initial_state=[0], terminal_state=[2]
    )
    result = lfo.solve(masked(9.0, problem=problem), throw=False)
    assert (len(solves), result.status, result.interrupted) == (2, "optimal", True)


def test_the_spectrum_stays_below_the_limit_between_the_bins(solved):
    w = np.linspace(0.6, np.pi, 40_001)
    above = np.abs(spectrum(solved.trajectory.u[:, 0], w)).max()
    (peak,) = peaks_of(solved)
    assert above <= 1.5 * peak.ratio
    assert 1.5 * (1 - 1e-6) < above
    ((name, atoms),) = solved.multipliers.frequencies.items()
    values, weights = spectrum(solved.trajectory.u[:, 0], atoms), solved.multipliers.stage[name]
    aligned = (weights * np.column_stack([values.real, values.imag])).sum(1)
    heavy = np.linalg.norm(weights, axis=1) > 1e-3 * np.linalg.norm(weights, axis=1).max()
    assert heavy.any()
    np.testing.assert_allclose(np.abs(values[heavy]), 1.5, rtol=1e-6)
    np.testing.assert_allclose(aligned[heavy], 1.5 * np.linalg.norm(weights, axis=1)[heavy], rtol=1e-5)


@expensive
@pytest.mark.parametrize("method", ["convex", "structured"])
def test_methods_find_the_same(solved, method):
    result = lfo.solve(masked(), method)
    assert result.method == method
    assert result.cost == pytest.approx(solved.cost, rel=1e-8)


@expensive
def test_the_bound_lies_between_those_of_grids(solved):
    """A grid bounds from below at its points; with ``between``, it asks for more than every frequency."""
    problem = lfo.library.double_integrator(horizon=100, sampling_time=0.04)
    band = lfo.low_pass(0.6 - 1e-9)
    coarse = replace(problem, control_spectrum=MASK(1.5, band=band, oversampling=8))
    assert lfo.solve(coarse).cost < solved.cost
    tight = replace(problem, control_spectrum=MASK(1.5 * 0.99, band=lfo.low_pass(0.55), oversampling=16, between=True))
    assert solved.cost < lfo.solve(tight).cost


# --- what is given ---------------------------------------------------------------------------------------------------


LIMITS = {
    "points": ([[0.3, 9.0], [1.0, 0.6], [np.pi, 1.2]], lfo.low_pass(0.3), {}),
    "decibels": (None, lfo.low_pass(0.3), {"limit_db": [[0.3, -10], [1.0, -34], [np.pi, -28]], "reference": 29.0}),
    "function": (lambda w: 3 / (1 + w), lfo.low_pass(0.3), {}),
    "hertz": (2.0, lfo.low_pass(cutoff_hz=2.0), {}),
    "notch": (2.0, lfo.spectrum.notch(0.5, 0.3), {}),
    "band pass": (2.9, lfo.spectrum.band_pass(0.0, 0.4), {}),
    "window": (0.5, lfo.low_pass(0.6), {"window": "hann"}),
}


@expensive
@pytest.mark.parametrize("name", LIMITS)
def test_limits_and_bands(name):
    limit, band, fields = LIMITS[name]
    result = lfo.solve(masked(limit, band, **fields))
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    (peak,) = peaks_of(result)
    assert peak.ratio - 1 < 5e-7
    if "window" not in fields:
        assert peak.found > 1 - 1e-6  # the limit is active
    samples = result.trajectory.u[:, 0] * (np.hanning(100) if "window" in fields else 1)
    w = np.linspace(0, np.pi, 5001)
    kept = (result.problem.terms[0].semi_infinite.limits.at(w)) * (1 + 1e-6)
    assert (np.abs(spectrum(samples, w)) <= kept).all()


@expensive
@pytest.mark.parametrize(("band", "unit"), [(lfo.low_pass(cutoff_hz=2.0), "Hz"), (lfo.low_pass(0.3), "rad/sample")])
def test_a_peak_is_told_in_the_unit_of_the_band(band, unit):
    result = lfo.solve(masked(2.0, band))
    (peak,) = peaks_of(result)
    factor = 1 / (2 * np.pi * result.problem.sampling_time) if unit == "Hz" else 1.0
    assert str(peak).endswith(f" at {factor * peak.frequency:.6g} {unit}")
    (table,) = [table["peak"] for table in result_summary(result)["certificate"]["conditions"] if "peak" in table]
    assert table == {"ratio": peak.ratio, "found": peak.found, "frequency": peak.frequency, "damping": None}


def test_decibels_are_linear_over_the_logarithm():
    bound = MASK(
        limit_db=[[0.1, 0], [1.0, -20]], reference=2.0, band=lfo.spectrum.notch(0.5, 0.6), every_frequency=True
    )
    problem = replace(lfo.library.double_integrator(horizon=20, cutoff_hz=None), control_spectrum=bound)
    (term,) = (term for term in problem.terms if term.semi_infinite is not None)
    limits = term.semi_infinite.limits
    inside = (limits.low > 0.21) & (limits.high < 0.79)
    assert inside.sum() > 20
    w, at = limits.low[inside], limits.at_low[inside]
    np.testing.assert_allclose(at, 2.0 * 10 ** (-np.log10(w / 0.1)), rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "field", "words"),
    [
        (lambda: MASK(0.0, band=lfo.low_pass(1.0), every_frequency=True), "limit", "vanishes on an interval"),
        (lambda: MASK([[0.5, 1], [4, 0]], band=lfo.low_pass(1.0), every_frequency=True), "limit", "above zero"),
        (lambda: MASK(1.0, bins=[3, 4], every_frequency=True), "MagnitudeBound", "a band of frequencies"),
        (lambda: MASK(1.0, band=lfo.low_pass(1.0), every_frequency=True, oversampling=2), "MagnitudeBound", "overs"),
        (lambda: MASK(1.0, band=lfo.low_pass(1.0), every_frequency=True, penalty=0.0), "MagnitudeBound.penalty", "0"),
        (lambda: MASK(1.0, band=lfo.low_pass(1.0), every_frequency=1), "every_frequency", "True or False"),
        (lambda: MASK([1.0, 2.0], band=lfo.low_pass(1.0), every_frequency=True), "limit", "shape (points, 2)"),
        (lambda: MASK([[2, 1], [1, 1]], band=lfo.low_pass(1.0), every_frequency=True), "limit", "increase"),
        (lambda: masked([[1.0, 1.0], [3.2, 1.0]], lfo.low_pass(0.5)), "limit", "points from 0.5"),
        (lambda: masked(1.0, lfo.low_pass(np.pi)), "band", "removes frequencies"),
        (lambda: MASK(lambda f: 1 / f, band=lfo.low_pass(cutoff_hz=1), every_frequency=True), "limit", "Give points"),
        (lambda: MASK(limit_db=[[0, 0], [4, 0]], reference=1.0, band=lfo.low_pass(1.0), every_frequency=True),
         "limit_db", "above 0"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(make, field, words):
    with pytest.raises(ProblemError) as raised:
        make()
    assert field in str(raised.value)
    assert words in str(raised.value)


# --- states, outputs, modes ------------------------------------------------------------------------------------------


@expensive
def test_states_and_outputs_have_the_same_optimum(solved):
    problem = lfo.library.double_integrator(horizon=100, sampling_time=0.04)
    speed = np.abs(spectrum(lfo.solve(problem).trajectory.x[:, 1], np.linspace(0.6, np.pi, 2001))).max()
    bound = MASK(0.7 * speed, band=lfo.low_pass(0.6), every_frequency=True)
    of_state = lfo.solve(replace(problem, state_spectrum=replace_component(bound, 1)))
    output = lfo.spectrum.OutputSpectrum(C=[[0.0, 1.0]], constraints=bound)
    of_output = lfo.solve(replace(problem, output_spectrum=output))
    assert of_state.status == of_output.status == "optimal"
    assert of_state.cost == pytest.approx(of_output.cost, rel=1e-9)
    labels = [[c.label for c in result.certificate.conditions if c.peak] for result in (of_state, of_output)]
    assert labels == [["C-vi"], ["S-yhat"]]


def replace_component(bound, component):
    return MASK(float(bound.limit), band=bound.band, component=component, every_frequency=True)


@expensive
def test_two_controls_have_atoms_of_their_own():
    dynamics = lfo.LinearDynamics([[1.0, 0.1], [0.0, 0.95]], np.eye(2) * 0.1)
    cost = lfo.QuadraticCost(Q=np.eye(2), R=0.05 * np.eye(2))
    problem = lfo.OptimalControlProblem(dynamics, 20, cost, initial_state=[3.0, -4.0])
    free = lfo.solve(problem).trajectory.u
    limit = 0.5 * np.abs(spectrum(free, np.linspace(1.0, np.pi, 500))).max()
    bound = MASK(limit, band=lfo.low_pass(1.0), every_frequency=True)
    result = lfo.solve(replace(problem, control_spectrum=bound))
    assert (result.status, len(result.multipliers.frequencies)) == ("optimal", 2)
    assert max(peak.ratio for peak in peaks_of(result)) < 1 + 1e-7


@expensive
@pytest.mark.parametrize("method", ["branch_and_bound", "enumerate"])
def test_searches_over_modes(method):
    wall = lfo.library.pendulum_with_wall(horizon=6)
    free = np.abs(spectrum(lfo.solve(wall).trajectory.u[:, 0], np.linspace(1.2, np.pi, 500))).max()
    problem = masked(0.7 * free, lfo.low_pass(1.2), wall)
    result = lfo.solve(problem, method)
    assert result.status == "optimal"
    assert peaks_of(result)[0].ratio < 1 + 5e-7
    again = lfo.certify(problem, result)  # the tree is checked anew, at its own frequencies
    assert again.lower_bound == pytest.approx(result.lower_bound, rel=1e-9)
    assert again.globally_optimal


# --- the judge -------------------------------------------------------------------------------------------------------


def failed_labels(problem, trajectory, multipliers):
    return {condition.label for condition in lfo.certify(problem, trajectory, multipliers).failed}


def test_a_moved_or_turned_atom_fails(solved):
    given = solved.multipliers
    ((name, atoms),) = given.frequencies.items()
    heaviest = int(np.argmax(np.linalg.norm(given.stage[name], axis=1)))
    moved = atoms.copy()
    moved[heaviest] += 0.003
    assert "N-uhat" in failed_labels(solved.problem, solved.trajectory, replace(given, frequencies={name: moved}))
    turned = given.stage[name].copy()
    turned[heaviest] = turned[heaviest] @ [[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]]
    labels = failed_labels(solved.problem, solved.trajectory, replace(given, stage={name: turned}))
    assert labels >= {"N-uhat", "C-v"}


def test_a_peak_raised_by_a_millionth_between_the_bins_fails(solved):
    """Without changing any other condition: a problem whose limit is lower by 1e-6 at that place is not satisfied."""
    (peak,) = peaks_of(solved)
    bins = np.arange(51) * 2 * np.pi / 100
    assert np.abs(bins - peak.frequency).min() > 1e-3
    lower = masked(1.5 / (1 + 1e-6) / peak.found)
    assert "C-vii" in failed_labels(lower, solved.trajectory, solved.multipliers)
    same = masked(1.5 / (1 + 1e-7) / peak.found)
    assert "C-vii" not in failed_labels(same, solved.trajectory, solved.multipliers)


def test_any_atoms_bound_the_optimum(solved):
    """A feasible signal satisfies the mask at every frequency: D is a bound wherever the atoms stand."""
    given, rng = solved.multipliers, np.random.default_rng(0)
    ((name, atoms),) = given.frequencies.items()
    for spread in (1e-4, 1e-2, 1.0):
        moved = np.clip(atoms + spread * rng.standard_normal(len(atoms)), 0.6, np.pi)
        certificate = lfo.certify(solved.problem, solved.trajectory, replace(given, frequencies={name: moved}))
        assert certificate.bound.value <= solved.cost * (1 + 1e-9)


@expensive
def test_multipliers_are_found_for_a_trajectory_alone(solved):
    certificate = lfo.certify(solved.problem, solved.trajectory)
    assert (certificate.pmp, certificate.globally_optimal) == ("satisfied", True)


def test_atoms_outside_the_circle_or_without_weights_are_refused(solved):
    given = solved.multipliers
    ((name, atoms),) = given.frequencies.items()
    fields = {key: getattr(given, key) for key in ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x", "stage")}
    for wrong, words in ((atoms - 4.0, "from 0 rad/sample on"), (atoms[:-1], "one per row")):
        with pytest.raises(ProblemError, match=words):
            Multipliers(**fields, frequencies={name: wrong})
    beyond = Multipliers(**fields, frequencies={name: atoms + 4.0})
    with pytest.raises(ProblemError, match="from 0 to pi"):
        lfo.certify(solved.problem, solved.trajectory, beyond)


def test_infeasible_masks_are_proven(tmp_path):
    result = lfo.solve(masked(1e-3, lfo.spectrum.high_pass(0.9)), throw=False)
    assert (result.status, result.message) == ("infeasible", "proven by a rigorous ray")
    assert any("mask" in conflict.block for conflict in result.conflict)
    assert result.ray.frequencies


@expensive
def test_scale_does_not_matter(solved):
    """The cost in billionths, the control in millionths, and time in another unit: the same verdict."""
    problem = lfo.library.double_integrator(horizon=100, sampling_time=0.04)
    dynamics = lfo.LinearDynamics(problem.linear.A, problem.linear.B * 1e-6, sampling_time=0.04)
    unit = 1e6
    other = replace(
        problem,
        dynamics=dynamics,
        cost=lfo.QuadraticCost(R=1e-9 * problem.quadratic.R / unit**2),
        control_set=lfo.Box(problem.control_tube.lower[0] * unit, problem.control_tube.upper[0] * unit),
    )
    result = lfo.solve(masked(1.5 * unit, problem=other))
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    assert result.cost == pytest.approx(1e-9 * solved.cost, rel=1e-7)
    assert abs(result.gap) < 1e-7


# --- files -----------------------------------------------------------------------------------------------------------


def test_solutions_and_problems_are_written_and_read(solved, tmp_path):
    solved.save(tmp_path / "run.npz")
    saved = lfo.load(tmp_path / "run.npz")
    ((name, atoms),) = solved.multipliers.frequencies.items()
    assert np.array_equal(saved.multipliers.frequencies[name], atoms)
    assert lfo.certify(solved.problem, saved).globally_optimal
    assert len(saved.summary["atoms"][name]) == len(atoms)
    lfo.write_problem(solved.problem, tmp_path / "problem.toml")
    read = lfo.read_problem(tmp_path / "problem.toml")
    assert lfo.certify(read, saved).globally_optimal
    points = masked([[0.3, 9.0], [1.0, 0.6], [np.pi, 1.2]], lfo.low_pass(0.3))
    lfo.write_problem(points, tmp_path / "points.toml")
    limit = lfo.read_problem(tmp_path / "points.toml").control_spectrum[0].limit
    assert np.array_equal(limit, points.control_spectrum.limit)


@expensive
@pytest.mark.parametrize("looks", [10, 40, 80])
def test_a_time_limit_keeps_what_was_found(looks):
    """A whole solve looks at the clock 170 times."""
    with use_clock(Clock(1.0)):
        result = lfo.solve(masked(), time_limit=float(looks), throw=False)
    assert result.status in ("limit", "numerical_error")
    assert isinstance(result.trajectory, (Trajectory, type(None)))


# --- comparison and figures ------------------------------------------------------------------------------------------


@expensive
def test_what_a_filter_leaves_between_the_bins_is_beyond_the_mask():
    comparison = lfo.compare(masked(), filters=["brickwall"])
    (filtered,) = comparison.filtered
    spectrum_between = np.abs(spectrum(filtered.replay.trajectory.u[:, 0], np.linspace(0.6, np.pi, 20_001))).max()
    terms = filtered.replay.terms
    assert not terms.passed.any()
    assert terms.values[0] == pytest.approx(spectrum_between - 1.5, rel=1e-4)
    kept = measured_solution("", comparison.constrained.problem, comparison.constrained).terms
    assert kept.passed.all()


def test_a_figure_marks_where_the_spectrum_reaches_its_limit(solved):
    signal = ProblemSignal(solved.problem, 0, is_state=False)
    touching = signal.touching(solved.trajectory)
    assert len(touching.at)
    np.testing.assert_allclose(np.abs(spectrum(solved.trajectory.u[:, 0], touching.at)), touching.values, rtol=1e-6)
    (level,) = signal.levels
    assert (level.at.tolist(), level.values.tolist()) == ([0.6, np.pi], [1.5, 1.5])
    assert not len(ProblemSignal(solved.problem, 1, is_state=True).touching(solved.trajectory).at)
    solved.plot()


def test_rounds_that_the_accuracy_of_a_solver_stalls_end_and_say_so(monkeypatch):
    """Each answer has an error of another wave: the peaks that it leaves do not fall."""
    honest, rounds = lfo.solvers.Convex.solve, []

    def rough(method, problem, request):
        outcome = honest(method, problem, request)
        rounds.append(outcome.status)
        u = outcome.trajectory.u
        wave = 1e-4 * np.cos(0.25 * len(rounds) * np.arange(len(u)))
        return replace(outcome, trajectory=Trajectory(outcome.trajectory.x, u * (1 + wave[:, None])))

    monkeypatch.setattr(lfo.solvers.Convex, "solve", rough)
    problem = lfo.library.printer_move(56, sampling_time=0.002)
    with pytest.raises(
        lfo.errors.NumericalError,
        match=r"leave known frequencies as much over their limits as all, by .*'structured' has",
    ):
        lfo.solve(problem, "convex")
    assert len(rounds) < 10
