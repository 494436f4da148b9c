"""The constraint qualification of path constraints: positive linear independence of the active gradients.

The set S_t = {(x, u) : h(t, x, u) <= upper} of a time has the normal cone {h'mu : mu >= 0, mu_i (h_i - upper_i) = 0}
at a point, also within the bounds and rows of that time, if

    sum_i mu_i grad h_i + (a normal to the active bounds and rows) = 0,   mu >= 0,   only for mu = 0

(Mangasarian and Fromovitz). Nonnegative least squares finds the shortest sum with sum_i mu_i = 1 of gradients of length
1. Fixed components count as constants. A gradient is zero if it vanishes near the point, by the Hessian of h. All is in
the sizes of the states and controls, so that neither their units nor a factor of h decide.
"""

from __future__ import annotations

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.base.polyhedra import hull_weights
from lin_freq_ocp.certificate.sizes import trajectory_sizes
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.hybrid.forms import active_normals

# Distance, in sizes, within which a gradient vanishes, and length of a sum of unit gradients that counts as zero: a
# quadratic constraint that holds within the judge's tolerance may be as far from a zero of its gradient
DEGENERATE = 1e-4


def dependent_gradients(problem: OptimalControlProblem, trajectory: Trajectory) -> tuple[tuple[str, int], ...]:
    """Return the names of hard path constraints, and the times, at which the qualification fails."""
    constraints = [one for one in problem.path_constraints if one.hard_part is not None]
    if not constraints:
        return ()
    units, found = np.concatenate(trajectory_sizes(problem, trajectory)), list[tuple[str, int]]()
    active = list[tuple[int, str, Array, bool]]()  # time, name, gradient in sizes, and whether it vanishes nearby
    for one in constraints:
        at, used = one.map.jets_along(trajectory.x, trajectory.u), one.used
        largest = np.abs(one.map.signals(trajectory.x, trajectory.u)).max(axis=0)
        terms = np.abs(at.slopes) @ largest + np.einsum("j,tijk,k->ti", largest, np.abs(at.curvatures), largest)
        near = CONDITION_TOLERANCE * terms.max(axis=0)
        for t, i in np.argwhere(one.slack(trajectory.x, trajectory.u) <= near):
            free = _free_components(problem, int(t))
            if (used[i] & free).any():  # else h is a constant there
                scale = np.where(free, units, 0.0)
                gradient, bend = at.slopes[t, i] * scale, at.curvatures[t, i] * scale * scale[:, None]
                active.append((int(t), one.name, gradient, _vanishes_nearby(gradient, bend)))
    of_stages = active_normals(problem, trajectory, units, CONDITION_TOLERANCE)
    for t in sorted({t for t, *_ in active}):
        here = [(name, gradient, vanishes) for time, name, gradient, vanishes in active if time == t]
        zero = [name for name, _, vanishes in here if vanishes]
        free = _free_components(problem, t)
        normals = [np.where(free, one.column * units, 0.0) for one in of_stages[t]]
        if zero or _dependent([gradient for _, gradient, _ in here], normals):
            found += [(name, t) for name in dict.fromkeys(zero or [name for name, *_ in here])]
    return tuple(found)


def _vanishes_nearby(gradient: Array, bend: Array) -> bool:
    """Whether a gradient is zero at a point that is near by its derivative."""
    step = np.linalg.lstsq(bend, -gradient, rcond=DEGENERATE)[0]
    left, length = (float(np.linalg.norm(part)) for part in (bend @ step + gradient, step))
    return left <= DEGENERATE * float(np.linalg.norm(gradient)) and length <= DEGENERATE


def _dependent(gradients: list[Array], normals: list[Array]) -> bool:
    """Whether a sum of gradients, with weights >= 0 that are not all zero, and of normals is zero."""
    vectors = np.array([vector / np.linalg.norm(vector) for vector in (*gradients, *normals) if vector.any()])
    weights = hull_weights(*np.split(vectors, [len(gradients)]))
    return not np.linalg.norm(vectors.T @ weights) > DEGENERATE * float(weights[: len(gradients)].sum())


def _free_components(problem: OptimalControlProblem, t: int) -> Mask:
    """Return which states and controls are not fixed at a time, (n + m,); there is no control at T."""
    controls, m = problem.control_tube, problem.control_dim
    free = controls.lower[t] < controls.upper[t] if t < problem.horizon else np.zeros(m, dtype=bool)
    return np.append(problem.state_tube.lower[t] < problem.state_tube.upper[t], free)
