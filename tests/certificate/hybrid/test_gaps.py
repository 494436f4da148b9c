"""Regions with gaps: what is feasible, what is optimal at the rim of a gap, and what the judge says there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lin_freq_ocp as lfo
from lin_freq_ocp.errors import NumericalError

SIDES = {"left": [[1.0, 0.0]], "right": [[-1.0, 0.0]], "below": [[0.0, 1.0]], "above": [[0.0, -1.0]]}


def stones(bound: float = 1.5, unit: float = 1.0, price: float = 1.0) -> lfo.OptimalControlProblem:
    """Return x_{t+1} = x_t + u_t from 0.6 to 2.5 in four steps over the stones [0, 1] and [2, 3]; cost |u|^2/2."""
    modes = [
        lfo.AffineMode([[1.0]], [[1.0]], G=[[-1.0], [1.0]], h=[-low * unit, high * unit], name=name)
        for name, low, high in (("first", 0, 1), ("second", 2, 3))
    ]
    return lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes),
        4,
        lfo.QuadraticCost(R=price / unit**2),
        control_set=lfo.Box(-bound * unit, bound * unit),
        state_set=lfo.Box(-unit, 4 * unit),
        initial_state=[0.6 * unit],
        terminal_state=[2.5 * unit],
    )


def around_a_block() -> lfo.OptimalControlProblem:
    """Return a point that moves in the plane from (-2, 0.2) to (2, 0.2) past the open square |x_i| < 1."""
    beside = {"below": [[1.0, 0.0], [-1.0, 0.0]], "above": [[1.0, 0.0], [-1.0, 0.0]]}
    modes = [
        lfo.AffineMode(
            np.eye(2), np.eye(2), G=row + beside.get(name, []), h=[-1.0] + [1.0] * (2 * (name in beside)), name=name
        )
        for name, row in SIDES.items()
    ]
    return lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes),
        6,
        lfo.QuadraticCost(R=np.eye(2)),
        control_set=lfo.Box(-1.2, 1.2),
        state_set=lfo.Box(-3, 3),
        initial_state=[-2.0, 0.2],
        terminal_state=[2.0, 0.2],
    )


@pytest.mark.parametrize(("unit", "price"), [(1.0, 1.0), (1e6, 1.0), (1.0, 1e-9)])
def test_the_least_effort_over_stepping_stones(unit, price):
    """By hand: 0.6, 1, 2, 2.25, 2.5, whose controls cost (0.16 + 1 + 1/16 + 1/16)/2."""
    result = lfo.solve(stones(unit=unit, price=price))
    np.testing.assert_allclose(result.trajectory.x.ravel() / unit, [0.6, 1, 2, 2.25, 2.5], atol=1e-6)
    assert result.cost / price == pytest.approx(0.6425, rel=1e-7)
    certificate = result.certificate
    assert certificate.globally_optimal
    assert (certificate.pmp, certificate.borders.gaps) == ("not_applicable", (1, 2))
    assert certificate.borders.flip_stationary
    assert "touches a gap between regions at t = 1 to 2" in str(certificate)


def test_a_gap_too_wide_to_jump_is_proven_infeasible():
    result = lfo.solve(stones(bound=0.9), throw=False)
    assert result.status == "infeasible"
    assert result.tree_bound.covers


def test_a_gap_elsewhere_changes_nothing():
    """Over the first stone alone, the optimum is that of the linear problem, and the theorem applies."""
    problem = replace(stones(), terminal_state=[0.9])
    certificate = lfo.solve(problem).certificate
    assert problem.gap is not None
    assert certificate.pmp == "satisfied"
    assert certificate.borders.gaps == ()


def test_a_trajectory_in_a_gap_fails():
    problem = stones()
    x = np.array([[0.6], [1.0 + 1e-4], [2.0], [2.25], [2.5]])
    certificate = lfo.certify(problem, lfo.Trajectory(x, np.diff(x, axis=0)))
    assert [one.label for one in certificate.failed if one.label == "S-f"]
    with pytest.raises(NumericalError, match="outside all regions"):
        lfo.simulate(problem, [[0.9], [0.5], [0.5], [0.0]])


def test_the_shorter_way_around_a_block():
    """The start is nearer to the upper edge: the way leads over it, and touches its corners or its edge."""
    result = lfo.solve(around_a_block())
    x = result.trajectory.x
    assert result.certificate.globally_optimal
    assert (np.abs(x[:-1]).max(axis=1) >= 1 - 1e-7).all()
    assert x[:, 1].max() >= 1 - 1e-7
    assert x[:, 1].min() >= 0.2 - 1e-7
    assert result.certificate.borders.gaps


def test_a_problem_with_a_gap_says_so():
    problem = stones()
    assert problem.gap is not None
    assert f"no mode {problem.gap}: infeasible there" in problem._repr_html_()
