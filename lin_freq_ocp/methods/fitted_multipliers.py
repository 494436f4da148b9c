"""Multipliers for a trajectory without any: those that violate the maximum principle least.

At a fixed point z of the program, with g = P z + q and N the normal cone of the constraints that are active there,

    minimise  1/2 |s|^2   subject to   s = g + A'y,   y in N:  y_i >= 0 at an active upper bound, <= 0 at a lower one,
                                       0 where neither is active, free for equations; of a second-order cone, a multiple
                                       of its normal at z, at its apex in its polar.

s = 0 iff z is extremal with eta_C = 1; else -s is a direction of descent that keeps the active constraints. Rounding of
z in the user's coordinates, by up to e, changes g by up to |P| e: near a set point that is more than ACTIVE of g. Such
entries of s are worth less: they are divided by 1 + |P| e / (ACTIVE max |g|).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.errors import NumericalError, UnsupportedError
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.methods.convex.polish import consecutive
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.backends.base import DEFAULT_TOLERANCE, backend
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Program, Scaling, rows_of
from lin_freq_ocp.program.units import scaled_program

ACTIVE = 1e-6  # distance to a bound, on a program scaled to order 1, at which it is active; solvers stop near 1e-8
NONTRIVIAL = 1e-6  # largest entry of abnormal multipliers that are zero; otherwise the linear program makes it 1
COORDINATE_ROUNDING = 4 * float(np.finfo(np.float64).eps)  # of a state in the user's coordinates, as the judge has it
DEPENDENT = 1e-10  # relative singular value of the normalised active gradients that is zero
MOST_GRADIENTS = 2000  # more take more than a few seconds


@dataclass(frozen=True, eq=False)
class Fit:
    """The best normal multipliers, and the direction of descent if they fail."""

    multipliers: Multipliers
    descent: Trajectory


@dataclass(frozen=True, eq=False)
class _NormalCone:
    """All y = basis w with w in [lower, upper], and -w in second-order cones at ``polars``."""

    basis: sp.csc_array
    lower: Array
    upper: Array
    polars: tuple[slice, ...]

    @property
    def in_polars(self) -> Indices:
        """Return the entries of w in polar cones."""
        return rows_of(self.polars)


def fit_multipliers(problem: OptimalControlProblem, trajectory: Trajectory, near: float = ACTIVE) -> Fit:
    """Return normal multipliers (eta_C = 1) that fit best; bounds within ``near`` (scaled to order 1) are active."""
    linear, scaling, program = scaled_program(problem)
    y, s = fitted_duals(program, *rounded_point(linear, scaling, trajectory, problem.origin), near)
    return Fit(linear.multipliers(scaling.dual(y), 1.0), linear.direction(scaling.primal(-s)))


def rounded_point(
    linear: LinearProgram, scaling: Scaling, trajectory: Trajectory, origin: Array | None
) -> tuple[Array, Array]:
    """Return the point of a trajectory in the scaled program, and its rounding as the user counts states."""
    z, given = scaling.scaled_primal(linear.point(trajectory)), np.abs(trajectory.x)
    given = given if origin is None else given + np.abs(origin)
    rounding = np.zeros(len(z))
    rounding[: given.size] = COORDINATE_ROUNDING * np.tile(given.max(axis=0), len(given))
    return z, scaling.scaled_primal(rounding)


def fitted_duals(program: Program, z: Array, rounding: Array, near: float = ACTIVE) -> tuple[Array, Array]:
    """Return y (rows,) in the normal cone at z with the least s = P z + q + A'y, and its gradient in z.

    ``rounding`` is that of the first entries of z; the others have none. NumericalError if no y could be computed.
    """
    cone = _normal_cone(program, z, near)
    # least squares in (w, s / worth), with rows s - A'y = g and the conditions on w
    variables, count = program.A.shape[1], len(cone.lower)
    gradient = program.P @ z + program.q
    unit_of_cost = min(float(np.abs(gradient).max(initial=0.0)), 1.0) or 1.0  # solvers also have absolute tolerances
    gradient = gradient / unit_of_cost
    blurred = abs(program.P) @ np.pad(rounding, (0, variables - len(rounding))) / unit_of_cost
    worth = 1 + blurred / (ACTIVE * (np.abs(gradient).max(initial=0.0) or 1.0))
    bounded = np.flatnonzero(np.isfinite(cone.lower) | np.isfinite(cone.upper))
    unit = sp.eye_array(count, format="csr")
    fitting = Program(
        P=sp.csc_array(sp.block_diag([sp.csc_array((count, count)), sp.eye_array(variables)])),
        q=np.zeros(count + variables),
        A=sp.csc_array(
            sp.block_array(
                [
                    [-(program.A.T @ cone.basis), sp.diags_array(worth)],
                    [unit[bounded], None],
                    [-unit[cone.in_polars], None],
                ]
            )
        ),
        lower=np.concatenate([gradient, cone.lower[bounded], np.zeros(len(cone.in_polars))]),
        upper=np.concatenate([gradient, cone.upper[bounded], np.full(len(cone.in_polars), np.inf)]),
        cones=consecutive(cone.polars, variables + len(bounded)),
    )
    solution = backend("clarabel")(fitting, DEFAULT_TOLERANCE, None)
    if solution.z is None:
        raise NumericalError(f"No multipliers fit the trajectory ({solution.message}); pass multipliers=.")
    w, s = np.split(solution.z, [len(cone.lower)])
    return unit_of_cost * (cone.basis @ w), unit_of_cost * s / worth


def abnormal_multipliers(problem: OptimalControlProblem, trajectory: Trajectory) -> Multipliers | None:
    """Return multipliers with eta_C = 0 that are not all zero, or None if none were found.

    They exist where A'y = 0 for some y in N. The linear program maximises the product with a fixed random vector, with
    all entries within [-1, 1]; if that is zero, as for half of all rays, with the vector that has the other sign where
    entries may have either.
    """
    linear, scaling, program = scaled_program(problem)
    at = scaling.scaled_primal(linear.point(trajectory))
    cone = _normal_cone(program, at, ACTIVE)
    count, variables = len(cone.lower), program.A.shape[1]
    signs = np.sign(cone.lower) + np.sign(cone.upper)
    free = (cone.lower < 0) & (cone.upper > 0)
    rng = np.random.default_rng(0)
    sizes, either = rng.uniform(0.5, 1.0, count), rng.choice([-1.0, 1.0], count)
    gradients = sp.csc_array(program.A.T @ cone.basis)
    sizes = np.where(abs(gradients).sum(0) > 0, sizes, 0.0)  # the radius of a ball has no gradient
    identity = sp.eye_array(count, format="csr")
    for sign in (1.0, -1.0):
        search = Program(
            P=sp.csc_array((count, count)),
            q=-sizes * np.where(free, sign * either, signs),
            A=sp.csc_array(sp.vstack([gradients, identity, -identity[cone.in_polars]])),
            lower=np.concatenate([np.zeros(variables), np.clip(cone.lower, -1, 0), np.zeros(len(cone.in_polars))]),
            upper=np.concatenate(
                [np.zeros(variables), np.clip(cone.upper, 0, 1), np.full(len(cone.in_polars), np.inf)]
            ),
            cones=consecutive(cone.polars, variables + count),
        )
        solution = backend("clarabel")(search, DEFAULT_TOLERANCE, None)
        if solution.z is not None and np.abs(solution.z).max() >= NONTRIVIAL:
            return linear.multipliers(scaling.dual(cone.basis @ solution.z), 0.0)
    return None


@dataclass(frozen=True)
class Uniqueness:
    """Whether the multipliers of a trajectory are unique."""

    active: int  # gradients of equations and active constraints
    rank: int  # how many of them are independent

    @property
    def unique(self) -> bool:
        """Whether all are independent: there is at most one set of normal multipliers, and no abnormal one."""
        return self.rank == self.active

    def __str__(self) -> str:
        if self.unique:
            return f"unique: the {self.active} active gradients are independent"
        return f"perhaps some of many: of {self.active} active gradients {self.rank} are independent"


def uniqueness(problem: OptimalControlProblem, trajectory: Trajectory) -> Uniqueness:
    """Return the number and rank of the active gradients at a trajectory of a linear problem.

    UnsupportedError if there are more than MOST_GRADIENTS.
    """
    linear, scaling, program = scaled_program(problem)
    cone = _normal_cone(program, scaling.scaled_primal(linear.point(trajectory)), ACTIVE)
    active = len(cone.lower)
    if active > MOST_GRADIENTS:
        text = f"uniqueness: got {active} active gradients; their rank is computed for up to {MOST_GRADIENTS}."
        raise UnsupportedError(text)
    gradients = (program.A.T @ cone.basis).toarray()
    norms = np.linalg.norm(gradients, axis=0)
    with one_blas_thread:
        values = np.linalg.svd(gradients / np.where(norms > 0, norms, 1.0), compute_uv=False)
    return Uniqueness(active, int((values > DEPENDENT * values.max(initial=0.0)).sum()))


def _normal_cone(program: Program, z: Array, near: float) -> _NormalCone:
    """Return the normal cone at z; equations, and rows that are violated, count as active.

    A second-order cone at whose edge z lies has the multiples of one normal, and at its apex its whole polar.
    """
    Az, low, high = program.A @ z, program.lower, program.upper
    equation = program.equality  # has both signs, however far rounding of states near a set point is from it
    from_below, from_above = equation | (Az <= low + near), equation | (Az >= high - near)
    alone = np.flatnonzero(program.alone & (from_below | from_above))  # all others are zero, exactly
    slack, lower, upper = Az - low, np.where(from_below[alone], -np.inf, 0.0), np.where(from_above[alone], np.inf, 0.0)
    columns = [sp.csc_array((np.ones(len(alone)), (alone, np.arange(len(alone)))), shape=(len(slack), len(alone)))]
    polars = list[slice]()
    for cone in program.cones:
        s, rows, count = slack[cone], np.arange(cone.start, cone.stop), len(lower)
        tail = float(np.linalg.norm(s[1:]))
        if s[0] - tail > near:
            continue
        if tail > near:
            block, least = np.append(-1.0, s[1:] / tail)[:, None], 0.0
        else:
            block, least = np.eye(len(s)), -np.inf
            polars.append(slice(count, count + len(s)))
        row, column = np.nonzero(np.ones_like(block))
        columns.append(sp.csc_array((block.ravel(), (rows[row], column)), shape=(len(slack), block.shape[1])))
        lower = np.append(lower, np.full(block.shape[1], least))
        upper = np.append(upper, np.full(block.shape[1], np.inf))
    return _NormalCone(sp.csc_array(sp.hstack(columns)), lower, upper, tuple(polars))
