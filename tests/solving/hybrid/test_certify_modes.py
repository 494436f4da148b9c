"""certify() of problems with modes: trajectories alone, flips that are tried, files, the command line, JSON."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from jsonschema import Draft202012Validator

import lin_freq_ocp as lfo
from helpers import kinks
from helpers.borders import changed, multipliers_of, peak_optimum
from helpers.schemas import RESULT, faults, printed
from helpers.seeds import expensive
from lin_freq_ocp import library
from lin_freq_ocp.certificate import judge
from lin_freq_ocp.cli import cli
from lin_freq_ocp.files import certificate_summary, save_solution
from lin_freq_ocp.methods import uniqueness
from lin_freq_ocp.methods.hybrid import multipliers_with_weights
from lin_freq_ocp.pages import verdict, worst_location
from lin_freq_ocp.problem.hybrid import REGION
from lin_freq_ocp.transform import Reduced
from lin_freq_ocp.transform.hybrid import linear_along


def best(problem):
    """Return the sequences of an elastic wall, from those that are free at first, by their optimal costs."""
    T = problem.horizon
    sequences = [np.array([(k >> t) & 1 for t in range(T)]) for k in range(2**T)]
    results = [(one, lfo.solve(problem.with_modes(one), throw=False)) for one in sequences if not one[0]]
    return sorted(((r.cost, list(s), r) for s, r in results if r.status == "optimal"), key=lambda found: found[0])


@pytest.fixture(scope="module")
def wall():
    problem = kinks.elastic_wall(4, initial_state=[0.8, 0.5])
    return problem, best(problem)


def test_controls_alone_are_replayed_through_the_modes():
    problem = kinks.peak()
    certificate = lfo.certify(problem, [[1.0], [4.0]])
    assert certificate.pmp == "satisfied"
    assert certificate.cost == pytest.approx(-5.75)
    with pytest.raises(lfo.errors.ProblemError, match="expected shape"):
        lfo.certify(problem, [[1.0]])
    with pytest.raises(lfo.errors.ProblemError, match="trajectory"):
        lfo.certify(problem, lfo.Trajectory(np.zeros((2, 1)), np.zeros((1, 1))))


@expensive
def test_the_best_sequence_is_extremal_and_the_others_have_a_verified_flip_or_are_extremal(wall):
    problem, found = wall
    assert len(found) > 3
    least, flipped = found[0][0], 0
    for cost, sequence, result in found:
        certificate = lfo.certify(problem, result.trajectory)
        facts = certificate.borders
        if cost == least:
            assert certificate.pmp == "satisfied"
            assert facts.flip_stationary
        for flip in facts.flips:
            assert flip.improves
            other = [*sequence]
            other[flip.time] = flip.mode
            assert lfo.solve(problem.with_modes(other)).cost < cost
            flipped += 1
        assert bool(facts.flips) == (certificate.descent is not None) == (not facts.flip_stationary)
    assert flipped >= 2


def test_a_trajectory_that_is_no_extremal_has_a_descent():
    problem = kinks.peak()
    certificate = lfo.certify(problem, [[0.5], [3.0]])
    assert certificate.pmp == "violated"
    assert certificate.feasible
    assert certificate.descent.slope < 0
    assert certificate.borders.times == ()
    assert str(certificate.borders) == "modes meet nowhere along the trajectory"


@expensive
def test_abnormal_multipliers_are_found_where_there_are_no_others():
    """x_1 = min(x_0, 2 - x_0) + u_2 = 1 from x_0 = 1 leaves u = 0 alone of the ball above it, whatever u_1 costs."""
    modes = [
        lfo.AffineMode(mode.linear.A, [[0.0, 1.0]], mode.linear.offset, G=mode.region.C, h=mode.region.e)
        for mode in kinks.peak().dynamics.modes
    ]
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes),
        1,
        lfo.QuadraticCost(r=[1.0, 0.0]),
        lfo.sets.Ball(1.0, centre=[0.0, 1.0]),
        initial_state=[1.0],
        terminal_state=[1.0],
    )
    certificate = lfo.certify(problem, [[0.0, 0.0]])
    assert certificate.pmp == "satisfied"
    assert certificate.normal is False
    assert certificate.borders.times == (0,)


def test_multipliers_of_a_region_that_repeats_a_bound_become_those_of_the_bound():
    """The regions say u <= 2 as the control set does; the fit may give the multiplier to either."""
    problem = kinks.peak()
    modes = [
        lfo.AffineMode(
            m.linear.A, m.linear.B, m.linear.offset, G=[*m.region.C, [0.0]], H=[[0.0], [1.0]], h=[*m.region.e, 2.0]
        )
        for m in problem.dynamics.modes
    ]
    problem = replace(problem, dynamics=lfo.PiecewiseAffineDynamics(modes), control_set=lfo.Box(-5, 2))
    result = lfo.solve(problem.with_modes([0, 0]))
    assert result.control[1] == pytest.approx([2.0])
    stage = {REGION: result.multipliers.stage[REGION].copy()}
    nu = result.multipliers.nu.copy()
    stage[REGION][1, 1] += nu[1, 0]  # all of it
    nu[1, 0] = 0.0
    given = changed(result.multipliers, nu=nu, stage=stage)
    multipliers = multipliers_with_weights(problem, result.trajectory, np.array([0, 0]), given)
    assert multipliers.nu[1, 0] == pytest.approx(1.0, abs=1e-6)  # 2 - u_1 / 2
    assert judge(problem, result.trajectory, multipliers).pmp == "satisfied"
    assert lfo.certify(problem, result.trajectory).pmp == "satisfied"


@pytest.mark.parametrize("far", [1e3, 1e5])
def test_a_proven_optimum_with_a_mask_at_every_frequency_is_certified_by_its_trajectory_alone(far):
    """A fit of multipliers leaves residuals as large as their terms; multipliers of the sequence leave none."""
    left = lfo.dynamics.AffineMode([[-0.9]], [[0.0109]], G=[[-0.2135]], h=[0.1215])
    right = lfo.dynamics.AffineMode([[-1.3255]], [[0.0109]], [-0.2422], G=[[0.2135]], h=[-0.1215])
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics([left, right]),
        3,
        lfo.QuadraticCost(Q=7e5, P=4.5e5, x_ref=-2.56),
        lfo.Box(-far, far),
        state_set=lfo.Box(-far, far),
        initial_state=[2.38],
        control_spectrum=lfo.MagnitudeBound(2.32, band=lfo.low_pass(1.2), every_frequency=True),
        stage_rows=lfo.StageRows([[-0.005]], [[0.0206]], [0.4586], "soft", penalty=1.7e7),
    )
    result = lfo.solve(problem)
    assert (result.status, result.certificate.pmp) == ("optimal", "satisfied")
    assert lfo.certify(problem, result.trajectory).pmp == "satisfied"


@pytest.mark.parametrize("price", [-5.0, 5.0])
@pytest.mark.parametrize("pushed", [-3.0, 3.0])
def test_a_fixed_control_at_a_kink_has_one_multiplier_of_either_sign(price, pushed):
    """x_1 = |u_0| costs 1 and u_0 = 0 is fixed: with all weight on the rising mode, nu = -1 - price."""
    modes = [lfo.AffineMode([[0.0]], [[slope]], G=[[0.0]], H=[[-slope]], h=[0.0]) for slope in (1.0, -1.0)]
    cost = lfo.QuadraticCost(r=[price], p=[1.0])
    problem = lfo.OptimalControlProblem(lfo.PiecewiseAffineDynamics(modes), 1, cost, lfo.Box(0, 0), initial_state=[0.0])
    given = multipliers_of(problem, [-1.0], [0.0, 0.0], [-1.0 - price - pushed])
    at_rest = lfo.simulate(problem, [[0.0]])
    found = multipliers_with_weights(problem, at_rest, np.array([0]), given, np.array([[0.0, pushed]]))
    slopes = found.weights[0] @ [-1.0, 1.0]  # of the modes, times eta = -1
    assert found.nu[0, 0] == pytest.approx(slopes - price)
    assert judge(problem, at_rest, found).pmp == "satisfied"


def test_joint_rows_of_a_stage_may_carry_what_a_mode_needs():
    """x_1 <= 1 as a joint row at the kink of the valley: for each mode, a multiplier of its own."""
    rows = lfo.StageRows([[1.0]], None, [1.0], name="ceiling")
    problem = replace(kinks.valley(), stage_rows=rows)
    certificate = lfo.certify(problem, [[-1.0], [4.0]])
    assert certificate.pmp == "satisfied"
    assert [(flip.mode, flip.improves) for flip in certificate.borders.flips] == [(0, True)]
    floor = lfo.StageRows([[-1.0]], None, [-1.0], name="floor")
    both = replace(problem, stage_rows=[rows, floor], initial_state=[1.0], horizon=1, control_set=lfo.Box(-5, 5))
    assert lfo.certify(both, [[4.0]]).borders.flip_stationary  # nothing leaves x_0 = 1


def test_uniqueness_counts_the_rows_of_the_sequence():
    problem, trajectory, _ = peak_optimum()
    found = uniqueness(linear_along(problem, trajectory), trajectory)
    assert found.unique
    assert found.active == uniqueness(problem.with_modes([0, 0]), trajectory).active


# --- files, words, command line ---------------------------------------------------------------------------------------


def test_weights_survive_the_round_trip(tmp_path):
    _, trajectory, multipliers = peak_optimum()
    save_solution(tmp_path / "run.npz", trajectory, multipliers, {})
    saved = lfo.load(tmp_path / "run.npz").multipliers
    assert (saved.weights == multipliers.weights).all()
    save_solution(tmp_path / "none.npz", trajectory, changed(multipliers, weights=None), {})
    assert lfo.load(tmp_path / "none.npz").multipliers.weights is None
    with np.load(tmp_path / "run.npz") as archive:
        arrays = dict(archive)
    np.savez(tmp_path / "bad.npz", **(arrays | {"weights": np.zeros(2)}))
    with pytest.raises(lfo.errors.ProblemError, match=r"bad\.npz: weights"):
        lfo.load(tmp_path / "bad.npz")


@expensive
@pytest.mark.parametrize("case", ["peak", "valley", "rotation", "inside"])
def test_certificates_of_modes_are_valid_json(case):
    problem, u = {
        "peak": (kinks.peak(), [[1.0], [4.0]]),
        "valley": (kinks.valley(), [[-1.0], [4.0]]),
        "rotation": (kinks.rotation(), np.zeros((5, 1))),
        "inside": (kinks.peak(), [[0.5], [4.0]]),
    }[case]
    certificate = lfo.certify(problem, u)
    summary = printed(certificate_summary(problem, certificate))
    assert faults(RESULT, summary) == []
    borders = summary["certificate"]["borders"]
    assert borders["times"] == list(certificate.borders.times)
    assert (borders["jumping"] is None) == (case != "rotation")
    assert [flip["improves"] for flip in borders["flips"]] == [flip.improves for flip in certificate.borders.flips]
    assert borders["modes"] == list(problem.mode_names)
    assert len(borders["weights"]) == len(borders["times"])
    spoiled = summary | {"certificate": summary["certificate"] | {"borders": borders | {"extra": 1}}}
    assert not Draft202012Validator(RESULT).is_valid(spoiled)


@expensive
def test_words_tell_what_holds_at_borders():
    good, bad = (lfo.certify(kinks.peak(), [[1.0], [4.0]]), lfo.certify(kinks.valley(), [[-1.0], [4.0]]))
    assert "modes meet at t = 1; joint inclusion holds; flip-stationary; printed form holds" in str(good.borders)
    assert "not flip-stationary; flip t = 1 to rising (rate 12, verified)" in str(bad.borders)
    assert "Modes meet at t = 1. There the dynamics have no single derivative." in verdict(good)
    assert "towards “rising” at t = 1 (rate 12, and the cost does fall there, which was verified)" in " ".join(
        verdict(bad)
    )
    assert "a search over their sequences" in " ".join(verdict(good))
    jumping = lfo.certify(kinks.rotation(), np.zeros((5, 1)))
    assert "does not apply" in " ".join(verdict(jumping))
    refused = lfo.certify(kinks.inner_absolute_value(), [[0.0], [0.5]])
    assert "which does not improve: it has other multipliers" in str(refused.borders)
    assert "where the cost does not fall: that sequence has other multipliers" in " ".join(verdict(refused))


def invoke(monkeypatch, tmp_path, problem, trajectory, multipliers=None, *options):
    monkeypatch.setitem(library.PROBLEMS, "kink", lambda: problem)
    save_solution(tmp_path / "run.npz", trajectory, multipliers, {})
    return CliRunner().invoke(cli, ["certify", "kink", str(tmp_path / "run.npz"), *options], standalone_mode=False)


@expensive
def test_the_command_line_judges_modes(monkeypatch, tmp_path):
    problem, trajectory, multipliers = peak_optimum()
    for given in (None, multipliers):
        answer = invoke(monkeypatch, tmp_path, problem, trajectory, given)
        assert answer.return_value == 0, answer.output
        assert "N-f" in answer.output
        assert "borders     modes meet at t = 1; joint inclusion holds; flip-stationary" in answer.output
        assert "multipliers unique" in answer.output
    weights = changed(multipliers, weights=[[1.0, 0.0], [1.0, 0.0]])
    assert invoke(monkeypatch, tmp_path, problem, trajectory, weights).return_value == 3
    summary = json.loads(invoke(monkeypatch, tmp_path, problem, trajectory, weights, "--json").output)
    assert summary["certificate"]["pmp"] == "violated"
    assert summary["certificate"]["borders"]["joint"] is False
    valley = kinks.valley()
    answer = invoke(monkeypatch, tmp_path, valley, lfo.simulate(valley, [[-1.0], [4.0]]))
    assert "descent     no local minimum" in answer.output
    assert "flip t = 1 to rising" in answer.output
    spoiled = changed(multipliers, weights=[[0.5, 0.5], [0.625, 0.375]])
    conditions = judge(problem, trajectory, spoiled).conditions
    places = {one.label: worst_location(problem, one) for one in conditions}
    assert places["N-f"] in ("t = 0, rising", "t = 0, falling")


def test_the_command_line_says_that_a_jump_is_outside_the_theorem(monkeypatch, tmp_path):
    problem = kinks.rotation()
    answer = invoke(monkeypatch, tmp_path, problem, lfo.simulate(problem, np.zeros((5, 1))))
    assert answer.return_value == 3
    assert "maximum principle not applicable" in answer.output
    assert "jumps between left turn and right turn" in answer.output


def test_a_result_shows_its_borders():
    problem, trajectory, multipliers = peak_optimum()
    linear = lfo.solve(problem.with_modes([0, 0]))
    certificate = judge(problem, trajectory, multipliers)
    result = replace(linear, problem=problem, multipliers=multipliers, certificate=certificate)
    assert "borders   modes meet at t = 1; joint inclusion holds" in str(result)
    assert "bound     none" in str(result)
    assert result.uniqueness.unique
    assert not result.dual


def test_multipliers_of_any_place_are_judged_without_an_error():
    """Infeasible, far away, all zero: an answer, and never a traceback."""
    problem = kinks.peak()
    for x, u in (([[0.0], [50.0], [-3.0]], [[1e3], [0.0]]), ([[1e200], [0.0], [0.0]], [[0.0], [1e200]])):
        certificate = judge(
            problem, lfo.Trajectory(x, u), multipliers_of(problem, np.zeros(2), np.zeros(3), np.zeros(2))
        )
        assert certificate.pmp == "violated"
        assert not certificate.feasible


class Doubled(Reduced):
    """The way back from a problem whose multipliers are half as large, and whose cost is lower by 1."""

    cost = 1.0

    def multipliers(self, reduced, at=None):
        return replace(reduced, eta=2.0 * reduced.eta)


def test_all_multipliers_and_bounds_of_a_tree_are_recovered():
    result = lfo.solve(lfo.library.pendulum_with_wall(horizon=4))
    evidence = result.evidence
    recovered = evidence.recovered(Doubled(result.problem, result.problem))
    pairs = [(a.proof, b.proof) for a, b in zip(evidence.tree.nodes, recovered.tree.nodes, strict=True) if a.proof]
    assert pairs
    for before, after in pairs:
        np.testing.assert_array_equal(after.multipliers.eta, 2.0 * before.multipliers.eta)
    assert recovered.lower_bound == evidence.lower_bound + 1.0
