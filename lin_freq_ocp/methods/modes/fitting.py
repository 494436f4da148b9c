"""Multipliers for a trajectory of piecewise-affine dynamics that has none: candidates, which the judge then judges.

Where modes meet, a trajectory lies in several mode sequences, and each of them may have multipliers of its own. Those
looked for here, all with the least residual of stationarity as in ``methods/multipliers.py``:

    common    eta and all else such that, with normals and region multipliers of its own, every mode that meets at a
              stage is stationary there: then the trajectory is flip-stationary
    border    multipliers of either sign in the directions across kinks, the span of all (F_i - F_s)', and none of
              regions, as if the trajectory had to stay on the kinks: if the active gradients are independent, the only
              ones that can satisfy Clarke's rule
    weights   stationarity of the sequence's own mode s with sum_j alpha_j (F_j - F_s)' eta added, alpha_j >= 0,
              sum_j alpha_j <= 1, and eta that of the last fit: Clarke's rule once eta stays the same; only where the
              active gradients depend on each other, and the others are not the only ones

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

from lin_freq_ocp.analysis.sizes import measured_modes
from lin_freq_ocp.analysis.stage_normals import CONTROL, STATE, Normal, stage_normals
from lin_freq_ocp.arrays import Array, Indices, Mask
from lin_freq_ocp.errors import NumericalError, UnsupportedError
from lin_freq_ocp.methods.convex.sparse_program import scaled_program
from lin_freq_ocp.methods.modes.weights import weighted
from lin_freq_ocp.methods.multipliers import fitted_duals, uniqueness
from lin_freq_ocp.problem.dynamics.affine_mode import REGION
from lin_freq_ocp.problem.dynamics.mode_arrays import ModeArrays
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transcription.linear.transcription import LinearTranscription
from lin_freq_ocp.transcription.program import Program, Scaling

# Fits of weights, each with the slopes of the adjoint of the last one: where eta is known at borders, as one step
# before a free end, the first is exact
ROUNDS = 12
SAME_ADJOINT = 1e-9  # change of eta, relative to its largest entry, below which a further round would change nothing
# Two maps whose derivatives differ by less, relative to their largest entry, have no kink between them
SMALLEST_KINK = 1e-9


def candidates(problem: OptimalControlProblem, trajectory: Trajectory) -> Iterator[Multipliers]:
    """Yield multipliers with eta_C = 1, the best guess first; each fit is made when it is asked for.

    Raises
    ------
    NumericalError
        If the first fit could not be solved; later ones that could not are left out.
    """
    place = _Place.of(problem, trajectory)
    common = weighted(problem, trajectory, place.sequence, place.multipliers(fitted_duals(*_hull(place))[0]))
    yield common
    if not place.stages:
        return
    try:
        program, pushes = _on_kinks(place)
        y, _ = fitted_duals(program, place.z)
        pushed = (y[len(place.program.lower) :] @ pushes).reshape(problem.horizon, -1)
        on_kinks = weighted(problem, trajectory, place.sequence, place.multipliers(y), pushed)
        yield on_kinks
        if _independent(problem, trajectory):
            return
        for start in (on_kinks, common):
            yield from _with_weights_of(place, start.eta)
    except NumericalError:
        return


def _independent(problem: OptimalControlProblem, trajectory: Trajectory) -> bool:
    """Whether the active gradients are known to be independent: then no other multipliers are worth a try."""
    try:
        return uniqueness(problem, trajectory).unique
    except UnsupportedError:  # too many to count in a moment
        return False


def _with_weights_of(place: _Place, eta: Array) -> Iterator[Multipliers]:
    """Yield the fits with weights, of slopes with this adjoint first; the judge finds the weights again."""
    for _ in range(ROUNDS):
        y, _ = fitted_duals(*_weighing(place, eta))
        fit = place.multipliers(y)
        stage = {name: weights for name, weights in fit.stage.items() if name != REGION}
        yield Multipliers(1.0, fit.eta, fit.mu, fit.nu, fit.rho_u, fit.rho_x, stage)
        if np.abs(fit.eta - eta).max() <= SAME_ADJOINT * np.abs(fit.eta).max():
            return
        eta = fit.eta


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
        arrays, x, u = measured_modes(problem), trajectory.x, trajectory.u
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
            z=scaling.scaled_primal(transcription.point(trajectory)),
            rows=transcription.multipliers(numbers, 1.0),
            stages=[(int(t), int(j)) for t, j in np.argwhere(meeting) if j != sequence[t]],
        )

    def multipliers(self, y: Array) -> Multipliers:
        """Return the multipliers of the mode sequence from duals of which the first are those of its own program."""
        return self.transcription.multipliers(self.scaling.dual(y[: len(self.program.lower)]), 1.0)

    def signals(self, t: int) -> Indices:
        """Return the variables of (x_t, u_t), (n + m,)."""
        T, n, m = *self.rows.eta.shape, self.rows.nu.shape[1]
        return np.concatenate([t * n + np.arange(n), (T + 1) * n + t * m + np.arange(m)])

    @property
    def times(self) -> list[int]:
        """Return the times at which modes meet."""
        return sorted({t for t, _ in self.stages})

    def maps(self, t: int) -> Array:
        """Return F_i of every mode, (modes, n, n + m)."""
        return np.concatenate([self.arrays.A[t], self.arrays.B[t]], axis=-1)

    def region(self, t: int, i: int) -> Array:
        """Return the rows of the region of a mode, (rows, n + m)."""
        return np.hstack([self.arrays.G[t, i], self.arrays.H[t, i]])

    def region_row(self, t: int, row: int) -> int:
        """Return the row of the program that is a row of the region of the sequence's own mode, or -1."""
        return int(self.rows.stage[REGION][t, row]) - 1

    def normal_row(self, normal: Normal) -> int:
        """Return the row of the program that a normal belongs to, or -1."""
        arrays = {STATE: self.rows.mu, CONTROL: self.rows.nu} | dict(self.rows.stage)
        return int(arrays[normal.family][normal.place]) - 1


def _without_regions(place: _Place) -> Program:
    """Return the program without region rows where modes meet."""
    upper = place.program.upper.copy()
    for t in place.times:
        region = place.rows.stage[REGION][t].astype(int)
        upper[region[region > 0] - 1] = np.inf
    return replace(place.program, upper=upper)


def _on_kinks(place: _Place) -> tuple[Program, Array]:
    """Return the program on the kinks, and what a dual of each further row adds to p_t, (rows, T * (n + m)).

    Where modes meet, there are no region rows, but (x_t, u_t) is fixed in all directions in which their maps differ.
    """
    rows, pushes = list[sp.csc_array](), list[Array]()
    for t in place.times:
        signals, maps = place.signals(t), place.maps(t)
        units, met = place.scaling.columns[signals], maps[place.meeting[t]]
        differences = ((met - maps[place.sequence[t]]) * units).reshape(-1, len(signals))
        _, sizes, across = np.linalg.svd(differences, full_matrices=False)
        across = across[sizes > SMALLEST_KINK * np.abs(met * units).max()]
        row, column = np.nonzero(np.ones_like(across))
        rows.append(sp.csc_array((across.ravel(), (row, signals[column])), shape=(len(across), len(place.z))))
        push = np.zeros((len(across), len(place.sequence), len(signals)))
        push[:, t] = across / units / place.scaling.cost
        pushes.append(push.reshape(len(across), len(place.sequence) * len(signals)))
    fixed = sp.csc_array(sp.vstack(rows))
    return _extended(_without_regions(place), fixed, np.asarray(fixed @ place.z), equations=True), np.vstack(pushes)


def _weighing(place: _Place, eta: Array) -> tuple[Program, Array]:
    """Return the program whose duals are weights of modes, and the point.

    At every stage the price max(0, max_j -v_j'(dx, du)), v_j = (F_j - F_s)' eta, is a slack sigma >= 0 of price 1 with
    rows -v_j'(x_t, u_t) - sigma <= -v_j'z: their duals alpha_j are >= 0, and sum to at most 1 by stationarity in sigma.
    """
    times, count, variables = place.times, len(place.stages), len(place.z)
    rows = np.zeros((count + len(times), variables + len(times)))
    for k, (t, j) in enumerate(place.stages):
        signals, kink = place.signals(t), place.maps(t)[j] - place.maps(t)[place.sequence[t]]
        rows[k, signals] = -place.scaling.cost * place.scaling.columns[signals] * (eta[t] @ kink)
        rows[k, variables + times.index(t)] = -1.0
    rows[count:, variables:] = -np.eye(len(times))
    z, sparse = np.append(place.z, np.zeros(len(times))), sp.csc_array(rows)
    return _extended(_without_regions(place), sparse, np.asarray(rows @ z), prices=np.ones(len(times))), z


def _hull(place: _Place) -> tuple[Program, Array]:
    """Return the program with a direction d_j for every further mode at every stage, and the point with d = 0."""
    program, width = place.program, place.signals(0).size
    further = width * len(place.stages)
    if not further:
        return program, place.z
    entries, cones = list[tuple[Indices, Indices, Array]](), list[sp.csc_array]()
    for k, (t, j) in enumerate(place.stages):
        units = place.scaling.columns[place.signals(t)]
        rows, coefficients = _own_rows(place, t, j)
        scaled = place.scaling.rows[rows, None] * coefficients * units
        row, column = np.nonzero(scaled)
        entries.append((rows[row], k * width + column, scaled[row, column]))
        facets = place.region(t, j)[place.touching[t, j]]
        cone = np.vstack([facets, *(one.column for one in place.normals[t])]) * units
        norms = np.linalg.norm(cone, axis=1)
        cones.append(sp.csc_array(cone[norms > 0] / norms[norms > 0, None]))
    row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    beside = sp.csc_array((value, (row, column)), shape=(program.A.shape[0], further))
    cone = sp.block_diag(cones)
    rows = sp.csc_array(sp.hstack([sp.csc_array((cone.shape[0], len(place.z))), cone]))
    extended = _extended(program, rows, np.zeros(cone.shape[0]), prices=np.zeros(further), beside=beside)
    return extended, np.append(place.z, np.zeros(further))


def _own_rows(place: _Place, t: int, j: int) -> tuple[Indices, Array]:
    """Return the program's rows that d_j stands in, and its coefficients, (rows, n + m).

    The dynamics with F_j - F_s; the rows of the sequence's own mode and of the stage's sets, which are about
    (x_t, u_t) - sum_j d_j, with a minus.
    """
    own = int(place.sequence[t])
    kinks = place.maps(t)[j] - place.maps(t)[own]
    found = {int(row) - 1: -line for row, line in zip(place.rows.eta[t], kinks, strict=True)}
    for row in np.flatnonzero(place.touching[t, own]):
        found[place.region_row(t, int(row))] = -place.region(t, own)[row]
    for normal in place.normals[t]:
        found[place.normal_row(normal)] = -normal.sign * normal.column
    found.pop(-1, None)
    return np.array(list(found), dtype=int), np.array(list(found.values()))


def _extended(
    program: Program,
    rows: sp.csc_array,
    limits: Array,
    equations: bool = False,
    prices: Array | None = None,
    beside: sp.csc_array | None = None,
) -> Program:
    """Return the program with further rows <= limits, or equations, and further variables.

    Parameters
    ----------
    prices : (variables,), optional
        Of further variables; none without.
    beside : sparse (rows of the program, further variables), optional
        What these add to the rows that there are; nothing without.
    """
    prices = np.zeros(0) if prices is None else prices
    count = program.A.shape[0], len(prices)
    beside = sp.csc_array(count) if beside is None else beside
    return replace(
        program,
        P=sp.csc_array(sp.block_diag([program.P, sp.csc_array((len(prices), len(prices)))])),
        q=np.append(program.q, prices),
        A=sp.csc_array(sp.vstack([sp.hstack([program.A, beside]), rows])),
        lower=np.append(program.lower, limits if equations else np.full(len(limits), -np.inf)),
        upper=np.append(program.upper, limits),
    )
