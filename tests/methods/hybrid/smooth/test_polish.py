"""The polish of local optima: the expansion against differences of the Lagrangian, its digits, and rows that hold."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.checks.pairs import problem_of
from helpers.known_optima import solved
from helpers.seeds import expensive
from lin_freq_ocp import library
from lin_freq_ocp.methods import zero_multipliers
from lin_freq_ocp.methods.hybrid import LocalOptimum, Pieces, newton_points, quadratic_model, smooth_optimum
from lin_freq_ocp.problem.hybrid import REGION

T = 4


def bent_problem() -> lfo.OptimalControlProblem:
    """Return a problem with curved modes, regions, costs and path constraints."""
    dynamics = lfo.PiecewiseSmoothDynamics.from_formulas(
        ["x_0 + 0.5*x_1 + 0.2*sin(x_0)*u_0", "x_1 + u_0 - 0.1*abs(x_1**2 + x_0 - 0.3)*x_0"], 2, 1
    )
    cost = lfo.QuadraticCost(Q=0.5, R=0.2, S=[[0.1], [0.0]], P=1.0, x_ref=[0.6, 0.1], u_ref=0.2)
    cost = cost + lfo.costs.SmoothCost(stage="u_0**4 + 0.1*sin(x_0)*x_1", terminal="cos(x_1)*x_0")
    path = lfo.sets.PathConstraint(["x_0**2 - x_1", "x_0*x_1"], "path", [5.0, 4.0])
    return lfo.OptimalControlProblem(dynamics, T, cost, initial_state=[1.0, 0.2], stage_rows=[path])


def test_the_expansion_has_the_slopes_and_the_curvature_of_the_lagrangian():
    problem, rng = bent_problem(), np.random.default_rng(0)
    pieces = Pieces.of(problem, np.array([0, 1, 1, 0]))
    paths = pieces.with_regions(problem).path_constraints
    at = lfo.Trajectory(rng.normal(size=(T + 1, 2)), rng.normal(size=(T, 1)))
    eta, prices = rng.normal(size=(T, 2)), {one.name: rng.random(one.map.shape) for one in paths}
    assert len(prices) == 3
    multipliers = replace(no_multipliers(problem), eta=eta, stage=prices)
    quadratic = quadratic_model(problem, pieces, at, multipliers)

    def lagrangian(x, u):
        total = problem.value(x, u) + np.vdot(eta, x[1:] - pieces.values(np.hstack([x[:-1], u])))
        return total + sum(np.vdot(prices[one.name], one.values(x, u)) for one in paths)

    def expansion(x, u):
        A, B, d = (getattr(quadratic.dynamics, name) for name in ("A", "B", "offset"))
        images = np.einsum("tij,tj->ti", A, x[:-1]) + np.einsum("tij,tj->ti", B, u) + d
        rows = sum(np.vdot(prices[one.name], one.values(x, u)) for one in quadratic.stage_rows)
        return quadratic.value(x, u) + np.vdot(eta, x[1:] - images) + rows

    for _ in range(5):
        dx, du, h = rng.normal(size=(T + 1, 2)), rng.normal(size=(T, 1)), 1e-4
        along = [[of(at.x + s * h * dx, at.u + s * h * du) for s in (-1, 0, 1)] for of in (lagrangian, expansion)]
        slopes = [(after - before) / (2 * h) for before, _, after in along]
        bends = [(after - 2 * middle + before) / h**2 for before, middle, after in along]
        assert slopes[0] == pytest.approx(slopes[1], rel=1e-6)
        assert bends[0] == pytest.approx(bends[1], rel=1e-5)


def no_multipliers(problem: lfo.OptimalControlProblem) -> lfo.results.Multipliers:
    """Return multipliers of a problem, all zero but that of the cost."""
    return zero_multipliers(problem, 1.0)


@pytest.mark.parametrize("spectrum", [[], [3, 4, 5]])
def test_steps_double_the_digits(spectrum):
    problem = library.buck_converter(8, control_spectrum=spectrum)
    result = lfo.solve(problem, "nonsmooth")
    sequence, rng = problem.dynamics.sequence_of(result.trajectory.x, result.trajectory.u), np.random.default_rng(0)
    local, _ = smooth_optimum(problem, result.trajectory, sequence)
    exact = [point for point, _ in newton_points(problem, local)][-1]
    noise = [1e-4 * np.abs(part).max() * rng.standard_normal(part.shape) for part in (exact.x, exact.u)]
    start = lfo.Trajectory(exact.x + noise[0], exact.u + noise[1])
    points = [point for point, _ in newton_points(problem, replace(local, trajectory=start))]
    distances = [float(np.abs(point.x - exact.x).max()) for point in (start, *points)]
    assert distances[0] > 1e-5
    assert distances[-1] <= 1e-13
    assert all(after <= max(10 * before**2, 1e-13) for before, after in pairwise(distances))


def test_linked_ends_and_norms_hold_kinks_to_rounding():
    """At rest on the kink of the map, all rows depend on each other: an interior point ends 5e-10 beside it."""
    problem = problem_of("piecewise-smooth dynamics", "L1 cost", "periodic ends")
    result = lfo.solve(problem, "nonsmooth")
    assert (result.status, result.certificate.pmp) == ("locally_optimal", "satisfied")
    assert result.cost == pytest.approx(0.64, abs=1e-14)
    assert np.abs(result.trajectory.x[:, 1]).max() <= 1e-15


@expensive
@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_dependent_rows_are_chosen_by_the_quadratic_problem(unit):
    """In mm, steps on the active rows of each point once ended at a wrong multiplier of the terminal cost."""
    formulas = [f"x_0 + x_1 + {0.5 * unit}*u_0", f"x_1 + {unit}*u_0 - 0.1*abs(x_1)"]
    quadratic = lfo.QuadraticCost(Q=0.5 / unit**2, R=0.2, P=1 / unit**2, x_ref=[0.6 * unit, 0])
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseSmoothDynamics.from_formulas(formulas, 2, 1, sampling_time=1.0),
        horizon=6,
        cost=quadratic + lfo.costs.L1Cost(x=[0.1 / unit, 0], u=0.2, terminal=1 / unit),
        control_set=lfo.Box(-1, 1),
        state_set=lfo.Box(-5 * unit, 5 * unit),
        initial_state=lfo.sets.Everything(),
        terminal_state=lfo.Periodic(),
    )
    result = lfo.solve(problem, "nonsmooth")
    assert (result.status, result.certificate.pmp) == ("locally_optimal", "satisfied")
    assert result.cost == pytest.approx(0.64, abs=1e-12)


def test_multipliers_of_regions_come_back_under_one_name():
    pieces = Pieces.of(bent_problem(), np.array([0, 1, 1, 0]))
    stage = {REGION: np.arange(1.0, T + 1)[:, None], "path": np.zeros((T + 1, 2))}
    again = pieces.with_region(pieces.without_region(stage))
    assert again.keys() == stage.keys()
    np.testing.assert_array_equal(again[REGION], stage[REGION])


def test_it_ends_where_its_time_is_over():
    problem = library.buck_converter(4)
    result = solved(library.buck_converter, {"horizon": 4})
    sequence = problem.dynamics.sequence_of(result.trajectory.x, result.trajectory.u)
    local = LocalOptimum(sequence, result.trajectory, result.multipliers, result.cost, 0.0)
    assert not list(newton_points(problem, local, end=-np.inf))


def test_a_terminal_ball_that_touches_linked_ends_is_proven():
    """The sets of x_T meet in (0.5, 0) alone: no multipliers are largest, and those of the barrier leave 2e-6."""
    result = lfo.solve(problem_of("convex path constraint", "linked ends", "terminal ball"), "nonsmooth")
    assert result.trajectory.x[-1] == pytest.approx([0.5, 0.0], abs=1e-6)
    assert (result.status, result.certificate.globally_optimal) == ("optimal", True)
