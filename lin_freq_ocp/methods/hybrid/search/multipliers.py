"""Multipliers of a trajectory of piecewise-affine dynamics: from a mode sequence, or fitted to the trajectory.

Where several modes are active, a trajectory lies in several mode sequences, and each may have multipliers of its own.
Candidates, all with the least residual of stationarity as in ``methods/fitted_multipliers.py``:

    common    every active mode of a stage is stationary with the same eta, and with normals and region multipliers of
              its own: then the trajectory is flip-stationary
    kinks     multipliers of either sign in the directions across kinks, the span of all (F_i - F_s)', and no region
              multipliers, as if the trajectory had to stay on the kinks: if the active gradients are independent, no
              other multipliers can satisfy Clarke's rule
    weights   stationarity of the sequence's own mode s with sum_j alpha_j (F_j - F_s)' eta added, alpha_j >= 0,
              sum_j alpha_j <= 1, and eta from the last fit: Clarke's rule once eta has converged; only where the
              active gradients depend on each other

The first belong to a linear problem, too: with d_j the part of (dx_t, du_t) that goes into mode j, in the cone of
directions into its region within the sets of the stage, and the remainder in the cone of the sequence's own mode,

    dx_{t+1} = A_s dx_t + B_s du_t + sum_j (F_j - F_s) d_j,        F = [A, B],

the convex hull of the map's directions. Stationarity in d_j is a_j - b_t = G_j' lambda_j + N nu_j.

``multipliers_with_weights`` turns the multipliers of a fixed mode sequence into those of the map (docs/borders.md). In
the linear problem of a mode sequence s, stationarity at a stage reads  a_s - G_s' lambda = b + N nu  with the slopes
a_i = (A_i' eta, B_i' eta), the region multipliers lambda, and the normals N nu of the sets of the stage. Clarke's rule
for the map asks for  sum_i alpha_i a_i = b + N nu'  with weights alpha >= 0, sum alpha = 1: for two modes that share a
facet lambda = alpha <g, eta>. So alpha, and nu' where nu does not fit, minimise

    |sum_i alpha_i (a_i - a_s) + G_s' lambda + N (nu - nu')|,

the distance of a polyhedron from 0 (``hull_weights``). eta and the other multipliers stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask, stack_signals
from lin_freq_ocp.base.errors import NumericalError, UnsupportedError
from lin_freq_ocp.base.polyhedra import hull_weights
from lin_freq_ocp.methods.fitted_multipliers import fitted_duals, rounded_point, uniqueness
from lin_freq_ocp.problem.hybrid.affine_mode import REGION, ModeArrays
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.linear_program import LinearProgram, signal_columns
from lin_freq_ocp.program.program import Program, Scaling
from lin_freq_ocp.program.units import scaled_program
from lin_freq_ocp.transform.hybrid.forms import CONTROL, STATE, Normal, active_normals, linear_along, measured_modes
from lin_freq_ocp.transform.sizes import stated_sizes

ACTIVE_DISTANCE = 1e-6  # distance, relative to its size, at which a bound or row is active: the tolerance of the judge
GOOD_FIT = 1e-8  # relative residual up to which normals do not change: solvers leave 1e-9, the judge allows 1e-6


def multipliers_with_weights(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    sequence: Indices,
    multipliers: Multipliers,
    pushed: Array | None = None,
    arrays: ModeArrays | None = None,
) -> Multipliers:
    """Return the multipliers of the map, with weights of active modes, from those of ``problem.with_modes(sequence)``.

    The latter have region multipliers under the name REGION (zero by default); ``pushed`` (T, n + m) is added to
    G_s' lambda. ``arrays`` are the modes with the sizes by which they are active, by default those of the data. The
    result is the best fit to Clarke's rule with this adjoint; it may be a poor one.
    """
    arrays, x, u = arrays or measured_modes(problem), trajectory.x, trajectory.u
    times, active = np.arange(problem.horizon), arrays.active_modes(x, u)
    active[times, sequence] = True
    slopes = np.einsum("tkij,ti->tkj", arrays.maps, multipliers.eta)
    region = multipliers.stage.get(REGION, np.zeros((problem.horizon, 0)))
    across = np.einsum("tr,trj->tj", region, arrays.rows[times, sequence, : region.shape[1]])
    across += 0.0 if pushed is None else pushed
    weights, normals = np.zeros(active.shape), _normals(problem, trajectory)
    weights[times, sequence] = 1.0
    if problem.form.choices is not None:  # every u is normal to a point
        nu, stage = multipliers.nu + across[:, x.shape[1] :], dict(multipliers.stage)
        stage.pop(REGION, None)
        return replace(multipliers, nu=nu, stage=stage, weights=weights)
    parts = {term.name: multipliers.stage.get(term.name, np.zeros(term.shape)).copy() for term in problem.terms}
    parts |= {STATE: multipliers.mu.copy(), CONTROL: multipliers.nu.copy()}
    # the scale of each entry of a slope: the largest terms of all slopes and normals
    terms = np.einsum("tkij,ti->tkj", np.abs(arrays.maps), np.abs(multipliers.eta)).max(axis=(0, 1))
    scale = terms + np.concatenate([np.abs(multipliers.mu).max(0), np.abs(multipliers.nu).max(0)])
    scale = np.where(scale > 0, scale, 1.0)
    for t in times:
        s, modes = sequence[t], np.flatnonzero(active[t])
        if len(modes) == 1 and not (np.abs(across[t]) > GOOD_FIT * scale).any():
            continue
        differences = (slopes[t, modes] - slopes[t, s] + across[t]) / scale
        values = np.array([normal.value(multipliers) for normal in normals[t]])
        columns = np.array([normal.column / scale for normal in normals[t]]).reshape(-1, len(scale))
        weights[t, modes], _, residual = _nearest_combination(differences, columns[:0])
        if residual <= GOOD_FIT or not normals[t]:
            continue  # the multipliers of the normals do not change
        alpha, changed, with_normals = _nearest_combination(differences + values @ columns, columns)
        if with_normals < residual:
            weights[t, modes] = alpha
            for normal in normals[t]:
                parts[normal.family][normal.location] = 0.0
            for normal, value in zip(normals[t], changed, strict=True):  # of a fixed component, both signs add up
                parts[normal.family][normal.location] += normal.sign * value
    mu, nu = parts.pop(STATE), parts.pop(CONTROL)
    return replace(multipliers, mu=mu, nu=nu, stage=parts, weights=weights)


def _normals(problem: OptimalControlProblem, trajectory: Trajectory) -> list[list[Normal]]:
    z = np.abs(stack_signals(trajectory.x, trajectory.u))
    return active_normals(problem, trajectory, np.concatenate(stated_sizes(problem)) + z, ACTIVE_DISTANCE)


def _nearest_combination(points: Array, rays: Array) -> tuple[Array, Array, float]:
    """Return alpha, nu >= 0, sum alpha = 1, with the least |sum alpha_i p_i - sum nu_k r_k|, and its largest entry."""
    norms = np.linalg.norm(rays, axis=1)
    norms = np.where(norms > 0, norms, 1.0)
    unit = -rays / norms[:, None]
    weights = hull_weights(points, unit)
    shares = weights / weights[: len(points)].sum()
    residual = float(np.abs(np.vstack([points, unit]).T @ shares).max())
    return shares[: len(points)], shares[len(points) :] / norms, residual


WEIGHT_FITS = 12  # fits of weights, each with the adjoint of the last
SAME_ADJOINT = 1e-9  # change of eta, relative to its largest entry, at which the rounds have converged
SMALLEST_KINK = 1e-9  # difference of two maps' derivatives, relative to their largest entry, that is no kink


def candidates(problem: OptimalControlProblem, trajectory: Trajectory, arrays: ModeArrays) -> Iterator[Multipliers]:
    """Yield multipliers with eta_C = 1, the best guess first; NumericalError if the first fit could not be solved.

    ``arrays`` are the modes with the sizes by which they are active.
    """
    point = _FitPoint.at(problem, trajectory, arrays)
    found = point.multipliers(fitted_duals(*_hull_program(point), point.rounding)[0])
    common = multipliers_with_weights(problem, trajectory, point.sequence, found, arrays=arrays)
    yield common
    if not point.stages:
        return
    try:
        program, pushes = _kink_program(point)
        y, _ = fitted_duals(program, point.z, point.rounding)
        pushed = (y[len(point.program.lower) :] @ pushes).reshape(problem.horizon, -1)
        on_kinks = multipliers_with_weights(problem, trajectory, point.sequence, point.multipliers(y), pushed, arrays)
        yield on_kinks
        with suppress(UnsupportedError):  # too many gradients
            if uniqueness(linear_along(problem, trajectory), trajectory).unique:
                return  # the active gradients are independent: there are no other multipliers
        for start in (on_kinks, common):
            eta = start.eta
            for _ in range(WEIGHT_FITS):
                fit = point.multipliers(fitted_duals(*_weight_program(point, eta), point.rounding)[0])
                # without weights: the judge fits them again
                stage = {name: values for name, values in fit.stage.items() if name != REGION}
                yield Multipliers(1.0, fit.eta, fit.mu, fit.nu, fit.rho_u, fit.rho_x, stage)
                if np.abs(fit.eta - eta).max() <= SAME_ADJOINT * np.abs(fit.eta).max():
                    break
                eta = fit.eta
    except NumericalError:
        return


@dataclass(frozen=True, eq=False)
class _FitPoint:
    """A trajectory as a point z of the scaled program of its mode sequence, with its rounding, active modes and facets.

    ``signals`` (T, n + m) are the variables of (x_t, u_t). ``rows`` has, for each multiplier, the number of its row in
    the program, counted from 1 (0: no row). ``stages`` are (time, mode) of all active modes that are not in the
    sequence.
    """

    arrays: ModeArrays
    sequence: Indices
    active: Mask
    facets: Mask
    normals: list[list[Normal]]
    linear: LinearProgram
    scaling: Scaling
    program: Program
    z: Array
    rounding: Array
    signals: Indices
    rows: Multipliers
    stages: list[tuple[int, int]]

    @classmethod
    def at(cls, problem: OptimalControlProblem, trajectory: Trajectory, arrays: ModeArrays) -> _FitPoint:
        x, u = trajectory.x, trajectory.u
        sequence, active = arrays.sequence(x, u), arrays.active_modes(x, u)
        linear, scaling, program = scaled_program(problem.with_modes(sequence))
        numbers = np.arange(1.0, 1.0 + len(program.lower))
        z, rounding = rounded_point(linear, scaling, trajectory, problem.origin)
        return cls(
            arrays=arrays,
            sequence=sequence,
            active=active,
            facets=arrays.active_facets(x, u),
            normals=_normals(problem, trajectory),
            linear=linear,
            scaling=scaling,
            program=program,
            z=z,
            rounding=rounding,
            signals=signal_columns(problem.horizon, problem.state_dim, problem.control_dim),
            rows=linear.multipliers(numbers, 0.0),  # as they are: those of an optimum pay for slacks
            stages=[(int(t), int(j)) for t, j in np.argwhere(active) if j != sequence[t]],
        )

    def multipliers(self, y: Array) -> Multipliers:
        """Return the multipliers of the mode sequence from duals that begin with those of its program."""
        return self.linear.multipliers(self.scaling.dual(y[: len(self.program.lower)]), 1.0)

    @property
    def times(self) -> list[int]:
        """Return the times at which several modes are active."""
        return sorted({t for t, _ in self.stages})


def _free_regions(point: _FitPoint) -> Program:
    """Return the program without region rows where several modes are active."""
    upper = point.program.upper.copy()
    for t in point.times:
        region = point.rows.stage[REGION][t].astype(int)
        upper[region[region > 0] - 1] = np.inf
    return replace(point.program, upper=upper)


def _kink_program(point: _FitPoint) -> tuple[Program, Array]:
    """Return the program on the kinks, and the share of each new row's dual in stationarity, (rows, T (n + m)).

    Where several modes are active, (x_t, u_t) is fixed in all directions in which their maps differ.
    """
    rows, pushes = list[sp.csc_array](), list[Array]()
    for t in point.times:
        signals, maps = point.signals[t], point.arrays.maps[t]
        units, active_maps = point.scaling.columns[signals], maps[point.active[t]]
        differences = ((active_maps - maps[point.sequence[t]]) * units).reshape(-1, len(signals))
        _, sizes, across = np.linalg.svd(differences, full_matrices=False)
        across = across[sizes > SMALLEST_KINK * np.abs(active_maps * units).max()]
        row, column = np.nonzero(np.ones_like(across))
        rows.append(sp.csc_array((across.ravel(), (row, signals[column])), shape=(len(across), len(point.z))))
        push = np.zeros((len(across), len(point.sequence), len(signals)))
        push[:, t] = across / units / point.scaling.cost
        pushes.append(push.reshape(len(across), len(point.sequence) * len(signals)))
    fixed = sp.csc_array(sp.vstack(rows))
    return _augment(_free_regions(point), fixed, np.asarray(fixed @ point.z), equations=True), np.vstack(pushes)


def _weight_program(point: _FitPoint, eta: Array) -> tuple[Program, Array]:
    """Return the program whose duals are weights of modes, and the point.

    The cost max(0, max_j -v_j'(dx, du)) of a stage, v_j = (F_j - F_s)' eta, is a slack sigma >= 0 of price 1 with rows
    -v_j'(x_t, u_t) - sigma <= -v_j'z: their duals alpha_j are >= 0, and sum to at most 1 by stationarity in sigma.
    """
    times, count, variables = point.times, len(point.stages), len(point.z)
    rows = np.zeros((count + len(times), variables + len(times)))
    for k, (t, j) in enumerate(point.stages):
        signals, maps = point.signals[t], point.arrays.maps[t]
        kink = maps[j] - maps[point.sequence[t]]
        rows[k, signals] = -point.scaling.cost * point.scaling.columns[signals] * (eta[t] @ kink)
        rows[k, variables + times.index(t)] = -1.0
    rows[count:, variables:] = -np.eye(len(times))
    z, sparse = np.append(point.z, np.zeros(len(times))), sp.csc_array(rows)
    return _augment(_free_regions(point), sparse, np.asarray(rows @ z), prices=np.ones(len(times))), z


def _hull_program(point: _FitPoint) -> tuple[Program, Array]:
    """Return the program with a direction d_j for every other active mode, and the point with d = 0."""
    program, width = point.program, point.signals.shape[1]
    further = width * len(point.stages)
    if not further:
        return program, point.z
    entries, cones = list[tuple[Indices, Indices, Array]](), list[sp.csc_array]()
    for k, (t, j) in enumerate(point.stages):
        units = point.scaling.columns[point.signals[t]]
        # the rows with d_j: F_j - F_s in the dynamics, and minus the rows of the region of mode s and of the sets
        s, maps, numbers = int(point.sequence[t]), point.arrays.maps[t], point.rows
        lines = {int(row): -line for row, line in zip(numbers.eta[t], maps[j] - maps[s], strict=True)}
        lines |= {
            int(numbers.stage[REGION][t, row]): -point.arrays.rows[t, s, row]
            for row in np.flatnonzero(point.facets[t, s])
        }
        families = {STATE: numbers.mu, CONTROL: numbers.nu} | dict(numbers.stage)
        for normal in point.normals[t]:
            lines[int(families[normal.family][normal.location])] = -normal.sign * normal.column
        lines.pop(0, None)  # the program has no such row
        rows, coefficients = np.array(list(lines), dtype=int) - 1, np.array(list(lines.values()))
        scaled = point.scaling.rows[rows, None] * coefficients * units
        row, column = np.nonzero(scaled)
        entries.append((rows[row], k * width + column, scaled[row, column]))
        facets = point.arrays.rows[t, j][point.facets[t, j]]
        cone = np.vstack([facets, *(normal.column for normal in point.normals[t])]) * units
        norms = np.linalg.norm(cone, axis=1)
        cones.append(sp.csc_array(cone[norms > 0] / norms[norms > 0, None]))
    row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    new_columns = sp.csc_array((value, (row, column)), shape=(program.A.shape[0], further))
    cone = sp.block_diag(cones)
    rows = sp.csc_array(sp.hstack([sp.csc_array((cone.shape[0], len(point.z))), cone]))
    extended = _augment(program, rows, np.zeros(cone.shape[0]), prices=np.zeros(further), new_columns=new_columns)
    return extended, np.append(point.z, np.zeros(further))


def _augment(
    program: Program,
    rows: sp.csc_array,
    limits: Array,
    equations: bool = False,
    prices: Array | None = None,
    new_columns: sp.csc_array | None = None,
) -> Program:
    """Return the program with new rows <= limits (or equations) and new variables.

    The variables have these prices, and the coefficients ``new_columns`` in the rows of the program.
    """
    prices = np.zeros(0) if prices is None else prices
    count = program.A.shape[0], len(prices)
    new_columns = sp.csc_array(count) if new_columns is None else new_columns
    return replace(
        program,
        P=sp.csc_array(sp.block_diag([program.P, sp.csc_array((len(prices), len(prices)))])),
        q=np.append(program.q, prices),
        A=sp.csc_array(sp.vstack([sp.hstack([program.A, new_columns]), rows])),
        lower=np.append(program.lower, limits if equations else np.full(len(limits), -np.inf)),
        upper=np.append(program.upper, limits),
    )
