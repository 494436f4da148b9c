"""What has no derivatives says so, and what to do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.seeds import expensive
from lin_freq_ocp.derivatives import data_of, with_data

PROBLEM = lfo.OptimalControlProblem(
    lfo.LinearDynamics([[0.9, 0.3], [-0.2, 0.85]], [[0.1], [1.0]]),
    12,
    lfo.QuadraticCost(Q=1.0, R=0.2),
    initial_state=[1.0, 0.5],
    control_set=lfo.Box(-1.0, 1.0),
)


@pytest.fixture(scope="module")
def found():
    return lfo.solve(PROBLEM).derivatives


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"Quadratic": np.eye(2)}, "derivatives: got the datum 'Quadratic'; expected one of Q, R, "),
        ({"Q": np.eye(3)}, r"Q: got shape \(3, 3\); expected shape \(2, 2\)."),
        ({"Q": [[0.0, 1.0], [0.0, 0.0]]}, "Q: got a matrix that differs from its transpose by 1; expected a symmetric"),
        ({"initial_state": [np.nan, 0.0]}, r"initial_state\[0\]: got nan; expected a finite number"),
        ({"u_ref": np.ones((12, 2))}, r"u_ref: got shape \(12, 2\); expected shape \(1,\)."),
        (
            {"control_upper": np.ones((11, 1))},
            r"control_upper: got shape \(11, 1\); expected shape \(12, 1\), or \(1,\).",
        ),
        ({"response": np.ones(7)}, "derivatives: got the datum 'response'"),
    ],
)
def test_changes_that_do_not_fit(found, change, message):
    with pytest.raises(lfo.errors.ProblemError, match=message):
        found.jvp(**change)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ({"u": np.ones((13, 1))}, r"u: got shape \(13, 1\); expected shape \(12, 1\)."),
        ({"x": np.full((13, 2), np.inf)}, r"x\[0\]\[0\]: got inf; expected a finite number"),
    ],
)
def test_weights_that_do_not_fit(found, weights, message):
    with pytest.raises(lfo.errors.ProblemError, match=message):
        found.vjp(**weights)


def test_a_fixed_state_moves_by_the_ends_alone():
    problem = replace(PROBLEM, state_set=lfo.Box(-9.0, 9.0))
    step = lfo.solve(problem).derivatives.jvp(state_upper=np.eye(13, 2))
    assert step.exists
    assert not step.x.any()
    assert step.cost == 0


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_bounds_of_an_end_are_no_bounds_of_the_state_set(side):
    """The tighter one is the one that counts; each has the derivative by differences."""
    sign = 1.0 if side == "lower" else -1.0

    def bounded(of_end: float, of_set: float) -> lfo.OptimalControlProblem:
        limits = np.full((13, 2), -sign * np.inf)
        limits[-1, 0] = sign * of_set
        end = [sign * of_end, None]
        return replace(
            PROBLEM,
            cost=lfo.QuadraticCost(Q=1.0, R=0.2, x_ref=[sign, 0.0]),
            terminal_state=lfo.Box(**{side: end}),
            state_set=lfo.Box(**{side: limits}),
        )

    def figures(problem: lfo.OptimalControlProblem) -> np.ndarray:
        found = lfo.solve(problem).derivatives
        return np.array([found.trajectory.u.sum(), problem.value(found.trajectory.x, found.trajectory.u)])

    def difference(first: tuple[float, float], second: tuple[float, float]) -> np.ndarray:
        return sign * (figures(bounded(*first)) - figures(bounded(*second))) / 2e-5

    h = 1e-5
    for of_end, of_set in ((1.0, 0.9), (0.9, 1.0)):
        found = lfo.solve(bounded(of_end, of_set)).derivatives
        by_end = difference((of_end + h, of_set), (of_end - h, of_set))
        by_set = difference((of_end, of_set + h), (of_end, of_set - h))
        assert by_end.any() != by_set.any()
        gradient = found.vjp(u=np.ones((12, 1)))
        ends, sets = (
            [np.nan_to_num(one["terminal_state"][0]) for one in (gradient, found.prices)],
            [one[f"state_{side}"][-1, 0] for one in (gradient, found.prices)],
        )
        np.testing.assert_allclose(ends, by_end, rtol=1e-6)
        np.testing.assert_allclose(sets, by_set, rtol=1e-6)
        changed = np.zeros((13, 2))
        changed[-1, 0] = 1.0
        for move, wanted in (({"terminal_state": [1.0, 0.0]}, by_end), ({f"state_{side}": changed}, by_set)):
            step = found.jvp(**move)
            np.testing.assert_allclose([step.u.sum(), step.cost], wanted, rtol=1e-6, atol=1e-12)
        known = data_of(found.problem)
        there = with_data(found.problem, {"terminal_state": known["terminal_state"] + [sign * h, 0.0]})
        np.testing.assert_allclose(figures(there), figures(bounded(of_end + h, of_set)), rtol=1e-9)


def test_a_name_that_is_no_datum_is_answered(found):
    gradient = found.vjp(u=np.ones((12, 1)))
    with pytest.raises(KeyError, match=r"derivatives: got 'initial_stat'; expected one of Q, .* 'initial_state'\?"):
        gradient["initial_stat"]
    assert "initial_stat" not in gradient
    assert gradient.get("initial_stat") is None


def test_an_end_that_is_no_box_is_not_replaced_by_a_point():
    ball = replace(PROBLEM, terminal_state=lfo.sets.Ball(0.5, [0.0, 0.0]))
    with pytest.raises(lfo.errors.UnsupportedError, match="terminal_state: got an end that is more than a Box"):
        with_data(ball, {"terminal_state": np.zeros(2)})


def test_an_infeasible_problem():
    result = lfo.solve(replace(PROBLEM, terminal_state=[99.0, 0.0]), throw=False)
    with pytest.raises(
        lfo.errors.SolveError, match="Only an optimum has derivatives; this solve ended as 'infeasible'"
    ):
        _ = result.derivatives


def test_abnormal_multipliers():
    result = lfo.solve(PROBLEM)
    m = result.multipliers
    abnormal = lfo.results.Multipliers(0.0, m.eta, m.mu, m.nu, m.rho_u, m.rho_x)
    with pytest.raises(lfo.errors.UnsupportedError, match="eta_C = 0"):
        _ = replace(result, multipliers=abnormal).derivatives


def test_modes():
    modes = [lfo.AffineMode([[side]], [[1.0]], G=[[-side]], h=[0.0]) for side in (1.0, -1.0)]
    cost = lfo.QuadraticCost(Q=1.0, R=1.0)
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes), 2, cost, initial_state=[1.0], control_set=lfo.Box(-2, 2)
    )
    result = lfo.solve(problem)
    with pytest.raises(lfo.errors.UnsupportedError, match="with_modes"):
        _ = result.derivatives
    assert result.sensitivities.A is None
    assert lfo.solve(problem.with_modes(result.sequence)).derivatives.vjp(u=np.ones((2, 1))).exists


@expensive
def test_a_mask_at_every_frequency_has_prices_alone():
    mask = lfo.MagnitudeBound(0.5, band=lfo.low_pass(cutoff=1.2), every_frequency=True)
    result = lfo.solve(replace(PROBLEM, control_spectrum=mask))
    with pytest.raises(lfo.errors.UnsupportedError, match="'mask on u_0' holds at every frequency, and its peaks move"):
        _ = result.derivatives
    assert result.sensitivities.A.shape == (2, 2)


def test_a_limit_of_zero_has_one_side():
    problem = replace(PROBLEM, control_spectrum=lfo.MagnitudeBound(0.0, bins=[3], window="hann"))
    found = lfo.solve(problem).derivatives
    with pytest.raises(lfo.errors.UnsupportedError, match="a limit of zero, of 'mask on u_0'"):
        found.jvp(**{"mask on u_0": [[1.0]]})
