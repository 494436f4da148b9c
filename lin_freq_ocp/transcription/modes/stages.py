"""The modes of a problem as relaxations need them: deviations from the references, in natural units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.ocp import OptimalControlProblem

FLAT = 1e-12  # eigenvalues of a stage's Hessian below this part of its largest one are zero


@dataclass(frozen=True, eq=False)
class ModeStages:
    """All modes in y = (x - x_ref, u - u_ref) / units, of k = n + m components.

    Attributes
    ----------
    units : (k,)
    references : (T, k)
    last_reference : (n,)
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
        """Return bounds (T, ..., k) of (x_t, u_t) as bounds of y."""
        shape = (len(bounds), *[1] * (bounds.ndim - 2), len(self.units))
        return (bounds - self.references.reshape(shape)) / self.units


def mode_stages(problem: OptimalControlProblem, units: Array) -> ModeStages:
    """Return the modes in units (k,) of states and controls."""
    T, n = problem.horizon, problem.state_dim
    arrays, cost = problem.piecewise.arrays(T), problem.quadratic
    states = np.broadcast_to(cost.x_ref, (T + 1, n))
    controls = np.broadcast_to(cost.u_ref, (T, problem.control_dim))
    references = np.hstack([states[:-1], controls])
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
    hessians = np.broadcast_to(cost.stage_hessians(), (horizon, len(units), len(units))) * np.outer(units, units)
    values, vectors = np.linalg.eigh(hessians)
    kept = values > FLAT * values.max(axis=1, keepdims=True)
    roots = np.sqrt(np.where(kept, values, 0.0))[..., None] * np.swapaxes(vectors, 1, 2)
    rank = int(kept.sum(axis=1).max(initial=0))
    return roots[:, len(units) - rank :]
