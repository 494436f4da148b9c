"""Optima of Examples 2 and 3 of the paper from cold starts, and their certificates at kinks."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from jsonschema import Draft202012Validator

import lin_freq_ocp as lfo
from helpers.command_line import parsed, run
from helpers.known_optima import solved
from helpers.schemas import RESULT
from helpers.seeds import expensive
from lin_freq_ocp import library
from lin_freq_ocp.certificate import judge
from lin_freq_ocp.certificate.hybrid import nearest_in_ball
from lin_freq_ocp.methods.hybrid import smooth_optimum

BUCK = library.buck_converter
FREE_END = {"terminal_state": None}
KINK = {"horizon": 4, "terminal_state": None, "terminal_price": -40.0}
AT_START = {"horizon": 2, "initial_state": [0.9351278729299871], **FREE_END}
INSIDE = {"horizon": 3, "initial_state": [0.8281718171540953], **FREE_END}

KNOWN = [
    (library.norm_dynamics, {"initial_state": (0.0, 1.0), "horizon": 3}, 1.0),
    (library.norm_dynamics, {"initial_state": (1.0, 0.0), "horizon": 3}, 1.959023692803284),
    (BUCK, {"horizon": 4}, 22.36493035150289),
    (BUCK, {"horizon": 4, "terminal_state": [1.0]}, 22.400633302541934),
    (BUCK, AT_START, 11.554464138730564),
    (BUCK, INSIDE, 17.080332697458882),
    (BUCK, {"horizon": 8, "v_min": None, "v_max": None}, 11.221825808084372),
    (BUCK, KINK, -17.5993666975),
]
"""Global optima, each found by several methods (dynamic programming, enumeration, a global solver); the long ones are
in scripts/verify.py."""


@expensive
@pytest.mark.parametrize(("build", "arguments", "cost"), KNOWN)
def test_known_optima_are_found_from_cold_starts_and_certified(build, arguments, cost):
    result = solved(build, arguments)
    assert result.status == "locally_optimal"
    assert result.cost == pytest.approx(cost, rel=1e-7)
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.worst.relative <= 1e-8
    assert result.certificate.borders.joint
    replay = lfo.simulate(result.problem, result.control)
    np.testing.assert_allclose(replay.x, result.trajectory.x, atol=1e-9)


@expensive
@pytest.mark.parametrize(("arguments", "time"), [(AT_START, 0), (INSIDE, 1)])
def test_where_the_multiplier_has_the_wrong_sign_only_the_joint_inclusion_holds(arguments, time):
    """The kink is convex for <eta, f>: the printed condition has no solution at the optimum."""
    facts = solved(BUCK, arguments).certificate.borders
    assert (facts.joint, facts.printed, facts.regular) == (True, False, False)
    assert time in facts.times


@expensive
def test_the_weight_at_the_concave_kink_is_the_known_one():
    """i_4 = I_ref touches its bound, whose multiplier is not unique; without the bound it is 0, at the same optimum."""
    result = solved(BUCK, KINK)
    facts = result.certificate.borders
    assert facts.times == (3,)
    assert (facts.joint, facts.flip_stationary, facts.printed, facts.regular) == (True, True, True, True)
    assert not result.uniqueness.unique
    free = replace(result.problem, state_set=[lfo.Box(0, 1)] * 4 + [lfo.Box(0, 2)])
    without = lfo.solve(free, method="nonsmooth")
    assert without.cost == pytest.approx(result.cost, rel=1e-12)
    assert without.uniqueness.unique
    assert without.certificate.borders.weights[0, 1] == pytest.approx(0.096273, abs=5e-7)
    certificate = judge(result.problem, without.trajectory, without.multipliers)
    assert (certificate.pmp, without.multipliers.mu[4, 0]) == ("satisfied", 0.0)


@expensive
def test_at_the_kink_of_a_norm_a_selection_is_named():
    facts = solved(library.norm_dynamics, {"initial_state": (0.0, 1.0), "horizon": 3}).certificate.borders
    assert {kink.time for kink in facts.norms} == {1, 2}
    assert all(np.linalg.norm(kink.selection) <= 1 + 1e-12 for kink in facts.norms)
    assert "norm(x_0, x_1) = 0 at t = 1 with xi = (" in str(facts)


def test_a_norm_that_pulls_the_cost_down_makes_the_printed_form_fail():
    """x+ = |x| + u with a norm: x_0 = 0, cost u^2 - x_1; at u = 1/2, eta_0 = 1, and |y| <= mu_0 y holds for no mu_0."""
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(lambda x, u: [lfo.norm([x[0]]) + u[0]], 1, 1),
        1,
        lfo.QuadraticCost(R=2.0, p=[-1.0]),
        control_set=lfo.Box(-1, 1),
        initial_state=[0.0],
    )
    result = lfo.solve(problem, method="nonsmooth")
    assert result.cost == pytest.approx(-0.25)
    facts = result.certificate.borders
    assert (facts.joint, facts.printed, facts.regular, facts.flip_stationary) == (True, False, False, False)
    assert facts.norms[0].rate == pytest.approx(1.0)


@expensive
@pytest.mark.parametrize(
    ("arguments", "spoiled"),
    [(KINK, {"eta": 1.02}), (KINK, {"nu": 1.5}), (AT_START, {"eta": 0.9}), ({"horizon": 4}, {"eta": 1 + 1e-5})],
)
def test_spoiled_multipliers_are_refused(arguments, spoiled):
    result = solved(BUCK, arguments)
    given = {name: factor * getattr(result.multipliers, name) for name, factor in spoiled.items()}
    fields = {name: getattr(result.multipliers, name) for name in ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x")}
    multipliers = lfo.results.Multipliers(**(fields | given))
    assert judge(result.problem, result.trajectory, multipliers).pmp == "violated"


def test_certify_finds_multipliers_for_a_trajectory_alone():
    result = solved(BUCK, KINK)
    certificate = lfo.certify(result.problem, result.trajectory)
    assert certificate.pmp == "satisfied"
    assert certificate.borders.flip_stationary
    worse = lfo.simulate(result.problem, result.control + np.array([[0.1], [0.0], [0.0], [0.0]]))
    assert lfo.certify(result.problem, worse).pmp == "violated"


@expensive
def test_a_trajectory_that_jumps_the_dynamics_is_refused():
    result = solved(BUCK, {"horizon": 4})
    shifted = lfo.Trajectory(result.trajectory.x + np.array([[0], [1e-4], [0], [0], [0]]), result.trajectory.u)
    failed = {one.name for one in lfo.certify(result.problem, shifted).failed}
    assert "state equation" in failed


@expensive
def test_infeasible_ends_are_said_to_be_out_of_reach():
    result = solved(BUCK, {"horizon": 1, "terminal_state": [0.1]})
    assert result.status == "numerical_error"
    assert "no trajectory was found" in result.message


def test_one_sequence_may_have_several_local_optima_and_flips_lead_on():
    problem = BUCK(horizon=8)
    start = lfo.simulate(problem, np.full((8, 1), 2.4))
    local, _ = smooth_optimum(problem, start, np.array([0, 0, 1, 1, 0, 0, 1, 1]))
    assert local.feasible
    assert local.cost == pytest.approx(44.67772239475926, rel=1e-9)
    infeasible, _ = smooth_optimum(problem, start, np.zeros(8, dtype=int))
    assert not infeasible.feasible


def test_a_mode_that_the_fixed_initial_state_excludes_is_tried_by_no_iteration():
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(["0.5*x_0 + abs(x_0) + u_0"], 1, 1)
    problem = lfo.OptimalControlProblem(dynamics, 2, lfo.QuadraticCost(R=1.0, P=1.0), initial_state=[1.0])
    start = lfo.simulate(problem, np.zeros((2, 1)))
    right, left = (dynamics.sequence_of(np.full((3, 1), side), np.zeros((2, 1))) for side in (1.0, -1.0))
    assert smooth_optimum(problem, start, right)[0].reason is lfo.results.Reason.LOCALLY_OPTIMAL
    assert smooth_optimum(problem, start, left)[0] is None


# --- other sets, and norms --------------------------------------------------------------------------------------------


@expensive
def test_other_sets_are_solved():
    problem = replace(BUCK(horizon=3), control_set=lfo.sets.Intersection([lfo.Box(2.2, 6), lfo.sets.Ball(5.5)]))
    result = lfo.solve(problem, method="nonsmooth")
    assert result.cost == pytest.approx(17.345547997984184, rel=1e-6)
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.worst.relative <= 1e-13  # the interior point leaves 1e-10


def test_the_nearest_point_of_a_ball():
    rng = np.random.default_rng(0)
    for _ in range(50):
        columns, wanted = rng.standard_normal((4, 3)), 3 * rng.standard_normal(4)
        found = nearest_in_ball(columns, wanted)
        assert np.linalg.norm(found) <= 1 + 1e-9
        tried = rng.standard_normal((400, 3))
        tried /= np.maximum(np.linalg.norm(tried, axis=1), 1)[:, None]
        best = np.linalg.norm(tried @ columns.T - wanted, axis=1).min()
        assert np.linalg.norm(columns @ found - wanted) <= best + 1e-9
    assert not nearest_in_ball(np.zeros((3, 2)), np.ones(3)).any()


# --- the command line -------------------------------------------------------------------------------------------------


@expensive
def test_the_command_solves_certifies_and_prints_valid_json(tmp_path):
    words = ("norm_dynamics", "--set", "initial_state=[0.0, 1.0]", "--set", "horizon=3")
    status, out, err = run("solve", *words, "--json", "--save", str(tmp_path / "run.npz"), "--method", "nonsmooth")
    summary = parsed(out)
    assert (status, err) == (0, "")
    assert summary["cost"] == pytest.approx(1.0)
    assert not list(Draft202012Validator(RESULT).iter_errors(summary))
    status, out, _ = run("certify", *words, str(tmp_path / "run.npz"), "--json")
    assert status == 0
    assert json.loads(out)["certificate"]["borders"]["norms"]


FILE = """
schema = 1
horizon = 1
initial_state = [0.0]

[dynamics]
control_dim = 1
f = ["abs(x_0) + u_0"]

[cost]
R = 2.0
p = [-1.0]

[control_set]
lower = -1.0
upper = 1.0
"""


def test_a_file_of_formulas_is_solved(tmp_path):
    path = tmp_path / "kink.toml"
    path.write_text(FILE, encoding="utf-8")
    status, out, _ = run("solve", str(path), "--method", "nonsmooth", "--json")
    assert status == 0
    assert parsed(out)["cost"] == pytest.approx(-0.25)
