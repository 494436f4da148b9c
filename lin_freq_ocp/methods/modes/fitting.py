"""Multipliers for a trajectory of piecewise-affine dynamics that has none: candidates, which the judge then judges.

Where modes meet, a trajectory lies in several mode sequences, and each of them may have multipliers of its own. Those
looked for here, all with the least residual of stationarity as in ``methods/multipliers.py``:

    common    eta and all else such that, with normals and region multipliers of its own, every mode that meets at a
              stage is stationary there: then the trajectory is flip-stationary
    border    region multipliers of either sign, as if the trajectory had to stay on the borders: if the active
              gradients are independent, the only ones that can satisfy Clarke's rule
    vertex    weights 0 and 1: those of one mode sequence with its regions forgotten; only if gradients depend

The first are those of a linear problem, too: with d_j the part of (dx_t, du_t) that goes into mode j, in the cone of
directions into its region within the sets of the stage, and what is left in that of the sequence's own mode,

    dx_{t+1} = A_s dx_t + B_s du_t + sum_j (F_j - F_s) d_j,        F = [A, B],

the convex hull of the map's directions. Stationarity in d_j is a_j - b_t = G_j' lambda_j + N nu_j.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.errors import NumericalError, UnsupportedError
from lin_freq_ocp.methods.convex import scaled_program
from lin_freq_ocp.methods.modes.weights import weighted
from lin_freq_ocp.methods.multipliers import fit_multipliers, fitted_duals, uniqueness
from lin_freq_ocp.problem.affine_mode import REGION
from lin_freq_ocp.problem.arrays import Array, Indices, Mask
from lin_freq_ocp.problem.mode_arrays import ModeArrays
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.stage_normals import CONTROL, STATE, Normal, stage_normals
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transcription.linear import LinearTranscription
from lin_freq_ocp.transcription.program import Program, Scaling

MOST_SEQUENCES = 16
"""Mode sequences whose multipliers are tried one by one where none of the others will do: each takes one fit, and there
can be as many as products of the modes that meet."""


def candidates(problem: OptimalControlProblem, trajectory: Trajectory) -> Iterator[Multipliers]:
    """Yield multipliers with weights and eta_C = 1, the best guess first; each fit is made when it is asked for.

    Raises
    ------
    NumericalError
        If the first fit could not be solved; later ones that could not are left out.
    """
    place = _Place.of(problem, trajectory)
    yield weighted(problem, trajectory, place.sequence, place.fitted(*_hull(place)))
    if not place.stages:
        return
    try:
        yield weighted(problem, trajectory, place.sequence, place.fitted(_on_borders(place), place.z))
    except NumericalError:
        pass
    if _independent(problem, trajectory):
        return
    for sequence in sequences_nearby(place.sequence, place.meeting, MOST_SEQUENCES):
        try:
            yield _vertex(problem, trajectory, sequence)
        except NumericalError:
            continue


def _independent(problem: OptimalControlProblem, trajectory: Trajectory) -> bool:
    """Whether the active gradients are known to be independent: then no other multipliers are worth a try."""
    try:
        return uniqueness(problem, trajectory).unique
    except UnsupportedError:  # too many to count in a moment
        return False


def sequences_nearby(sequence: Indices, meeting: Mask, most: int) -> list[Indices]:
    """Return a mode sequence and those with one mode changed to another that meets there, at most so many."""
    found = [sequence]
    for t, j in np.argwhere(meeting):
        if j != sequence[t] and len(found) < most:
            changed = sequence.copy()
            changed[t] = j
            found.append(changed)
    return found


def _vertex(problem: OptimalControlProblem, trajectory: Trajectory, sequence: Indices) -> Multipliers:
    free = replace(problem, dynamics=problem.piecewise.along(sequence))
    fit = fit_multipliers(free, trajectory).multipliers
    weights = np.eye(len(problem.piecewise.modes))[sequence]
    return Multipliers(fit.eta_C, fit.eta, fit.mu, fit.nu, fit.rho_u, fit.rho_x, fit.stage, weights)


@dataclass(frozen=True, eq=False)
class _Place:
    """A trajectory as a point z of the scaled program of its mode sequence, and what meets there.

    Attributes
    ----------
    rows : Multipliers
        In the place of each multiplier, the number of its row in the program, counted from 1; 0: it has none.
    stages : list of (time, mode)
        Every mode but the sequence's own that meets at a time.
    """

    arrays: ModeArrays
    sequence: Indices
    meeting: Mask
    touching: Mask
    normals: list[list[Normal]]
    transcription: LinearTranscription
    scaling: Scaling
    program: Program
    z: Array
    rows: Multipliers
    stages: list[tuple[int, int]]

    @classmethod
    def of(cls, problem: OptimalControlProblem, trajectory: Trajectory) -> _Place:
        arrays, x, u = problem.piecewise.arrays(problem.horizon), trajectory.x, trajectory.u
        sequence, meeting = arrays.sequence(x, u), arrays.meeting(x, u)
        transcription, scaling, program = scaled_program(problem.with_modes(sequence))
        numbers = np.arange(1.0, 1.0 + len(program.lower))
        return cls(
            arrays=arrays,
            sequence=sequence,
            meeting=meeting,
            touching=arrays.touching(x, u),
            normals=stage_normals(problem, trajectory),
            transcription=transcription,
            scaling=scaling,
            program=program,
            z=transcription.point(trajectory) / scaling.columns,
            rows=transcription.multipliers(numbers, 1.0),
            stages=[(int(t), int(j)) for t, j in np.argwhere(meeting) if j != sequence[t]],
        )

    def fitted(self, program: Program, z: Array) -> Multipliers:
        """Return the multipliers of the mode sequence from a fit of a program whose first rows are those of its own."""
        y, _ = fitted_duals(program, z)
        return self.transcription.multipliers(self.scaling.dual(y[: len(self.program.lower)]), 1.0)

    def signals(self, t: int) -> Indices:
        """Return the variables of (x_t, u_t), (n + m,)."""
        T, n, m = *self.rows.eta.shape, self.rows.nu.shape[1]
        return np.concatenate([t * n + np.arange(n), (T + 1) * n + t * m + np.arange(m)])

    def region_row(self, t: int, row: int) -> int:
        """Return the row of the program that is a row of the region of the sequence's own mode, or -1."""
        return int(self.rows.stage[REGION][t, row]) - 1

    def normal_row(self, normal: Normal) -> int:
        """Return the row of the program that a normal belongs to, or -1."""
        arrays = {STATE: self.rows.mu, CONTROL: self.rows.nu} | dict(self.rows.stage)
        return int(arrays[normal.family][normal.place]) - 1


def _on_borders(place: _Place) -> Program:
    """Return the program in which the region rows that touch where modes meet are equations."""
    lower = place.program.lower.copy()
    for t in sorted({t for t, _ in place.stages}):
        for row in np.flatnonzero(place.touching[t, place.sequence[t]]):
            i = place.region_row(t, int(row))
            if i >= 0:
                lower[i] = place.program.upper[i]
    return replace(place.program, lower=lower)


def _hull(place: _Place) -> tuple[Program, Array]:
    """Return the program with a direction d_j for every further mode at every stage, and the point with d = 0."""
    program, first = place.program, place.program.A.shape[1]
    entries, cones = list[tuple[Indices, Indices, Array]](), list[sp.csc_array]()
    width = place.arrays.A.shape[-1] + place.arrays.B.shape[-1]
    for k, (t, j) in enumerate(place.stages):
        own, columns, units = place.sequence[t], first + k * width, place.scaling.columns[place.signals(t)]
        rows, coefficients = _own_rows(place, t, int(own), j)
        scaled = place.scaling.rows[rows, None] * coefficients * units
        row, column = np.nonzero(scaled)
        entries.append((rows[row], columns + column, scaled[row, column]))
        facets = _rows(place.arrays, t, j)[place.touching[t, j]]
        cone = np.vstack([facets, *(one.column for one in place.normals[t])]) * units
        norms = np.linalg.norm(cone, axis=1)
        cones.append(sp.csc_array(cone[norms > 0] / norms[norms > 0, None]))
    if not place.stages:
        return program, place.z
    row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    total = first + width * len(place.stages)
    known = sp.csc_array(sp.hstack([program.A, sp.csc_array((program.A.shape[0], total - first))]))
    known = known + sp.csc_array((value, (row, column)), shape=known.shape)
    new = sp.block_diag(cones)
    return (
        replace(
            program,
            P=sp.csc_array(sp.block_diag([program.P, sp.csc_array((total - first, total - first))])),
            q=np.concatenate([program.q, np.zeros(total - first)]),
            A=sp.csc_array(sp.vstack([known, sp.hstack([sp.csc_array((new.shape[0], first)), new])])),
            lower=np.concatenate([program.lower, np.full(new.shape[0], -np.inf)]),
            upper=np.concatenate([program.upper, np.zeros(new.shape[0])]),
        ),
        np.concatenate([place.z, np.zeros(total - first)]),
    )


def _own_rows(place: _Place, t: int, own: int, j: int) -> tuple[Indices, Array]:
    """Return the program's rows that d_j stands in, and its coefficients, (rows, n + m).

    The dynamics with F_j - F_s; the rows of the sequence's own mode and of the stage's sets, which are about
    (x_t, u_t) - sum_j d_j, with a minus.
    """
    maps = [np.hstack([place.arrays.A[t, i], place.arrays.B[t, i]]) for i in (own, j)]
    found = {int(row) - 1: -line for row, line in zip(place.rows.eta[t], maps[1] - maps[0], strict=True)}
    for row in np.flatnonzero(place.touching[t, own]):
        found[place.region_row(t, int(row))] = -_rows(place.arrays, t, own)[row]
    for normal in place.normals[t]:
        found[place.normal_row(normal)] = -normal.sign * normal.column
    found.pop(-1, None)
    return np.array(list(found), dtype=int), np.array(list(found.values()))


def _rows(arrays: ModeArrays, t: int, i: int) -> Array:
    return np.hstack([arrays.G[t, i], arrays.H[t, i]])
