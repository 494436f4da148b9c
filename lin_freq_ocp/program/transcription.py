"""A problem as a sparse quadratic or second-order cone program in x_0 .. x_T, u_0 .. u_{T-1}, and slacks of its terms.

    minimise    sum_t 1/2 x_t'Q x_t + 1/2 u_t'R u_t + x_t'S u_t + (linear terms) + 1/2 x_T'P x_T + p'x_T + (terms)
    DYNAMICS          x_{t+1} - A_t x_t - B_t u_t = d_t         dual eta_t
    STATE_SET         lower_t <= x_t <= upper_t                 dual mu_t   (bounded components only)
    CONTROL_SET       lower_t <= u_t <= upper_t                 dual nu_t
    STATE_SPECTRUM    R_i x^i = 0, rows of the DFT of N         dual rho, one real number a row
    CONTROL_SPECTRUM  R_j u^j = 0, rows of the DFT of T
    TERMS             every other term h(L(x, u)): v = L(x, u) with the conic form of h, and slacks with prices

The variables are deviations from the references x_ref, u_ref, so that a small cost is not the difference of large
numbers; the right-hand sides are shifted accordingly. Fixed ends are rows of STATE_SET with equal bounds: their dual is
mu_0, mu_T. Signs: P z + q + A'y = 0 with all duals y, so that eta, mu, nu, rho and the multipliers of the terms come
out as in the maximum principle. Frequency constraints are dense rows; their memory and time are estimated before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.resources import require_memory
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.program import Block, Program
from lin_freq_ocp.program.stop_band_rows import stop_band_multipliers, stop_band_rows

BYTES_PER_ENTRY = 100.0  # of a dense row at the peak, with indices during assembly and the scaled copies for solvers
BYTES_OF_FACTOR = 12.0  # per entry of a solver's factor: a value and an index
SECONDS_PER_ENTRY = 7.5e-7  # to make, scale and order dense rows, measured with Clarabel
SECONDS_PER_PRODUCT = 4e-10  # of one factorisation, measured with Clarabel: d^2 V for d dense rows and V variables
SECONDS_PER_VARIABLE = 5e-6  # of one factorisation without dense rows, or of measuring a point
LEAST_FACTORISATIONS = 5.0  # of an interior-point method


@dataclass(frozen=True, eq=False)
class LinearTranscription:
    """The program of a linear problem, with its own inverse for trajectories and multipliers."""

    problem: OptimalControlProblem

    @cached_property
    def program(self) -> Program:
        """Return the program in the problem's own units; UnsupportedError if it does not fit into memory."""
        problem, dense = self.problem, dense_rows(self.problem)
        require_memory(
            f"the frequency constraints, {dense.count} dense rows of a program of {dense.variables} variables,",
            dense.size,
            "Method 'spectral' needs no dense rows (time-invariant linear dynamics, quadratic costs, boxes, joint rows "
            "and stop bands; it says what it cannot take); else choose a shorter horizon or a longer sampling time.",
        )
        terms = self.conic_terms
        parts = {
            Block.DYNAMICS: self._dynamics_rows(),
            Block.STATE_SET: _box_rows(problem.state_tube, self._variables, 0),
            Block.CONTROL_SET: _box_rows(problem.control_tube, self._variables, self._states),
        }
        for block, stop, length, first in (
            (Block.STATE_SPECTRUM, problem.state_stop, problem.state_samples, 0),
            (Block.CONTROL_SPECTRUM, problem.control_stop, problem.horizon, self._states),
        ):
            matrix = stop_band_rows(stop, length, self._variables, first)
            parts[block] = matrix, np.zeros(matrix.shape[0]), np.zeros(matrix.shape[0])
        parts[Block.TERMS] = terms.matrix, terms.lower, terms.upper
        rows, count = dict[Block, slice](), 0
        for block, (matrix, *_) in parts.items():
            rows[block], count = slice(count, count + matrix.shape[0]), count + matrix.shape[0]
        matrices, lower, upper = zip(*parts.values(), strict=True)
        A, P = sp.csc_array(sp.vstack(matrices)), self._hessian()
        A.eliminate_zeros()
        P.eliminate_zeros()
        # in deviations from the references
        x, u = self._references
        gradient = [part.ravel() for part in problem.quadratic.gradient(x, u)]
        shift = A @ np.concatenate([x.ravel(), u.ravel(), np.zeros(terms.slacks)])
        first = rows[Block.TERMS].start
        return Program(
            P,
            np.concatenate([*gradient, terms.prices]),
            problem.quadratic.value(x, u),
            A,
            np.concatenate(lower) - shift,
            np.concatenate(upper) - shift,
            rows,
            tuple(slice(first + cone.start, first + cone.stop) for cone in terms.cones),
        )

    @cached_property
    def conic_terms(self) -> ConicTerms:
        """The rows, slacks and prices of the problem's terms."""
        return conic_terms(self.problem)

    def trajectory(self, z: Array) -> Trajectory:
        """Return (x, u) from a point of the program."""
        x, u = np.split(z[: self.signals], [self._states])
        x_ref, u_ref = self._references
        return Trajectory(x_ref + x.reshape(x_ref.shape), u_ref + u.reshape(u_ref.shape))

    def direction(self, z: Array) -> Trajectory:
        """Return the change (dx, du) of a change z of the point of the program."""
        x, u = np.split(z[: self.signals], [self._states])
        return Trajectory(x.reshape(-1, self.problem.state_dim), u.reshape(-1, self.problem.control_dim))

    def point(self, trajectory: Trajectory) -> Array:
        """Return the point of the program of a trajectory."""
        a, b = self.problem.quadratic.deviations(trajectory.x, trajectory.u)
        return np.concatenate([a.ravel(), b.ravel(), self.conic_terms.slacks_of(trajectory)])

    def multipliers(self, y: Array, eta_C: float) -> Multipliers:
        """Return the theorem's multipliers from the duals of all rows; eta_C = 0 for a Farkas ray."""
        problem, rows = self.problem, self.program.rows
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        mu, nu = np.zeros((T + 1, n)), np.zeros((T, m))
        mu[_bounded_components(problem.state_tube)] = y[rows[Block.STATE_SET]]
        nu[_bounded_components(problem.control_tube)] = y[rows[Block.CONTROL_SET]]
        return Multipliers(
            eta_C=eta_C,
            eta=y[rows[Block.DYNAMICS]].reshape(T, n),
            mu=mu,
            nu=nu,
            rho_u=stop_band_multipliers(problem.control_stop, T, y[rows[Block.CONTROL_SPECTRUM]]),
            rho_x=stop_band_multipliers(problem.state_stop, problem.state_samples, y[rows[Block.STATE_SPECTRUM]]),
            stage=self.conic_terms.multipliers(y[rows[Block.TERMS]]),
        )

    def column_units(self, state_units: Array, control_units: Array) -> Array:
        """Return one unit per variable from those of states, (n,) or (T+1, n), and of controls, (m,) or (T, m)."""
        T, n, m = self.problem.horizon, self.problem.state_dim, self.problem.control_dim
        steady = np.broadcast_to(state_units, (T + 1, n)), np.broadcast_to(control_units, (T, m))
        return np.concatenate([*(part.ravel() for part in steady), self.conic_terms.slack_units(*steady)])

    @property
    def signals(self) -> int:
        """Return how many variables are states and controls; slacks follow."""
        return self._states + self.problem.horizon * self.problem.control_dim

    @property
    def _references(self) -> tuple[Array, Array]:
        problem = self.problem
        x = np.broadcast_to(problem.quadratic.x_ref, (problem.horizon + 1, problem.state_dim))
        return x, np.broadcast_to(problem.quadratic.u_ref, (problem.horizon, problem.control_dim))

    @property
    def _states(self) -> int:
        return (self.problem.horizon + 1) * self.problem.state_dim

    @property
    def _variables(self) -> int:
        return self.signals + self.conic_terms.slacks

    def _dynamics_rows(self) -> tuple[sp.csc_array, Array, Array]:
        T, n = self.problem.horizon, self.problem.state_dim
        response = self.problem.dynamics.response(T)
        if response is not None:  # x_{t+1} is a sum over all controls
            through_u = response.matrix[n:]
            slacks = sp.csc_array((T * n, self.conic_terms.slacks))
            matrix = sp.hstack([sp.csc_array((T * n, n)), sp.eye_array(T * n), sp.csc_array(-through_u), slacks])
            return sp.csc_array(matrix), response.base[1:].ravel(), response.base[1:].ravel()
        dynamics = self.problem.linear
        offset = np.broadcast_to(dynamics.offset, (T, n)).ravel()
        parts = [(np.eye(n), 0, n), (-dynamics.A, 0, 0), (-dynamics.B, 0, self._states)]
        return _sparse_matrix([_block_diagonal(*part, T) for part in parts], (T * n, self._variables)), offset, offset

    def _hessian(self) -> sp.csc_array:
        cost, T, first = self.problem.quadratic, self.problem.horizon, self._states
        last = first - self.problem.state_dim
        parts = [
            _block_diagonal(cost.Q, 0, 0, T),
            _block_diagonal(cost.P, last, last, 1),
            _block_diagonal(cost.S, 0, first, T),
            _block_diagonal(np.swapaxes(cost.S, -1, -2), first, 0, T),
            _block_diagonal(cost.R, first, first, T),
        ]
        return _sparse_matrix(parts, (self._variables, self._variables))


def _block_diagonal(matrices: Array, row: int, column: int, times: int) -> tuple[Array, Indices, Indices]:
    """Return values, rows and columns of diag(M_0 .. M_{times-1}), one or one per time, from (row, column) on."""
    rows, columns = matrices.shape[-2:]
    i = row + np.arange(times * rows).reshape(times, rows, 1)
    j = column + np.arange(times * columns).reshape(times, 1, columns)
    blocks, i, j = np.broadcast_arrays(matrices, i, j)
    return blocks.ravel(), i.ravel(), j.ravel()


def _sparse_matrix(parts: Sequence[tuple[Array, Indices, Indices]], shape: tuple[int, int]) -> sp.csc_array:
    """Return the matrix of these entries: to join sparse matrices takes several times as long."""
    values, i, j = (np.concatenate(part) for part in zip(*parts, strict=True))
    return sp.csc_array((values, (i, j)), shape=shape)


def _bounded_components(tube: Box) -> Mask:
    return np.isfinite(tube.lower) | np.isfinite(tube.upper)


def _box_rows(tube: Box, columns: int, first: int) -> tuple[sp.csc_array, Array, Array]:
    bounded = _bounded_components(tube)
    chosen = np.flatnonzero(bounded.ravel())
    matrix = sp.csc_array(
        (np.ones(len(chosen)), (np.arange(len(chosen)), first + chosen)), shape=(len(chosen), columns)
    )
    return matrix, tube.lower[bounded], tube.upper[bounded]


@dataclass(frozen=True, eq=False)
class ConicTerms:
    """The rows of all terms of a problem, on the signals and all slacks."""

    parts: tuple[TermRows, ...]
    signals: int

    @property
    def slacks(self) -> int:
        """Return the number of slacks."""
        return sum(len(part.prices) for part in self.parts)

    @property
    def matrix(self) -> sp.csc_array:
        """Return the coefficients, (rows, signals + slacks)."""
        if not self.parts:
            return sp.csc_array((0, self.signals))
        of_signals = sp.vstack([part.signals for part in self.parts])
        return sp.csc_array(sp.hstack([of_signals, sp.block_diag([part.slacks for part in self.parts])]))

    @property
    def lower(self) -> Array:
        """Return the lower limits of the rows."""
        return _concatenate([part.lower for part in self.parts])

    @property
    def upper(self) -> Array:
        """Return the upper limits of the rows."""
        return _concatenate([part.upper for part in self.parts])

    @property
    def prices(self) -> Array:
        """Return the cost of one unit of each slack."""
        return _concatenate([part.prices for part in self.parts])

    @property
    def of_costs(self) -> Mask:
        """Return which slacks belong to nonsmooth costs: their prices give the size of the cost."""
        counts = [len(part.prices) for part in self.parts]
        return np.repeat(np.array([part.term.kind.is_cost for part in self.parts], dtype=bool), counts)

    @property
    def cones(self) -> list[slice]:
        """Return the rows of each second-order cone."""
        firsts = np.cumsum([0, *(len(part.lower) for part in self.parts)])
        return [
            slice(int(first) + cone.start, int(first) + cone.stop)
            for first, part in zip(firsts, self.parts, strict=False)
            for cone in part.cones
        ]

    def multipliers(self, y: Array) -> dict[str, Array]:
        """Return the multipliers of every term by its name, from the duals of all rows."""
        ends = np.cumsum([len(part.lower) for part in self.parts])
        pieces = np.split(y, ends[:-1]) if self.parts else []
        return {part.term.name: part.multipliers(piece) for part, piece in zip(self.parts, pieces, strict=True)}

    def slacks_of(self, trajectory: Trajectory) -> Array:
        """Return the slacks of a trajectory."""
        x, u = trajectory.x, trajectory.u
        return _concatenate([part.term.penalty.least_slacks(part.term.map.values(x, u)) for part in self.parts])

    def slack_units(self, x: Array, u: Array) -> Array:
        """Return one unit for each slack, with states and controls as large as x (T+1, n) and u (T, m)."""
        return _concatenate([part.slack_units(part.term.map.sizes(x, u)) for part in self.parts])


@dataclass(frozen=True, eq=False)
class TermRows:
    """The rows of one term, with coefficients of signals and slacks.

    ``entries`` (rows,) is the value of the term whose multiplier a row's dual is (-1: none); ``paid`` (slacks, k) the
    values whose violation each slack measures.
    """

    term: Term
    signals: sp.csr_array
    slacks: sp.csr_array
    lower: Array
    upper: Array
    cones: tuple[slice, ...]
    prices: Array
    entries: Indices
    paid: Indices

    def multipliers(self, y: Array) -> Array:
        """Return the multipliers of the term, (groups, dim), from the duals of its rows."""
        multipliers = np.zeros(self.term.shape)
        of_values = self.entries >= 0
        np.add.at(multipliers.reshape(-1), self.entries[of_values], y[of_values])
        return multipliers

    def slack_units(self, sizes: Array) -> Array:
        """Return one unit for each slack, from the sizes of the values (groups, dim)."""
        units = sizes.ravel()[self.paid].max(axis=1, initial=0.0)
        return np.where(units > 0, units, 1.0)


def conic_terms(problem: OptimalControlProblem) -> ConicTerms:
    """Return the rows of all terms."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    parts = tuple(term_rows(term, T, n, m) for term in problem.terms)
    return ConicTerms(parts, (T + 1) * n + T * m)


def term_rows(term: Term, horizon: int, n: int, m: int) -> TermRows:
    """Return the rows of one term; without the equations 0 = 0 that the real bins of a spectrum give."""
    (L, c), form = term.map.rows(horizon, n, m), term.penalty.conic(*term.shape)
    L = sp.csr_array(sp.vstack([L, sp.csr_array((1, L.shape[1]))]))  # a row of zeros, for -1
    c = np.append(c, 0.0)[form.entries]
    empty = np.diff(L.indptr)[form.entries] + np.diff(form.slacks.indptr) == 0
    kept = np.flatnonzero(~(empty & (form.lower == form.upper)))
    return TermRows(
        term,
        sp.csr_array(L[form.entries[kept]]),
        sp.csr_array(form.slacks[kept]),
        (form.lower - c)[kept],
        (form.upper - c)[kept],
        form.cones,
        form.prices,
        form.entries[kept],
        form.paid,
    )


def _concatenate(parts: Sequence[Array]) -> Array:
    return np.concatenate([np.zeros(0), *parts])


def dense_rows(problem: OptimalControlProblem) -> DenseRows:
    """Return the dense rows of stop bands, masks, energy bounds, and of a frequency response."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    of_u, of_x = 2 * int(problem.control_stop.sum()), 2 * int(problem.state_stop.sum())
    count, entries = of_u + of_x, of_u * T + of_x * (T + 1)
    if problem.dynamics.response(T) is not None:
        count, entries = count + T * n, entries + T * n * T * m
    for term in problem.terms:
        rows, size = term.map.dense_size
        count, entries = count + rows, entries + size
    return DenseRows(count, entries, (T + 1) * n + T * m)


@dataclass(frozen=True)
class DenseRows:
    """The numbers of dense rows, of their entries, and of the variables of the program."""

    count: int
    entries: int
    variables: int

    @property
    def size(self) -> float:
        """Return the bytes that the rows and their part of a factor take, estimated."""
        factor = self.count * (self.variables + self.count / 2)
        return BYTES_PER_ENTRY * self.entries + BYTES_OF_FACTOR * factor

    @property
    def factorisation_seconds(self) -> float:
        """Return the time of one factorisation, estimated."""
        return (SECONDS_PER_PRODUCT * self.count**2 + SECONDS_PER_VARIABLE) * self.variables

    @property
    def seconds(self) -> float:
        """Return the least time to an answer, estimated."""
        return SECONDS_PER_ENTRY * self.entries + LEAST_FACTORISATIONS * self.factorisation_seconds
