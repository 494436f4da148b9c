"""Joint rows C x_t + D u_t <= e_t: what they say, how they are solved, and how each part of the proof can fail."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.analysis.measures import measure
from lin_freq_ocp.certificate.conflict import prove_infeasible
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.interchange.results.summary import comparison_summary
from lin_freq_ocp.methods.multipliers import fit_multipliers
from lin_freq_ocp.problem.description import problem_facts
from lin_freq_ocp.report.findings import finding
from lin_freq_ocp.report.page import draw, render
from lin_freq_ocp.report.tables import certificate_rows, comparison_rows

T, N, M = 16, 3, 2
KINDS = ("x", "u", "xu")
VARYING = ("", "C", "D", "e", "CDe")


def solve(problem: lfo.OptimalControlProblem, method: str = "convex", backend: str = "auto") -> lfo.results.Result:
    return lfo.solve(problem, method=method, backend=backend)


def problem_of(kind: str, varying: str, seed: int = 0) -> lfo.OptimalControlProblem:
    """A random problem whose trajectory without control is feasible, and whose optimum without the rows is not."""
    rng = np.random.default_rng([seed, KINDS.index(kind), VARYING.index(varying)])
    root = rng.normal(size=(N + M, N + M))
    H = root @ root.T + np.eye(N + M)
    H = (H + H.T) / 2
    dynamics = lfo.LinearDynamics(0.8 * np.eye(N) + 0.1 * rng.normal(size=(N, N)), rng.normal(size=(N, M)))
    problem = lfo.OptimalControlProblem(
        dynamics=dynamics,
        horizon=T,
        cost=lfo.QuadraticCost(Q=H[:N, :N], R=H[N:, N:], S=H[:N, N:], P=1.0, x_ref=2 + rng.normal(size=N)),
        control_set=lfo.Box(-4.0, 4.0),
        initial_state=0.3 * rng.normal(size=N),
        control_spectrum=lfo.stop_band(bins=[5, 8], component=0),
    )
    free, rest = solve(problem).trajectory, lfo.simulate(problem, np.zeros((T, M)))
    C = rng.normal(size=(T, 2, N) if "C" in varying else (2, N)) if "x" in kind else np.zeros((2, N))
    D = rng.normal(size=(T, 2, M) if "D" in varying else (2, M)) if "u" in kind else np.zeros((2, M))
    values = lfo.StageRows(C, D, np.zeros(2)).values(free.x, free.u)
    sign = np.where(values.max(0) > -values.min(0), 1.0, -1.0)[:, None]
    rows = lfo.StageRows(sign * C, sign * D, np.zeros(2))
    at_rest, at_optimum = rows.values(rest.x, rest.u), rows.values(free.x, free.u)
    if "e" not in varying:
        at_rest, at_optimum = at_rest.max(0), at_optimum.max(0)
    cut = at_optimum > at_rest + 1e-9  # x_0 is fixed: a row on it alone would have no unique multiplier
    assert cut.any()
    e = np.where(cut, at_rest + 0.4 * (at_optimum - at_rest), np.inf)
    return replace(problem, stage_rows=lfo.StageRows(rows.C, rows.D, e, name=f"rows on {kind}"))


@pytest.fixture(scope="module")
def two_families():
    """A problem with two families of joint rows, both active, one with limits per time; and its solution."""
    problem = problem_of("xu", "CDe")
    other = problem_of("xu", "", 1).stage_rows[0]
    x, u = (getattr(solve(problem).trajectory, name) for name in "xu")
    most = other.values(x, u).max(0)
    e = most - 0.05 * np.ptp(other.values(x, u), axis=0) * (np.arange(2) == 0)
    problem = replace(problem, stage_rows=[*problem.stage_rows, replace_limits(other, e)])
    return solve(problem)


def replace_limits(rows: lfo.StageRows, e: Any, name: str = "second") -> lfo.StageRows:
    return lfo.StageRows(rows.C, rows.D, e, name=name)


def changed(multipliers: lfo.results.Multipliers, **fields: Any) -> lfo.results.Multipliers:
    names = ("eta_C", "eta", "mu", "nu", "rho_u", "rho_x", "stage")
    return lfo.results.Multipliers(**({name: getattr(multipliers, name) for name in names} | fields))


def scaled(multipliers: lfo.results.Multipliers, factor: float) -> lfo.results.Multipliers:
    return changed(multipliers, stage={name: factor * weights for name, weights in multipliers.stage.items()})


def failed(certificate: Certificate) -> set[str]:
    return {one.label for one in certificate.failed}


def place_of_largest(multipliers: lfo.results.Multipliers, name: str) -> tuple[int, int]:
    weights = multipliers.stage[name]
    t, row = np.unravel_index(np.argmax(weights), weights.shape)
    return int(t), int(row)


# ------------------------------------------------------------------------------------------------------- description


def test_values_and_slack_are_the_sums_they_stand_for():
    rng = np.random.default_rng(1)
    x, u = rng.normal(size=(T + 1, N)), rng.normal(size=(T, M))
    for C in (rng.normal(size=(2, N)), rng.normal(size=(T, 2, N))):
        for D in (rng.normal(size=(2, M)), rng.normal(size=(T, 2, M))):
            rows = lfo.StageRows(C, D, [1.0, np.inf]).at_dimensions(N, M, T, "rows")
            assert rows.time_varying == (C.ndim == 3 or D.ndim == 3)
            for t in range(T):
                C_t, D_t = C if C.ndim == 2 else C[t], D if D.ndim == 2 else D[t]
                value = C_t @ x[t] + D_t @ u[t]
                np.testing.assert_allclose(rows.values(x, u)[t], value, rtol=1e-12)
                np.testing.assert_allclose(rows.slack(x, u)[t], [1 - value[0], np.inf], rtol=1e-12)
                np.testing.assert_allclose(rows.violation(x, u)[t], [max(value[0] - 1, 0), 0], rtol=1e-12)
            assert rows.bounded(T).tolist() == [[True, False]] * T


def test_a_problem_completes_what_was_left_out():
    problem = problem_of("x", "e")
    (rows,) = problem.stage_rows
    assert rows.D.shape == (2, M)
    assert not rows.D.any()
    assert not any(array.flags.writeable for array in (rows.C, rows.D, rows.e))
    assert replace(problem, stage_rows=None).stage_rows == ()
    again = replace(problem, name="again").stage_rows[0]
    assert all((getattr(again, field) == getattr(rows, field)).all() for field in "CDe")
    assert "2 joint rows" in str(problem)
    assert "joint" not in str(replace(problem, stage_rows=()))


def test_a_row_without_coefficients_that_holds_is_no_row():
    rows = lfo.StageRows(np.zeros((1, N)), None, [0.0])
    result = solve(replace(problem_of("x", ""), stage_rows=rows))
    assert result.certificate.pmp == "satisfied"
    assert not result.multipliers.stage["stage rows"].any()


ROW = np.ones((1, N))
BAD_ROWS = [
    (lambda: lfo.StageRows(None, None, [1.0]), "stage_rows", "at least one"),
    (lambda: lfo.StageRows([1.0, 0.0, 0.0], None, [1.0]), "stage_rows.C", "one row: [[c_1"),
    (lambda: lfo.StageRows(ROW, None, [1.0, 2.0]), "stage_rows.C", "2 rows"),
    (lambda: lfo.StageRows(ROW, [[1.0], [2.0]], [1.0]), "stage_rows.D", "1 rows"),
    (lambda: lfo.StageRows([[np.inf, 0, 0]], None, [1.0]), "stage_rows.C[0][0]", "finite"),
    (lambda: lfo.StageRows(ROW, None, 1.0), "stage_rows.e", "shape ()"),
    (lambda: lfo.StageRows(ROW, None, []), "stage_rows.e", "shape (0,)"),
    (lambda: lfo.StageRows(ROW, None, [np.nan]), "stage_rows.e[0]", "nan"),
    (lambda: lfo.StageRows(ROW, None, [[0.0], [-np.inf]]), "stage_rows.e[1][0]", "inf for no bound"),
    (lambda: lfo.StageRows(ROW, None, [1.0], name=" "), "stage_rows.name", "a name"),
    (lambda: lfo.StageRows(ROW, None, [1.0], name=3), "stage_rows.name", "a name"),
]
BAD_IN_A_PROBLEM = [
    (object(), "stage_rows", "StageRows"),
    ("rows", "stage_rows", "StageRows"),
    (lfo.StageRows([[1.0]], None, [1.0]), "stage_rows.C", f"(1, {N})"),
    ([lfo.StageRows(ROW, None, [1.0]), lfo.StageRows(None, ROW, [1.0], "b")], "stage_rows[1].D", f"(1, {M})"),
    (lfo.StageRows(np.ones((T + 1, 1, N)), None, [1.0]), "stage_rows.C", f"({T}, 1, {N})"),
    (lfo.StageRows(ROW, None, np.ones((T + 1, 1))), "stage_rows.e", f"{T} steps"),
    ([lfo.StageRows(ROW, None, [1.0])] * 2, "stage_rows", "a different name"),
    (lfo.StageRows(0 * ROW, None, [-1.0]), "stage_rows.e", "row 0,"),
    (lfo.StageRows(0 * ROW, None, np.where(np.arange(T) == 3, -1, 0)[:, None]), "stage_rows.e", "row 0 at t = 3,"),
]


@pytest.mark.parametrize(("make", "field", "words"), BAD_ROWS)
def test_rows_that_say_nothing_or_nonsense_are_refused(make, field, words):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        make()
    assert caught.value.field == field
    assert words in str(caught.value)


@pytest.mark.parametrize(("given", "field", "words"), BAD_IN_A_PROBLEM)
def test_rows_that_do_not_fit_their_problem_are_refused(given, field, words):
    with pytest.raises(lfo.errors.ProblemError) as caught:
        replace(problem_of("x", ""), stage_rows=given)
    assert caught.value.field == field
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("stage", "words"),
    [
        ([1.0], "a mapping"),
        ({"rows on x": np.zeros(T)}, "two dimensions"),
        ({"rows on x": np.zeros((T - 1, 2))}, f"shape ({T}, 2)"),
        ({"rows on x": np.zeros((T, 3))}, f"shape ({T}, 2)"),
        ({"rows on x": np.full((T, 2), np.nan)}, "finite"),
        ({"other": np.zeros((T, 2))}, "the names of the constraints"),
        ({"rows on x": np.eye(T, 2)}, "[0, 0]: got 1; expected 0"),
    ],
)
def test_multipliers_that_do_not_fit_the_rows_are_refused(stage, words):
    problem = problem_of("x", "e")
    rows = problem.stage_rows[0]
    problem = replace(problem, stage_rows=replace_limits(rows, np.full((T, 2), np.inf), rows.name))
    result = solve(problem)
    assert judge(problem, result.trajectory, changed(result.multipliers, stage=None)).pmp == "satisfied"
    with pytest.raises(lfo.errors.ProblemError) as caught:
        judge(problem, result.trajectory, changed(result.multipliers, stage=stage))
    assert caught.value.field.startswith("multipliers.stage")
    assert words in str(caught.value)


# ----------------------------------------------------------------------------------------------------------- solution


@pytest.mark.parametrize("method", ["convex", "auto"])
@pytest.mark.parametrize("varying", VARYING)
@pytest.mark.parametrize("kind", KINDS)
def test_cost_and_multipliers_are_those_of_cvxpy(kind, varying, method):
    problem = problem_of(kind, varying)
    result = solve(problem, method)
    program = lfo.to_cvxpy(problem)
    program.solve(solver="CLARABEL", tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)
    assert result.cost == pytest.approx(program.value, rel=1e-7)
    assert result.cost > solve(replace(problem, stage_rows=None)).cost * (1 + 1e-4)
    assert result.certificate.pmp == "satisfied"
    assert result.certificate.globally_optimal
    assert result.gap < 1e-6
    (rows,) = problem.stage_rows
    weights = result.multipliers.stage[rows.name]
    assert weights.max() > 1e-2
    duals = {one.label: one for one in program.constraints}[rows.name].dual_value
    np.testing.assert_allclose(weights[rows.bounded(T)], duals, atol=1e-5 * weights.max())
    assert not weights[~rows.bounded(T)].any()


@pytest.mark.parametrize("backend", ["clarabel", "osqp", "qpsolvers:piqp"])
def test_every_backend_takes_the_rows(backend, two_families):
    problem = two_families.problem
    result = solve(problem, backend=backend)
    assert result.cost == pytest.approx(two_families.cost, rel=1e-7)
    assert result.certificate.pmp == "satisfied"
    for name, weights in two_families.multipliers.stage.items():
        assert weights.max() > 1e-2
        np.testing.assert_allclose(result.multipliers.stage[name], weights, atol=1e-5 * weights.max())


def test_rows_that_say_what_a_box_says_have_the_multipliers_of_the_box():
    boxed = replace(problem_of("u", ""), stage_rows=None, control_set=lfo.Box(-0.4, 0.4), control_spectrum=None)
    both = np.vstack([np.eye(M), -np.eye(M)])
    joint = replace(boxed, control_set=None, stage_rows=lfo.StageRows(None, both, np.full(2 * M, 0.4)))
    of_box, of_rows = solve(boxed), solve(joint)
    assert of_rows.cost == pytest.approx(of_box.cost, rel=1e-9)
    upper, lower = np.split(of_rows.multipliers.stage["stage rows"], 2, axis=1)
    assert min(upper.max(), lower.max()) > 0.1
    np.testing.assert_allclose(upper - lower, of_box.multipliers.nu, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_the_price_of_a_limit(kind):
    """d J*/d e = -l, by central differences."""
    problem = problem_of(kind, "e")
    (rows,) = problem.stage_rows
    t, i = place_of_largest(solve(problem).multipliers, rows.name)
    costs = []
    for step in (1e-4, -1e-4):
        e = np.array(rows.e)
        e[t, i] += step
        costs.append(solve(replace(problem, stage_rows=replace_limits(rows, e, rows.name))).cost)
    price = solve(problem).multipliers.stage[rows.name][t, i]
    assert (costs[1] - costs[0]) / 2e-4 == pytest.approx(price, rel=1e-4)


@pytest.mark.parametrize("varying", VARYING)
def test_multipliers_are_found_for_a_trajectory_alone(varying):
    problem = problem_of("xu", varying)
    result = solve(problem)
    certificate = lfo.certify(problem, result.trajectory)
    assert certificate.pmp == "satisfied"
    assert certificate.gap < 1e-6
    found = fit_multipliers(problem, result.trajectory).multipliers.stage["rows on xu"]
    np.testing.assert_allclose(found, result.multipliers.stage["rows on xu"], atol=1e-4 * found.max())
    free = solve(replace(problem, stage_rows=None))
    assert "S-z" in failed(lfo.certify(problem, free.trajectory))


# ---------------------------------------------------------------------------------------------------------- judgement


def test_the_two_conditions_exist_only_with_rows(two_families):
    labels = [(one.label, one.name.partition(": ")[2]) for one in two_families.certificate.conditions]
    names = [rows.name for rows in two_families.problem.stage_rows]
    assert labels[-4:] == [("S-z", names[0]), ("N-z", names[0]), ("S-z", names[1]), ("N-z", names[1])]
    without = solve(replace(two_families.problem, stage_rows=None)).certificate
    assert not {"S-z", "N-z"} & {one.label for one in without.conditions}


def test_the_wrong_sign_fails(two_families):
    certificate = judge(two_families.problem, two_families.trajectory, scaled(two_families.multipliers, -1.0))
    assert {"N-z", "C-v", "C-iii"} <= failed(certificate)
    assert certificate.feasible


@pytest.mark.parametrize("factor", [0.0, 1.001, 2.0])
def test_the_wrong_size_fails(two_families, factor):
    certificate = judge(two_families.problem, two_families.trajectory, scaled(two_families.multipliers, factor))
    assert {"C-v", "C-iii"} <= failed(certificate)
    assert not {"S-z", "N-z"} & failed(certificate)


def test_a_tighter_limit_fails_where_it_is_tighter(two_families):
    first, second = two_families.problem.stage_rows
    t, row = place_of_largest(two_families.multipliers, first.name)
    e = np.array(first.e)
    e[t, row] -= 1e-3
    problem = replace(two_families.problem, stage_rows=[replace_limits(first, e, first.name), second])
    certificate = judge(problem, two_families.trajectory, two_families.multipliers)
    assert failed(certificate) == {"S-z", "N-z"}
    violated = next(one for one in certificate.failed if one.label == "S-z")
    assert (violated.time, violated.component, violated.residual) == (t, row, pytest.approx(1e-3, rel=1e-3))
    assert not certificate.feasible


def test_a_looser_limit_leaves_a_multiplier_without_its_row(two_families):
    first, second = two_families.problem.stage_rows
    t, row = place_of_largest(two_families.multipliers, second.name)
    problem = replace(two_families.problem, stage_rows=[first, replace_limits(second, second.e + 1e-2)])
    certificate = judge(problem, two_families.trajectory, two_families.multipliers)
    assert failed(certificate) == {"N-z", "C-v"}
    assert {one.name for one in certificate.failed if one.label == "C-v"} == {"Hamiltonian maximal in u"}
    complementary = next(one for one in certificate.failed if one.label == "N-z")
    assert (complementary.time, complementary.component) == (t, row)
    assert complementary.name.endswith(second.name)
    assert certificate.feasible


def test_a_multiplier_of_a_row_that_is_not_active_fails(two_families):
    stage = {name: np.array(weights) for name, weights in two_families.multipliers.stage.items()}
    slack = two_families.problem.stage_rows[1].slack(two_families.trajectory.x, two_families.trajectory.u)
    t, row = (int(i) for i in np.unravel_index(np.argmax(slack), slack.shape))
    stage["second"][t, row] += 0.1
    certificate = judge(two_families.problem, two_families.trajectory, changed(two_families.multipliers, stage=stage))
    complementary = next(one for one in certificate.failed if one.label == "N-z")
    assert (complementary.time, complementary.component) == (t, row)
    assert complementary.residual == pytest.approx(0.1 * slack[t, row], rel=1e-6)


def test_the_excess_of_the_hamiltonian_covers_the_controls_that_the_rows_allow(two_families):
    """max H - H(u_t) over sampled {v in U_t : D v <= e - C x_t} is within what is reported, for any l and eta."""
    problem, trajectory = two_families.problem, two_families.trajectory
    rng, R = np.random.default_rng(3), problem.cost.R
    x, u = trajectory.x, trajectory.u
    eta = two_families.multipliers.eta
    for size in (0.0, 0.1, 1.0):
        stage = {name: rng.uniform(1 - size, 1 + size) * w for name, w in two_families.multipliers.stage.items()}
        moved = eta + size * rng.normal(size=(T, N)) * np.abs(eta).mean()
        multipliers = changed(two_families.multipliers, stage=stage, eta=moved)
        reported = next(
            one.residual for one in judge(problem, trajectory, multipliers).conditions if "maximal" in one.name
        )
        in_u = problem.dynamics.pull_back(multipliers.eta)[1] - problem.cost.gradient(x, u)[1]
        k = np.arange(T // 2 + 1)
        weight = np.where((k == 0) | (2 * k == T), 1.0, 0.5)
        in_u = in_u - np.fft.irfft(T * weight[:, None] * multipliers.rho_u, n=T, axis=0)
        step = rng.normal(size=(4000, T, M)) * 10.0 ** rng.uniform(-3, 0.5, size=(4000, 1, 1))
        allowed = (np.abs(u + step) <= 4.0).all(-1)
        for rows in problem.stage_rows:
            change = np.einsum("trm,stm->str", np.broadcast_to(rows.D, (T, 2, M)), step)
            allowed &= (change <= rows.slack(x, u)).all(-1)
        gained = (in_u * step).sum(-1) - 0.5 * np.einsum("sti,ij,stj->st", step, R, step)
        assert (allowed.sum(0) > 20).sum() > T // 2
        assert gained[allowed].max() <= reported + 1e-6
        assert (gained[allowed].max() > 0.05 * reported) == (size > 0)


@pytest.mark.parametrize("seed", range(4))
def test_the_bound_holds_for_any_multipliers(seed):
    """D <= J* however wrong l is, in sign and size; and J - D is the sum of its parts."""
    result = solve(problem_of("xu", VARYING[seed], seed))
    problem, rng = result.problem, np.random.default_rng(seed)
    (rows,) = problem.stage_rows
    right, finite = result.multipliers.stage[rows.name], 0
    for size in (0.0, 1e-2, 1.0, 10.0):
        noise = size * right.max() * np.where(rows.bounded(T), rng.normal(size=(T, 2)), 0.0)
        multipliers = changed(
            result.multipliers,
            eta=result.multipliers.eta * (1 + 0.1 * size * rng.normal()),
            stage={rows.name: right + noise},
        )
        bound = judge(problem, result.trajectory, multipliers).bound
        assert bound.value <= result.cost * (1 + 1e-9)
        slack = np.where(rows.bounded(T), rows.slack(result.trajectory.x, result.trajectory.u), 0.0)
        assert bound.stage_term == pytest.approx((np.maximum(right + noise, 0) * slack).sum(), abs=1e-12)
        if np.isfinite(bound.value):
            finite += 1
            parts = bound.stage_gaps.sum() - bound.dynamics_term - bound.frequency_term + bound.stage_term
            least = max(result.cost - parts - bound.rounding, 0.0)  # as the cost is never negative
            assert bound.value == pytest.approx(least, rel=1e-9, abs=1e-9 * result.cost)
    assert finite == 4


def test_a_multiplier_below_zero_counts_as_zero_in_the_bound(two_families):
    """Below zero at a row that is not active, l would lift D above J* to first order."""
    problem, right = two_families.problem, two_families.multipliers
    stage = {name: np.where(weights > 1e-6, weights, -1e-2) for name, weights in right.stage.items()}
    for rows in problem.stage_rows:
        stage[rows.name][~rows.bounded(T)] = 0.0
    certificate = judge(problem, two_families.trajectory, changed(right, stage=stage))
    assert "N-z" in failed(certificate)
    assert certificate.lower_bound <= two_families.cost * (1 + 1e-9)
    assert certificate.lower_bound == pytest.approx(two_families.lower_bound, rel=1e-6)


def test_the_bound_needs_the_rows():
    """Without l the bound is that of the problem without the rows, at most; with it, the cost of this one."""
    problem = problem_of("xu", "")
    result, free = solve(problem), solve(replace(problem, stage_rows=None))
    without = judge(problem, result.trajectory, scaled(result.multipliers, 0.0))
    assert without.lower_bound <= free.cost < result.lower_bound <= result.cost * (1 + 1e-9)
    best = judge(problem, free.trajectory, changed(free.multipliers, stage=None))
    assert best.lower_bound == pytest.approx(free.cost, rel=1e-6)
    assert failed(best) == {"S-z"}


# -------------------------------------------------------------------------------------------------------- infeasible


def cart(**changes: Any) -> lfo.OptimalControlProblem:
    given = {
        "dynamics": lfo.LinearDynamics(
            [[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], state_names=["place [m]", "speed [m/s]"]
        ),
        "horizon": 24,
        "cost": lfo.QuadraticCost(R=1.0),
        "control_set": lfo.Box(-5.0, 5.0),
        "initial_state": [0.0, 0.0],
        "terminal_state": [1.0, 0.0],
    }
    return lfo.OptimalControlProblem(**(given | changes))


def test_rows_in_conflict_are_named_with_their_times():
    """The cart must cover 1 m in 2.4 s, at a speed of at most 0.3 m/s (row 1): 0.72 m."""
    solve(cart())
    rows = lfo.StageRows([[0.0, -1.0], [0.0, 1.0]], [[0.0], [0.05]], [9.0, 0.3], name="traction")
    with pytest.raises(lfo.errors.InfeasibleError, match=r"row 1 of traction, t = ") as caught:
        solve(cart(stage_rows=rows))
    result = caught.value.result
    assert "row 0" not in str(caught.value)
    one = next(one for one in result.conflict if "traction" in one.block)
    assert len(one.times) > 6
    assert all(0 <= t < 24 for t in one.times)
    ray = result.ray
    assert prove_infeasible(result.problem, ray) is not None
    assert prove_infeasible(result.problem, changed(ray, stage={})) is None
    assert prove_infeasible(result.problem, changed(ray, stage={"traction": -ray.stage["traction"]})) is None
    assert prove_infeasible(cart(stage_rows=replace_limits(rows, [9.0, 3.0], "traction")), ray) is None


def test_rows_that_contradict_each_other_are_both_named():
    rows = [lfo.StageRows(None, [[1.0]], [-1.0], name="pull"), lfo.StageRows(None, [[-1.0]], [0.5], name="push")]
    with pytest.raises(lfo.errors.InfeasibleError, match=r"row 0 of pull.*row 0 of push"):
        solve(cart(stage_rows=rows, terminal_state=None))


# ------------------------------------------------------------------------------------------------- files and reports


def test_problem_and_solution_survive_their_files(tmp_path, two_families):
    two_families.save(tmp_path / "run.npz")
    lfo.write_problem(two_families.problem, tmp_path / "problem.toml")
    saved, problem = lfo.load(tmp_path / "run.npz"), lfo.read_problem(tmp_path / "problem.toml")
    for one, other in zip(problem.stage_rows, two_families.problem.stage_rows, strict=True):
        assert one.name == other.name
        assert all(np.array_equal(getattr(one, field), getattr(other, field)) for field in "CDe")
    assert np.isinf(problem.stage_rows[0].e).any()
    certificate = judge(problem, saved.trajectory, saved.multipliers)
    assert certificate.pmp == "satisfied"
    assert certificate.lower_bound == two_families.lower_bound
    with np.load(tmp_path / "run.npz") as arrays:
        for name, weights in two_families.multipliers.stage.items():
            assert (arrays[f"stage/{name}"] == weights).all()


@pytest.mark.parametrize(
    ("table", "place"),
    [
        ("[[stage_rows]]\nC = [[1.0, 0.0]]", "stage_rows[0].e: got nothing"),
        ("[[stage_rows]]\nC = [[1.0, 0.0]]\ne = [-inf]", "stage_rows[0].e[0]: got -inf"),
        ("[[stage_rows]]\nC = [[1.0]]\ne = [1.0]", "stage_rows[0].C: got shape (1, 1)"),
        ("[[stage_rows]]\nC = [[1.0, 0.0]]\ne = [1.0]\nF = 1", "stage_rows[0].F: got an unknown key"),
        ("[stage_rows]\ne = [1.0]", "stage_rows: got neither C nor D"),
    ],
)
def test_a_bad_table_is_refused_with_its_place(tmp_path, table, place):
    lfo.write_problem(cart(), tmp_path / "cart.toml")
    good = (tmp_path / "cart.toml").read_text(encoding="utf-8")
    (tmp_path / "cart.toml").write_text(good + table, encoding="utf-8")
    with pytest.raises(lfo.errors.ProblemError) as caught:
        lfo.read_problem(tmp_path / "cart.toml")
    assert f"cart.toml: {place}" in str(caught.value)


def test_violations_are_measured_and_shown():
    """At least 0.45 at t = 5, which the brick wall, smoothing the start, misses."""
    e = [[0.55, -0.45 if t == 5 else np.inf] for t in range(24)]
    rows = lfo.StageRows([[0.0, 1.0], [0.0, -1.0]], [[0.05], [-0.05]], e, name="traction [N]")
    problem = cart(stage_rows=rows, control_spectrum=lfo.stop_band(bins=range(4, 13)))
    comparison = lfo.compare(problem, filters=["brickwall"])
    assert comparison.classical_measures.stage_violation < 1e-8
    brick_wall = comparison.filtered[0].replay.measures
    x, u = comparison.filtered[0].replay.trajectory.x, comparison.filtered[0].replay.trajectory.u
    excess = 0.45 - x[5, 1] - 0.05 * u[5, 0]
    assert brick_wall.stage_violation == pytest.approx(excess)
    assert excess > 1e-3
    assert measure(cart(), comparison.classical.trajectory).stage_violation is None
    summary = json.loads(json.dumps(comparison_summary(comparison)))
    assert summary["filtered"]["brickwall"]["stage_violation"] == pytest.approx(excess)
    group = next(group for group in comparison_rows(comparison).groups if group.title == "Beyond the joint rows by")
    (row,) = group.rows
    assert (row.label, row.unit) == ("traction", "N")
    assert [cell.passed for cell in row.cells] == [True, False, True]
    assert float(row.cells[1].text) == pytest.approx(excess, rel=1e-3)
    assert "violates traction by" in str(finding(comparison))
    assert ("rows: traction [N]", "2 rows C x + D u ≤ e, which depend on time") in problem_facts(problem)
    shown = [row for row in certificate_rows(problem, comparison.constrained.certificate) if row.label == "S-z"]
    assert shown[0].name == "rows hold: traction [N]"
    drawings = draw(comparison)
    page = render(comparison, drawings)
    assert "rows hold: traction" in page
    assert "that joint rows hold" in page
    without = lfo.compare(cart(), filters=[])
    assert "that joint rows hold" not in render(without, drawings)
