"""Residual vibration over a box of modes: against simulation of the modes, what is judged, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.results import Multipliers

H = 0.04
LIMIT = 0.02
FREE = lfo.library.double_integrator(horizon=80, sampling_time=H, cutoff_hz=None, speed_bound=None)


def calm(limit=LIMIT, frequency=(0.9, 1.1), damping=(0.0, 0.1), **fields):
    return replace(FREE, control_spectrum=lfo.ResidualVibration(frequency, damping, limit, **fields))


@pytest.fixture(scope="module")
def solved():
    return lfo.solve(calm())


def ringing(u, frequency, damping):
    """Simulate the mode, driven by held samples, and return its amplitude at the end."""
    w = 2 * np.pi * frequency
    dynamics = np.array([[0.0, 1.0, 0.0], [-(w**2), -2 * damping * w, w**2], [0.0, 0.0, 0.0]])
    step, q = scipy.linalg.expm(dynamics * H), np.zeros(2)
    for value in u:
        q = step[:2, :2] @ q + step[:2, 2] * value
    return np.hypot(q[0], (q[1] + damping * w * q[0]) / (w * np.sqrt(1 - damping**2)))


def largest(u, count=15):
    return max(ringing(u, f, d) for f in np.linspace(0.9, 1.1, count) for d in np.linspace(0.0, 0.1, 5))


def vibration_of(certificate):
    (condition,) = [one for one in certificate.conditions if one.peak is not None]
    return condition


def failed_labels(problem, trajectory, multipliers):
    return {condition.label for condition in lfo.certify(problem, trajectory, multipliers).failed}


@expensive
def test_no_mode_of_the_box_rings_more(solved):
    condition = vibration_of(solved.certificate)
    assert (solved.status, solved.certificate.pmp, condition.label) == ("optimal", "satisfied", "C-vii")
    assert largest(lfo.solve(FREE).trajectory.u[:, 0]) > 10 * LIMIT
    assert largest(solved.trajectory.u[:, 0]) <= LIMIT * condition.peak.ratio
    assert condition.peak.ratio - 1 < 1e-7
    assert abs(solved.gap) < 1e-7
    at = ringing(solved.trajectory.u[:, 0], condition.peak.frequency, condition.peak.damping)
    assert at == pytest.approx(LIMIT * condition.peak.found, rel=1e-7)
    ((_, atoms),) = solved.multipliers.frequencies.items()
    for frequency, damping in atoms:
        assert ringing(solved.trajectory.u[:, 0], frequency, damping) <= LIMIT * (1 + 1e-7)


@expensive
@pytest.mark.parametrize("method", ["convex", "structured"])
def test_methods_find_the_same(solved, method):
    assert lfo.solve(calm(), method).cost == pytest.approx(solved.cost, rel=1e-8)


@expensive
@pytest.mark.parametrize("method", ["auto", "convex", "structured"])
@pytest.mark.parametrize(("horizon", "status"), [(10, "infeasible"), (30, "optimal")])
def test_a_zero_cost_asks_for_a_shaper_only(method, horizon, status):
    shaper = lfo.OptimalControlProblem(
        lfo.LinearDynamics([[1.0]], [[1.0]], sampling_time=H),
        horizon,
        lfo.QuadraticCost(),
        lfo.Box(0, 1),
        initial_state=[0.0],
        terminal_state=[1.0],
        control_spectrum=lfo.ResidualVibration((0.9, 1.1), (0.0, 0.1), 0.05, relative=True),
    )
    result = lfo.solve(shaper, method, throw=False)
    assert result.status == status
    if status == "optimal":
        assert result.cost == result.lower_bound == 0.0
        assert lfo.certify(shaper, result.trajectory).pmp == "satisfied"


@expensive
def test_single_modes_cost_less(solved):
    """The constraint at one mode is a relaxation."""
    modes = [(f, d) for f in (0.9, 1.1) for d in (0.0, 0.1)]
    costs = [lfo.solve(calm(frequency=(f, f), damping=(d, d))).cost for f, d in modes]
    assert lfo.solve(FREE).cost < max(costs) <= solved.cost * (1 + 1e-9)
    assert lfo.solve(calm(frequency=(0.85, 1.1))).cost > solved.cost * (1 + 1e-4)


def test_a_moved_or_turned_atom_fails(solved):
    given = solved.multipliers
    ((name, atoms),) = given.frequencies.items()
    heaviest = int(np.argmax(np.linalg.norm(given.stage[name], axis=1)))
    moved = atoms.copy()
    moved[heaviest, 0] += -0.01 if atoms[heaviest, 0] > 1.0 else 0.01
    assert "N-uhat" in failed_labels(solved.problem, solved.trajectory, replace(given, frequencies={name: moved}))
    damped = atoms.copy()
    damped[heaviest, 1] = 0.1 - damped[heaviest, 1]
    assert "N-uhat" in failed_labels(solved.problem, solved.trajectory, replace(given, frequencies={name: damped}))
    turned = given.stage[name].copy()
    turned[heaviest] = turned[heaviest] @ [[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]]
    assert failed_labels(solved.problem, solved.trajectory, replace(given, stage={name: turned})) >= {"N-uhat", "C-v"}


def test_a_limit_lower_by_a_millionth_fails(solved):
    found = vibration_of(solved.certificate).peak.found
    lower = calm(LIMIT * found / (1 + 1e-6))
    assert "C-vii" in failed_labels(lower, solved.trajectory, solved.multipliers)
    assert "C-vii" not in failed_labels(calm(LIMIT * found / (1 + 1e-7)), solved.trajectory, solved.multipliers)


def test_any_atoms_bound_the_optimum(solved):
    given, rng = solved.multipliers, np.random.default_rng(0)
    ((name, atoms),) = given.frequencies.items()
    for spread in (1e-4, 1e-2, 1.0):
        moved = np.clip(atoms + spread * rng.standard_normal(atoms.shape), [0.9, 0.0], [1.1, 0.1])
        certificate = lfo.certify(solved.problem, solved.trajectory, replace(given, frequencies={name: moved}))
        assert certificate.bound.value <= solved.cost * (1 + 1e-9)


def test_atoms_outside_the_box_count_for_nothing(solved):
    given = solved.multipliers
    ((name, atoms),) = given.frequencies.items()
    outside = lfo.certify(solved.problem, solved.trajectory, replace(given, frequencies={name: atoms + 0.5}))
    assert {one.label for one in outside.failed} >= {"C-v", "N-uhat"}
    assert outside.bound.value <= lfo.solve(FREE).cost * (1 + 1e-9)
    with pytest.raises(ProblemError, match="atoms, 2"):
        lfo.certify(solved.problem, solved.trajectory, replace(given, frequencies={name: atoms[:, 0]}))
    fields = {key: getattr(given, key) for key in ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x", "stage")}
    for wrong, words in ((atoms - [2.0, 0.0], "above 0 Hz"), (atoms[:-1], "one per row")):
        with pytest.raises(ProblemError, match=words):
            Multipliers(**fields, frequencies={name: wrong})


@expensive
@pytest.mark.parametrize("limit", [LIMIT, 1e3], ids=["active", "inactive"])
def test_multipliers_are_found_for_a_trajectory_alone(solved, limit):
    problem = calm(limit)
    certificate = lfo.certify(problem, (solved if limit == LIMIT else lfo.solve(problem)).trajectory)
    assert (certificate.pmp, certificate.globally_optimal) == ("satisfied", True)


def test_what_cannot_be_held_is_proven_infeasible():
    result = lfo.solve(calm(1e-6, frequency=(0.3, 3.0)), throw=False)
    assert (result.status, result.message) == ("infeasible", "proven by a rigorous ray")
    assert any("residual vibration" in conflict.block for conflict in result.conflict)
    assert result.ray.frequencies


def test_one_damping_ratio_is_both_ends():
    single = lfo.ResidualVibration((0.9, 1.1), 0.02, LIMIT)
    assert single.damping.tolist() == [0.02, 0.02]
    text = "0.02 for every mode of 0.9 to 1.1 Hz with a damping ratio of 0.02"
    assert single.describe(["force"]).endswith(text)


@expensive
def test_a_relative_limit_counts_a_last_sample_as_itself():
    """The sum of the samples alone, by its definition, on a grid of the box; the factor differs from mode to mode."""
    result = lfo.solve(calm(0.1, relative=True))
    condition, u = vibration_of(result.certificate), result.trajectory.u[:, 0]
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    f, zeta = (part.ravel() for part in np.meshgrid(np.linspace(0.9, 1.1, 30), np.linspace(0.0, 0.1, 20)))
    z = np.exp(2 * np.pi * f * (-zeta + 1j * np.sqrt(1 - zeta**2)) * H)
    assert np.abs(np.polyval(u, z)).max() <= 0.1 * condition.peak.ratio
    assert condition.peak.ratio - 1 < 1e-7
    (term,) = result.problem.terms
    x, unit = np.zeros((81, 2)), np.zeros((80, 1))
    unit[-1] = 1.0
    values = term.semi_infinite.map.at_points(np.array([[0.9, 0.0], [1.1, 0.1]])).values(x, unit)
    assert np.hypot(*values.T) == pytest.approx([1.0, 1.0])


def test_two_vibrations_of_a_signal_are_named_by_their_bands():
    bands = [lfo.ResidualVibration(band, 0.02, LIMIT) for band in ((0.9, 1.1), (2.0, 2.5))]
    names = [term.name for term in replace(FREE, control_spectrum=bands).terms]
    signal = FREE.control_names[0]
    assert names == [f"residual vibration of {signal} at {band} Hz" for band in ("0.9 to 1.1", "2 to 2.5")]
    assert [term.name for term in calm().terms] == [f"residual vibration of {signal}"]


@expensive
def test_an_output_that_is_the_control_has_the_same_optimum(solved):
    one = lfo.ResidualVibration((0.9, 1.1), (0.0, 0.1), LIMIT)
    output = lfo.spectrum.OutputSpectrum(D=[[1.0]], constraints=one)
    result = lfo.solve(replace(FREE, output_spectrum=output))
    assert result.cost == pytest.approx(solved.cost, rel=1e-9)
    assert vibration_of(result.certificate).label == "S-yhat"


def test_solutions_and_problems_are_written_and_read(solved, tmp_path):
    solved.save(tmp_path / "run.npz")
    saved = lfo.load(tmp_path / "run.npz")
    ((name, atoms),) = solved.multipliers.frequencies.items()
    assert np.array_equal(saved.multipliers.frequencies[name], atoms)
    assert lfo.certify(solved.problem, saved).globally_optimal
    assert {len(atom) for atom in saved.summary["atoms"][name]} == {4}
    lfo.write_problem(solved.problem, tmp_path / "problem.toml")
    assert lfo.certify(lfo.read_problem(tmp_path / "problem.toml"), saved).globally_optimal


@pytest.mark.parametrize(
    ("make", "field", "words"),
    [
        (lambda: calm(frequency=(0.0, 1.0)), "frequency", "above 0 Hz"),
        (lambda: calm(frequency=(2.0, 1.0)), "frequency", "lowest and the highest"),
        (lambda: calm(frequency=1.0), "frequency", "two numbers"),
        (lambda: calm(damping=(-0.1, 0.1)), "damping", "from 0 to below 1"),
        (lambda: calm(damping=(0.1, 1.0)), "damping", "from 0 to below 1"),
        (lambda: calm(damping=1.0), "damping", "from 0 to below 1"),
        (lambda: calm(relative=1), "relative", "True or False"),
        (lambda: calm(0.0), "limit", "above zero"),
        (lambda: calm(component="speed"), "component", "acceleration"),
        (lambda: lfo.OptimalControlProblem(lfo.LinearDynamics([[1.0]], [[1.0]]), 4, lfo.QuadraticCost(R=1.0),
            initial_state=[0.0], control_spectrum=lfo.ResidualVibration((1, 2), (0, 0), 1.0)),
         "frequency", "sampling_time"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused(make, field, words):
    with pytest.raises(ProblemError) as raised:
        make()
    assert field in str(raised.value)
    assert words in str(raised.value)
