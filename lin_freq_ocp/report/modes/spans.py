"""Which mode every trajectory is in, as spans of time, and what becomes of the derivatives where modes meet."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from lin_freq_ocp.analysis.sizes import measured_modes
from lin_freq_ocp.arrays import Array, Indices
from lin_freq_ocp.certificate.hamiltonian import lift
from lin_freq_ocp.certificate.modes.clarke import BorderFacts, required_slopes
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.formulas.text import text_of
from lin_freq_ocp.problem.dynamics.mode_arrays import BORDER_TOLERANCE
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.outcome import Outcome

STOPPED = "leave the regions of all modes"
"""What the states of a replay do that came to no end."""

NO_MODE = -1
"""Stands in a mode sequence where a trajectory is in no region."""


@dataclass(frozen=True)
class Span:
    """A mode that holds over the steps start .. end - 1, from time ``start`` to time ``end``."""

    start: int
    end: int
    mode: int


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
        p_t in x: what the adjoint equation asks of it (certificate.clarke.required_slopes).
    """

    time: int
    lower: Array
    upper: Array
    required: Array

    def of(self, i: int) -> Array:
        """Return what is drawn of component i, (3,)."""
        return np.array([self.lower[i], self.upper[i], self.required[i]])


def mode_names(problem: OptimalControlProblem) -> tuple[str, ...]:
    """Return the names of the modes, none for linear dynamics."""
    return problem.dynamics.mode_names


def mode_sequence(problem: OptimalControlProblem, trajectory: Trajectory) -> Indices | None:
    """Return the mode at every time, (T,), NO_MODE outside all regions; None for dynamics with fewer than two modes."""
    if len(mode_names(problem)) < 2:
        return None
    arrays = measured_modes(problem.affine_at(trajectory), trajectory)
    x, u = trajectory.x, trajectory.u
    outside = arrays.distance(x, u).min(axis=1) > BORDER_TOLERANCE
    return np.where(outside, NO_MODE, arrays.sequence(x, u))


def sequence_of(result: Outcome) -> Indices | None:
    """Return the mode at every time of a solution: the one that was solved for, if there is one."""
    if result.trajectory is None or len(mode_names(result.problem)) < 2:
        return None
    return mode_sequence(result.problem, result.trajectory) if result.sequence is None else result.sequence


def spans(sequence: Indices) -> tuple[Span, ...]:
    """Return the runs of equal modes of a sequence, which cover it without overlap."""
    edges = [0, *(int(t) + 1 for t in np.flatnonzero(np.diff(sequence))), len(sequence)]
    return tuple(Span(start, end, int(sequence[start])) for start, end in pairwise(edges))


def kinks(
    problem: OptimalControlProblem, trajectory: Trajectory, multipliers: Multipliers, borders: BorderFacts
) -> tuple[Kink, ...]:
    """Return the kinks that a judge found along a trajectory, in time."""
    times = sorted({*borders.times, *(one.time for one in borders.norms)})
    if not times:
        return ()
    n, x, u = problem.state_dim, trajectory.x, trajectory.u
    selections = _selections(problem, trajectory, borders)
    affine = problem.affine_at(trajectory, selections)
    arrays = measured_modes(affine, trajectory)
    lifted = lift(replace(affine, dynamics=affine.piecewise.along(arrays.sequence(x, u))), trajectory, multipliers)
    required = required_slopes(lifted)[:, :n]
    centre, radius = _pulled(affine, multipliers), 0.0
    for one, selection in selections.items():
        at_zero = np.where(np.isfinite(selection), 0.0, np.nan)

        def slopes(chosen: Array, one: Formula = one) -> Array:
            changed = {**selections, one: chosen}
            return _pulled(problem.affine_at(trajectory, changed), multipliers)

        columns = np.stack([slopes(at_zero + unit) for unit in np.eye(selection.shape[1])]) - slopes(at_zero)
        centre = centre - np.einsum("jtki,tj->tki", columns, np.nan_to_num(selection))
        radius = radius + np.linalg.norm(columns, axis=0)  # the largest of columns @ xi, |xi| <= 1
    lower, upper = centre - radius, centre + radius
    meeting = arrays.meeting(x, u)
    return tuple(
        Kink(t, lower[t, meeting[t]].min(axis=0), upper[t, meeting[t]].max(axis=0), required[t]) for t in times
    )


def _selections(problem: OptimalControlProblem, trajectory: Trajectory, borders: BorderFacts) -> dict[Formula, Array]:
    """Return the judge's selection of every norm at its zeros, (T, components), not a number elsewhere."""
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
