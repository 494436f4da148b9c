"""Units of states, controls and cost in which the numbers of a program are near 1.

Magnitudes come from the optimum without bounds and bands, capped by the bounds: these say what is allowed, not what
happens. Variables are deviations from the references. Once there is a trajectory, its magnitudes are the units: its
residuals are measured in them (``point_scaling``), and further solves may be.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from lin_freq_ocp.base.arrays import Array, Mask, split_signals, times_vectors
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.passed_bins import response_basis
from lin_freq_ocp.program.program import Block, Program, Scaling, regularised_kkt, scale_matrix
from lin_freq_ocp.transform.sizes import stated_sizes

HESSIAN_REGULARISATION = 1e-6  # relative to the mean diagonal: directions without cost get the smallest trajectory
ROW_REGULARISATION = 1e-10  # dependent equations (an unreachable end) get a least-squares trajectory
NEGLIGIBLE_SIZE = 1e-6  # magnitude, relative to the size in the data, below which a component does not move
UNIT_ROUNDING = 1e-12  # of the previous unit: smaller signals are rounding errors
UNNOTICED = 1e-3  # least unit of a component, relative to the smallest change that affects others over the horizon
TERM_SHARE = 0.1  # with terms, which the relaxed optimum ignores, units differ by at most this from the data
REVISED = 100.0  # factor between a unit and the magnitude of the answer, above which the program is solved again
COST_LEVEL = 10.0  # steepest slope of the scaled cost, the others being smaller


def natural_scaling(linear: LinearProgram) -> Scaling:
    """Return the change of units that makes states and controls of order 1, and the cost gradient of order 10."""
    stated = np.concatenate(stated_sizes(linear.problem))
    sizes = _relaxed_magnitudes(linear, stated)
    if any(not term.hard or not term.kind.is_rows for term in linear.problem.terms):
        sizes = np.clip(sizes, TERM_SHARE * stated, stated / TERM_SHARE)
    columns = linear.column_units(*np.split(sizes, [linear.problem.state_dim]))
    return scale_rows_and_cost(linear, columns, columns)


def scaled_program(problem: OptimalControlProblem) -> tuple[LinearProgram, Scaling, Program]:
    """Return the linear program, its natural units, and the program in them."""
    linear = LinearProgram(problem)
    scaling = natural_scaling(linear)
    return linear, scaling, linear.sparse.scaled(scaling)


def common_scaling(programs: Sequence[LinearProgram], sizes: tuple[Array, Array]) -> Scaling:
    """Return one change of units for several linear problems that differ in their dynamics only, such as modes.

    The unit of a component is its largest one among the problems, within TERM_SHARE of its size in the data of all.
    """
    first = programs[0]
    stated = first.column_units(*sizes)
    largest = np.max([natural_scaling(linear).columns for linear in programs], axis=0)
    columns = np.clip(largest, TERM_SHARE * stated, stated / TERM_SHARE)
    return scale_rows_and_cost(first, columns, columns)


def point_scaling(linear: LinearProgram, z: Array, fallback: Array) -> Scaling:
    """Return the units in which a point z (in the program's own units) is of order 1 (see ``point_units``)."""
    columns = point_units(linear, z, fallback)
    return scale_rows_and_cost(linear, columns, np.maximum(np.abs(z), UNNOTICED * columns))


def point_units(linear: LinearProgram, z: Array, fallback: Array) -> Array:
    """Return the units of variables in which a point z (in the program's own units) is of order 1, (variables,).

    ``fallback`` (variables,) are the units of variables that are zero.
    """
    signals = (np.broadcast_to(signal.max(0), signal.shape) for signal in _noticeable_sizes(linear, z))
    pairs = zip(signals, linear.split_signals(fallback), strict=True)
    return linear.column_units(*(np.where(size > UNIT_ROUNDING * unit, size, unit) for size, unit in pairs))


def point_sizes(linear: LinearProgram, z: Array) -> Array:
    """Return the magnitudes of the variables of a point, (variables,), with those of signals bounded below."""
    return np.concatenate([*(signal.ravel() for signal in _noticeable_sizes(linear, z)), np.abs(z[linear.signals :])])


def stated_scaling(linear: LinearProgram) -> Scaling:
    """Return the units from the sizes in the data of a problem."""
    columns = linear.column_units(*stated_sizes(linear.problem))
    return scale_rows_and_cost(linear, columns, columns)


def plain_scaling(linear: LinearProgram) -> Scaling:
    """Return the problem's own units."""
    program = linear.sparse
    return Scaling(np.ones(program.A.shape[1]), np.ones(program.A.shape[0]), 1.0)


def bounds_scaling(linear: LinearProgram, natural: Scaling) -> Scaling:
    """Return the natural units, enlarged until the farthest bound on a state or control is of order 1.

    They are for optima at far bounds.
    """
    bounds = np.abs(linear.problem.signal_bounds)
    sides = split_signals(np.where(np.isfinite(bounds), bounds, 0.0).max(0), linear.problem.state_dim)
    units = natural.columns[: linear.signals]
    far = float((np.concatenate([side.ravel() for side in sides]) / units).max(initial=1.0))
    return scale_rows_and_cost(linear, far * natural.columns, far * natural.columns)


def revised_scaling(linear: LinearProgram, scaling: Scaling, z: Array) -> Scaling | None:
    """Return units from a solution z (in the program's own units), or None if they differ little from its own."""
    revised = point_scaling(linear, z, scaling.columns)
    return revised if is_revision(revised.columns / scaling.columns, revised.cost / scaling.cost) else None


def is_revision(columns: Array, cost: float) -> bool:
    """Whether units that change by these factors are worth another solve."""
    return bool(np.abs(np.log(np.append(columns, cost))).max() > np.log(REVISED))


def cost_factor(slopes: Array, priced: Mask, mean: Callable[[Array], np.floating] = np.max) -> float:
    """Return the factor of the cost that makes the steepest of the slopes, or another ``mean``, COST_LEVEL.

    Those of variables that are not ``priced`` count where there are no others: the cost has penalties only.
    """
    counted = slopes[priced & (slopes > 0)] if (slopes[priced] > 0).any() else slopes[slopes > 0]
    factor = COST_LEVEL / float(mean(counted)) if len(counted) else np.inf
    return factor if 0 < factor < np.inf else 1.0


def scale_rows_and_cost(linear: LinearProgram, columns: Array, typical: Array) -> Scaling:
    """Return the change to units ``columns``, with slopes of order 1 at a point of the size ``typical``."""
    program = linear.sparse
    # a dynamics or bound row is divided by its component's unit, any other likewise
    norms = _row_norms(scale_matrix(program.A, np.ones(program.A.shape[0]), columns))
    norms[program.rows[Block.DYNAMICS]] = columns[linear.problem.state_dim : linear.states]
    for cone in program.cones:  # rows of zeros in it have limits
        norms[cone] = max(norms[cone].max(), np.abs(program.lower[cone]).max())
    rows = 1.0 / np.where(norms > 0, norms, 1.0)
    slopes = columns * (abs(program.P) @ typical + np.abs(program.q))
    return Scaling(columns, rows, cost_factor(slopes, linear.priced))


def _relaxed_magnitudes(linear: LinearProgram, stated: Array) -> Array:
    """Return the largest deviations from the references of the optimum without inequalities and bands, (n + m,)."""
    program, problem = linear.sparse, linear.problem
    if not program.P.nnz and program.q.any():  # without curvature, the minimum is unbounded
        return stated
    columns = linear.column_units(*np.split(stated, [problem.state_dim]))[: linear.signals]
    z = _relaxed_response(linear, columns) if problem.response is not None else _relaxed_signals(linear, columns)
    if z is None:
        return stated
    z = np.nan_to_num(z * columns, nan=0.0, posinf=0.0, neginf=0.0)
    sizes = np.concatenate([signal.max(0) for signal in linear.split_signals(np.abs(z))])
    # bounds cap the sizes: they say what is allowed, not what happens
    widest = np.max(np.abs(problem.signal_bounds), axis=(0, 1))
    sizes = np.minimum(sizes, np.where(widest > 0, widest, np.inf))
    return np.where(sizes > NEGLIGIBLE_SIZE * stated, sizes, stated)


def _relaxed_signals(linear: LinearProgram, columns: Array) -> Array | None:
    """Return the optimum in units ``columns``, (signals,); None if the equations are singular."""
    program, signals = linear.sparse, linear.signals
    keep = np.flatnonzero(program.equality)
    keep = keep[keep < program.rows[Block.CONTROL_SET].stop]
    P = scale_matrix(program.P[:signals, :signals], columns, columns)
    A = scale_matrix(program.A[keep][:, :signals], np.ones(len(keep)), columns)
    row_units = 1.0 / _row_norms(A)
    mean = float(P.diagonal().mean()) or 1.0
    A = scale_matrix(A, row_units, np.ones(signals))
    P.data /= mean
    kkt = regularised_kkt(P, A, HESSIAN_REGULARISATION, ROW_REGULARISATION)
    right = np.concatenate([-columns * program.q[:signals] / mean, row_units * program.lower[keep]])
    try:
        return splu(kkt).solve(right)[:signals]
    except RuntimeError:  # exactly singular
        return None


def _relaxed_response(linear: LinearProgram, columns: Array) -> Array:
    """Return the optimum of a frequency response in units ``columns``, (signals,): that of its passed bins."""
    program, signals = linear.sparse, linear.signals
    P = scale_matrix(program.P[:signals, :signals], columns, columns)
    start, N = response_basis(linear, columns)
    H, slope = N.T @ (P @ N), N.T @ (P @ start + columns * program.q[:signals])
    mean = float(np.trace(H)) / max(len(H), 1) or 1.0
    return start - N @ np.linalg.solve(H + HESSIAN_REGULARISATION * abs(mean) * np.eye(len(H)), slope)


def _noticeable_sizes(linear: LinearProgram, z: Array) -> tuple[Array, Array]:
    """Return magnitudes (T+1, n) and (T, m) of z, floored at the smallest change that affects others."""
    problem, (x, u) = linear.problem, linear.split_signals(np.abs(z))
    if problem.response is not None:  # no state follows from the one before
        return x, u
    A, B = (np.abs(matrix) for matrix in (problem.linear.A, problem.linear.B))
    part, x, u = UNNOTICED / problem.horizon, x.copy(), u.copy()
    caused = times_vectors(A, x[:-1]) + times_vectors(B, u) + np.abs(linear.drift)
    x[1:] = np.maximum(x[1:], part * caused)
    for matrix, signal in ((A, x[:-1]), (B, u)):
        noticed = np.where(
            (matrix > 0) & (x[1:, :, None] > 0), x[1:, :, None] / np.where(matrix > 0, matrix, 1), np.inf
        )
        needed = noticed.min(1)
        np.maximum(signal, np.where(np.isfinite(needed), part * needed, 0.0), out=signal)
    return x, u


def _row_norms(matrix: sp.csc_array) -> Array:
    """Return the Euclidean norms of the rows of a matrix by columns; those of zeros are in cones only."""
    largest = np.zeros(matrix.shape[0])
    np.maximum.at(largest, matrix.indices, np.abs(matrix.data))
    largest = np.where(largest > 0, largest, 1.0)  # squares of the largest entries overflow
    squares = np.bincount(matrix.indices, (matrix.data / largest[matrix.indices]) ** 2, minlength=matrix.shape[0])
    return np.where(squares > 0, largest * np.sqrt(squares), 0.0)
