"""A linear time-invariant problem in few unknowns: the tables of the condensed method (docs/condensed.md).

With u_t = K x_t + v_t and a stabilising feedback K, every map below is one of the stable loop, however unstable the
plant is. Stop bands and a fixed end are equations E v = e; their solutions are v = W (x_0, 1, xi), where the unknowns
xi have the cost 1/2 |xi|^2 + const.

Source: dense condensing with prestabilisation as in Rossiter, Kouvaritakis and Rice (1998); least-distance form as in
Lawson and Hanson, "Solving Least Squares Problems" (1974), chapter 23.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_discrete_are, solve_triangular

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.spectral.model import Lti
from lin_freq_ocp.methods.structured.kkt.recursions import simulate, simulation_matrix
from lin_freq_ocp.program.program_rows import real_rows

EQUATION_RANK = 1e-11
"""Singular values of the equations below this part of the largest count as zero: the equations then depend on each
other up to the rounding of their coefficients."""

RIGHT_SIDE_ROUNDING = 1e-9  # of dependent equations, relative to their coefficients: above it they are contradictory

DEFINITE = 1e-12
"""Least eigenvalue of the Hessian, relative to the largest, of a cost that is strictly convex in the unknowns."""

SMALL_WEIGHT = 1e-6  # of the feedback's cost, relative to the mean weight, where the problem has none

ROW_TOLERANCE = 1e-9  # of a row's value, relative to the size of its family
GRADIENT_DEPENDENCE = 1e-7  # a gradient with less than this part of its length outside the active ones depends on them
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
    """The loop x_{t+1} = (A + B K) x_t + B v_t + d_t with the cost and the equations of a problem.

    Signals x (T+1, k, n), u and v (T, k, m) hold k trajectories; ``data`` (k,) are factors of offsets, linear costs and
    fixed ends: 1 for a trajectory, 0 for a change of one.
    """

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

    @cached_property
    def matrix(self) -> Array:
        """The banded matrix of the recursion over all stages."""
        return simulation_matrix(np.broadcast_to(self.A, (self.lti.horizon + 1, *self.A.shape)), np.arange(0))

    @cached_property
    def stop_rows(self) -> list[Array]:
        """The orthonormal rows of the stop bands of each control, (rows, T)."""
        return [real_rows(self.lti.horizon, ~passed) for passed in self.lti.passed]

    def plans(self, v: Array) -> Array:
        """Return controls (T, k, m) from flat ones, (T m, k)."""
        T, _, m = self.shape
        return v.reshape(T, m, -1).swapaxes(1, 2)

    def simulate(self, x_0: Array, v: Array, data: Array) -> tuple[Array, Array]:
        """Return x and u of x_0 (k, n) and v (T, k, m)."""
        right = np.empty((len(v) + 1, *x_0.shape))
        right[0], right[1:] = x_0, _product(v, self.lti.B.T)
        if self.lti.offset is not None:
            right[1:] += self.lti.offset.T[:, None] * data[:, None]
        x = simulate(self.matrix, right.swapaxes(1, 2), False).swapaxes(1, 2)
        return x, v + _product(x[:-1], self.K.T)

    def slopes(self, x: Array, u: Array, data: Array) -> tuple[Array, Array]:
        """Return the slopes of the cost in all states and controls."""
        lti, (T, n, _) = self.lti, self.shape
        inner = _product(np.concatenate([x[:T], u], axis=2), lti.M)
        if lti.linear is not None:
            inner += lti.linear.T[:, None] * data[:, None]
        last = x[T] @ lti.P + lti.p * data[:, None]
        return np.concatenate([inner[..., :n], last[None]]), inner[..., n:]

    def adjoint(self, in_x: Array, in_u: Array) -> Array:
        """Return eta (T, k, n): eta_{t-1} = A'eta_t - (slope in x_t) - K'(slope in u_t), eta_{T-1} = -slope in x_T."""
        right = in_x.copy()
        right[:-1] += _product(in_u, self.K)
        return -simulate(self.matrix, right.swapaxes(1, 2), True).swapaxes(1, 2)[1:]

    def gradient(self, in_u: Array, eta: Array) -> Array:
        """Return the slopes in v, flat, (T m, k), of the slopes in u and their adjoint."""
        slope = in_u - _product(eta, self.lti.B)
        return slope.swapaxes(1, 2).reshape(-1, slope.shape[1])

    def equations(self, x: Array, u: Array, data: Array) -> Array:
        """Return the violations of the stop bands, by orthonormal rows, and of the fixed end, (equations, k)."""
        end, on_u = self.fixed_end, [rows @ u[..., j] for j, rows in enumerate(self.stop_rows)]
        return np.concatenate([*on_u, (x[-1][:, end] - self.lti.end[end] * data[:, None]).T])

    def forces(self, multipliers: Array) -> tuple[Array, Array]:
        """Return the forces of multipliers of the equations, (equations, k): on u (T, k, m), and on the fixed end."""
        *on_rows, on_end = np.split(multipliers, np.cumsum([len(rows) for rows in self.stop_rows]))
        on_u = [rows.T @ weights for rows, weights in zip(self.stop_rows, on_rows, strict=True)]
        return np.stack(on_u, axis=2), on_end.T


def _product(signals: Array, M: Array) -> Array:
    """Return signals (T, k, n) times a matrix, as one product: NumPy would take one for each time."""
    T, k, n = signals.shape
    return (signals.reshape(T * k, n) @ M).reshape(T, k, M.shape[1])


@dataclass(frozen=True, eq=False)
class RecoveredPlans:
    """k points with multipliers in the units of the problem; ``band`` is the spectrum of the stop bands' forces."""

    x: Array  # (T+1, k, n)
    u: Array  # (T, k, m)
    eta: Array  # (T, k, n)
    on_rows: Array  # of F, (rows, T+1, k)
    band: ComplexArray  # (bins, k, m)


@dataclass(frozen=True, eq=False)
class CondensedTables:
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
        """Units of the tolerances of the families, (families,): their largest bounds, at most the unit of the signal.

        A bound of 1e9 units stands for none, and allows no more than others.
        """
        largest = np.max([np.where(np.isfinite(side), np.abs(side), 0.0).max(axis=1) for side in self.bounds], axis=0)
        return np.where(largest > 0, np.minimum(largest, 1.0), 1.0)

    def with_data(self, lti: Lti) -> CondensedTables | None:
        """Return the tables with other references, offsets, ends and bounds; None if other rows are bounded."""
        families, bounds, limits = _bounds(lti)
        if not np.array_equal(families, self.families):
            return None
        changed, W = replace(self, loop=replace(self.loop, lti=lti)), self.W.copy()
        W[:, -1:] = changed.centers(np.zeros((1, len(lti.A))), np.ones(1))
        return replace(changed, W=W, bounds=bounds, limits=limits)

    def centers(self, x_0: Array, data: Array) -> Array:
        """Return v of least cost on the equations, (T m, k), for x_0 (k, n) and the data times numbers (k,)."""
        loop = self.loop
        at_zero = loop.simulate(x_0, loop.plans(np.zeros((len(self.V), len(data)))), data)
        v = -self.solve_equations @ loop.equations(*at_zero, data)
        in_x, in_u = loop.slopes(*loop.simulate(x_0, loop.plans(v), data), data)
        return v - self.V @ (self.V.T @ loop.gradient(in_u, loop.adjoint(in_x, in_u)))

    def row_values(self, v: Array, x_0: Array, data: Array) -> Array:
        """Return C x_t + D u_t of all families at all times, (families (T+1), k), of v (T m, k) from x_0 (k, n)."""
        x, u = self.loop.simulate(x_0, self.loop.plans(v), data)
        y = x @ self.C.T
        y[:-1] += u @ self.D.T
        return np.moveaxis(y, 2, 0).reshape(len(self.families) * len(y), len(data))

    def worth(self, x_0: Array, v: Array) -> tuple[float, float]:
        """Return the violation and the cost of a plan v (T m,) from x_0 (n,), prices of soft rows included.

        The violation is the largest of a hard row, relative to its size, and of a stop band or end, relative to that of
        the controls.
        """
        loop, T, data = self.loop, self.loop.shape[0], np.ones(1)
        x, u = loop.simulate(x_0[None], loop.plans(v[:, None]), data)
        slopes, squares = loop.slopes(x, u, data), loop.slopes(x, u, 0 * data)  # M y + h, M y
        cost = sum(float((y * (a - 0.5 * b)).sum()) for y, a, b in zip((x, u), slopes, squares, strict=True))
        y = np.moveaxis(x @ self.C.T, 2, 0)[..., 0]
        y[:, :T] += (u @ self.D.T)[:, 0].T
        size = max(float(np.linalg.norm(u)), float(np.finfo(np.float64).tiny))
        violation = float(np.linalg.norm(loop.equations(x, u, data))) / size
        for beyond, limit in zip((self.bounds[0] - y, y - self.bounds[1]), self.limits, strict=True):
            over, hard = np.maximum(beyond, 0.0), np.isinf(limit)
            violation = max(violation, float((np.where(hard, over, 0.0) / self.sizes[:, None]).max(initial=0.0)))
            cost += float((over[~hard] * limit[~hard]).sum())
        return violation, cost

    def recover(
        self, x_0: Array, v: Array, weights: Array, eta_C: float = 1.0, forces: Array | float = 0.0
    ) -> RecoveredPlans:
        """Return the points of x_0 (k, n) and v (T m, k) with their multipliers, from those of the rows.

        ``weights`` are the multipliers of the rows, (families, T+1, k), above zero at upper bounds. With eta_C = 0 they
        are multiples of constraints alone. ``forces`` are those of other constraints on the controls, (T, k, m).
        """
        loop, lti, (T, n, _), data = self.loop, self.loop.lti, self.loop.shape, np.ones(len(x_0))
        x, u = loop.simulate(x_0, loop.plans(v), data)
        in_x, in_u = (eta_C * slope for slope in loop.slopes(x, u, data))
        at_rows = weights.transpose(1, 2, 0)
        in_x += _product(at_rows, self.C)
        in_u += _product(at_rows[:-1], self.D) + forces
        on_rows, band = np.zeros((len(lti.F), *weights.shape[1:])), np.zeros((T // 2 + 1, *in_u.shape[1:]), complex)
        on_rows[self.families] = weights
        eta = loop.adjoint(in_x, in_u)
        if self.solve_equations.size:  # of stop bands and a fixed end
            on_u, on_end = loop.forces(-self.solve_equations.T @ loop.gradient(in_u, eta))
            in_x[-1][:, loop.fixed_end] += on_end
            on_rows[loop.fixed_end, T] = on_end.T
            eta = loop.adjoint(in_x, in_u + on_u)
        if not lti.passed.all():
            spectrum = np.fft.rfft(_product(eta, lti.B) - in_u, axis=0)
            band = np.where(lti.passed.T[:, None], 0.0, spectrum)
        on_rows[:n, 0] += (eta[0] @ lti.A - in_x[0]).T
        return RecoveredPlans(x, u, eta, on_rows, band)


def condense(lti: Lti) -> CondensedTables:
    """Return the tables of a problem; UnsupportedError, with the reason, if the method does not take it."""
    reason = refusal(lti)
    if reason is not None:
        raise UnsupportedError(f"method 'condensed': {reason}.")
    loop = Loop(lti, stabilising_feedback(lti))
    T, n, m = loop.shape
    none = np.zeros(T * m)
    x, u = loop.simulate(np.zeros((T * m, n)), loop.plans(np.eye(T * m)), none)
    in_x, in_u = loop.slopes(x, u, none)
    E, hessian = loop.equations(x, u, none), loop.gradient(in_u, loop.adjoint(in_x, in_u))
    solve_equations, Z = _solve_equations(loop, E)
    in_unknowns = Z.T @ hessian @ Z
    in_unknowns = (in_unknowns + in_unknowns.T) / 2
    values = np.linalg.eigvalsh(in_unknowns)
    if not len(values) or not values[0] > DEFINITE * values[-1]:
        fault = "it is not strictly convex in the controls that stop bands and ends leave; R > 0 suffices"
        raise UnsupportedError(f"method 'condensed': cost: {fault}.")
    L = np.linalg.cholesky(in_unknowns)
    V = solve_triangular(L, Z.T, lower=True).T
    families, bounds, limits = _bounds(lti)
    tables = CondensedTables(loop, V, np.zeros((T * m, n + 1)), solve_equations, families, bounds, limits)
    return replace(tables, W=tables.centers(np.eye(n + 1, n), np.eye(n + 1)[-1]))


def stabilising_feedback(lti: Lti) -> Array:
    """Return K (m, n) of the regulator u = K x of the stage cost, with small weights in place of none."""
    n, m = lti.state_dim, lti.control_dim
    Q, R = lti.M[:n, :n], lti.M[n:, n:]
    size = max(float(np.trace(Q)) / n, SMALL_WEIGHT * float(np.trace(R)) / m)
    Q = Q + SMALL_WEIGHT * size * np.eye(n)
    R = R + SMALL_WEIGHT * max(float(np.trace(R)) / m, size) * np.eye(m)
    try:
        value = solve_discrete_are(lti.A, lti.B, Q, R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise UnsupportedError(f"method 'condensed': dynamics: no feedback stabilises them ({error}).") from None
    return np.asarray(-np.linalg.solve(R + lti.B.T @ value @ lti.B, lti.B.T @ value @ lti.A), dtype=np.float64)


def _solve_equations(loop: Loop, E: Array) -> tuple[Array, Array]:
    """Return v of the right-hand sides, (T m, equations), and an orthonormal basis of the solutions of E v = 0."""
    if not len(E):
        return np.zeros((E.shape[1], 0)), np.eye(E.shape[1])
    left, sigma, right = np.linalg.svd(E, full_matrices=True)
    rank = int((sigma > EQUATION_RANK * sigma[0]).sum())
    if rank < len(E):
        n, data = loop.shape[1], np.eye(loop.shape[1] + 1)[-1]
        still = loop.plans(np.zeros((E.shape[1], n + 1)))
        alone = loop.equations(*loop.simulate(np.eye(n + 1, n), still, data), data)
        contradiction = np.abs(left[:, rank:].T @ alone).max(initial=0.0)
        if contradiction > RIGHT_SIDE_ROUNDING * max(float(np.abs(alone).max()), sigma[0]):
            what = "control_spectrum, terminal_state: they contradict each other for some initial states"
            raise UnsupportedError(f"method 'condensed': {what}.")
    return (right[:rank].T / sigma[:rank]) @ left[:, :rank].T, right[rank:].T


def _bounds(lti: Lti) -> tuple[Indices, tuple[Array, Array], tuple[Array, Array]]:
    """Return the rows of F with a bound after x_0, their bounds and limits of multipliers, (families, T+1)."""
    n, of = lti.state_dim, lti.prices

    def over_all_times(inner: Array, last: Array, none: float) -> Array:
        values = np.hstack([inner, np.full((len(inner), 1), none)])
        values[:n, 0], values[:n, -1] = none, last
        return values

    lower = over_all_times(lti.bounds.lower, lti.bounds.last_lower, -np.inf)
    upper = over_all_times(lti.bounds.upper, lti.bounds.last_upper, np.inf)
    fixed = np.flatnonzero(~np.isnan(lti.end))
    lower[fixed, -1], upper[fixed, -1] = -np.inf, np.inf
    limits = over_all_times(of.lower, of.last_lower, np.inf), over_all_times(of.upper, of.last_upper, np.inf)
    families = np.flatnonzero((np.isfinite(lower) | np.isfinite(upper)).any(axis=1))
    return families, (lower[families], upper[families]), (limits[0][families], limits[1][families])
