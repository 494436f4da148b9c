"""The conditions of the maximum principle for piecewise-smooth dynamics as equations in as many unknowns.

Unknowns are x, u, eta, the frequency multipliers, and a selection for every kink, shared by x and u: at a border of two
modes the weight alpha in [0, 1] of the second, at a norm the vector xi. For every component v with bounds l <= v <= h,
F >= 0 at l, F <= 0 at h, and F = 0 between say, with the function of Fischer and Burmeister, nested as by Billups,

    phi(v - l, phi(h - v, -F)) = 0,    phi(a, b) = |(a, b)| - a - b,    where F is

    of x_t, u_t     the derivative of the Lagrangian without mu, nu, which then are -F
    of alpha_t      -s(x_t, u_t), the switching function of the first mode
    of eta_t        x_{t+1} - f_t(x_t, u_t); of frequency multipliers, the rows of the DFT
    of xi_t         xi - P(xi + q), the projection P onto the unit ball, q the arguments of the norm

Everything is in natural units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.arrays import Array, Indices, Mask
from lin_freq_ocp.formulas.jets import jets
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.problem.dynamics.piecewise_smooth import ModeJets
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transcription.linear.real_rows import real_rows
from lin_freq_ocp.transcription.linear.transcription import LinearTranscription
from lin_freq_ocp.transcription.linear.units import natural_scaling


@dataclass(frozen=True, eq=False)
class SystemValue:
    """Phi, an element of its generalised derivative, and F, all in natural units."""

    phi: Array
    slopes: Array
    F: Array


@dataclass(frozen=True, eq=False)
class System:
    """The equations near a trajectory, and where their unknowns stand.

    Attributes
    ----------
    x, u, eta, rho_x, rho_u : Indices
    borders : list of (time, second mode, region row of the first), with alpha : (as many,)
    norms : list of (norm, time), with xi : list of Indices
    units : (unknowns,), scales : (unknowns,)
        Of the unknowns, and what each equation is multiplied by.
    """

    problem: OptimalControlProblem
    sequence: Indices
    x: Indices
    u: Indices
    eta: Indices
    rho_x: Indices
    rho_u: Indices
    borders: list[tuple[int, int, int]]
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
    def of(cls, problem: OptimalControlProblem, trajectory: Trajectory, sequence: Indices, near: float) -> System:
        """Return the system near a trajectory, with numbers and units for its unknowns."""
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        scaling = natural_scaling(LinearTranscription(problem.affine_at(trajectory).with_modes(sequence)))
        in_x, in_u = scaling.columns[:n], scaling.columns[(T + 1) * n : (T + 1) * n + m]
        rows_x, of_x = _rows(problem.state_stop, T + 1, in_x)
        rows_u, of_u = _rows(problem.control_stop, T, in_u)
        borders = _borders(problem, trajectory, sequence, np.append(in_x, in_u), near)
        norms = _norms(problem, trajectory, near)
        sizes = [(T + 1) * n, T * m, T * n, len(rows_x), len(rows_u), len(borders)]
        sizes += [len(one.arguments) for one, _ in norms]
        ends = np.cumsum(sizes)
        places = [np.arange(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        units = np.ones(ends[-1])
        units[places[0]], units[places[1]] = np.tile(in_x, T + 1), np.tile(in_u, T)
        units[places[2]] = np.tile(1 / (scaling.cost * in_x), T)
        units[places[3]], units[places[4]] = 1 / (scaling.cost * of_x), 1 / (scaling.cost * of_u)
        scales = np.ones(ends[-1])
        signals = np.concatenate(places[:2])
        scales[signals] = scaling.cost * units[signals]
        scales[places[2]] = np.tile(1 / in_x, T)
        scales[places[3]], scales[places[4]] = 1 / of_x, 1 / of_u
        slopes = problem.smooth_pieces.jets_at(np.hstack([trajectory.x[:T], trajectory.u]))
        for k, (t, _, row) in enumerate(borders):
            slope = slopes.regions[sequence[t]].slopes[t, row] * np.append(in_x, in_u)
            scales[places[5][k]] = 1 / max(float(np.linalg.norm(slope)), 1e-300)
        lower, upper = np.full(ends[-1], -np.inf), np.full(ends[-1], np.inf)
        for place, box in ((places[0], problem.state_tube), (places[1], problem.control_tube)):
            lower[place], upper[place] = box.lower.ravel(), box.upper.ravel()
        lower[places[5]], upper[places[5]] = 0.0, 1.0
        x, u, eta = places[0].reshape(T + 1, n), places[1].reshape(T, m), places[2].reshape(T, n)
        parts = x, u, eta, places[3], places[4], borders, places[5], norms, places[6:]
        return cls(problem, sequence, *parts, units, scales, lower / units, upper / units, rows_x, rows_u)

    def at(self, v: Array) -> SystemValue:
        """Return Phi and an element of its generalised derivative."""
        F, derivative = self.equations(v * self.units)
        F, J = F * self.scales, derivative * self.scales[:, None] * self.units
        free, fixed = np.isinf(self.lower) & np.isinf(self.upper), self.lower == self.upper
        phi, by_v, by_F = _bounded(v, F, self.lower, self.upper)
        phi, by_v, by_F = np.where(free, F, phi), np.where(free, 0.0, by_v), np.where(free, 1.0, by_F)
        phi = np.where(fixed, v - np.where(fixed, self.lower, 0.0), phi)
        by_v, by_F = np.where(fixed, 1.0, by_v), np.where(fixed, 0.0, by_F)
        return SystemValue(phi, np.diag(by_v) + by_F[:, None] * J, F)

    def equations(self, v: Array) -> tuple[Array, Array]:
        """Return F and its derivative, in the problem's units."""
        problem, T = self.problem, self.problem.horizon
        x, u, eta, alpha = v[self.x], v[self.u], v[self.eta], v[self.alpha]
        y, at = np.hstack([x[:-1], u]), np.hstack([self.x[:-1], self.u])
        found = problem.smooth_pieces.jets_at(y, self._selections(v))
        times = np.arange(T)
        first = _of(found, times, self.sequence)
        values, slopes, curvatures = first
        active = slopes.copy()
        F, J = np.zeros(len(v)), np.zeros((len(v), len(v)))
        for k, (t, second, row) in enumerate(self.borders):
            other = _of(found, np.array([t]), np.array([second]))
            region = found.regions[self.sequence[t]]
            switch, gradient = region.values[t, row], region.slopes[t, row]
            kink = other[1][0] - slopes[t]
            F[self.alpha[k]] = -switch
            J[self.alpha[k], at[t]] = -gradient
            J[at[t], self.alpha[k]] -= kink.T @ eta[t]
            if switch > 0:
                values[t], active[t] = other[0][0], other[1][0]
            slopes[t] = slopes[t] + alpha[k] * kink
            curvatures[t] = curvatures[t] + alpha[k] * (other[2][0] - curvatures[t])
        cost_x, cost_u = problem.quadratic.gradient(x, u)
        F[self.x], F[self.u] = cost_x, cost_u
        F[self.x[1:]] += eta
        F[at] -= np.einsum("tij,ti->tj", slopes, eta)
        F[self.eta] = x[1:] - values
        hessians = np.broadcast_to(problem.quadratic.stage_hessians(), (T, at.shape[1], at.shape[1]))
        bent = hessians - np.einsum("ti,tijk->tjk", eta, curvatures)
        for t in range(T):
            J[np.ix_(at[t], at[t])] += bent[t]
            J[np.ix_(at[t], self.eta[t])] -= slopes[t].T
            J[np.ix_(self.eta[t], at[t])] -= active[t]
            J[self.eta[t], self.x[t + 1]] += 1.0
            J[self.x[t + 1], self.eta[t]] += 1.0
        J[np.ix_(self.x[T], self.x[T])] += problem.quadratic.P
        for place, rows, signals in ((self.rho_x, self.rows_x, self.x), (self.rho_u, self.rows_u, self.u)):
            if len(place):
                F[signals.ravel()] += rows.T @ v[place]
                F[place] = rows @ v[signals.ravel()]
                J[np.ix_(signals.ravel(), place)] += rows.T
                J[np.ix_(place, signals.ravel())] += rows
        self._add_norms(v, F, J, y, at, eta)
        return F, J

    def _selections(self, v: Array) -> Mapping[Formula, Array]:
        selections: dict[Formula, Array] = {}
        for (one, t), place in zip(self.norms, self.xi, strict=True):
            rows = selections.setdefault(one, np.full((self.problem.horizon, len(one.arguments)), np.nan))
            rows[t] = v[place]
        return selections

    def _add_norms(self, v: Array, F: Array, J: Array, y: Array, at: Indices, eta: Array) -> None:
        """Add the equations of the selections of norms, and what these change in the others."""
        dynamics = self.problem.smooth_pieces
        for (one, t), place in zip(self.norms, self.xi, strict=True):
            inner = jets(one.arguments, y[t : t + 1])
            q, slopes, xi = inner.values[0], inner.slopes[0], v[place]
            reached = xi + q
            length = float(np.linalg.norm(reached))
            projection, onto = reached, np.eye(len(q))
            if length > 1:
                projection = reached / length
                onto = (np.eye(len(q)) - np.outer(projection, projection)) / length
            F[place] = xi - projection
            J[np.ix_(place, place)] = np.eye(len(q)) - onto
            J[np.ix_(place, at[t])] = -onto @ slopes
            pull = dynamics.pull_of_norm(one, y[t], int(self.sequence[t]), eta[t])
            J[np.ix_(at[t], place)] -= pull * slopes.T


def _of(found: ModeJets, times: Indices, modes: Indices) -> tuple[Array, Array, Array]:
    values, slopes, curvatures = (
        np.stack([getattr(one, part) for one in found.f], axis=1)[times, modes]
        for part in ("values", "slopes", "curvatures")
    )
    return values, slopes, curvatures


def _bounded(v: Array, F: Array, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
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


def _borders(
    problem: OptimalControlProblem, trajectory: Trajectory, sequence: Indices, units: Array, near: float
) -> list[tuple[int, int, int]]:
    """Return (time, second mode, row) where a row of the first mode's region touches and the second holds, nearly."""
    T = problem.horizon
    found = problem.smooth_pieces.jets_at(np.hstack([trajectory.x[:T], trajectory.u]))
    defined = found.defined()

    def distances(mode: int, t: int) -> Array:
        region = found.regions[mode]
        sizes = np.linalg.norm(region.slopes[t] * units, axis=-1)
        return region.values[t] / np.where(sizes > 0, sizes, 1.0)

    borders: list[tuple[int, int, int]] = []
    for t in range(T):
        own = distances(int(sequence[t]), t)
        others = [
            mode
            for mode in np.flatnonzero(defined[t])
            if mode != sequence[t] and distances(int(mode), t).max(initial=-np.inf) <= near
        ]
        touching = np.flatnonzero(np.abs(own) <= near)
        if len(others) and len(touching):
            borders.append((t, int(others[0]), int(touching[0])))
    return borders


def _norms(problem: OptimalControlProblem, trajectory: Trajectory, near: float) -> list[tuple[Formula, int]]:
    T = problem.horizon
    y = np.hstack([trajectory.x[:T], trajectory.u])
    found: list[tuple[Formula, int]] = []
    for one in problem.smooth_pieces.norms:
        size = np.linalg.norm(jets(one.arguments, y).values, axis=1)
        found += [(one, int(t)) for t in np.flatnonzero(size <= near * max(1.0, float(size.max())))]
    return found


def _rows(stop: Mask, length: int, units: Array) -> tuple[Array, Array]:
    """Return the rows of the removed bins on a signal (length, components) raveled, and the units of their signals."""
    components = stop.shape[1]
    parts, sizes = [np.zeros((0, length * components))], [np.zeros(0)]
    for j in range(components):
        rows = real_rows(length, stop[:, j])
        placed = np.zeros((len(rows), length, components))
        placed[:, :, j] = rows
        parts.append(placed.reshape(len(rows), length * components))
        sizes.append(np.full(len(rows), units[j]))
    return np.vstack(parts), np.concatenate(sizes)
