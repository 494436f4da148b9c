"""The judge of joint rows: each condition is broken once, and the bound holds for any multipliers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.seeds import seeds
from helpers.stage_rows import (
    VARYING,
    M,
    N,
    T,
    changed,
    failed,
    place_of_largest,
    problem_of,
    replace_limits,
    scaled,
    solve,
)
from lin_freq_ocp.certificate import judge


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
    assert failed(certificate) == {"S-z", "N-z", "N-r"}
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
        in_u = problem.dynamics.pull_back(multipliers.eta)[:, problem.state_dim :] - problem.cost.gradient(x, u)[1]
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


@pytest.mark.parametrize("seed", seeds(range(4)))
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
