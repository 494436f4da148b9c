"""Joint rows C x_t + D u_t <= e_t: what they say and what they refuse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.stage_rows import M, N, T, changed, problem_of, replace_limits, solve
from lin_freq_ocp.certificate import judge


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
    ([lfo.StageRows(ROW, None, [1.0], "a")] * 2, "stage_rows", "a different name"),
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
