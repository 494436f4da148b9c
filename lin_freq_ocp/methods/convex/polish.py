"""Refinement of a solver's rays.

A ray of descent is projected onto the recession cone: the directions along which every constraint holds for ever and
the cost has no curvature. ``nearest_recession`` projects to the tolerance of a solver, ``recession_directions`` to
rounding errors. For long problems with stop bands the projection is a problem of the package's own class.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, split_signals, stack_signals, to_long_double
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.methods.long_problems import distance_cost, is_long, solve_long, with_sides
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.active_rows import solve_active
from lin_freq_ocp.program.backends.base import DEFAULT_TOLERANCE, Claim, backend
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Program, Scaling, scale_matrix
from lin_freq_ocp.program.units import stated_scaling
from lin_freq_ocp.transform.sizes import stated_sizes

PROJECTED_ROUNDING = 1e-14  # entries of a projection, in its units, that are zero
RESTING = 1e-3  # unit of a component that rests along a direction, relative to its size in the data
DECAYED = 1e-20  # least unit of a time
LEAST_DESCENT = 1e-7  # part of a slope that is more than the error of an interior point
END_STEPS = 4  # per state, whose controls lead to the end


def zero_rounding(values: Array, units: Array, level: float) -> Array:
    """Return values with exact zeros in place of those below ``level`` times their units."""
    return np.where(np.abs(values) <= level * units, 0.0, values)


def steepest_recession(problem: OptimalControlProblem) -> Trajectory | None:
    """Return the recession direction nearest to minus the slope of the cost, for the judge to verify; None without one.

    The slope along it is minus the square of its length: the cost falls without bound. Lengths are measured in the
    sizes that the data state, so that neither the unit of the cost nor a trajectory affects the result. The direction
    is scaled to length 1 and projected once more: if it is short compared with the slope, the first projection leaves
    it few digits.
    """
    if is_long(problem):
        return _steepest_of_long(problem)
    linear = LinearProgram(problem)
    scaling = stated_scaling(linear)
    program = linear.sparse.scaled(scaling)
    along = -program.q
    for _ in range(2):
        if not along.any():
            return None
        along = nearest_recession(program, along / np.abs(along).max())
    return linear.direction(scaling.primal(along))


def _steepest_of_long(problem: OptimalControlProblem) -> Trajectory | None:
    """Return the steepest direction by a problem of the class; None where what the cone leaves of the slope is error.

    An interior point comes first: unlike the Fourier-domain method, it is as fast where the projection is zero.
    """
    cost, sizes = problem.quadratic, stated_sizes(problem)
    x, u = split_signals(np.zeros(problem.signal_bounds[0].shape), problem.state_dim)
    slopes = cost.gradient(x + cost.x_ref, u + cost.u_ref)
    steepest = Trajectory(*(-slope * size**2 for slope, size in zip(slopes, sizes, strict=True)))
    along = nearest_of_long(problem, steepest, spectral=False)
    if along is None:
        return None
    length, most = (np.abs(stack_signals(one.x, one.u) / np.concatenate(sizes)).max() for one in (along, steepest))
    return along if length > LEAST_DESCENT * most else None


def nearest_of_long(problem: OptimalControlProblem, along: Trajectory, spectral: bool = True) -> Trajectory | None:
    """Return the recession direction nearest to one, in the sizes that the data state; None if none is found.

    Components with curvature rest: directions along which weights cancel each other are not looked for.
    """
    (lower, upper), cost = recession_bounds(problem), problem.quadratic
    bent = np.zeros(lower.shape, dtype=bool)
    bent[:-1] = np.diagonal(cost.stage_hessians, axis1=1, axis2=2) > 0
    bent[-1, : problem.state_dim] = np.diagonal(cost.P) > 0
    lower[bent] = upper[bent] = 0.0
    distance = distance_cost(problem, along.x, along.u)
    found = solve_long(with_sides(problem, lower, upper, 0 * problem.linear.offset, distance), spectral=spectral)
    return found.trajectory if found is not None and found.status == Status.OPTIMAL else None


def recession_bounds(problem: OptimalControlProblem) -> tuple[Array, Array]:
    """Return the bounds of z_t = (x_t, u_t) along directions, (T+1, n+m) each: zero where there is one."""
    lower, upper = (np.where(np.isfinite(side), 0.0, side) for side in problem.signal_bounds)
    return lower, upper


def nearest_recession(program: Program, z: Array, signals: int | None = None) -> Array:
    """Return the recession direction nearest to z, with P z = 0; z itself if the projection fails.

    A solver's ray may satisfy cones to the root of a tolerance only. A cone with a constant s_0, such as that of a
    mask, requires s = 0 of a direction. Where the number of ``signals`` is given, the projection is exact up to
    rounding, by all rows but those with slacks: these have prices.
    """
    fixed = np.isfinite(program.upper) & np.isfinite(program.lower)
    limited, curved = np.isfinite(program.upper) | np.isfinite(program.lower), list[int]()
    constant = abs(program.A).sum(1) == 0
    for cone in program.cones:
        if constant[cone.start]:
            fixed[cone] = True
        else:
            curved += range(cone.start, cone.stop)
    alone = np.setdiff1d(np.flatnonzero(limited & ~constant), curved)
    if signals is not None:
        alone, curved = alone[abs(program.A[alone][:, signals:]).sum(1) == 0], []
    first, size = len(alone) + len(z), float(np.abs(z).max())
    lower = np.where(np.isfinite(program.lower[alone]), 0.0, -np.inf)
    upper = np.where(np.isfinite(program.upper[alone]) | fixed[alone], 0.0, np.inf)
    rows = sp.csc_array(sp.vstack([program.A[alone], program.P]))
    norms = np.asarray(abs(rows).max(axis=1).todense()).ravel()
    rows = scale_matrix(rows, 1 / np.where(norms > 0, norms, 1.0), np.ones(len(z)))
    nearest = Program(
        P=sp.csc_array(sp.eye_array(len(z))),
        q=-z / size,
        A=sp.csc_array(sp.vstack([rows, program.A[curved]])),
        lower=np.concatenate([lower, np.zeros(len(z) + len(curved))]),
        upper=np.concatenate([upper, np.zeros(len(z)), np.full(len(curved), np.inf)]),
        cones=consecutive([cone for cone in program.cones if not constant[cone.start]], first) if curved else (),
    )
    solution = backend("clarabel")(nearest, DEFAULT_TOLERANCE, None)
    if solution.claim is not Claim.SOLVED or solution.z is None or solution.y is None:
        return z
    exact = None if signals is None else solve_active(nearest, solution.z, solution.y)
    return size * (solution.z if exact is None else exact[0])


def recession_directions(problem: OptimalControlProblem, along: Trajectory) -> Iterator[Trajectory]:
    """Yield a solver's direction, then its exact projections onto the recession cone, for the judge to verify.

    Projections are in the units of the direction, then in those of every time, as a direction may decay far. Each is
    also simulated from its first state and its controls.
    """
    yield along
    signs = split_signals(np.stack(recession_bounds(problem)), problem.state_dim)
    if is_long(problem):
        nearest = nearest_of_long(problem, along)
        if nearest is not None:
            yield _simulate_to_end(problem, np.clip(nearest.x, *signs[0]), np.clip(nearest.u, *signs[1]), signs[0])
        return
    linear = LinearProgram(problem)
    for per_time in (False, True):
        columns = linear.column_units(*_direction_units(problem, along, per_time))
        z = np.zeros(linear.variables)
        z[: linear.signals] = np.concatenate([along.x.ravel(), along.u.ravel()])
        if not z.any():  # the projection of the solver's direction: there is none nearby
            return
        try:
            program = linear.sparse.scaled(Scaling(columns, np.ones(len(linear.sparse.lower)), 1.0))
        except UnsupportedError:  # it does not fit into memory
            return
        v = nearest_recession(program, z / columns, linear.signals)
        along = linear.direction(zero_rounding(v, np.abs(v).max(), PROJECTED_ROUNDING) * columns)
        x, u = np.clip(along.x, *signs[0]), np.clip(along.u, *signs[1])
        yield Trajectory(x.copy(), u)
        if problem.response is None:
            yield _simulate_to_end(problem, x, u, signs[0])


def _simulate_to_end(problem: OptimalControlProblem, x: Array, u: Array, signs: Array) -> Trajectory:
    """Return the direction of the first state and the controls, whose last ones are changed to lead to the end.

    What rounding of all controls leaves of a fixed end is more than rounding of the terms there.
    """
    (T, n), x, u = x[1:].shape, x.copy(), u.copy()
    first = max(T - END_STEPS * n, 0)
    moves, reach, missed = u[first:] != 0, np.zeros((n, 0)), np.zeros(n)
    for start in (0, first):
        for t in range(start, T):
            A, B, _ = problem.linear.at(t)
            moved = A @ to_long_double(x[t]) + B @ to_long_double(u[t])
            x[t + 1] = np.clip(moved.astype(np.float64), signs[0][t + 1], signs[1][t + 1])
            reach, missed = np.hstack([A @ reach, B * moves[t - first]]) if t >= first else reach, x[T] - moved
        if reach.shape[1] == moves.size:
            u[first:] += np.linalg.lstsq(reach, missed.astype(np.float64))[0].reshape(moves.shape)
    return Trajectory(x, u)


def _direction_units(problem: OptimalControlProblem, along: Trajectory, per_time: bool) -> tuple[Array, Array]:
    """Return the units of states (T+1, n) and controls (T, m) in which a direction is of order 1."""
    pairs = zip((np.abs(along.x), np.abs(along.u)), stated_sizes(problem), strict=True)
    (x, of_x), (u, of_u) = ((signal, np.maximum(signal.max(0), RESTING * size)) for signal, size in pairs)
    times = np.maximum((x / of_x).max(1), DECAYED) if per_time else np.ones(len(x))
    steps = np.maximum((u / of_u).max(1), RESTING * np.maximum(times[1:], times[:-1])) if per_time else np.ones(len(u))
    return times[:, None] * of_x, steps[:, None] * of_u


def consecutive(cones: Sequence[slice], first: int) -> tuple[slice, ...]:
    """Return slices of the same sizes, one after the other."""
    sizes = [cone.stop - cone.start for cone in cones]
    starts = first + np.cumsum([0, *sizes])
    return tuple(slice(int(start), int(start) + size) for start, size in zip(starts, sizes, strict=False))
