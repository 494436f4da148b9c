"""The rows of mode relaxations (see relaxation.py), the columns they stand on, and the modes in natural units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.hybrid.forms import piecewise_affine
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.hybrid.row_template import Groups, RowTemplate, Sense

FLAT = 1e-12  # eigenvalues of a stage's Hessian below this part of the largest are zero


@dataclass(frozen=True, eq=False)
class ModeStages:
    """All modes in y = (x - x_ref, u - u_ref) / units, of k = n + m components.

    Attributes
    ----------
    units : (k,), references : (T, k), last_reference : (n,)
    maps : (T, modes, n, k), offsets : (T, modes, n)
        The next state, in deviations and units, is maps y + offsets.
    rows : (T, modes, r, k), limits : (T, modes, r), norms : (T, modes, r)
        Regions; each row was divided by ``norms``.
    """

    units: Array
    references: Array
    last_reference: Array
    maps: Array
    offsets: Array
    rows: Array
    limits: Array
    norms: Array

    def scaled(self, bounds: Array) -> Array:
        """Return bounds (T, modes, k) of (x_t, u_t) as bounds of y."""
        return (bounds - self.references[:, None]) / self.units


def mode_stages(problem: OptimalControlProblem, units: Array) -> ModeStages:
    """Return the modes in units (k,) of states and controls."""
    T, n = problem.horizon, problem.state_dim
    arrays, cost = piecewise_affine(problem).arrays(T), problem.quadratic
    states = np.broadcast_to(cost.x_ref, (T + 1, n))
    references = np.hstack([states[:-1], np.broadcast_to(cost.u_ref, (T, problem.control_dim))])
    maps = np.concatenate([arrays.A, arrays.B], axis=-1)
    offsets = np.einsum("tijk,tk->tij", maps, references) + arrays.offset - states[1:, None]
    rows = np.concatenate([arrays.G, arrays.H], axis=-1)
    limits = arrays.h - np.einsum("tirk,tk->tir", rows, references)
    norms = np.linalg.norm(rows * units, axis=-1)
    norms = np.where(norms > 0, norms, 1.0)
    return ModeStages(
        units=units,
        references=references,
        last_reference=states[-1],
        maps=maps * units / units[:n, None],
        offsets=offsets / units[:n],
        rows=rows * units / norms[..., None],
        limits=limits / norms,
        norms=norms,
    )


def hessian_roots(cost: QuadraticCost, units: Array, horizon: int) -> Array:
    """Return L (T, rank, k) with L'L = [[Q, S], [S', R]] in these units; rows of zeros where the rank is lower."""
    return symmetric_roots(
        np.broadcast_to(cost.stage_hessians(), (horizon, len(units), len(units))) * np.outer(units, units)
    )


def symmetric_roots(hessians: Array) -> Array:
    """Return L (times, rank, k) with L'L = H; rows of zeros where the rank is lower."""
    values, vectors = np.linalg.eigh(hessians)
    kept = values > FLAT * np.maximum(values.max(axis=1, keepdims=True), 0.0)
    roots = np.sqrt(np.where(kept, values, 0.0))[..., None] * np.swapaxes(vectors, 1, 2)
    rank = int(kept.sum(axis=1).max(initial=0))
    return roots[:, hessians.shape[-1] - rank :]


class ModeColumns:
    """The columns of variables: x, u and slacks of the host program, then shares, weights and epigraphs of modes.

    Attributes
    ----------
    x : (T+1, n), y : (T, k)
        y_t is (x_t, u_t).
    share : (T, modes, k), delta : (T, modes), epsilon : (T, modes)
    count : int
    """

    def __init__(self, horizon: int, modes: int, n: int, m: int, host: int):
        T, k = horizon, n + m
        self.x: Indices = np.arange((T + 1) * n).reshape(T + 1, n)
        self.y: Indices = np.hstack([self.x[:-1], (T + 1) * n + np.arange(T * m).reshape(T, m)])
        own = host + np.arange(T * modes * (k + 2)).reshape(T, modes, k + 2)
        self.share, self.delta, self.epsilon = own[..., :k], own[..., k], own[..., k + 1]
        self.count = host + own.size


@dataclass(frozen=True, eq=False)
class ModeRows:
    """Groups of rows, one for each (t, mode) or each t (the sums and ``share_map``); names as in relaxation.py.

    ``one_map`` and ``one_region`` are rows on (x_t, u_t), where one mode is left; BOX has three kinds.
    """

    one_map: Groups
    one_region: Groups
    share_sum: Groups
    weight_sum: Groups
    share_map: Groups
    share_region: Groups
    share_upper: Groups
    share_lower: Groups
    share_equal: Groups
    weight: Groups
    cone: Groups


def mode_rows(template: RowTemplate, stages: ModeStages, at: ModeColumns, roots: Array) -> ModeRows:
    """Add all rows that a relaxation may have; the coefficients of bounds are filled in for each member."""
    T, modes, n, k = stages.maps.shape
    limits = np.where(np.isfinite(stages.limits), stages.limits, 0.0)
    count, rank = limits.shape[2], roots.shape[1]
    y, after = (np.broadcast_to(part[:, None], (T, modes, part.shape[1])) for part in (at.y, at.x[1:]))
    of_state, of_row, of_pair = np.arange(n), np.arange(count), np.arange(k)
    of_map, of_region = np.repeat(of_state, k), np.repeat(of_row, k)
    maps, regions = stages.maps.reshape(T, modes, n * k), stages.rows.reshape(T, modes, count * k)
    shares, all_maps, all_offsets = at.share.reshape(T, -1), maps.reshape(T, -1), stages.offsets.reshape(T, -1)
    share, pair = at.share, np.stack([at.epsilon, at.delta] * 2, axis=-1)
    box, delta = np.zeros((T, modes, k)), at.delta[..., None]
    weights = of_pair, np.repeat(delta, k, axis=-1), 0.0
    add, equation, inequality = template.add, Sense.EQUATION, Sense.INEQUALITY
    return ModeRows(
        one_map=add(equation, stages.offsets, (of_state, after, 1.0), (of_map, np.tile(y, n), -maps)),
        one_region=add(inequality, limits, (of_region, np.tile(y, count), regions)),
        share_sum=add(equation, np.zeros((T, k)), (of_pair, at.y, 1.0), (np.tile(of_pair, modes), shares, -1.0)),
        weight_sum=add(equation, np.ones((T, 1)), (np.zeros(modes, dtype=np.intp), at.delta, 1.0)),
        share_map=add(
            equation,
            np.zeros((T, n)),
            (of_state, at.x[1:], 1.0),
            (np.tile(of_map, modes), np.tile(share, n).reshape(T, -1), -all_maps),
            (np.tile(of_state, modes), np.repeat(at.delta, n, axis=1), -all_offsets),
        ),
        share_region=add(
            inequality,
            np.zeros(limits.shape),
            (of_region, np.tile(share, count), regions),
            (of_row, np.repeat(delta, count, axis=-1), -limits),
        ),
        share_upper=add(inequality, box, (of_pair, share, 1.0), weights),
        share_lower=add(inequality, box, (of_pair, share, -1.0), weights),
        share_equal=add(equation, box, (of_pair, share, 1.0), weights),
        weight=add(inequality, np.zeros(delta.shape), (np.zeros(1, dtype=np.intp), delta, -1.0)),
        cone=add(  # (epsilon + delta, epsilon - delta, sqrt(2) L y)
            Sense.CONE,
            np.zeros((T, modes, rank + 2)),
            (np.array([0, 0, 1, 1]), pair, np.array([1.0, 1.0, 1.0, -1.0])),
            (np.repeat(2 + np.arange(rank), k), np.tile(share, rank), np.sqrt(2.0) * roots.reshape(T, 1, -1)),
        ),
    )
