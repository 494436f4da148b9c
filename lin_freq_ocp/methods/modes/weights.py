"""From the multipliers of a fixed mode sequence to those of the piecewise-affine map (docs/borders.md).

In the linear problem of a mode sequence s, stationarity at a stage reads  a_s - G_s' lambda = b + N nu  with the slopes
a_i = (A_i' eta, B_i' eta), the region multipliers lambda, and the normals N nu of the sets of the stage. Clarke's rule
for the map asks for  sum_i alpha_i a_i = b + N nu'  with weights alpha >= 0, sum alpha = 1: for two modes that share a
facet lambda = alpha <g, eta>. So alpha, and nu' where nu does not do, are those with the least

    |sum_i alpha_i (a_i - a_s) + G_s' lambda + N (nu - nu')|,

the nearest point of a polyhedron to 0: beta, nu'' >= 0 with the least |V beta - N nu''|^2 + (sum beta - 1)^2 are a
multiple of them. eta and all else stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lin_freq_ocp.analysis.sizes import measured_modes
from lin_freq_ocp.analysis.stage_normals import CONTROL, STATE, Normal, stage_normals
from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.problem.dynamics.affine_mode import REGION
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

# What is left over, relative to the largest terms, up to which weights fit and normals are left as they are: the judge
# allows 1e-6, and solvers leave 1e-9
GOOD_FIT = 1e-8


def weighted(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    sequence: Indices,
    multipliers: Multipliers,
    pushed: Array | None = None,
) -> Multipliers:
    """Return the multipliers of the map, with weights, from those of ``problem.with_modes(sequence)``.

    Parameters
    ----------
    problem : OptimalControlProblem
        With piecewise-affine dynamics.
    trajectory : Trajectory
        Whose (x_t, u_t) lie in the regions of the sequence.
    sequence : (T,)
        The mode at every time.
    multipliers : Multipliers
        Those of the linear problem; region multipliers under the name REGION, zero if they are not there.
    pushed : (T, n + m), optional
        What is to be added to G_s' lambda.

    Returns
    -------
    Multipliers
        Without REGION, with weights of the modes that meet at each time. They are the nearest to Clarke's rule that
        there are with this adjoint: whether near enough, the judge says.
    """
    arrays, x, u = measured_modes(problem), trajectory.x, trajectory.u
    times, meeting = np.arange(problem.horizon), arrays.meeting(x, u)
    meeting[times, sequence] = True
    rows = np.concatenate([arrays.G, arrays.H], axis=-1)
    maps = np.concatenate([arrays.A, arrays.B], axis=-1)
    slopes = np.einsum("tkij,ti->tkj", maps, multipliers.eta)
    region = multipliers.stage.get(REGION, np.zeros((problem.horizon, 0)))
    across = np.einsum("tr,trj->tj", region, rows[times, sequence, : region.shape[1]])
    across += 0.0 if pushed is None else pushed
    weights, normals = np.zeros(meeting.shape), stage_normals(problem, trajectory)
    weights[times, sequence] = 1.0
    parts = {term.name: multipliers.stage.get(term.name, np.zeros(term.shape)).copy() for term in problem.terms}
    parts |= {STATE: multipliers.mu.copy(), CONTROL: multipliers.nu.copy()}
    scale = _scale(maps, multipliers)
    for t in times:
        s, modes = sequence[t], np.flatnonzero(meeting[t])
        if len(modes) == 1 and not (np.abs(across[t]) > GOOD_FIT * scale).any():
            continue
        differences = (slopes[t, modes] - slopes[t, s] + across[t]) / scale
        held = np.array([one.value(multipliers) for one in normals[t]])
        weights[t, modes], changed = _nearest(differences, normals[t], held, scale)
        if changed is not None:
            for one in normals[t]:
                parts[one.family][one.place] = 0.0
            for one, value in zip(normals[t], changed, strict=True):  # of a fixed component, both signs add up
                parts[one.family][one.place] += one.sign * value
    mu, nu = parts.pop(STATE), parts.pop(CONTROL)
    return Multipliers(multipliers.eta_C, multipliers.eta, mu, nu, multipliers.rho_u, multipliers.rho_x, parts, weights)


def _nearest(differences: Array, normals: Sequence[Normal], held: Array, scale: Array) -> tuple[Array, Array | None]:
    """Return alpha, and what of each normal there is to be; None: what is held. ``differences`` is (modes, n + m)."""
    columns = np.array([one.column / scale for one in normals]).reshape(-1, len(scale))
    alpha, _, left = _polytope(differences, columns[:0])
    if left <= GOOD_FIT or not len(normals):
        return alpha, None
    freed, values, with_normals = _polytope(differences + held @ columns, columns)
    return (freed, values) if with_normals < left else (alpha, None)


def _polytope(points: Array, rays: Array) -> tuple[Array, Array, float]:
    """Return alpha, nu >= 0, sum alpha = 1, with the least |sum alpha_i p_i - sum nu_k r_k|, and its largest entry."""
    from scipy.optimize import nnls  # slow to import

    norms = np.linalg.norm(rays, axis=1)
    norms = np.where(norms > 0, norms, 1.0)
    matrix = np.hstack([points.T, -(rays / norms[:, None]).T])
    total = np.concatenate([np.ones(len(points)), np.zeros(len(rays))])
    found, _ = nnls(np.vstack([matrix, total]), np.append(np.zeros(len(matrix)), 1.0))
    found = found / found[: len(points)].sum()
    left = float(np.abs(matrix @ found).max())
    return found[: len(points)], found[len(points) :] / norms, left


def _scale(maps: Array, multipliers: Multipliers) -> Array:
    """Return what each entry of a slope is measured by, (n + m,): the largest terms of all slopes and normals."""
    terms = np.einsum("tkij,ti->tkj", np.abs(maps), np.abs(multipliers.eta)).max(axis=(0, 1))
    scale = terms + np.concatenate([np.abs(multipliers.mu).max(0), np.abs(multipliers.nu).max(0)])
    return np.where(scale > 0, scale, 1.0)
