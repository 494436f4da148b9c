"""Relaxations weaker than the path relaxation of the search, for comparison.

perspective    shares of modes at each time (ModeRelaxation)
hull    the same shares of modes, but the cost of (x_t, u_t) itself
big-M   no shares: x_{t+1} - f_i, f_i - x_{t+1} and G y - h within M (1 - delta_i), M from the same boxes
"""
# pyright: reportPrivateUsage=false

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.hybrid.path_relaxation import PathRelaxation
from lin_freq_ocp.program.hybrid.relaxation import Member, ModeRelaxation
from lin_freq_ocp.program.hybrid.rows import Duals, Groups, RowTemplate, Sense
from lin_freq_ocp.transform.hybrid.mode_reach import Reach


class HullRelaxation(ModeRelaxation):
    """Shares of modes, and the cost of their sum."""

    def __init__(self, problem: OptimalControlProblem, level: float = 1.0):
        super().__init__(problem, level)
        self._stage[:] = -1  # the Hessian of (x_t, u_t) counts at all times, and epigraphs cost nothing
        self._price[self._at.epsilon] = 0.0

    @property
    def proves(self) -> bool:
        """Return False: stagewise bounds from duals belong to the perspective relaxation."""
        return False

    def _take_several(self, rows: Mask, values: Array, right: Array, reach: Reach, many: Mask) -> None:
        super()._take_several(rows, values, right, reach, many)
        rows[self._rows.cone.rows] = False


class BigMRelaxation(HullRelaxation):
    """The rows of each mode, relaxed by as much as any point of the boxes violates them."""

    bounds_where_several = True

    def _add_host_rows(self, template: RowTemplate) -> None:
        super()._add_host_rows(template)
        stages, at = self._stages, self._at
        T, modes, n, k = stages.maps.shape
        after, y = (np.broadcast_to(part[:, None], (T, modes, part.shape[1])) for part in (at.x[1:], at.y))
        row = np.concatenate([np.arange(n), np.repeat(np.arange(n), k)])
        columns = np.concatenate([after, np.tile(y, n)], axis=-1)
        values = np.concatenate([np.ones((T, modes, n)), -stages.maps.reshape(T, modes, -1)], axis=-1)
        regions = stages.rows.reshape(T, modes, -1)
        r = stages.rows.shape[2]
        self._above = self._far(template, n, row, columns, values)
        self._below = self._far(template, n, row, columns, -values)
        self._region = self._far(template, r, np.repeat(np.arange(r), k), np.tile(y, r), regions)

    def _far(self, template: RowTemplate, size: int, row: Indices, columns: Indices, values: Array) -> Groups:
        """Add rows with a coefficient M of delta each, which members fill in."""
        groups = values.shape[0] * values.shape[1]
        delta = np.repeat(self._at.delta.reshape(groups, 1), size, axis=1)
        return template.add(
            Sense.INEQUALITY,
            np.zeros((groups, size)),
            (row, columns.reshape(groups, -1), values.reshape(groups, -1)),
            (np.arange(size), delta, 0.0),
        )

    def _take_several(self, rows: Mask, values: Array, right: Array, reach: Reach, many: Mask) -> None:
        """Take the rows of modes with M, the most by which any point of the boxes violates them."""
        stages, n = self._stages, self._n
        finite = np.isfinite(stages.limits)
        lower, upper = self._require_bounds(reach.mode_lower, many), self._require_bounds(reach.mode_upper, many)
        low = np.where(many[..., None], lower, np.inf).min(axis=1, keepdims=True)
        high = np.where(many[..., None], upper, -np.inf).max(axis=1, keepdims=True)
        low, high = (np.where(np.isfinite(bound), bound, 0.0) for bound in (low, high))
        references = np.vstack([stages.references[1:, :n], stages.last_reference])
        next_low, next_high = (
            ((bound[1:] - references) / stages.units[:n])[:, None] for bound in (reach.lower, reach.upper)
        )
        least, most = _range(stages.maps, low, high)
        limits = np.where(finite, stages.limits, 0.0)
        above, below = next_high - least - stages.offsets, most + stages.offsets - next_low
        for part, excess, limit, mask in (
            (self._above, above, stages.offsets, np.ones_like(above, dtype=bool)),
            (self._below, below, -stages.offsets, np.ones_like(below, dtype=bool)),
            (self._region, _range(stages.rows, low, high)[1] - limits, limits, finite),
        ):
            M = np.maximum(excess, 0.0).reshape(part.rows.shape)
            part.take(rows, many, mask)
            values[part.entries[:, -part.rows.shape[1] :]] = M
            right[part.rows] = limit.reshape(M.shape) + M

    def duals(self, member: Member, y: Array, z: Array | None) -> Duals:
        """Return the duals, those of regions and the adjoint with the far rows'."""
        found, full = super().duals(member, y, z), np.zeros(len(self._template.right))
        full[member.form.row] = member.form.sign * y
        shape = self._stages.offsets.shape
        above, below = (full[part.rows].reshape(shape) for part in (self._above, self._below))
        region = found.regions + full[self._region.rows].reshape(self._stages.limits.shape)
        return replace(found, regions=region, adjoint=found.adjoint + (above - below).sum(axis=1))


def _range(matrices: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return the least and largest value of every row of (T, modes, rows, k) over boxes (T, 1, k)."""
    ends = matrices * low[:, :, None], matrices * high[:, :, None]
    return np.minimum(*ends).sum(axis=-1), np.maximum(*ends).sum(axis=-1)


RELAXATIONS = {"paths": PathRelaxation, "perspective": ModeRelaxation, "hull": HullRelaxation, "big-M": BigMRelaxation}
