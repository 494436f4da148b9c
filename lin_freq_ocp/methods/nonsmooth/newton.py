"""A semismooth Newton method on the conditions of the maximum principle for piecewise-smooth dynamics.

Unknowns are x, u, eta, the frequency multipliers, and a selection for every kink, shared by x and u: at a border of two
modes the weight alpha in [0, 1] of the second, at a norm the vector xi. For every component v with bounds l <= v <= h,
F >= 0 at l, F <= 0 at h, and F = 0 between say, with the function of Fischer and Burmeister, nested as by Billups,

    phi(v - l, phi(h - v, -F)) = 0,    phi(a, b) = |(a, b)| - a - b,    where F is

    of x_t, u_t     the derivative of the Lagrangian without mu, nu, which then are -F
    of alpha_t      -s(x_t, u_t), the switching function of the first mode
    of eta_t        x_{t+1} - f_t(x_t, u_t); of frequency multipliers, the rows of the DFT
    of xi_t         xi - P(xi + q), the projection P onto the unit ball, q the arguments of the norm

Everything is in natural units. Steps solve the linearised equations, with the term of Levenberg and Marquardt where
these are singular, and are shortened until |Phi|^2 falls.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.problem.arrays import Array, ComplexArray, Indices, Mask
from lin_freq_ocp.problem.formula_jets import jets
from lin_freq_ocp.problem.formulas import Formula
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.piecewise_smooth import ModeJets
from lin_freq_ocp.problem.spectrum import time_signal
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transcription.linear import LinearTranscription
from lin_freq_ocp.transcription.real_rows import bin_multipliers, real_rows
from lin_freq_ocp.transcription.units import natural_scaling

NEAR_KINK = 1e-3
"""A border of modes, or the zero of a norm, this near in natural units gets a selection of its own."""

CONVERGED = 1e-12
"""|Phi| of equations of order 1 at which nothing is left to gain."""

SLOPE_SHARE, SHORTEST = 1e-4, 2.0**-14
"""Of the decrease that the slope promises, what a step must reach; the shortest step that is tried with one damping."""

SMALL_NORMALS = 1e-2
"""Weight at which multipliers of bounds are kept small where multipliers are fitted: others explain what they can."""

SINGULAR = 1e-13
"""Reciprocal condition number of the linearised equations below which a step is damped."""

DAMPINGS = (0.0, 1e-8, 1e-6, 1e-4, 1e-2)
"""Of the damping term, relative to |J|^2 |Phi|, one after the other until a step is found: it vanishes with the
residual, so that convergence stays fast."""

MOST_STEPS = 40


@dataclass(frozen=True, eq=False)
class NewtonRun:
    """Where Newton's method ended.

    Attributes
    ----------
    trajectory, multipliers
        With weights of modes.
    residuals : tuple of float
        |Phi| before the first step and after each.
    converged : bool
    """

    trajectory: Trajectory
    multipliers: Multipliers
    residuals: tuple[float, ...]
    converged: bool


def newton(
    problem: OptimalControlProblem,
    trajectory: Trajectory,
    multipliers: Multipliers | None,
    sequence: Indices,
    near: float = NEAR_KINK,
    most_steps: int = MOST_STEPS,
) -> NewtonRun:
    """Solve the conditions of the maximum principle from a point near to a solution.

    Parameters
    ----------
    multipliers : Multipliers or None
        eta, rho_u and rho_x are looked at, and weights if there are any. None: those that fit best, with normals to
        the bounds that are nearer than ``near``.
    sequence : (T,)
        The first mode at every time.
    near : float
        Kinks this near, in natural units, get a selection.

    Raises
    ------
    UnsupportedError
        If the problem has more than bounds, stop bands and a quadratic cost.
    """
    if problem.terms:
        raise UnsupportedError(f"{problem.terms[0].name}: the semismooth Newton method takes bounds and stop bands.")
    system = _System.of(problem, trajectory, sequence, near)
    runs: list[NewtonRun] = []
    for weights in ("of the side", "one half"):
        runs.append(_run(system, system.start(trajectory, multipliers, near, weights == "one half"), most_steps))
        if runs[-1].converged or multipliers is not None or not system.borders:
            break
    return min(runs, key=lambda run: run.residuals[-1])


def _run(system: _System, v: Array, most_steps: int) -> NewtonRun:
    state = system.at(v)
    residuals = [float(np.linalg.norm(state.phi))]
    while residuals[-1] > CONVERGED and len(residuals) <= most_steps:
        stepped = _stepped(system, v, state)
        if stepped is None:
            break
        v, state = stepped
        residuals.append(float(np.linalg.norm(state.phi)))
    found, multipliers = system.answer(v, state)
    return NewtonRun(found, multipliers, tuple(residuals), residuals[-1] <= 1e3 * CONVERGED)


def _stepped(system: _System, v: Array, state: _State) -> tuple[Array, _State] | None:
    """Return where a step leads with which |Phi|^2 falls, damped as little as possible; None: nowhere."""
    U, sizes, V = np.linalg.svd(state.slopes)
    gradient, along = state.slopes.T @ state.phi, U.T @ state.phi
    for damping in DAMPINGS:
        if not damping and sizes[-1] <= SINGULAR * sizes[0]:
            continue
        weight = damping * sizes[0] ** 2 * min(1.0, float(np.linalg.norm(state.phi)))
        step = -V.T @ (sizes / (sizes**2 + weight) * along)
        slope, length = float(gradient @ step), 1.0
        while length >= SHORTEST:
            after = system.at(v + length * step)
            if after.phi @ after.phi <= state.phi @ state.phi + 2 * SLOPE_SHARE * length * slope:
                return v + length * step, after
            length /= 2
    return None


@dataclass(frozen=True, eq=False)
class _State:
    phi: Array
    slopes: Array
    F: Array


@dataclass(frozen=True, eq=False)
class _System:
    """The equations, and where their unknowns stand.

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
    def of(cls, problem: OptimalControlProblem, trajectory: Trajectory, sequence: Indices, near: float) -> _System:
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

    def start(self, trajectory: Trajectory, multipliers: Multipliers | None, near: float, halved: bool) -> Array:
        """Return the unknowns, in natural units."""
        v = np.zeros(len(self.units))
        v[self.x], v[self.u] = trajectory.x, trajectory.u
        if multipliers is None:
            v[self.alpha] = 0.5 if halved else self._sides(trajectory)
            return self._fitted(v / self.units, near)
        v[self.eta] = multipliers.eta
        for place, rows, signal in (
            (self.rho_x, self.rows_x, time_signal(multipliers.rho_x, len(trajectory.x))),
            (self.rho_u, self.rows_u, time_signal(multipliers.rho_u, len(trajectory.u))),
        ):
            if len(place):
                v[place] = np.linalg.lstsq(rows.T, signal.ravel(), rcond=None)[0]
        for k, (t, second, _) in enumerate(self.borders):
            v[self.alpha[k]] = 0.5 if multipliers.weights is None else np.clip(multipliers.weights[t, second], 0, 1)
        return v / self.units

    def _sides(self, trajectory: Trajectory) -> Array:
        """Return 1 where a border is crossed, else 0."""
        T = self.problem.horizon
        found = self.problem.smooth_pieces.jets_at(np.hstack([trajectory.x[:T], trajectory.u]))
        crossed = [found.regions[self.sequence[t]].values[t, row] > 0 for t, _, row in self.borders]
        return np.array(crossed, dtype=float)

    def _fitted(self, v: Array, near: float) -> Array:
        """Return the unknowns with the multipliers of least squares."""
        F, J = self._equations(v * self.units)
        signals = np.concatenate([self.x.ravel(), self.u.ravel()])
        signals = signals[self.lower[signals] < self.upper[signals]]
        at_lower, at_upper = v[signals] <= self.lower[signals] + near, v[signals] >= self.upper[signals] - near
        pressed = np.flatnonzero(at_lower | at_upper)
        found = np.concatenate([self.eta.ravel(), self.rho_x, self.rho_u])
        slopes = self.scales[signals, None] * J[np.ix_(signals, found)] * self.units[found]
        normals = np.zeros((len(signals), len(pressed)))
        normals[pressed, np.arange(len(pressed))] = 1.0
        small = np.hstack([np.zeros((len(pressed), len(found))), SMALL_NORMALS * np.eye(len(pressed))])
        wanted = np.concatenate([-self.scales[signals] * F[signals], np.zeros(len(pressed))])
        free = np.full(len(found), np.inf)
        above = np.where(at_upper[pressed], np.inf, 0.0)
        below = np.where(at_lower[pressed], -np.inf, 0.0)
        bounds = np.append(-free, below), np.append(free, above)
        v[found] = lsq_linear(np.vstack([np.hstack([slopes, normals]), small]), wanted, bounds).x[: len(found)]
        return v

    def at(self, v: Array) -> _State:
        """Return Phi and an element of its generalised derivative."""
        F, derivative = self._equations(v * self.units)
        F, J = F * self.scales, derivative * self.scales[:, None] * self.units
        free, fixed = np.isinf(self.lower) & np.isinf(self.upper), self.lower == self.upper
        phi, by_v, by_F = _bounded(v, F, self.lower, self.upper)
        phi, by_v, by_F = np.where(free, F, phi), np.where(free, 0.0, by_v), np.where(free, 1.0, by_F)
        phi = np.where(fixed, v - np.where(fixed, self.lower, 0.0), phi)
        by_v, by_F = np.where(fixed, 1.0, by_v), np.where(fixed, 0.0, by_F)
        return _State(phi, np.diag(by_v) + by_F[:, None] * J, F)

    def answer(self, v: Array, state: _State) -> tuple[Trajectory, Multipliers]:
        """Return the trajectory and the multipliers of unknowns in natural units."""
        problem, values, F = self.problem, v * self.units, state.F / self.scales
        T = problem.horizon
        weights = np.zeros((T, len(problem.smooth_pieces.modes)))
        weights[np.arange(T), self.sequence] = 1.0
        for k, (t, second, _) in enumerate(self.borders):
            share = float(np.clip(values[self.alpha[k]], 0.0, 1.0))
            weights[t, self.sequence[t]], weights[t, second] = 1 - share, share
        x = np.clip(values[self.x], problem.state_tube.lower, problem.state_tube.upper)
        u = np.clip(values[self.u], problem.control_tube.lower, problem.control_tube.upper)
        mu, nu = (
            np.where(np.isfinite(box.lower) | np.isfinite(box.upper), -F[place], 0.0)
            for place, box in ((self.x, problem.state_tube), (self.u, problem.control_tube))
        )
        rho = [
            _bins(stop, length, values[place])
            for stop, length, place in ((problem.control_stop, T, self.rho_u), (problem.state_stop, T + 1, self.rho_x))
        ]
        return Trajectory(x, u), Multipliers(1.0, values[self.eta], mu, nu, rho[0], rho[1], None, weights)

    def _equations(self, v: Array) -> tuple[Array, Array]:
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


def _bins(stop: Mask, length: int, rho: Array) -> ComplexArray:
    """Return the multipliers of every bin, complex (bins, components)."""
    result, first = np.zeros(stop.shape, dtype=np.complex128), 0
    for j in range(stop.shape[1]):
        count = len(real_rows(length, stop[:, j]))
        result[:, j] = bin_multipliers(length, stop[:, j], rho[first : first + count])
        first += count
    return result
