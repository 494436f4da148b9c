"""Path constraints by formulas: what they take, say and refuse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.path_constraints import disc, mass
from helpers.seeds import expensive

PathConstraint = lfo.sets.PathConstraint


def trajectory(problem, seed=0):
    rng = np.random.default_rng(seed)
    return lfo.Trajectory(rng.normal(size=(problem.horizon + 1, 4)), rng.normal(size=(problem.horizon, 2)))


def test_values_and_times_are_those_of_the_function():
    problem = mass(lambda t, x, u: [disc(x, u) + 0.1 * t, x[0] * x[3] - 2.0], upper=[0.0, 1.0])
    at, (rows,) = trajectory(problem), problem.stage_rows
    t = np.arange(problem.horizon + 1)
    expected = np.stack([disc(at.x.T, at.u) + 0.1 * t, at.x[:, 0] * at.x[:, 3] - 2.0], axis=1)
    assert np.allclose(rows.values(at.x, at.u), expected)  # of x_T, too
    assert np.allclose(rows.violation(at.x, at.u), np.maximum(expected - [0.0, 1.0], 0.0))
    with_control = mass(lambda x, u: u[0] ** 2 + u[1] ** 2, upper=4.0).stage_rows[0]
    assert np.allclose(with_control.values(at.x, at.u)[:, 0], (at.u**2).sum(axis=1))


def test_its_rows_agree_with_it_to_second_order():
    problem = mass(lambda t, x, u: [disc(x, u), np.exp(x[2]) - t - 3.0])
    at, change, (rows,) = trajectory(problem), trajectory(problem, 1), problem.stage_rows
    tangents = rows.linearised(at.x, at.u)
    lost = [
        np.abs(tangents.slack(x, u) - rows.slack(x, u)).max()
        for x, u in ((at.x + part * change.x, at.u + part * change.u) for part in (1e-3, 1e-4))
    ]
    assert np.abs(tangents.slack(at.x, at.u) - rows.slack(at.x, at.u)).max() < 1e-12
    assert lost[1] < 0.02 * lost[0]


def test_a_maximum_is_several_components():
    problem = mass("abs(u_0) + 2 * max(u_1, -3 * u_1)", upper=9.0)
    at, (rows,) = trajectory(problem), problem.stage_rows
    together = np.abs(at.u[:, 0]) + 2 * np.maximum(at.u[:, 1], -3 * at.u[:, 1])
    assert rows.rows == 4
    assert np.allclose(rows.values(at.x, at.u).max(axis=1), together)
    assert np.array_equal(rows.e, [9.0] * 4)


def test_limits_may_depend_on_time_and_be_absent():
    limits = np.full((13, 1), np.inf)
    limits[3:5] = -0.1
    rows = mass("x_0", upper=limits).stage_rows[0]
    assert np.isfinite(rows.limits()).sum() == 2
    assert np.isinf(mass("x_0", upper=np.zeros((12, 1))).stage_rows[0].limits()[-1]).all()  # none for x_T


def test_states_counted_from_elsewhere_and_added_states_keep_its_values():
    problem = mass(lambda t, x, u: disc(x, u) + 0.01 * t * x[2])
    at, (rows,) = trajectory(problem), problem.stage_rows
    origin = np.array([5.0, -2.0, 0.5, 0.0])
    assert np.allclose(rows.translated(origin).values(at.x - origin, at.u), rows.values(at.x, at.u))
    more = np.hstack([at.x, np.ones((13, 3))])
    assert np.allclose(rows.augmented(4, 3).values(more, at.u), rows.values(at.x, at.u))
    tangents = rows.linearised(at.x, at.u)
    assert np.allclose(tangents.translated(origin).slack(at.x - origin, at.u), tangents.slack(at.x, at.u))
    assert np.allclose(tangents.augmented(4, 3).slack(more, at.u), tangents.slack(at.x, at.u))


@expensive
def test_a_measured_state_that_violates_it_is_left_free():
    rows = mass(lambda x, u: [disc(x, u), u[0] ** 2 - 4], upper=[0.0, 1.0]).stage_rows[0].free_first_state(12)
    assert np.array_equal(rows.limits()[0], [np.inf, 1.0])
    assert np.array_equal(rows.limits()[1], [0.0, 1.0])
    loop = lfo.RecedingHorizon(mass(terminal_state=lfo.Box(-9, 9), cost=lfo.QuadraticCost(Q=1.0, R=0.1)))
    loop.step([0.45, 0.0, 1.0, 0.0])  # within the disc, on the way out
    assert loop.log.steps[0].status.solved


def test_a_soft_one_costs_its_price():
    problem, hard = mass(price=7.0), mass()
    at = trajectory(problem)
    excess = np.maximum(disc(at.x.T, at.u), 0.0).sum()
    assert problem.value(at.x, at.u) - hard.value(at.x, at.u) == pytest.approx(7.0 * excess)
    assert excess > 0


def test_it_is_described_by_its_formulas():
    assert "-(x_0)**2 - (x_1)**2 + 0.25 ≤ 0; soft, 2 per unit" in mass(price=2.0)._repr_html_()
    assert "limits over time" in mass("x_0", upper=np.ones((13, 1)))._repr_html_()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"h": 3.0}, r"stage_rows.h: got 3.0; expected a list of formulas"),
        ({"h": "x_9"}, r"stage_rows.h\[0\]: got 'x_9'; expected one of x_0"),
        ({"h": "min(x_0, x_1)"}, r"stage_rows.h: got a kink, 'min\(x_0, x_1\)'"),
        ({"h": "1 - abs(x_0)"}, r"stage_rows.h: got a kink, '-max\(x_0, -x_0\) \+ 1'"),
        ({"h": "exp(abs(x_0))"}, r"got a kink.*max\(a, b\) <= 0 is a <= 0 and b <= 0"),
        ({"h": ["x_0", "x_1"], "upper": [1, 2, 3]}, r"got 2 formulas and 3 limits"),
        ({"h": "x_0", "upper": np.ones((7, 1))}, r"upper: got limits for 7 times; .* 12 steps, or 13 with x_T"),
        ({"h": "u_0", "upper": np.ones((13, 1))}, r"upper: got limits for 13 times; expected .* 12 steps\."),
        ({"h": "x_0", "upper": "a"}, r"stage_rows.upper: got 'a'"),
        ({"h": "x_0", "price": -1.0}, r"stage_rows.price: got -1"),
        ({"h": "x_0", "convex": 2}, r"stage_rows.convex: got 2; expected True or False"),
        ({"h": "x_0", "name": " "}, r"stage_rows.name"),
        ({"h": "look_up(t, 1.0, 2.0) * x_0"}, r"h.look_up: got 2 numbers; expected 13"),
        ({"h": lambda x, u: [x[0], 1.0]}, r"upper: got 0 for row 1, which has no coefficients"),
        ({"h": lambda x, u: x[17]}, r"stage_rows.h: got IndexError"),
    ],
)
def test_bad_input_is_refused_by_its_field(given, message):
    with pytest.raises(lfo.errors.ProblemError, match=message):
        mass(**given)


def test_families_need_different_names():
    with pytest.raises(lfo.errors.ProblemError, match="a different name for each"):
        replace(mass(), stage_rows=[PathConstraint("x_0", name="a"), PathConstraint("x_1", name="a")])


def test_families_without_a_name_are_numbered():
    rows, others = [lfo.sets.StageRows(C=np.eye(4), e=np.ones(4))], [PathConstraint("x_1", name="a")]
    problem = replace(mass(), stage_rows=[*2 * rows, *others, PathConstraint("x_0"), PathConstraint("x_0 - 1")])
    numbered = ["stage rows 1", "stage rows 2", "a", "path constraint 1", "path constraint 2"]
    assert [one.name for one in problem.stage_rows] == numbered
    assert [one.name for one in rows] == ["stage rows"]
    further = replace(problem, stage_rows=[*problem.stage_rows, *rows])
    assert [one.name for one in further.stage_rows] == [*numbered, "stage rows"]
    assert [one.name for one in replace(mass(), stage_rows=rows).stage_rows] == ["stage rows"]


def test_no_other_kind_of_dynamics_takes_one():
    kinked = lfo.PiecewiseAffineDynamics.from_formulas("abs(x_0) + u_0", 1, 1)
    with pytest.raises(lfo.errors.UnsupportedError, match="PiecewiseAffineDynamics"):
        lfo.OptimalControlProblem(kinked, 3, lfo.QuadraticCost(R=1), stage_rows=PathConstraint("x_0**2 - 1"))


def test_what_needs_linear_rows_says_so(tmp_path):
    problem = mass()
    for refused in (
        lambda: problem.linear,
        lambda: lfo.to_cvxpy(problem),
        lambda: lfo.generate(lfo.RecedingHorizon(problem), tmp_path / "c"),
    ):
        with pytest.raises(lfo.errors.UnsupportedError, match="stage_rows: a path constraint"):
            refused()
    with pytest.raises(lfo.errors.UnsupportedError, match="explain: got path constraints by formulas, 'path'"):
        lfo.explain(problem)
