"""Problems with joint rows: cost, multipliers, prices and conflicts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive, seeds
from helpers.stage_rows import (
    KINDS,
    VARYING,
    M,
    T,
    cart,
    changed,
    failed,
    place_of_largest,
    problem_of,
    replace_limits,
    solve,
)
from lin_freq_ocp.certificate import prove_infeasible
from lin_freq_ocp.methods import fit_multipliers

# ----------------------------------------------------------------------------------------------------------- solution


@pytest.mark.parametrize("method", ["convex", "auto"])
@pytest.mark.parametrize("varying", VARYING)
@pytest.mark.parametrize("kind", seeds(KINDS))
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


@expensive
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


@pytest.mark.parametrize("varying", seeds(VARYING))
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


# -------------------------------------------------------------------------------------------------------- infeasible


@expensive
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


@expensive
def test_rows_that_contradict_each_other_are_both_named():
    rows = [lfo.StageRows(None, [[1.0]], [-1.0], name="pull"), lfo.StageRows(None, [[-1.0]], [0.5], name="push")]
    with pytest.raises(lfo.errors.InfeasibleError, match=r"row 0 of pull.*row 0 of push"):
        solve(cart(stage_rows=rows, terminal_state=None))
