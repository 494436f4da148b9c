"""A local optimum of a mode sequence, exact on its active rows: Newton's method on their conditions.

An interior point ends at a small distance from the rows that hold its answer, and so near a kink, not on it. To second
order, with d the deviation from it, the problem of the mode sequence is

    minimise  g'd + 1/2 d'H d   subject to   the tangents of maps, path constraints and regions, and all other rows,

H the Hessian of the Lagrangian. The solution on its active rows is one step of Newton's method, for any sets, costs and
linked ends (``methods/correction``): active rows hold to rounding, kinks included. At the zero of a norm, the rows
q <= 0 and -q <= 0 keep its arguments q at zero. Their multipliers are an element of its subdifferential, times its
factor in the Lagrangian.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import islice

import numpy as np

from lin_freq_ocp.base.arrays import Array, stack_signals
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.methods.correction import corrections
from lin_freq_ocp.methods.hybrid.smooth.local_optimum import LocalOptimum
from lin_freq_ocp.methods.hybrid.smooth.model import Pieces
from lin_freq_ocp.problem.costs.quadratic import CostSum
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import replace_fields
from lin_freq_ocp.problem.sets.path_constraint import PathConstraint
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.hybrid.convex_cost import with_parabola
from lin_freq_ocp.transform.sizes import stated_sizes

MOST_STEPS = 6  # one is enough near an optimum; where active rows depend on each other, the first ones may leave it


def newton_points(
    problem: OptimalControlProblem, local: LocalOptimum, end: float = np.inf, solved: bool = False
) -> Iterator[tuple[Trajectory, Multipliers]]:
    """Yield the points of Newton's method from a local optimum, with the multipliers of the mode sequence.

    The active rows are those of each point or, if ``solved``, those of the optimum of its quadratic problem: where rows
    depend on each other, the point does not tell them. It ends at ``end``, by ``clock.now``, or where the active rows
    determine no step.
    """
    pieces, trajectory = Pieces.of(problem, local.sequence), local.trajectory
    multipliers = replace(local.multipliers, stage=pieces.without_region(local.multipliers.stage))
    with suppress(ProblemError, UnsupportedError):  # a formula is not defined there, or a step takes too much
        for _ in range(MOST_STEPS):
            quadratic = quadratic_model(problem, pieces, trajectory, multipliers)
            with np.errstate(over="ignore", invalid="ignore"):  # numbers that are not finite are no correction
                tries = () if now() > end else corrections(quadratic, trajectory, multipliers)
                correction = next(islice(tries, 1 if solved else 0, None), None)
            if correction is None:
                return
            trajectory, multipliers = correction.trajectory, correction.multipliers
            yield trajectory, replace(multipliers, stage=pieces.with_region(multipliers.stage))


def quadratic_model(
    problem: OptimalControlProblem, pieces: Pieces, trajectory: Trajectory, multipliers: Multipliers
) -> OptimalControlProblem:
    """Return the problem of a mode sequence to second order: linear dynamics, rows, and the Hessian as a cost."""
    (T, n, m), x, u = (problem.horizon, problem.state_dim, problem.control_dim), trajectory.x, trajectory.u
    selections, zeros = dict[Formula, Array](), list[PathConstraint]()
    sizes = np.concatenate(stated_sizes(problem)) + np.hstack([np.abs(x).max(axis=0), np.abs(u).max(axis=0)])
    for i, (norm, at_zero) in enumerate(pieces.dynamics.active_kinks(x, u, sizes).items()):
        if at_zero.any():
            q = [*norm.arguments, *(-1.0 * one for one in norm.arguments)]
            limits = np.where(at_zero[:, None], 0.0, np.inf) * np.ones(len(q))
            zeros.append(PathConstraint(q, f"zero of norm {i}", limits).at_dimensions(n, m, T, "dynamics"))
            selections[norm] = np.where(at_zero[:, None], 0.0, np.nan) * np.ones(len(norm.arguments))
    pieces = replace(pieces, selections=selections)
    problem = pieces.with_regions(problem)
    problem = replace_fields(problem, stage_rows=(*problem.stage_rows, *zeros))
    points = stack_signals(x, u)
    slopes, hessians = pieces.cost_slopes(points)
    hessians[:-1] -= np.einsum("ti,tijk->tjk", multipliers.eta, pieces.jets(points[:-1]).curvatures)
    for one in problem.path_constraints:
        prices = multipliers.stage.get(one.name, np.zeros(one.map.shape))
        hessians[one.map.times] += np.einsum("ti,tijk->tjk", prices, one.map.jets_along(x, u).curvatures)
    cost = CostSum([with_parabola(problem.quadratic, points, slopes, hessians), *problem.cost.without_formulas.norms])
    return replace_fields(
        problem,
        dynamics=pieces.linear_at(trajectory),
        cost=cost.at_dimensions(n, m, T),
        stage_rows=problem.rows_along(trajectory),
    )
