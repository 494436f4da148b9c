"""A semismooth Newton method on the conditions of the maximum principle for piecewise-smooth dynamics.

Steps solve the linearised equations, with the term of Levenberg and Marquardt where these are singular, and are
shortened until |Phi|^2 falls.

The conditions are equations in as many unknowns. Unknowns are x, u, eta, the frequency multipliers, and a selection for
every kink, shared by x and u: where two modes touch, the weight alpha in [0, 1] of the second; at the zero of a norm,
the vector xi. For every component v with bounds l <= v <= h, the conditions F >= 0 at l, F <= 0 at h, and F = 0 between
are, with the function of Fischer and Burmeister, nested as by Billups,

    phi(v - l, phi(h - v, -F)) = 0,    phi(a, b) = |(a, b)| - a - b,    where F is

    of x_t, u_t     the derivative of the Lagrangian without mu, nu, which then are -F
    of alpha_t      -s(x_t, u_t), the switching function of the first mode
    of eta_t        x_{t+1} - f_t(x_t, u_t); of frequency multipliers, the rows of the DFT
    of xi_t         xi - P(xi + q), the projection P onto the unit ball, q the arguments of the norm

Everything is in natural units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.formulas.jets import jets_of
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.linear_program import LinearProgram
from lin_freq_ocp.program.program import Block
from lin_freq_ocp.program.units import natural_scaling
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth


@dataclass(frozen=True, eq=False)
class SystemValue:
    """Phi, an element of its generalised derivative, and F, all in natural units."""

    phi: Array
    slopes: sp.csc_array
    F: Array


@dataclass(frozen=True, eq=False)
class NewtonSystem:
    """The equations near a trajectory, and the numbers of their unknowns.

    ``switches`` are (time, second mode, region row of the first), one for each alpha; ``norms`` are (norm, time), one
    for each xi. Unknowns are divided by ``units``, equations multiplied by ``scales``; ``linear`` has the rows of stop
    bands.
    """

    problem: OptimalControlProblem
    sequence: Indices
    linear: LinearProgram
    x: Indices
    u: Indices
    eta: Indices
    rho_x: Indices
    rho_u: Indices
    switches: list[tuple[int, int, int]]
    alpha: Indices
    norms: list[tuple[Formula, int]]
    xi: list[Indices]
    units: Array
    scales: Array
    lower: Array
    upper: Array
    rows_x: Array
    rows_u: Array

    @classmethod
    def around(
        cls, problem: OptimalControlProblem, trajectory: Trajectory, sequence: Indices, near: float
    ) -> NewtonSystem:
        """Return the system near a trajectory."""
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        linear = LinearProgram(problem.affine_at(trajectory).with_modes(sequence))
        scaling = natural_scaling(linear)
        in_x, in_u = scaling.columns[:n], scaling.columns[(T + 1) * n : (T + 1) * n + m]
        rows_x = linear.sparse.A[linear.sparse.rows[Block.STATE_SPECTRUM], : linear.states].toarray()
        rows_u = linear.sparse.A[linear.sparse.rows[Block.CONTROL_SPECTRUM], linear.states : linear.signals].toarray()
        of_x, of_u = in_x[np.abs(rows_x).argmax(axis=1) % n], in_u[np.abs(rows_u).argmax(axis=1) % m]
        switches = _switches_near(problem, trajectory, sequence, np.append(in_x, in_u), near)
        y = np.hstack([trajectory.x[:T], trajectory.u])
        norms: list[tuple[Formula, int]] = []
        for norm in piecewise_smooth(problem).norms:
            size = np.linalg.norm(jets_of(norm.arguments, y).values, axis=1)
            norms += [(norm, int(t)) for t in np.flatnonzero(size <= near * max(1.0, float(size.max())))]
        sizes = [(T + 1) * n, T * m, T * n, len(rows_x), len(rows_u), len(switches)]
        sizes += [len(norm.arguments) for norm, _ in norms]
        ends = np.cumsum(sizes)
        numbers = [np.arange(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        x, u, eta, rho_x, rho_u, alpha = numbers[:6]
        units = np.ones(ends[-1])
        units[x], units[u], units[eta] = np.tile(in_x, T + 1), np.tile(in_u, T), np.tile(1 / (scaling.cost * in_x), T)
        units[rho_x], units[rho_u] = 1 / (scaling.cost * of_x), 1 / (scaling.cost * of_u)
        scales = np.ones(ends[-1])
        signals = np.concatenate([x, u])
        scales[signals] = scaling.cost * units[signals]
        scales[eta], scales[rho_x], scales[rho_u] = np.tile(1 / in_x, T), 1 / of_x, 1 / of_u
        slopes = piecewise_smooth(problem).jets_at(y)
        for k, (t, _, row) in enumerate(switches):
            slope = slopes.regions[sequence[t]].slopes[t, row] * np.append(in_x, in_u)
            scales[alpha[k]] = 1 / max(float(np.linalg.norm(slope)), 1e-300)
        lower, upper = np.full(ends[-1], -np.inf), np.full(ends[-1], np.inf)
        for signal, box in ((x, problem.state_tube), (u, problem.control_tube)):
            lower[signal], upper[signal] = box.lower.ravel(), box.upper.ravel()
        lower[alpha], upper[alpha] = 0.0, 1.0
        shaped = x.reshape(T + 1, n), u.reshape(T, m), eta.reshape(T, n)
        parts = *shaped, rho_x, rho_u, switches, alpha, norms, numbers[6:]
        return cls(problem, sequence, linear, *parts, units, scales, lower / units, upper / units, rows_x, rows_u)

    def at(self, v: Array) -> SystemValue:
        """Return Phi and an element of its generalised derivative."""
        F, derivative = self.equations(v * self.units)
        F, J = F * self.scales, sp.diags_array(self.scales) @ derivative @ sp.diags_array(self.units)
        free, fixed = np.isinf(self.lower) & np.isinf(self.upper), self.lower == self.upper
        phi, by_v, by_F = _bounded_complementarity(v, F, self.lower, self.upper)
        phi, by_v, by_F = np.where(free, F, phi), np.where(free, 0.0, by_v), np.where(free, 1.0, by_F)
        phi = np.where(fixed, v - np.where(fixed, self.lower, 0.0), phi)
        by_v, by_F = np.where(fixed, 1.0, by_v), np.where(fixed, 0.0, by_F)
        return SystemValue(phi, sp.csc_array(sp.diags_array(by_v) + sp.diags_array(by_F) @ J), F)

    def equations(self, v: Array) -> tuple[Array, sp.csr_array]:
        """Return F and its derivative, in the problem's units."""
        problem, T = self.problem, self.problem.horizon
        x, u, eta, alpha = v[self.x], v[self.u], v[self.eta], v[self.alpha]
        y, at = np.hstack([x[:-1], u]), np.hstack([self.x[:-1], self.u])
        dynamics, selections = piecewise_smooth(problem), dict[Formula, Array]()
        for (norm, t), xi in zip(self.norms, self.xi, strict=True):
            selections.setdefault(norm, np.full((T, len(norm.arguments)), np.nan))[t] = v[xi]
        mode_jets = dynamics.jets_at(y, selections)
        times = np.arange(T)
        values, slopes, curvatures = mode_jets.maps_of(self.sequence, times)
        active = slopes.copy()
        F, J = np.zeros(len(v)), _Blocks(len(v))
        for k, (t, second, row) in enumerate(self.switches):
            second_map = mode_jets.maps_of(second, t)
            region = mode_jets.regions[self.sequence[t]]
            switch, gradient = region.values[t, row], region.slopes[t, row]
            kink = second_map[1] - slopes[t]
            F[self.alpha[k]] = -switch
            J.add(self.alpha[[k]], at[t], -gradient[None, :])
            J.add(at[t], self.alpha[[k]], -(kink.T @ eta[t])[:, None])
            if switch > 0:
                values[t], active[t] = second_map[:2]
            slopes[t] = slopes[t] + alpha[k] * kink
            curvatures[t] = curvatures[t] + alpha[k] * (second_map[2] - curvatures[t])
        cost_x, cost_u = problem.quadratic.gradient(x, u)
        F[self.x], F[self.u] = cost_x, cost_u
        F[self.x[1:]] += eta
        F[at] -= np.einsum("tij,ti->tj", slopes, eta)
        F[self.eta] = x[1:] - values
        hessians = np.broadcast_to(problem.quadratic.stage_hessians, (T, at.shape[1], at.shape[1]))
        curved = hessians - np.einsum("ti,tijk->tjk", eta, curvatures)
        J.add(at, at, curved)
        J.add(at, self.eta, -slopes.swapaxes(1, 2))
        J.add(self.eta, at, -active)
        single = self.eta.reshape(-1, 1), self.x[1:].reshape(-1, 1), np.ones((self.eta.size, 1, 1))
        J.add(single[0], single[1], single[2])
        J.add(single[1], single[0], single[2])
        J.add(self.x[T], self.x[T], problem.quadratic.P)
        for rho, rows, signals in (
            (self.rho_x, self.rows_x, self.x.ravel()),
            (self.rho_u, self.rows_u, self.u.ravel()),
        ):
            F[signals] += rows.T @ v[rho]
            F[rho] = rows @ v[signals]
            J.add(signals, rho, rows.T)
            J.add(rho, signals, rows)
        for (norm, t), columns in zip(self.norms, self.xi, strict=True):
            inner = jets_of(norm.arguments, y[t : t + 1], times=np.array([t]))
            q, of_q, xi = inner.values[0], inner.slopes[0], v[columns]
            reached = xi + q
            length = float(np.linalg.norm(reached))
            projection, onto = reached, np.eye(len(q))
            if length > 1:
                projection = reached / length
                onto = (np.eye(len(q)) - np.outer(projection, projection)) / length
            F[columns] = xi - projection
            J.add(columns, columns, np.eye(len(q)) - onto)
            J.add(columns, at[t], -onto @ of_q)
            pull = dynamics.pull_of_norm(norm, y[t], t, int(self.sequence[t]), eta[t])
            J.add(at[t], columns, -pull * of_q.T)
        return F, J.matrix()


class _Blocks:
    """A sparse square matrix that is a sum of dense blocks."""

    def __init__(self, size: int):
        self._size, self._parts = size, list[tuple[Indices, Indices, Array]]()

    def add(self, rows: Indices, columns: Indices, block: Array) -> None:
        """Add blocks (..., rows, columns) at rows (..., rows) and columns (..., columns)."""
        row, column = np.broadcast_arrays(rows[..., :, None], columns[..., None, :])
        self._parts.append((row.ravel(), column.ravel(), np.broadcast_to(block, row.shape).ravel()))

    def matrix(self) -> sp.csr_array:
        """Return the sum."""
        row, column, value = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        return sp.csr_array((value, (row, column)), shape=(self._size, self._size))


def _bounded_complementarity(v: Array, F: Array, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
    """Return phi(v - l, phi(h - v, -F)) with its derivatives by v and by F."""
    with np.errstate(invalid="ignore"):
        inner, by_a, by_b = _fischer_burmeister(upper - v, -F)
    inner, by_v, by_F = (
        np.where(np.isfinite(upper), part, whole) for part, whole in ((inner, F), (-by_a, 0.0), (-by_b, 1.0))
    )
    with np.errstate(invalid="ignore"):
        outer, by_a, by_b = _fischer_burmeister(v - lower, inner)
    below = np.isfinite(lower)
    return (
        np.where(below, outer, inner),
        np.where(below, by_a + by_b * by_v, by_v),
        np.where(below, by_b * by_F, by_F),
    )


def _fischer_burmeister(a: Array, b: Array) -> tuple[Array, Array, Array]:
    """Return |(a, b)| - a - b, with an element of its generalised derivative."""
    length = np.hypot(a, b)
    zero = length == 0
    safe = np.where(zero, 1.0, length)
    diagonal = np.sqrt(0.5)
    return length - a - b, np.where(zero, diagonal, a / safe) - 1, np.where(zero, diagonal, b / safe) - 1


def _switches_near(
    problem: OptimalControlProblem, trajectory: Trajectory, sequence: Indices, units: Array, near: float
) -> list[tuple[int, int, int]]:
    """Return (time, second mode, row) where a row of the first mode's region is nearly zero and the second holds."""
    T = problem.horizon
    mode_jets = piecewise_smooth(problem).jets_at(np.hstack([trajectory.x[:T], trajectory.u]))
    defined = mode_jets.defined()

    def distances(mode: int, t: int) -> Array:
        region = mode_jets.regions[mode]
        sizes = np.linalg.norm(region.slopes[t] * units, axis=-1)
        return region.values[t] / np.where(sizes > 0, sizes, 1.0)

    switches: list[tuple[int, int, int]] = []
    for t in range(T):
        row_distances = distances(int(sequence[t]), t)
        others = [
            mode
            for mode in np.flatnonzero(defined[t])
            if mode != sequence[t] and distances(int(mode), t).max(initial=-np.inf) <= near
        ]
        zero = np.flatnonzero(np.abs(row_distances) <= near)
        if len(others) and len(zero):
            switches.append((t, int(others[0]), int(zero[0])))
    return switches


NEAR_KINK = 1e-3  # distance in natural units at which a switching surface or zero of a norm gets a selection
CONVERGED = 1e-12  # |Phi| of equations of order 1: a further step gains nothing
SLOPE_SHARE, SHORTEST = 1e-4, 2.0**-14  # Armijo's constant, and the shortest step
SINGULAR = 1e-13  # reciprocal condition number of the linearised equations below which a step is damped
ZERO_PIVOT = 1e-14  # part of the largest entry on the diagonal, so that no pivot is exactly zero
# Relative to |J|^2 |Phi|, until a step is found: they vanish with the residual, so that convergence stays fast
DAMPINGS = (0.0, 1e-8, 1e-6, 1e-4, 1e-2)
MOST_STEPS = 40


@dataclass(frozen=True, eq=False)
class NewtonRun:
    """The end of Newton's method; ``residuals`` are |Phi| before the first step and after each."""

    trajectory: Trajectory
    multipliers: Multipliers
    residuals: tuple[float, ...]
    converged: bool


def newton(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    multipliers: Multipliers,
    sequence: Indices,
    near: float = NEAR_KINK,
    end: float = np.inf,
) -> NewtonRun:
    """Solve the conditions of the maximum principle from a point near to a solution, in a mode sequence (T,).

    Kinks nearer than ``near``, in natural units, get a selection. Of the multipliers, eta, rho and weights are used. It
    ends at ``end``, by ``clock.now``. Raises UnsupportedError if the problem has more than bounds, stop bands and a
    quadratic cost.
    """
    if problem.terms:
        raise UnsupportedError(f"{problem.terms[0].name}: the semismooth Newton method takes bounds and stop bands.")
    system = NewtonSystem.around(problem, trajectory, sequence, near)
    return iterate_from(system, starting_point(system, trajectory, multipliers), end)


def iterate_from(system: NewtonSystem, v: Array, end: float = np.inf) -> NewtonRun:
    """Return the run from the unknowns v."""
    value = system.at(v)
    residuals = [float(np.linalg.norm(value.phi))]
    while residuals[-1] > CONVERGED and len(residuals) <= MOST_STEPS and now() <= end:
        stepped = _damped_step(system, v, value)
        if stepped is None:
            break
        v, value = stepped
        residuals.append(float(np.linalg.norm(value.phi)))
    problem, values, F = system.problem, v * system.units, value.F / system.scales
    T = problem.horizon
    weights = np.zeros((T, len(piecewise_smooth(problem).modes)))
    weights[np.arange(T), system.sequence] = 1.0
    for k, (t, second, _) in enumerate(system.switches):
        share = float(np.clip(values[system.alpha[k]], 0.0, 1.0))
        weights[t, system.sequence[t]], weights[t, second] = 1 - share, share
    x = np.clip(values[system.x], problem.state_tube.lower, problem.state_tube.upper)
    u = np.clip(values[system.u], problem.control_tube.lower, problem.control_tube.upper)
    mu, nu = (
        np.where(np.isfinite(box.lower) | np.isfinite(box.upper), -F[block], 0.0)
        for block, box in ((system.x, problem.state_tube), (system.u, problem.control_tube))
    )
    program, rho = system.linear.sparse, np.append(system.rho_x, system.rho_u)
    duals = np.zeros(len(program.lower))
    duals[program.rows[Block.STATE_SPECTRUM].start : program.rows[Block.CONTROL_SPECTRUM].stop] = values[rho]
    bands = system.linear.multipliers(duals, 1.0)
    multipliers = Multipliers(1.0, values[system.eta], mu, nu, bands.rho_u, bands.rho_x, None, weights)
    return NewtonRun(Trajectory(x, u), multipliers, tuple(residuals), residuals[-1] <= 1e3 * CONVERGED)


def _damped_step(system: NewtonSystem, v: Array, value: SystemValue) -> tuple[Array, SystemValue] | None:
    """Return the point after a step that decreases |Phi|^2, damped as little as possible, or None."""
    J, count = value.slopes, len(v)
    gradient, sizes = J.T @ value.phi, abs(J)
    square = float(sizes.sum(axis=0).max() * sizes.sum(axis=1).max())  # of the largest singular value, or more
    for damping in DAMPINGS:
        weight = damping * square * min(1.0, float(np.linalg.norm(value.phi)))
        # the least |J step + phi|^2 + weight |step|^2, by the system of residual and step
        augmented = sp.csc_array(sp.block_array([[sp.eye_array(count), J], [J.T, -weight * sp.eye_array(count)]]))
        try:
            # SuperLU ends the process at some matrices with several pivots of exactly zero
            factors = splu(augmented if damping else sp.csc_array(J + ZERO_PIVOT * sizes.max() * sp.eye_array(count)))
        except RuntimeError:  # exactly singular
            continue
        pivots = np.abs(factors.U.diagonal())
        if not damping and not pivots.min() > SINGULAR * pivots.max():
            continue
        right = np.concatenate([-value.phi, np.zeros(count)]) if damping else -value.phi
        step = factors.solve(right)[-count:]
        slope, length = float(gradient @ step), 1.0
        while length >= SHORTEST:
            after = system.at(v + length * step)
            if after.phi @ after.phi <= value.phi @ value.phi + 2 * SLOPE_SHARE * length * slope:
                return v + length * step, after
            length /= 2
    return None


def starting_point(system: NewtonSystem, trajectory: Trajectory, multipliers: Multipliers) -> Array:
    """Return the unknowns at a trajectory with multipliers, in natural units."""
    v = np.zeros(len(system.units))
    v[system.x], v[system.u] = trajectory.x, trajectory.u
    v[system.eta] = multipliers.eta
    for block, rows, signal in (
        (system.rho_x, system.rows_x, system.problem.in_time(multipliers.rho_x)),
        (system.rho_u, system.rows_u, time_signal(multipliers.rho_u, len(trajectory.u))),
    ):
        if len(block):
            v[block] = np.linalg.lstsq(rows.T, signal.ravel(), rcond=None)[0]
    for k, (t, second, _) in enumerate(system.switches):
        v[system.alpha[k]] = 0.5 if multipliers.weights is None else np.clip(multipliers.weights[t, second], 0, 1)
    return v / system.units
