"""From the multipliers of a fixed mode sequence to those of the piecewise-affine map (docs/borders.md).

In the linear problem of a mode sequence s, stationarity at a stage reads  a_s - G_s' lambda = b + N nu  with the slopes
a_i = (A_i' eta, B_i' eta), the region multipliers lambda, and the normals N nu of the sets of the stage. Clarke's rule
for the map asks for  sum_i alpha_i a_i = b + N nu'  with weights alpha >= 0, sum alpha = 1: for two modes that share a
facet lambda = alpha <g, eta>. So alpha, and nu' where nu does not fit, minimise

    |sum_i alpha_i (a_i - a_s) + G_s' lambda + N (nu - nu')|,

the distance of a polyhedron from 0: beta, nu'' >= 0 with the least |V beta - N nu''|^2 + (sum beta - 1)^2 are a
multiple of them. eta and the other multipliers stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.hybrid.stage_normals import CONTROL, STATE, Normal, stage_normals
from lin_freq_ocp.problem.hybrid.affine_mode import REGION
from lin_freq_ocp.problem.hybrid.forms import measured_modes
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

GOOD_FIT = 1e-8  # relative residual up to which normals stay as they are: solvers leave 1e-9, the judge allows 1e-6


def weighted(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    sequence: Indices,
    multipliers: Multipliers,
    pushed: Array | None = None,
) -> Multipliers:
    """Return the multipliers of the map, with weights of active modes, from those of ``problem.with_modes(sequence)``.

    The latter have region multipliers under the name REGION (zero by default); ``pushed`` (T, n + m) is added to
    G_s' lambda. The result is the best fit to Clarke's rule with this adjoint, be it good or not.
    """
    arrays, x, u = measured_modes(problem), trajectory.x, trajectory.u
    times, active = np.arange(problem.horizon), arrays.active_modes(x, u)
    active[times, sequence] = True
    rows = np.concatenate([arrays.G, arrays.H], axis=-1)
    maps = np.concatenate([arrays.A, arrays.B], axis=-1)
    slopes = np.einsum("tkij,ti->tkj", maps, multipliers.eta)
    region = multipliers.stage.get(REGION, np.zeros((problem.horizon, 0)))
    across = np.einsum("tr,trj->tj", region, rows[times, sequence, : region.shape[1]])
    across += 0.0 if pushed is None else pushed
    weights, normals = np.zeros(active.shape), stage_normals(problem, trajectory)
    weights[times, sequence] = 1.0
    if problem.dynamics.controls_of(sequence) is not None:  # every u is normal to a point
        nu, stage = multipliers.nu + across[:, x.shape[1] :], dict(multipliers.stage)
        stage.pop(REGION, None)
        return replace(multipliers, nu=nu, stage=stage, weights=weights)
    parts = {term.name: multipliers.stage.get(term.name, np.zeros(term.shape)).copy() for term in problem.terms}
    parts |= {STATE: multipliers.mu.copy(), CONTROL: multipliers.nu.copy()}
    scale = _scale(maps, multipliers)
    for t in times:
        s, modes = sequence[t], np.flatnonzero(active[t])
        if len(modes) == 1 and not (np.abs(across[t]) > GOOD_FIT * scale).any():
            continue
        differences = (slopes[t, modes] - slopes[t, s] + across[t]) / scale
        held = np.array([normal.value(multipliers) for normal in normals[t]])
        weights[t, modes], changed = _nearest(differences, normals[t], held, scale)
        if changed is not None:
            for normal in normals[t]:
                parts[normal.family][normal.place] = 0.0
            for normal, value in zip(normals[t], changed, strict=True):  # of a fixed component, both signs add up
                parts[normal.family][normal.place] += normal.sign * value
    mu, nu = parts.pop(STATE), parts.pop(CONTROL)
    return Multipliers(multipliers.eta_C, multipliers.eta, mu, nu, multipliers.rho_u, multipliers.rho_x, parts, weights)


def _nearest(differences: Array, normals: Sequence[Normal], held: Array, scale: Array) -> tuple[Array, Array | None]:
    """Return alpha, and new multipliers of the normals, or None to keep ``held``; ``differences`` is (modes, n + m)."""
    columns = np.array([normal.column / scale for normal in normals]).reshape(-1, len(scale))
    alpha, _, residual = _polytope(differences, columns[:0])
    if residual <= GOOD_FIT or not len(normals):
        return alpha, None
    freed, values, with_normals = _polytope(differences + held @ columns, columns)
    return (freed, values) if with_normals < residual else (alpha, None)


def _polytope(points: Array, rays: Array) -> tuple[Array, Array, float]:
    """Return alpha, nu >= 0, sum alpha = 1, with the least |sum alpha_i p_i - sum nu_k r_k|, and its largest entry."""
    from scipy.optimize import nnls  # slow to import

    norms = np.linalg.norm(rays, axis=1)
    norms = np.where(norms > 0, norms, 1.0)
    matrix = np.hstack([points.T, -(rays / norms[:, None]).T])
    total = np.concatenate([np.ones(len(points)), np.zeros(len(rays))])
    found, _ = nnls(np.vstack([matrix, total]), np.append(np.zeros(len(matrix)), 1.0))
    found = found / found[: len(points)].sum()
    return found[: len(points)], found[len(points) :] / norms, float(np.abs(matrix @ found).max())


def _scale(maps: Array, multipliers: Multipliers) -> Array:
    """Return the scale of each entry of a slope, (n + m,): the largest terms of all slopes and normals."""
    terms = np.einsum("tkij,ti->tkj", np.abs(maps), np.abs(multipliers.eta)).max(axis=(0, 1))
    scale = terms + np.concatenate([np.abs(multipliers.mu).max(0), np.abs(multipliers.nu).max(0)])
    return np.where(scale > 0, scale, 1.0)
