"""A solver's point made accurate: the equations of its active rows, solved directly."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.program.program import Program

PROXIMAL = 1e-8  # on the diagonal: dependent rows and flat directions keep their values
STEPS = 8  # of the proximal method of multipliers
ROUNDS = 4  # of adding violated rows, and of dropping rows whose multiplier has the wrong sign
ROUNDING = 1e-12  # violations and multipliers, in a program scaled to order 1, that are zero


def polished(program: Program, z: Array, y: Array) -> tuple[Array, Array] | None:
    """Return z and y with the active rows at their bounds, or None if that fails; the program has no cones.

    A row is active if its multiplier is larger than its distance from the bound.
    """
    values = program.A @ z
    equal = program.equality
    above = ~equal & (y > program.upper - values)
    below = ~equal & ~above & (-y > values - program.lower)
    for _ in range(ROUNDS):
        solution = _held(program, np.where(equal | above | below, y, 0.0), z, equal, above, below)
        if solution is None:
            return None
        z, y = solution
        values = program.A @ z
        kept_above, kept_below = above & (y >= -ROUNDING), below & (y <= ROUNDING)
        new_above = ~equal & (values > program.upper + ROUNDING)
        new_below = ~equal & (values < program.lower - ROUNDING)
        after = kept_above | new_above, (kept_below | new_below) & ~new_above
        if np.array_equal(after[0], above) and np.array_equal(after[1], below):
            break
        above, below = after
    return z, np.where(above, np.maximum(y, 0.0), np.where(below, np.minimum(y, 0.0), np.where(equal, y, 0.0)))


def without_rounding(values: Array, units: Array, level: float) -> Array:
    """Return values with exact zeros where they are below this part of their units."""
    return np.where(np.abs(values) <= level * units, 0.0, values)


def _held(program: Program, y: Array, z: Array, equal: Mask, above: Mask, below: Mask) -> tuple[Array, Array] | None:
    """Return the optimum with some rows as equations, and its multipliers."""
    rows = np.flatnonzero(equal | above | below)
    A, target = sp.csc_array(program.A[rows]), np.where(below, program.lower, program.upper)[rows]
    variables, count = len(z), len(rows)
    weights = sp.diags_array(np.append(np.full(variables, PROXIMAL), np.full(count, -PROXIMAL)))
    none = sp.csc_array((count, count))
    matrix = sp.csc_array(sp.block_array([[program.P, A.T], [A, none]]) + weights)
    try:
        factor = splu(matrix)
    except RuntimeError:  # exactly singular
        return None
    held = y[rows]
    for _ in range(STEPS):
        residual = np.concatenate([-(program.P @ z + program.q + A.T @ held), target - A @ z])
        step = factor.solve(residual)
        if not np.isfinite(step).all():
            return None
        z, held = z + step[:variables], held + step[variables:]
    found = np.zeros_like(y)
    found[rows] = held
    return z, found
