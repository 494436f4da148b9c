"""Problems with further states beside their own: what a constraint must remember becomes a state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.problem.costs.norms import CostSum
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.affine_mode import AffineMode
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.dynamics.piecewise_affine import PiecewiseAffineDynamics
from lin_freq_ocp.problem.dynamics.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_terms import OutputSpectrum
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.convex import Ball, ConvexSet, Ellipsoid, Intersection, Polyhedron, SecondOrderCone, Soft
from lin_freq_ocp.problem.spectrum.bands import bands_of
from lin_freq_ocp.problem.spectrum.bounds import EnergyBound, LinearConstraint, MagnitudeBound
from lin_freq_ocp.problem.terms.stage_rows import StageRows


@dataclass(frozen=True, eq=False)
class FurtherStates:
    """States w of w_{t+1} = A w_t + B u_t, without cost.

    Attributes
    ----------
    A : (k, k), B : (k, m)
    initial : Box
        Of w_0, bounds (k,).
    lower : (k,)
        Of w_t, at all times.
    names : sequence of str
    """

    A: Array
    B: Array
    initial: Box
    lower: Array
    names: Sequence[str]


def extended(problem: OptimalControlProblem, further: FurtherStates) -> OptimalControlProblem:
    """Return the problem in the states (x, w); its own constraints and cost are as they were."""
    k = len(further.A)
    free = np.full(k, np.inf)
    return replace(
        problem,
        dynamics=_wider_dynamics(problem.dynamics, further),
        cost=_wider_cost(problem, k),
        state_set=_wider_state_set(problem, further.lower),
        initial_state=_with_box(problem.initial_state, problem.initial_box, further.initial),
        terminal_state=_with_box(problem.terminal_state, problem.terminal_box, Box(-free, free)),
        state_spectrum=[*bands_of(problem.state_stop), *_wider_bounds(problem, k)],
        stage_rows=[
            StageRows(_beside(rows.C, k), rows.D, rows.e, rows.name, rows.penalty) for rows in problem.stage_rows
        ],
        output_spectrum=[
            OutputSpectrum(None if one.C is None else _beside(one.C, k), one.D, one.constraints, one.output_names)
            for one in listed(problem.output_spectrum)
        ]
        or None,
    )


def _wider_dynamics(
    plant: LinearDynamics | PiecewiseAffineDynamics | PiecewiseSmoothDynamics, further: FurtherStates
) -> LinearDynamics | PiecewiseAffineDynamics:
    names = [*plant.state_names, *further.names]
    if isinstance(plant, PiecewiseSmoothDynamics):
        raise UnsupportedError(
            "dynamics: got PiecewiseSmoothDynamics; further states take linear or piecewise-affine dynamics: write the "
            "former control as a further state in the formulas."
        )
    if isinstance(plant, LinearDynamics):
        return LinearDynamics(*_wider_map(plant, further), plant.sampling_time, names, plant.control_names)
    modes = [
        AffineMode(
            *_wider_map(mode.linear, further),
            G=_beside(mode.region.C, len(further.A)),
            H=mode.region.D,
            h=mode.region.e,
            name=mode.name,
        )
        for mode in plant.modes
    ]
    return PiecewiseAffineDynamics(modes, plant.sampling_time, names, plant.control_names)


def _wider_map(plant: LinearDynamics, further: FurtherStates) -> tuple[Array, Array, Array]:
    n, k = plant.state_dim, len(further.A)
    A = _below(_beside(plant.A, k), np.hstack([np.zeros((k, n)), further.A]))
    return A, _below(plant.B, further.B), _beside(plant.offset, k)


def _beside(array: Array, columns: int) -> Array:
    """Return the array with so many zeros more along its last axis."""
    return np.concatenate([array, np.zeros((*array.shape[:-1], columns))], axis=-1)


def _below(array: Array, rows: Array) -> Array:
    """Return the array, or each of one per time, with these rows below."""
    return np.concatenate([array, np.broadcast_to(rows, (*array.shape[:-2], *rows.shape))], axis=-2)


def _wider_cost(problem: OptimalControlProblem, k: int) -> QuadraticCost | CostSum:
    cost, n = problem.quadratic, problem.state_dim
    wider = QuadraticCost(
        Q=_below(_beside(cost.Q, k), np.zeros((k, n + k))),
        R=cost.R,
        S=_below(cost.S, np.zeros((k, problem.control_dim))),
        q=_beside(cost.q, k),
        r=cost.r,
        P=_below(_beside(cost.P, k), np.zeros((k, n + k))),
        p=_beside(cost.p, k),
        x_ref=_beside(cost.x_ref, k),
        u_ref=cost.u_ref,
    )
    if not isinstance(problem.cost, CostSum):
        return wider

    def complete(weights: Array) -> Array:
        return _beside(np.full(n, weights) if weights.ndim == 0 else weights, k)

    norms = [
        type(one)(complete(one.x), one.u, complete(one.terminal), complete(one.x_ref), one.u_ref)
        for one in problem.cost.norms
    ]
    return CostSum([wider, *norms])


def _wider_state_set(problem: OptimalControlProblem, lower: Array) -> Any:
    given, k = problem.state_set, len(lower)
    if isinstance(given, (list, tuple)):
        bounds = Box(lower, np.full(k, np.inf))
        return [_with_box(one, problem.state_boxes.at(t), bounds) for t, one in enumerate(given)]
    boxes, T = problem.state_boxes, problem.horizon
    shape = T + 1, k
    return _with_box(given, boxes, Box(np.broadcast_to(lower, shape), np.full(shape, np.inf)))


def _with_box(given: Any, bounds: Box, further: Box) -> Any:
    """Return the set of (x, w) with x in the given set, whose bounds these are, and w within the further ones."""
    box = Box(np.hstack([bounds.lower, further.lower]), np.hstack([bounds.upper, further.upper]))
    if not isinstance(given, ConvexSet):
        return box
    n, k = bounds.lower.shape[-1], further.lower.shape[-1]
    return Intersection([box, *_wider_sets(given, n, k)])


def _wider_sets(one: ConvexSet, n: int, k: int) -> list[Any]:
    """Return the sets of (x, w), bounds apart, that say of x what a set says."""
    if isinstance(one, Intersection):
        return [wider for member in one.sets if isinstance(member, ConvexSet) for wider in _wider_sets(member, n, k)]
    if isinstance(one, Soft):
        if isinstance(one.soft_set, Box):
            box, none = one.soft_set.at_dimension(n, "Soft"), np.full(k, np.inf)
            return [Soft(Box(np.append(box.lower, -none), np.append(box.upper, none)), one.penalty)]
        return [Soft(_wider_sets(one.soft_set, n, k)[0], one.penalty)]
    if isinstance(one, Polyhedron):
        return [Polyhedron(_beside(one.F, k), one.g)]
    if isinstance(one, SecondOrderCone):
        return [SecondOrderCone(_beside(one.F, k), one.g, _beside(one.h, k), one.d)]
    assert isinstance(one, (Ball, Ellipsoid))
    W = np.eye(n) if isinstance(one, Ball) else one.W
    return [Ellipsoid(_beside(W, k), one.radius, _beside(np.broadcast_to(one.centre, n), k))]


def _wider_bounds(problem: OptimalControlProblem, k: int) -> list[Any]:
    """Return what bounds the spectra of the states beside stop bands, of the same states."""
    wider: list[Any] = []
    for one in listed(problem.state_spectrum):
        if isinstance(one, LinearConstraint):
            wider.append(LinearConstraint(_beside(one.coefficients, k), one.constant, one.penalty))
        elif isinstance(one, (MagnitudeBound, EnergyBound)):
            components = range(problem.state_dim) if one.component is None else [one.component]
            wider += [one.on(component) for component in components]
    return wider


def listed(given: Any) -> Sequence[Any]:
    """Return what a field holds, one or several or None, as a sequence."""
    return given if isinstance(given, (list, tuple)) else [] if given is None else [given]
