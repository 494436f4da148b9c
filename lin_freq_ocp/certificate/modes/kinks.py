"""The derivatives of the dynamics where modes meet, or norms are zero, against the adjoint equation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.analysis.sizes import measured_modes
from lin_freq_ocp.arrays import Array
from lin_freq_ocp.certificate.hamiltonian import lift
from lin_freq_ocp.certificate.modes.clarke import BorderFacts, required_slopes
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.formulas.text import text_of
from lin_freq_ocp.problem.dynamics.piecewise_smooth import PiecewiseSmoothDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


@dataclass(frozen=True, eq=False)
class Kink:
    """A time at which modes meet or the arguments of a norm are zero.

    Attributes
    ----------
    time : int
    lower, upper : (n,)
        The least and the largest of each component of D_x <eta_t, f_i> over the modes i that meet and, at the zero of a
        norm, over all its selections |xi| <= 1.
    required : (n,)
        p_t in x: what the adjoint equation requires.
    """

    time: int
    lower: Array
    upper: Array
    required: Array

    def of(self, i: int) -> Array:
        """Return the three values of component i, (3,)."""
        return np.array([self.lower[i], self.upper[i], self.required[i]])


def kinks(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers, borders: BorderFacts
) -> tuple[Kink, ...]:
    """Return the kinks of judged border facts along a trajectory, in time."""
    times = sorted({*borders.times, *(one.time for one in borders.norms)})
    if not times:
        return ()
    n, x, u = problem.state_dim, trajectory.x, trajectory.u
    selections = _selections(problem, trajectory, borders)
    affine = problem.affine_at(trajectory, selections) if selections is not None else problem
    arrays = measured_modes(affine, trajectory)
    lifted = lift(replace(affine, dynamics=affine.piecewise.along(arrays.sequence(x, u))), trajectory, multipliers)
    required = required_slopes(lifted)[:, :n]
    centre, radius = _pulled(affine, multipliers), 0.0
    for one, selection in (selections or {}).items():
        at_zero = np.where(np.isfinite(selection), 0.0, np.nan)

        def slopes(chosen: Array, one: Formula = one) -> Array:
            changed = {**(selections or {}), one: chosen}
            return _pulled(problem.affine_at(trajectory, changed), multipliers)

        columns = np.stack([slopes(at_zero + unit) for unit in np.eye(selection.shape[1])]) - slopes(at_zero)
        centre = centre - np.einsum("jtki,tj->tki", columns, np.nan_to_num(selection))
        radius = radius + np.linalg.norm(columns, axis=0)  # the largest of columns @ xi, |xi| <= 1
    lower, upper = centre - radius, centre + radius
    meeting = arrays.meeting(x, u)
    return tuple(
        Kink(t, lower[t, meeting[t]].min(axis=0), upper[t, meeting[t]].max(axis=0), required[t]) for t in times
    )


def _selections(
    problem: OptimalControlProblem, trajectory: Trajectory, borders: BorderFacts
) -> dict[Formula, Array] | None:
    """Return the judge's selection of every norm at its zeros, (T, components), not a number elsewhere.

    None for dynamics without smooth pieces.
    """
    if not isinstance(problem.dynamics, PiecewiseSmoothDynamics):
        return None
    labels = [name.split(" [")[0] for name in (*problem.state_names, *problem.control_names)]
    judged = {(one.norm, one.time): one.selection for one in borders.norms}
    found: dict[Formula, Array] = {}
    for one, at_zero in problem.dynamics.at_zero(trajectory.x, trajectory.u).items():
        selection = np.full((problem.horizon, len(one.arguments)), np.nan)
        for t in np.flatnonzero(at_zero):
            selection[t] = judged.get((text_of(one, labels), int(t)), 0.0)
        found[one] = selection
    return found


def _pulled(affine: OptimalControlProblem, multipliers: Multipliers) -> Array:
    """Return D_x <eta_t, f_i> of every mode, (T, modes, n)."""
    return np.einsum("tkij,ti->tkj", affine.piecewise.arrays(affine.horizon).A, multipliers.eta)
