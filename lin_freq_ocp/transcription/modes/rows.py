"""The rows of mode relaxations (see relaxation.py), and the columns they stand on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.transcription.modes.row_template import Groups, RowTemplate, Sense
from lin_freq_ocp.transcription.modes.stages import ModeStages


class ModeColumns:
    """Where variables stand: x, u and slacks of the host program, then shares, weights and epigraphs of modes.

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
    """Groups of rows, one for each (t, mode) or each t; names as in relaxation.py.

    Attributes
    ----------
    one_map, one_region
        On (x_t, u_t), where one mode is left.
    share_sum, weight_sum, share_map
        For each t: SUM and MAP.
    share_region, share_upper, share_lower, share_equal, weight, cone
        REGION, BOX (its three kinds), delta >= 0, CONE.
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
    """Add all rows that a relaxation may have; bounds, and M, are filled in for each member."""
    T, modes, n, k = stages.maps.shape
    r = stages.limits.shape[2]
    limits = np.where(np.isfinite(stages.limits), stages.limits, 0.0)
    y, after = _for_modes(at.y, modes), _for_modes(at.x[1:], modes)
    rows_n, rows_r, rows_k = np.arange(n), np.arange(r), np.arange(k)
    map_rows = np.repeat(rows_n, k)
    region_rows = np.repeat(rows_r, k)
    zero = np.zeros((T, modes, 1))

    def added(sense: Sense, right: Array, row: Indices, column: list[Indices], value: list[Array]) -> Groups:
        groups = int(np.prod(right.shape[:-1]))
        columns, values = np.concatenate(column, -1), np.concatenate(value, -1)
        return template.add(
            sense, right.reshape(groups, -1), row, columns.reshape(groups, -1), values.reshape(groups, -1)
        )

    def with_weight(size: int, parts: tuple[Indices, list[Indices], list[Array]], weight: Array):
        row, column, value = parts
        delta = np.broadcast_to(at.delta[..., None], (T, modes, size))
        return np.concatenate([row, np.arange(size)]), [*column, delta], [*value, np.broadcast_to(weight, delta.shape)]

    one_map = (
        np.concatenate([rows_n, map_rows]),
        [after, np.tile(y, n)],
        [np.ones((T, modes, n)), -stages.maps.reshape(T, modes, -1)],
    )
    region = region_rows, [np.tile(y, r)], [stages.rows.reshape(T, modes, -1)]
    share_region = region_rows, [np.tile(at.share, r)], [stages.rows.reshape(T, modes, -1)]
    identity = rows_k, [at.share], [np.ones((T, modes, k))]
    minus = rows_k, [at.share], [-np.ones((T, modes, k))]
    nothing_k = np.zeros((T, modes, k))
    return ModeRows(
        one_map=added(Sense.EQUATION, stages.offsets, *one_map),
        one_region=added(Sense.INEQUALITY, limits, *region),
        share_sum=added(
            Sense.EQUATION,
            np.zeros((T, k)),
            np.concatenate([rows_k, np.tile(rows_k, modes)]),
            [at.y, at.share.reshape(T, -1)],
            [np.ones((T, k)), -np.ones((T, modes * k))],
        ),
        weight_sum=added(
            Sense.EQUATION, np.ones((T, 1)), np.zeros(modes, dtype=int), [at.delta], [np.ones((T, modes))]
        ),
        share_map=added(
            Sense.EQUATION,
            np.zeros((T, n)),
            np.concatenate([rows_n, np.tile(map_rows, modes), np.tile(rows_n, modes)]),
            [at.x[1:], np.tile(at.share, n).reshape(T, -1), np.repeat(at.delta, n, axis=1)],
            [np.ones((T, n)), -stages.maps.reshape(T, -1), -stages.offsets.reshape(T, -1)],
        ),
        share_region=added(Sense.INEQUALITY, np.zeros((T, modes, r)), *with_weight(r, share_region, -limits)),
        share_upper=added(Sense.INEQUALITY, nothing_k, *with_weight(k, identity, zero)),
        share_lower=added(Sense.INEQUALITY, nothing_k, *with_weight(k, minus, zero)),
        share_equal=added(Sense.EQUATION, nothing_k, *with_weight(k, identity, zero)),
        weight=added(Sense.INEQUALITY, zero, np.zeros(1, dtype=int), [at.delta[..., None]], [zero - 1.0]),
        cone=_cones(template, at, roots),
    )


def _cones(template: RowTemplate, at: ModeColumns, roots: Array) -> Groups:
    """Add (epsilon + delta, epsilon - delta, sqrt(2) L y) in the second-order cone."""
    T, modes, k = at.share.shape
    rank = roots.shape[1]
    row = np.concatenate([[0, 0, 1, 1], np.repeat(2 + np.arange(rank), k)])
    pair = np.stack([at.epsilon, at.delta], axis=-1)
    column = np.concatenate([pair, pair, np.tile(at.share, rank)], axis=-1)
    signs = np.broadcast_to([1.0, 1.0, 1.0, -1.0], (T, modes, 4))
    through = np.broadcast_to(np.sqrt(2.0) * roots.reshape(T, 1, -1), (T, modes, rank * k))
    value = np.concatenate([signs, through], axis=-1)
    groups = T * modes
    right = np.zeros((groups, rank + 2))
    return template.add(Sense.CONE, right, row, column.reshape(groups, -1), value.reshape(groups, -1))


def _for_modes(columns: Indices, modes: int) -> Indices:
    """Return the columns of each time, (T, c), for each mode, (T, modes, c)."""
    return np.broadcast_to(columns[:, None], (len(columns), modes, columns.shape[1]))
