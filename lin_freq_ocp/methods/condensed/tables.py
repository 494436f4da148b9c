"""A linear time-invariant problem in few unknowns: the tables of the condensed method (docs/condensed.md).

With u_t = K x_t + v_t and a stabilising feedback K, every map below is one of the stable loop, however unstable the
plant is. Stop bands and a fixed end are equations E v = e; their solutions are v = W (x_0, 1, xi), where the unknowns
xi have the cost 1/2 |xi|^2 + const. Sweeps have all columns of their arguments as a last axis.

Source: dense condensing with prestabilisation as in Rossiter, Kouvaritakis and Rice (1998); least-distance form as in
Lawson and Hanson, "Solving Least Squares Problems" (1974), chapter 23.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import fft
from scipy.linalg import solve_discrete_are, solve_triangular

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.spectral.model import Bounds, Lti
from lin_freq_ocp.methods.spectral.recovery import Recovered

RANK_TOLERANCE = 1e-11
"""Singular values of the equations below this part of the largest count as zero: the equations then depend on each
other up to the rounding of their coefficients."""

RIGHT_SIDE_ROUNDING = 1e-9  # of dependent equations, relative to their coefficients: beyond it they contradict each other

DEFINITE = 1e-12
"""Least eigenvalue of the Hessian, relative to the largest, of a cost that is strictly convex in the unknowns."""

SMALL_WEIGHT = 1e-6  # of the feedback's cost, relative to the mean weight, where the problem has none

TOLERANCE = 1e-9  # of a row's value, relative to the largest bound of its family
ROUNDING = 100  # a dependent row that is violated by this many tolerances contradicts the active ones
DEPENDENT = 1e-7  # a gradient with less than this part of its length outside of the active ones depends on them
SOLVED, LIMIT, INFEASIBLE = range(3)  # statuses of a step

MOST_UNKNOWNS = 600  # controls times steps: the tables grow with the square of it, and the set-up with the cube


def refusal(lti: Lti) -> str | None:
    """Return why a problem of the Fourier-domain method is not one of the condensed method, or None."""
    if lti.response is not None or lti.periodic:
        return "it needs a recursion and ends that are not linked"
    if np.isnan(lti.start).any():
        return "the initial state is not fixed"
    if lti.state_stop.any():
        return "stop bands of states are equations of too many unknowns"
    if lti.horizon * lti.control_dim > MOST_UNKNOWNS:
        return f"{lti.horizon * lti.control_dim} controls in all; it takes {MOST_UNKNOWNS}"
    return None


@dataclass(frozen=True, eq=False)
class Loop:
    """The loop x_{t+1} = (A + B K) x_t + B v_t + d_t with the cost and the equations of a problem."""

    lti: Lti
    K: Array  # (m, n)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Return T, n, m."""
        return self.lti.horizon, self.lti.state_dim, self.lti.control_dim

    @cached_property
    def A(self) -> Array:
        """A + B K."""
        return self.lti.A + self.lti.B @ self.K

    @cached_property
    def fixed_end(self) -> Indices:
        """The components of x_T that are fixed."""
        return np.flatnonzero(~np.isnan(self.lti.end))

    def simulate(self, x_0: Array, v: Array, data: Array | float = 1.0) -> tuple[Array, Array]:
        """Return x (T+1, n, k) and u (T, m, k) of x_0 (n, k) and v (T, m, k), with the offset times ``data`` (k,)."""
        (T, n, _), x, u = self.shape, np.empty((len(v) + 1, *x_0.shape)), v.copy()
        x[0], offset = x_0, self.lti.offset
        for t in range(T):
            x[t + 1] = self.A @ x[t] + self.lti.B @ v[t]
            if offset is not None:
                x[t + 1] += offset[:, t, None] * data
            u[t] += self.K @ x[t]
        return x, u

    def slopes(self, x: Array, u: Array, data: Array | float = 1.0) -> tuple[Array, Array]:
        """Return the slopes of the cost in all states and controls, with linear terms times ``data``."""
        lti, (T, n, _) = self.lti, self.shape
        inner = lti.M @ np.concatenate([x[:T], u], axis=1)
        if lti.linear is not None:
            inner += lti.linear.T[:, :, None] * data
        last = lti.P @ x[T] + lti.p[:, None] * data
        return np.concatenate([inner[:, :n], last[None]]), inner[:, n:]

    def adjoint(self, in_x: Array, in_u: Array) -> Array:
        """Return eta (T, n, k) with eta_{t-1} = A'eta_t - (slopes in x_t and K u_t), and eta_{T-1} = -slope in x_T."""
        total, eta = in_x.copy(), np.empty((len(in_u), *in_x.shape[1:]))
        total[:-1] += self.K.T @ in_u
        eta[-1] = -total[-1]
        for t in range(len(in_u) - 1, 0, -1):
            eta[t - 1] = self.A.T @ eta[t] - total[t]
        return eta

    def gradient(self, in_x: Array, in_u: Array) -> Array:
        """Return the slopes in v, (T, m, k), of the slopes in x and u."""
        return in_u - self.lti.B.T @ self.adjoint(in_x, in_u)

    def equations(self, x: Array, u: Array, data: Array | float = 1.0) -> Array:
        """Return the violations of the stop bands, by orthonormal rows, and of the fixed end, (equations, k)."""
        bins, found = fft.rfft(u, axis=0) / np.sqrt(len(u) / 2), list[Array]()
        for j, passed in enumerate(self.lti.passed):
            stopped = np.flatnonzero(~passed)
            real = (stopped == 0) | (2 * stopped == len(u))
            of_bins = bins[stopped, j]
            found += [of_bins.real * np.where(real, np.sqrt(0.5), 1.0)[:, None], of_bins.imag[~real]]
        end = self.fixed_end
        return np.concatenate([*found, x[-1][end] - self.lti.end[end][:, None] * data])


@dataclass(frozen=True, eq=False)
class Tables:
    """A problem of the condensed method, for every initial state."""

    loop: Loop
    V: Array  # v of the unknowns, (T m, r)
    W: Array  # v of (x_0, 1), (T m, n + 1)
    solve_equations: Array  # of E v = e: v of e, (T m, equations)
    families: Indices  # the rows of F with a bound
    bounds: tuple[Array, Array]  # lower and upper, (families, T+1)
    limits: tuple[Array, Array]  # of their multipliers: the prices

    @property
    def unknowns(self) -> int:
        """Return how many unknowns there are."""
        return self.V.shape[1]

    @property
    def most_changes(self) -> int:
        """Return the most changes of the working set in one step."""
        return 20 * (self.unknowns + 20)

    @cached_property
    def C(self) -> Array:
        """Coefficients of the rows in x_t, (families, n)."""
        return self.loop.lti.F[self.families, : self.loop.shape[1]]

    @cached_property
    def D(self) -> Array:
        """Coefficients of the rows in u_t, (families, m)."""
        return self.loop.lti.F[self.families, self.loop.shape[1] :]

    @cached_property
    def sizes(self) -> Array:
        """Largest finite bound of each family, (families,); 1 without one."""
        both = np.stack([np.where(np.isfinite(side), np.abs(side), 0.0).max(axis=1) for side in self.bounds])
        largest = both.max(axis=0)
        return np.where(largest > 0, largest, 1.0)

    def with_data(self, lti: Lti) -> Tables | None:
        """Return the tables of a problem with other references, offsets, end and bounds; None if others are bounded."""
        families, bounds, limits = _bounds(lti)
        if not np.array_equal(families, self.families):
            return None
        changed, W = replace(self, loop=replace(self.loop, lti=lti)), self.W.copy()
        W[:, -1:] = changed.centers(np.zeros((len(lti.A), 1)), np.ones(1))
        return replace(changed, W=W, bounds=bounds, limits=limits)

    def centers(self, x_0: Array, data: Array) -> Array:
        """Return v of least cost on the equations, (T m, k), for x_0 (n, k) and the data times numbers (k,)."""
        loop, (T, _, m), count = self.loop, self.loop.shape, len(data)

        def signals(v: Array) -> tuple[Array, Array]:
            return loop.simulate(x_0, v.reshape(T, m, count), data)

        v = -self.solve_equations @ loop.equations(*signals(np.zeros((T * m, count))), data)
        slope = loop.gradient(*loop.slopes(*signals(v), data)).reshape(T * m, count)
        return v - self.V @ (self.V.T @ slope)

    def row_values(self, x: Array, v: Array) -> Array:
        """Return C x_t + D u_t of all families, (families, T+1, k), for x (T+1, n, k) and v (T, m, k)."""
        y = np.moveaxis(self.C @ x, 0, 1)
        y[:, :-1] += np.moveaxis(self.D @ (v + self.loop.K @ x[:-1]), 0, 1)
        return y

    def recover(self, x_0: Array, v: Array, weights: Array) -> tuple[Array, Array, Recovered]:
        """Return x (T+1, n), u (T, m) and the multipliers, from those of the rows, (families, T+1)."""
        loop, lti, (T, n, m) = self.loop, self.loop.lti, self.loop.shape
        x, u = loop.simulate(x_0[:, None], v.reshape(T, m, 1))
        in_x, in_u = loop.slopes(x, u)
        in_x += (weights.T @ self.C)[:, :, None]
        in_u += (weights[:, :-1].T @ self.D)[:, :, None]
        on_equations = -self.solve_equations.T @ loop.gradient(in_x, in_u).reshape(T * m, 1)
        band, on_end = self._forces(on_equations)
        at_end = in_x.copy()
        at_end[-1, loop.fixed_end] += on_end
        eta = loop.adjoint(at_end, in_u + band)[:, :, 0]
        spectrum = fft.rfft(eta @ lti.B - in_u[:, :, 0], axis=0).T
        missed = np.where(lti.passed, spectrum, 0.0)
        on_rows = np.zeros((len(lti.F), T + 1))
        on_rows[self.families] = weights
        on_rows[:n, 0] += eta[0] @ lti.A - in_x[0, :, 0]
        on_rows[loop.fixed_end, T] = on_end[:, 0]
        stationarity = float(np.abs(missed).max(initial=0.0)) / T
        none = np.zeros(lti.state_stop.shape, dtype=np.complex128)
        return x[:, :, 0], u[:, :, 0], Recovered(1.0, eta.T, on_rows, spectrum - missed, stationarity, none)

    def _forces(self, multipliers: Array) -> tuple[Array, Array]:
        """Return the forces of multipliers of the equations on all controls, (T, m, 1), and those on the fixed end."""
        loop, (T, _, m), first = self.loop, self.loop.shape, 0
        spectrum = np.zeros((T // 2 + 1, m, 1), dtype=np.complex128)
        for j, passed in enumerate(loop.lti.passed):
            stopped = np.flatnonzero(~passed)
            real = (stopped == 0) | (2 * stopped == T)
            parts = np.split(multipliers[first:], np.cumsum([len(stopped), int((~real).sum())]))[:2]
            spectrum[stopped, j] = parts[0] * np.where(real, np.sqrt(2.0), 1.0)[:, None]
            spectrum[stopped[~real], j] += 1j * parts[1]
            first += len(parts[0]) + len(parts[1])
        return fft.irfft(spectrum * np.sqrt(T / 2), T, axis=0), multipliers[first:]


def condense(lti: Lti) -> Tables:
    """Return the tables of a problem; UnsupportedError, with the reason, if the method does not take it."""
    reason = refusal(lti)
    if reason is not None:
        raise UnsupportedError(f"method 'condensed': {reason}.")
    loop = Loop(lti, stabilising_feedback(lti))
    T, n, m = loop.shape
    x, u = loop.simulate(np.zeros((n, T * m)), np.eye(T * m).reshape(T, m, -1), 0.0)
    E, hessian = loop.equations(x, u, 0.0), loop.gradient(*loop.slopes(x, u, 0.0)).reshape(T * m, -1)
    solve_equations, Z = _solve_equations(loop, E)
    in_unknowns = Z.T @ hessian @ Z
    in_unknowns = (in_unknowns + in_unknowns.T) / 2
    values = np.linalg.eigvalsh(in_unknowns)
    if not len(values) or not values[0] > DEFINITE * values[-1]:
        raise UnsupportedError("method 'condensed': the cost is not strictly convex in the controls that bands and ends leave.")
    L = np.linalg.cholesky(in_unknowns)
    V = solve_triangular(L, Z.T, lower=True).T
    families, bounds, limits = _bounds(lti)
    tables = Tables(loop, V, np.zeros((T * m, n + 1)), solve_equations, families, bounds, limits)
    return replace(tables, W=tables.centers(np.eye(n, n + 1), np.eye(n + 1)[-1]))


def stabilising_feedback(lti: Lti) -> Array:
    """Return K (m, n) of the linear-quadratic regulator u = K x of the stage cost, with small weights in place of none."""
    n, m = lti.state_dim, lti.control_dim
    Q, R = lti.M[:n, :n], lti.M[n:, n:]
    size = max(float(np.trace(Q)) / n, SMALL_WEIGHT * float(np.trace(R)) / m)
    Q = Q + SMALL_WEIGHT * size * np.eye(n)
    R = R + SMALL_WEIGHT * max(float(np.trace(R)) / m, size) * np.eye(m)
    try:
        value = solve_discrete_are(lti.A, lti.B, Q, R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise UnsupportedError(f"method 'condensed': no feedback stabilises the dynamics ({error}).") from None
    return -np.linalg.solve(R + lti.B.T @ value @ lti.B, lti.B.T @ value @ lti.A)


def _solve_equations(loop: Loop, E: Array) -> tuple[Array, Array]:
    """Return v of the right-hand sides, (T m, equations), and an orthonormal basis of the solutions of E v = 0."""
    if not len(E):
        return np.zeros((E.shape[1], 0)), np.eye(E.shape[1])
    left, sigma, right = np.linalg.svd(E, full_matrices=True)
    rank = int((sigma > RANK_TOLERANCE * sigma[0]).sum())
    if rank < len(E):
        T, n, m = loop.shape
        alone = loop.equations(*loop.simulate(np.eye(n, n + 1), np.zeros((T, m, n + 1)), np.eye(n + 1)[-1]), np.eye(n + 1)[-1])
        contradiction = np.abs(left[:, rank:].T @ alone).max(initial=0.0)
        if contradiction > RIGHT_SIDE_ROUNDING * max(float(np.abs(alone).max()), sigma[0]):
            raise UnsupportedError("method 'condensed': stop bands and end contradict each other for some initial states.")
    return (right[:rank].T / sigma[:rank]) @ left[:, :rank].T, right[rank:].T


def _bounds(lti: Lti) -> tuple[Indices, tuple[Array, Array], tuple[Array, Array]]:
    """Return the rows of F with a bound after x_0, their bounds and the limits of their multipliers, (families, T+1)."""
    n, prices = lti.state_dim, lti.prices
    hard = Bounds(*(np.full(part.shape, np.inf) for part in (lti.bounds.lower, lti.bounds.upper)), *np.full((2, n), np.inf))

    def over_all_times(inner: Array, last: Array, none: float) -> Array:
        values = np.hstack([inner, np.full((len(inner), 1), none)])
        values[:n, 0], values[:n, -1] = none, last
        return values

    lower = over_all_times(lti.bounds.lower, lti.bounds.last_lower, -np.inf)
    upper = over_all_times(lti.bounds.upper, lti.bounds.last_upper, np.inf)
    fixed = np.flatnonzero(~np.isnan(lti.end))
    lower[fixed, -1], upper[fixed, -1] = -np.inf, np.inf
    of = hard if prices is None else prices
    limits = over_all_times(of.lower, of.last_lower, np.inf), over_all_times(of.upper, of.last_upper, np.inf)
    families = np.flatnonzero((np.isfinite(lower) | np.isfinite(upper)).any(axis=1))
    return families, (lower[families], upper[families]), (limits[0][families], limits[1][families])
