"""Problems without a solution by a hair: braking as hard as it can, a carriage passes its bound by eps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.random.linear import random_linear
from helpers.seeds import expensive, seeds
from lin_freq_ocp.certificate import judge, prove_infeasible

T = 20
BRAKES = 0.4
FREE = lfo.OptimalControlProblem(
    lfo.LinearDynamics([[1, 0.1], [0, 1]], [[0.005], [0.1]]),
    T,
    lfo.QuadraticCost(R=1.0),
    control_set=lfo.Box(-BRAKES, BRAKES),
    initial_state=[0, 1],
)
FARTHEST = float(lfo.simulate(FREE, np.full((T, 1), -BRAKES)).x[:, 0].max())
"""Where full braking ends: no trajectory stays below it."""

METHODS = pytest.mark.parametrize("method", ["auto", "convex"])


def bounded(eps: float) -> lfo.OptimalControlProblem:
    """Return the problem whose bound on the position no trajectory keeps by less than eps."""
    return replace(FREE, state_set=lfo.Box(None, [FARTHEST - eps, None]))


@METHODS
@pytest.mark.parametrize("eps", [1e-5, 1e-6, 1e-7, 1e-8, 1e-9])
def test_what_fails_by_a_hair_is_proven_infeasible(eps, method):
    problem = bounded(eps)
    result = lfo.solve(problem, method=method, throw=False)
    assert result.status == "infeasible"
    assert (result.trajectory, result.certificate) == (None, None)
    assert "rigorous" in result.message
    proof = prove_infeasible(problem, result.ray)
    assert proof.bound.kind == "rigorous"
    assert {one.block for one in result.conflict} >= {"initial state", "state bound on x_0", "control bound on u_0"}
    assert prove_infeasible(bounded(0.0), result.ray) is None  # the same ray proves nothing of what can be reached


@METHODS
def test_below_the_tolerance_of_the_judge_both_answers_are_consistent(method):
    """1e-10 is far below what the judge accepts as rounding: a proof, or a point that holds within its tolerance."""
    problem = bounded(1e-10)
    result = lfo.solve(problem, method=method, throw=False)
    if result.status == "infeasible":
        assert prove_infeasible(problem, result.ray).bound.kind == "rigorous"
    else:
        assert result.status in ("optimal", "locally_optimal")
        assert judge(problem, result.trajectory, result.multipliers).pmp == "satisfied"


@METHODS
@pytest.mark.parametrize("eps", seeds([0.0, -1e-10, -1e-9, -1e-8, -1e-6, -1e-4]))
def test_what_holds_by_a_hair_is_solved(eps, method):
    """Within 1e-8, more constraints are active than there is freedom: a feasible trajectory nearby may not be known."""
    result = lfo.solve(bounded(eps), method=method, throw=False)
    assert result.certificate.pmp == "satisfied"
    if eps < -5e-9:
        assert result.status == "optimal"
        assert result.certificate.globally_optimal
    elif result.status != "optimal":
        assert "no trajectory that satisfies every constraint is known to cost" in result.message
    np.testing.assert_allclose(result.control, -BRAKES, atol=max(1e-3, 1e3 * abs(eps)))


# Found with a tolerance of 1e-9 or so on each constraint, a cure of 1e-9 is known to a third of itself.
@expensive
@pytest.mark.parametrize(("eps", "to"), [(1e-5, 0.1), (1e-9, 0.4)])
def test_the_cure_is_as_small_as_what_is_missing(eps, to):
    explanation = lfo.explain(bounded(eps))
    cures = {cure.block: cure for cure in explanation.cures}
    assert set(explanation.family) == {"initial state", "state bound on x_0", "control bound on u_0"}
    assert cures["state bound on x_0"].amount == pytest.approx(eps, rel=to)
    needed = eps / (0.1 * T) ** 2 * 2  # position T steps later, per unit of a constant control
    assert cures["control bound on u_0"].amount == pytest.approx(needed, rel=to)
    if eps <= 1e-6:
        assert "nearly feasible" in str(explanation)
        assert "nearly feasible" in cures["state bound on x_0"].words


def test_what_is_missed_by_much_is_not_called_nearly_feasible():
    explanation = lfo.explain(bounded(0.1))
    cures = {cure.block: cure for cure in explanation.cures}
    assert cures["state bound on x_0"].amount == pytest.approx(0.1, rel=1e-3)
    assert "nearly" not in str(explanation)


@expensive
def test_a_slow_low_pass_leaves_no_trajectory():
    """A low pass of 0.3 Hz lets too few bins of so short a horizon pass for the speed limit."""
    problem = lfo.library.double_integrator(horizon=20, sampling_time=0.25, cutoff_hz=0.3)
    for method in ("auto", "convex"):
        result = lfo.solve(problem, method=method, throw=False)
        assert result.status == "infeasible"
        assert prove_infeasible(problem, result.ray) is not None
    with pytest.raises(lfo.errors.InfeasibleError, match="In conflict"):
        lfo.solve(problem)


def test_where_rounding_of_the_data_leaves_no_trajectory_none_is_optimal():
    """In these units the data are rounded so that no trajectory is left, by 3e-15 of the terms of the dynamics."""
    sample = random_linear(1819)
    assert lfo.solve(sample.problem, "spectral", throw=False).status == "infeasible"
    statuses = {lfo.solve(problem, throw=False).status for problem in (sample.problem, sample.good)}
    assert statuses <= {"infeasible", "locally_optimal"}
