"""The stages of a problem in units in which they are of order 1.

    y = columns * y',   row' = factor * row,   cost' = factor * cost;   z = factor of the row * z' / factor of the cost

Entries of y, limits of rows and cones are of order 1, and the steepest slope of the cost is 10.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.methods.structured.stages import Stages, inverse_sizes
from lin_freq_ocp.program.program import Scaling
from lin_freq_ocp.program.units import UNIT_ROUNDING, UNNOTICED, cost_factor


def scale_stages(stages: Stages, columns: Array, priced: Mask, y: Array | None = None) -> tuple[Stages, Scaling]:
    """Return the stages with y in units ``columns`` (T+1, n+k), and the change of units.

    Its factors of rows are flat: x_0, stages, equations, inequalities, balls. The cost is scaled by its slopes in the
    priced entries at y; without y, at the point whose entries are one unit.
    """
    n = stages.states
    G = stages.G * columns[:, None]
    of_stages = _stage_factors(G, stages.g, stages.cones)
    before, units = stages.coupling, columns[:, stages.coupling.channels]
    equations = [part.scaled(units) for part in before.equations]
    inequalities = [part.scaled(units) for part in before.inequalities]
    balls = [part.scaled(units) for part in before.balls]
    end = columns[-1, before.terminal]
    coupling = replace(
        before,
        terminal_state=before.terminal_state / end,
        equations=tuple(part for part, _ in equations),
        inequalities=tuple(part for part, _ in inequalities),
        balls=tuple(part for part, _ in balls),
    )
    of_coupling = [1 / end, *(factors for _, factors in (*equations, *inequalities, *balls))]
    H, h = stages.H * columns[:, :, None] * columns[:, None, :], stages.h * columns
    typical = np.ones(h.shape)
    if y is not None:  # in the new units; a component that moves is floored at the smallest change that affects others
        size = np.abs(y)
        typical = np.where(size.max(axis=0) > UNIT_ROUNDING, np.maximum(size / columns, UNNOTICED), 0.0)
    slopes = np.einsum("tij,tj->ti", np.abs(H), typical) + np.abs(h)
    cost = cost_factor(slopes, priced)
    A, B, d = scale_dynamics(stages.A, stages.B, stages.d, columns)
    changed = replace(
        stages,
        A=A,
        B=B,
        d=d,
        H=H * cost,
        h=h * cost,
        G=G * of_stages[:, :, None],
        g=stages.g * of_stages,
        initial=stages.initial / columns[0, :n],
        coupling=coupling,
        constant=stages.constant * cost,
    )
    return changed, Scaling(columns, np.concatenate([1 / columns[0, :n], of_stages.ravel(), *of_coupling]), cost)


def scale_dynamics(A: Array, B: Array, d: Array, columns: Array) -> tuple[Array, Array, Array]:
    """Return A, B and d with y in units ``columns``."""
    n = A.shape[1]
    after = np.concatenate([columns[1:, :n], np.ones((1, n))])
    return A * columns[:, None, :n] / after[:, :, None], B * columns[:, None, n:] / after[:, :, None], d / after


def _stage_factors(G: Array, g: Array, cones: tuple[int, ...]) -> Array:
    """Return the factor of every row, (T+1, p), that makes the larger one of its norm and its (cone's) limit 1."""
    norms, limits = np.sqrt((G**2).sum(2)), np.where(np.isfinite(g), np.abs(g), 0.0)
    sizes, first = np.maximum(norms, limits), g.shape[1] - sum(cones)
    for size in cones:
        cone = slice(first, first + size)
        head = sizes[:, first, None]
        sizes[:, cone] = np.where(head > 0, head, norms[:, cone].max(axis=1, keepdims=True))
        first += size
    return inverse_sizes(sizes)


def fix_unused_entries(stages: Stages, used: Mask) -> Stages:
    """Return the stages with the Hessian 1 in place of 0 for unused entries of y; ``used`` is (T+1, n+k)."""
    H, (time, entry) = stages.H.copy(), np.nonzero(~used)
    H[time, entry, entry] = 1.0
    return replace(stages, H=H)
