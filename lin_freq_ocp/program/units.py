"""Typical magnitudes of a problem's states, controls and cost, so that a solver sees numbers near 1.

Magnitudes come from the optimum without bounds and bands; bounds only cap them, as they say what is allowed, not what
happens. Variables are deviations from the references. Once there is a trajectory, its own magnitudes are the units: a
solution is measured in them (``own_scaling``), and solved again in them if its units were very different.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from lin_freq_ocp.base.arrays import Array, times_vectors
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sizes import stated_sizes
from lin_freq_ocp.program.program import Block, Program, Scaling
from lin_freq_ocp.program.transcription import LinearTranscription

HESSIAN_REGULARISATION = 1e-6  # relative to the mean diagonal: directions without cost get the smallest trajectory
ROW_REGULARISATION = 1e-10  # dependent equations (an unreachable end) get a least-squares trajectory
NEGLIGIBLE_SIZE = 1e-6  # magnitude, relative to the size in the data, below which a component does not move
UNIT_ROUNDING = 1e-12  # of the previous unit: smaller signals are rounding
UNNOTICED = 1e-3  # least unit of a component, relative to the change, over the horizon, that others would notice
TERM_SHARE = 0.1  # with terms, which the relaxed optimum ignores, units differ by at most this from the data
REVISED = 100.0  # factor between a unit and the magnitude found from which the program is solved again
COST_LEVEL = 10.0  # steepest slope of the scaled cost, the others being smaller


def natural_scaling(transcription: LinearTranscription) -> Scaling:
    """Return the change of units that makes states and controls of order 1, and the cost gradient of order 10."""
    guess = stated_sizes(transcription.problem)
    x, u = _relaxed_magnitudes(transcription, guess)
    if any(not term.hard or term.kind != "stage rows" for term in transcription.problem.terms):
        x, u = (
            np.clip(size, TERM_SHARE * stated, stated / TERM_SHARE) for size, stated in zip((x, u), guess, strict=True)
        )
    columns = transcription.column_units(x, u)
    return _scaling_of_units(transcription, columns, columns)


def scaled_program(problem: OptimalControlProblem) -> tuple[LinearTranscription, Scaling, Program]:
    """Return the transcription, its natural units, and the program in them."""
    transcription = LinearTranscription(problem)
    scaling = natural_scaling(transcription)
    return transcription, scaling, transcription.program.scaled(scaling)


def common_scaling(transcriptions: Sequence[LinearTranscription]) -> Scaling:
    """Return one change of units for several linear problems that differ in their dynamics only, such as modes.

    A component is as large as in the largest of them, but not much smaller or larger than the data state.
    """
    first = transcriptions[0]
    stated = first.column_units(*stated_sizes(first.problem))
    largest = np.max([natural_scaling(transcription).columns for transcription in transcriptions], axis=0)
    columns = np.clip(largest, TERM_SHARE * stated, stated / TERM_SHARE)
    return _scaling_of_units(first, columns, columns)


def own_scaling(transcription: LinearTranscription, z: Array, fallback: Array, per_time: bool = False) -> Scaling:
    """Return the units in which a point z (in the program's own units) is of order 1.

    ``fallback`` (variables,) are the units of variables that are zero. With ``per_time``, a component has another unit
    at every time, for one that decays over many orders of magnitude.
    """
    x, u = _noticeable_sizes(transcription, *_by_time(transcription, z))
    if not per_time:
        x, u = (np.broadcast_to(signal.max(0), signal.shape) for signal in (x, u))
    columns = transcription.column_units(x, u)
    signals, least = np.concatenate([x.ravel(), u.ravel()]), UNIT_ROUNDING * fallback[: transcription.signals]
    columns[: len(signals)] = np.where(signals > least, signals, fallback[: len(signals)])
    return _scaling_of_units(transcription, columns, np.maximum(np.abs(z), UNNOTICED * columns))


def own_sizes(transcription: LinearTranscription, z: Array) -> Array:
    """Return the magnitudes of the variables of a point, (variables,), with those of signals bounded below."""
    x, u = _noticeable_sizes(transcription, *_by_time(transcription, z))
    return np.concatenate([x.ravel(), u.ravel(), np.abs(z[transcription.signals :])])


def stated_scaling(transcription: LinearTranscription) -> Scaling:
    """Return the units from the sizes in the data of a problem."""
    columns = transcription.column_units(*stated_sizes(transcription.problem))
    return _scaling_of_units(transcription, columns, columns)


def plain_scaling(transcription: LinearTranscription) -> Scaling:
    """Return the problem's own units."""
    program = transcription.program
    return Scaling(np.ones(program.A.shape[1]), np.ones(program.A.shape[0]), 1.0)


def bounds_scaling(transcription: LinearTranscription, natural: Scaling) -> Scaling:
    """Return the natural units, enlarged until the farthest bound on a state or control is of order 1.

    They are for optima at far bounds.
    """
    tubes = transcription.problem.state_tube, transcription.problem.control_tube
    sides = [
        np.maximum(*(np.where(np.isfinite(side), np.abs(side), 0.0) for side in (t.lower, t.upper))) for t in tubes
    ]
    units = natural.columns[: transcription.signals]
    far = float((np.concatenate([side.ravel() for side in sides]) / units).max(initial=1.0))
    return _scaling_of_units(transcription, far * natural.columns, far * natural.columns)


def revised_scaling(transcription: LinearTranscription, scaling: Scaling, z: Array) -> Scaling | None:
    """Return units from a solution z (in the program's own units), or None if they differ little from its own."""
    revised = own_scaling(transcription, z, scaling.columns)
    factors = np.append(revised.columns / scaling.columns, revised.cost / scaling.cost)
    return revised if np.exp(np.abs(np.log(factors)).max()) > REVISED else None


def _scaling_of_units(transcription: LinearTranscription, columns: Array, typical: Array) -> Scaling:
    """Return the change to units ``columns``, with a cost of order 1 per step at a point of size ``typical``."""
    program, problem = transcription.program, transcription.problem
    # a dynamics or bound row is divided by its component's unit, any other likewise
    rows = np.empty(program.A.shape[0])
    rows[program.rows[Block.DYNAMICS]] = 1.0 / columns[problem.state_dim : (problem.horizon + 1) * problem.state_dim]
    norms = _row_norms(_scale_matrix(program.A, np.ones(len(rows)), columns))
    for block in set(program.rows) - {Block.DYNAMICS}:
        rows[program.rows[block]] = 1.0 / norms[program.rows[block]]
    for cone in program.cones:
        rows[cone] = rows[cone].min()
    slopes = columns * (abs(program.P) @ typical + np.abs(program.q))
    costs = np.append(np.ones(transcription.signals, dtype=bool), transcription.conic_terms.of_costs)
    steepest = float(slopes[costs].max(initial=0.0))
    if steepest == 0:  # nothing but penalties
        steepest = float(slopes.max(initial=0.0))
    cost = COST_LEVEL / steepest if np.isfinite(steepest) and steepest > 0 else 1.0
    return Scaling(columns, rows, cost)


def _relaxed_magnitudes(transcription: LinearTranscription, guess: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the largest deviations from the references of the optimum without inequalities and bands."""
    program, problem = transcription.program, transcription.problem
    if not program.P.nnz and program.q.any():  # without curvature, the minimum is unbounded
        return guess
    keep = np.flatnonzero(program.equality)
    keep = keep[keep < program.rows[Block.CONTROL_SET].stop]
    signals = transcription.signals
    columns = transcription.column_units(*guess)[:signals]
    P = _scale_matrix(program.P[:signals, :signals], columns, columns)
    A = _scale_matrix(program.A[keep][:, :signals], np.ones(len(keep)), columns)
    row_units = 1.0 / _row_norms(A)
    mean = float(P.diagonal().mean()) or 1.0
    kkt = _kkt(P, mean, _scale_matrix(A, row_units, np.ones(signals)))
    right = np.concatenate([-columns * program.q[:signals] / mean, row_units * program.lower[keep]])
    try:
        z = splu(kkt).solve(right)
    except RuntimeError:  # exactly singular
        return guess
    z = np.nan_to_num(z[: len(columns)] * columns, nan=0.0, posinf=0.0, neginf=0.0)
    x, u = (signal.max(0) for signal in _by_time(transcription, z))
    # bounds cap the sizes: they say what is allowed, not what happens
    widest = [np.maximum(np.abs(t.lower), np.abs(t.upper)).max(0) for t in (problem.state_tube, problem.control_tube)]
    x, u = (np.minimum(size, np.where(w > 0, w, np.inf)) for size, w in zip((x, u), widest, strict=True))
    x, u = (np.where(size > NEGLIGIBLE_SIZE * stated, size, stated) for size, stated in zip((x, u), guess, strict=True))
    return x, u


def _kkt(P: sp.csc_array, mean: float, A: sp.csc_array) -> sp.csc_array:
    """Return the regularised matrix of min z'P z / (2 mean) subject to rows A of length 1."""
    signals, count = P.shape[0], A.shape[0]
    every, hessian, rows = np.arange(signals + count), sp.coo_array(P), sp.coo_array(A)
    regularisation = np.append(np.full(signals, HESSIAN_REGULARISATION), np.full(count, -ROW_REGULARISATION))
    values = np.concatenate([hessian.data / mean, rows.data, rows.data, regularisation])
    i = np.concatenate([hessian.coords[0], rows.coords[0] + signals, rows.coords[1], every])
    j = np.concatenate([hessian.coords[1], rows.coords[1], rows.coords[0] + signals, every])
    return sp.csc_array((values, (i, j)), shape=(signals + count, signals + count))


def _by_time(transcription: LinearTranscription, z: Array) -> tuple[Array, Array]:
    """Return the magnitudes of states, (T+1, n), and controls, (T, m), of z."""
    problem = transcription.problem
    x, u = np.split(np.abs(z[: transcription.signals]), [(problem.horizon + 1) * problem.state_dim])
    return x.reshape(-1, problem.state_dim), u.reshape(-1, problem.control_dim)


def _noticeable_sizes(transcription: LinearTranscription, x: Array, u: Array) -> tuple[Array, Array]:
    """Return magnitudes (T+1, n) and (T, m), none smaller than what others would notice through the dynamics."""
    program, problem = transcription.program, transcription.problem
    if problem.dynamics.response(problem.horizon) is not None:  # nothing is noticed from one step to the next
        return x, u
    A, B = (np.abs(matrix) for matrix in (problem.linear.A, problem.linear.B))
    constant = np.abs(program.lower[program.rows[Block.DYNAMICS]]).reshape(-1, problem.state_dim)
    part, x, u = UNNOTICED / problem.horizon, x.copy(), u.copy()
    caused = times_vectors(A, x[:-1]) + times_vectors(B, u) + constant
    x[1:] = np.maximum(x[1:], part * caused)
    for matrix, signal in ((A, x[:-1]), (B, u)):
        noticed = np.where(
            (matrix > 0) & (x[1:, :, None] > 0), x[1:, :, None] / np.where(matrix > 0, matrix, 1), np.inf
        )
        needed = noticed.min(1)
        np.maximum(signal, np.where(np.isfinite(needed), part * needed, 0.0), out=signal)
    return x, u


def _row_norms(matrix: sp.csc_array) -> Array:
    """Return the Euclidean norms of the rows of a matrix by columns; 1 for rows of zeros, which are in cones only."""
    largest = np.zeros(matrix.shape[0])
    np.maximum.at(largest, matrix.indices, np.abs(matrix.data))
    largest = np.where(largest > 0, largest, 1.0)  # squares of the largest entries overflow
    squares = np.bincount(matrix.indices, (matrix.data / largest[matrix.indices]) ** 2, minlength=matrix.shape[0])
    return largest * np.sqrt(np.where(squares > 0, squares, 1.0))


def _scale_matrix(matrix: sp.csc_array, rows: Array, columns: Array) -> sp.csc_array:
    """Return diag(rows) matrix diag(columns) by columns; products of sparse matrices take several times as long."""
    scaled = sp.csc_array(matrix, copy=True)
    scaled.data *= rows[scaled.indices]
    scaled.data *= np.repeat(columns, np.diff(scaled.indptr))
    return scaled
