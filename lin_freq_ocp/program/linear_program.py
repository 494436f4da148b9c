"""A problem with linear dynamics as a linear program: dynamics, cost, rows, slacks, and the way back.

    minimise    sum_t 1/2 x_t'Q x_t + 1/2 u_t'R u_t + x_t'S u_t + (linear terms) + 1/2 x_T'P x_T + p'x_T + prices's
    DYNAMICS          x_{t+1} - A_t x_t - B_t u_t = d_t         dual eta_t
    STATE_SET         lower_t <= x_t <= upper_t                 dual mu_t   (bounded components only)
    CONTROL_SET       lower_t <= u_t <= upper_t                 dual nu_t
    STATE_SPECTRUM    R_i x^i = 0, rows of the DFT of N         dual rho, one real number a row
    CONTROL_SPECTRUM  R_j u^j = 0, rows of the DFT of T
    TERMS             every other term h(L(x, u)): v = L(x, u) with the conic form of h, and slacks s with prices

The variables are deviations from an origin, so that a small cost is not the difference of large numbers. Unless another
is given, it is that of the references x_ref, u_ref, as near as bounds and dynamics let a state come to them, and of the
slacks that nothing avoids. Fixed ends are rows of STATE_SET with equal bounds: their dual is mu_0, mu_T. Signs:
P z + q + A'y = 0 with all duals y, so that eta, mu, nu, rho and the multipliers of the terms come out as in the maximum
principle.

The rows have two forms. ``sparse`` is one matrix over x_0 .. x_T, u_0 .. u_{T-1}, and the slacks, for solvers of other
projects; frequency constraints are dense rows there, whose memory and time are estimated before. The structured method
makes stages of the same rows (methods/structured/assembly.py). Either maps its duals back by ``MultiplierLayout``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import lsqr

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask, split_signals, with_columns
from lin_freq_ocp.base.resources import require_memory
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.maps import sparse_rows
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.program.program import Block, Program
from lin_freq_ocp.program.program_rows import ProgramRows, box_rows, map_rows, stop_band_rows
from lin_freq_ocp.transform.simulation import nearest_in_reach, reach_of_bounds, within_reach

BYTES_PER_ENTRY = 100.0  # of a dense row at the peak, with indices during assembly and the scaled copies for solvers
BYTES_OF_FACTOR = 12.0  # per entry of a solver's factor: a value and an index
SECONDS_PER_ENTRY = 7.5e-7  # to make, scale and order dense rows, measured with Clarabel
SECONDS_PER_PRODUCT = 4e-10  # of one factorisation, measured with Clarabel: d^2 V for d dense rows and V variables
SECONDS_PER_VARIABLE = 5e-6  # of one factorisation without dense rows, or of measuring a point
LEAST_FACTORISATIONS = 5.0  # of an interior-point method

BLOCKS = Block.STATE_SET, Block.CONTROL_SET, Block.STATE_SPECTRUM, Block.CONTROL_SPECTRUM, Block.TERMS


@dataclass(frozen=True, eq=False)
class LinearProgram:
    """The program of a linear problem, with its own inverse for trajectories and multipliers."""

    problem: OptimalControlProblem
    given_origin: Trajectory | None = None  # None: the references, within reach
    given_slacks: Sequence[Array] | None = None  # at the origin, of each term; None: those that nothing avoids

    @cached_property
    def origin(self) -> Trajectory:
        """The trajectory from which the variables are deviations; it need not follow the dynamics."""
        if self.given_origin is not None:
            return self.given_origin
        problem = self.problem
        x = within_reach(problem, problem.quadratic.x_ref)
        return Trajectory(x, np.broadcast_to(problem.quadratic.u_ref, (problem.horizon, problem.control_dim)))

    @cached_property
    def layout(self) -> MultiplierLayout:
        """The positions of the multipliers of the problem in one flat array."""
        problem = self.problem
        names = tuple((term.name, term.shape) for term in problem.terms)
        sizes = [
            problem.state_tube.lower.size,
            problem.control_tube.lower.size,
            2 * problem.state_stop.size,
            2 * problem.control_stop.size,
            *(groups * dim for _, (groups, dim) in names),
        ]
        mu, nu, rho_x, rho_u, *terms = (int(first) for first in np.cumsum([0, *sizes]))
        shape = problem.horizon, problem.state_dim, problem.control_dim
        return MultiplierLayout(shape, mu, nu, rho_x, rho_u, tuple(terms[:-1]), names, terms[-1])

    @cached_property
    def rows(self) -> tuple[ProgramRows, ...]:
        """All rows but those of the dynamics, block by block; the terms come last, each with its rows."""
        problem, origin, layout = self.problem, self.origin, self.layout
        rows = [
            box_rows(Block.STATE_SET, problem.state_tube, origin, layout.mu),
            box_rows(Block.CONTROL_SET, problem.control_tube, origin, layout.nu),
            *(stop_band_rows(map, origin, (layout.rho_x, layout.rho_u)) for map in problem.stop_band_maps),
        ]
        slacks = self.given_slacks or map(self._slacks_that_nothing_avoids, problem.terms)
        for term, target, at_origin in zip(problem.terms, layout.terms, slacks, strict=True):
            rows.append(map_rows(term.name, term.map, term.penalty, origin, target, at_origin))
        return tuple(rows)

    def _slacks_that_nothing_avoids(self, term: Term) -> Array:
        """Return the slacks of a term that no trajectory undercuts, as far as bounds and dynamics let it move."""
        problem, (x, u) = self.problem, (self.origin.x, self.origin.u)
        least = term.penalty.least_slacks(term.map.values(x, u))
        if not least.any():
            return least
        nearest = term.map.values(nearest_in_reach(problem, x), problem.control_tube.project(u))
        apart, paid = split_signals(reach_of_bounds(problem), problem.state_dim), term.penalty.conic(*term.shape).paid
        moved = term.map.largest_changes(*apart).ravel()[paid].max(axis=1, initial=0.0)
        return np.maximum(term.penalty.least_slacks(nearest) - moved, 0.0)

    @property
    def of_terms(self) -> tuple[ProgramRows, ...]:
        """Return the rows of each term of the problem."""
        return self.rows[len(self.rows) - len(self.problem.terms) :]

    @cached_property
    def prices(self) -> Array:
        """The cost of one unit of each slack."""
        return np.concatenate([np.zeros(0), *(rows.prices for rows in self.rows)])

    @property
    def constant(self) -> float:
        """Return the cost at the origin."""
        of_slacks = sum(float(rows.prices @ rows.origin) for rows in self.of_terms)
        return self.problem.quadratic.value(self.origin.x, self.origin.u) + of_slacks

    @property
    def priced(self) -> Mask:
        """Return which variables determine the size of the cost: signals, and slacks of nonsmooth costs."""
        parts = zip(self.problem.terms, self.of_terms, strict=True)
        slacks = [np.full(len(rows.prices), term.kind.is_cost) for term, rows in parts]
        return np.concatenate([np.ones(self.signals, dtype=bool), *slacks])

    @property
    def states(self) -> int:
        """Return how many variables are states; controls follow."""
        return (self.problem.horizon + 1) * self.problem.state_dim

    @property
    def signals(self) -> int:
        """Return how many variables are states and controls; slacks follow."""
        return self.states + self.problem.horizon * self.problem.control_dim

    @property
    def variables(self) -> int:
        """Return how many variables there are."""
        return self.signals + len(self.prices)

    @property
    def gradient(self) -> Array:
        """Return the slope of the cost in all variables at the origin."""
        parts = self.problem.quadratic.gradient(self.origin.x, self.origin.u)
        return np.concatenate([*(part.ravel() for part in parts), self.prices]).astype(np.float64)

    def matrix(self, chosen: Sequence[ProgramRows]) -> sp.csr_array:
        """Return the coefficients of all variables in the chosen rows."""
        of_signals = stack_rows([(rows.signals, 0) for rows in chosen], self.variables)
        if not any(len(rows.prices) for rows in chosen):
            return of_signals
        return sp.csr_array(of_signals + self.slack_matrix(chosen))

    def slack_matrix(self, chosen: Sequence[ProgramRows]) -> sp.csr_array:
        """Return the coefficients of slacks in the chosen rows; those of other variables are zero."""
        ends = self.signals + np.cumsum([0, *(len(rows.prices) for rows in self.rows)])
        firsts = {rows: int(first) for rows, first in zip(self.rows, ends, strict=False)}
        return stack_rows([(rows.slacks, firsts[rows]) for rows in chosen], int(ends[-1]))

    @cached_property
    def sparse(self) -> Program:
        """The program in the problem's own units; UnsupportedError if it does not fit into memory."""
        dense = dense_rows(self.problem)
        require_memory(
            f"the frequency constraints, {dense.count} dense rows of a program of {dense.variables} variables,",
            dense.size,
            "Method 'spectral' needs no dense rows (time-invariant linear dynamics, quadratic costs, boxes, joint rows "
            "and stop bands; it says what it cannot take); else choose a shorter horizon or a longer sampling time.",
        )
        dynamics = self.dynamics
        A = sp.csc_array(stack_rows([(dynamics, 0), (self.matrix(self.rows), 0)], dynamics.shape[1]))
        blocks, cones, first = {Block.DYNAMICS: slice(0, dynamics.shape[0])}, list[slice](), dynamics.shape[0]
        for block in BLOCKS:
            begin = first
            for part in (part for part in self.rows if part.block is block):
                cones += [slice(first + int(start), first + int(stop)) for start, stop in part.cones]
                first += len(part.lower)
            blocks[block] = slice(begin, first)
        return Program(self.hessian, self.gradient, A, *self._limits, self.constant, blocks, tuple(cones))

    def share_matrices(self, other: LinearProgram) -> bool:
        """Take over the matrices of a program that differs in right-hand sides and slopes alone; whether it does."""
        new, old = self.problem, other.problem
        pairs = [(getattr(new.quadratic, name), getattr(old.quadratic, name)) for name in ("Q", "R", "S", "P")]
        same = _same_recursion(new, old) and self.layout.shape == other.layout.shape
        same &= all(one is another or np.array_equal(one, another) for one, another in pairs)
        if not same or len(self.rows) != len(other.rows):
            return False
        if not all(map(ProgramRows.same_matrix, self.rows, other.rows)):
            return False
        lower, upper = self._limits
        self.__dict__["sparse"] = replace(
            other.sparse, q=self.gradient, constant=self.constant, lower=lower, upper=upper
        )
        return True

    @property
    def _limits(self) -> tuple[Array, Array]:
        """Return the lower and the upper limits of all rows; differences from an origin are formed in its precision."""
        drift = self.drift.ravel()
        lower, upper = ([drift, *(getattr(part, side) for part in self.rows)] for side in ("lower", "upper"))
        return np.concatenate(lower).astype(np.float64), np.concatenate(upper).astype(np.float64)

    @property
    def drift(self) -> Array:
        """Return the constant d_t, (T, n), of the dynamics of the deviations."""
        problem, origin = self.problem, self.origin
        response = problem.response
        if response is not None:  # x_{t+1} is a sum over all controls
            return response.states(origin.u)[1:] - origin.x[1:]
        return problem.linear.successors(origin.x, origin.u) - origin.x[1:]

    def trajectory(self, z: Array) -> Trajectory:
        """Return (x, u) from a point of the program."""
        change = self.direction(z)
        return Trajectory(self.origin.x + change.x, self.origin.u + change.u)

    def direction(self, z: Array) -> Trajectory:
        """Return the change (dx, du) of a change z of the point of the program."""
        return Trajectory(*self.split_signals(z))

    def split_signals(self, z: Array) -> tuple[Array, Array]:
        """Return the states (T+1, n) and the controls (T, m) of a point, finite or not."""
        x, u = z[: self.states], z[self.states : self.signals]
        return x.reshape(-1, self.problem.state_dim), u.reshape(-1, self.problem.control_dim)

    def point(self, trajectory: Trajectory) -> Array:
        """Return the point of the program of a trajectory, with the least slacks."""
        x, u = trajectory.x, trajectory.u
        parts = zip(self.problem.terms, self.of_terms, strict=True)
        slacks = [term.penalty.least_slacks(term.map.values(x, u)) - rows.origin for term, rows in parts]
        return np.concatenate([(x - self.origin.x).ravel(), (u - self.origin.u).ravel(), *slacks]).astype(np.float64)

    def multipliers(self, y: Array, eta_C: float) -> Multipliers:
        """Return the theorem's multipliers from the duals of all rows of ``sparse``; eta_C = 0 for a Farkas ray."""
        ends = np.cumsum([self.problem.horizon * self.problem.state_dim, *(len(rows.lower) for rows in self.rows)])
        eta, *parts = np.split(y, ends[:-1])
        if eta_C:
            parts = [rows.priced_duals(part) for rows, part in zip(self.rows, parts, strict=True)]
        targets = np.concatenate([rows.targets for rows in self.rows])
        weights = [np.ones(len(rows.lower)) if rows.weights is None else rows.weights for rows in self.rows]
        return self.layout.multipliers(eta, targets, np.concatenate(weights) * np.concatenate(parts), eta_C)

    def duals(self, multipliers: Multipliers) -> Array:
        """Return duals of all rows of ``sparse`` that have these multipliers.

        Where slacks give a multiplier several rows, or a row none, they are the least ones with no slope in the slacks.
        """
        flat, duals = self.layout.flat(multipliers), [multipliers.eta.ravel()]
        for rows in self.rows:
            of_rows = np.append(flat, 0.0)[rows.targets] / (1.0 if rows.weights is None else rows.weights)
            if len(rows.prices):
                owned = np.flatnonzero(rows.targets >= 0)
                known, at = np.unique(rows.targets[owned], return_inverse=True)
                sums = sp.csr_array((np.ones(len(at)), (at, owned)), (len(known), len(of_rows)))
                conditions = sp.csr_array(sp.vstack([sums, rows.slacks.T]))
                of_rows = lsqr(conditions, np.concatenate([flat[known], -rows.prices]), atol=1e-14, btol=1e-14)[0]
            for first, last in rows.cones:
                of_rows[first] = -np.linalg.norm(of_rows[first + 1 : last])
            duals.append(of_rows)
        return np.concatenate(duals)

    def column_units(self, state_units: Array, control_units: Array) -> Array:
        """Return one unit per variable from those of states, (n,) or (T+1, n), and of controls, (m,) or (T, m)."""
        T, n, m = self.problem.horizon, self.problem.state_dim, self.problem.control_dim
        steady = np.broadcast_to(state_units, (T + 1, n)), np.broadcast_to(control_units, (T, m))
        slacks = (rows.slack_sizes(*steady) for rows in self.of_terms)
        units = np.concatenate([*(part.ravel() for part in steady), *slacks])
        # a slack that no signal moves has no size: a large unit would make it the largest part of the cost
        return np.where(units > 0, units, units[units > 0].min(initial=1.0))

    @property
    def dynamics(self) -> sp.csr_array:
        """Return the coefficients of all variables in the rows of the dynamics, (T n, variables)."""
        (T, n, m), first = self.layout.shape, 0
        response = self.problem.response
        if response is not None:  # x_{t+1} is a sum over all controls
            values = -response.matrix[n:]
            columns = np.broadcast_to(np.arange(self.states, self.signals), values.shape)
        else:
            linear, first = self.problem.linear, n
            parts = np.broadcast_to(linear.A, (T, n, n)), np.broadcast_to(linear.B, (T, n, m))
            values = -np.concatenate(parts, axis=2).reshape(T * n, n + m)
            columns = np.repeat(signal_columns(T, n, m), n, axis=0)
        columns = np.insert(columns, first, np.arange(n, self.states), axis=1)  # of x_{t+1}
        return sparse_rows(np.insert(values, first, 1.0, axis=1), columns, self.variables)

    @property
    def hessian(self) -> sp.csc_array:
        """Return the second derivatives of the cost, (variables, variables)."""
        cost, (T, n, m) = self.problem.quadratic, self.layout.shape
        stages = np.broadcast_to(np.swapaxes(cost.stage_hessians, 1, 2), (T, n + m, n + m))
        rows, last = signal_columns(T, n, m), np.arange(self.states - n, self.states + m)
        values = [stages[:, :n].reshape(T * n, -1), with_columns(cost.P.T, m), stages[:, n:].reshape(T * m, -1)]
        rows = [np.repeat(rows, n, axis=0), np.broadcast_to(last, (n, n + m)), np.repeat(rows, m, axis=0)]
        of_signals = sparse_rows(np.vstack(values), np.vstack(rows), self.variables)  # transposed
        pointers = np.append(of_signals.indptr, np.full(len(self.prices), of_signals.nnz))
        return sp.csc_array((of_signals.data, of_signals.indices, pointers), shape=(self.variables, self.variables))


def signal_columns(horizon: int, n: int, m: int) -> Indices:
    """Return the columns of (x_t, u_t), (T, n + m), in a program whose variables begin with all x, then all u."""
    x, u = np.arange(horizon * n), (horizon + 1) * n + np.arange(horizon * m)
    return np.hstack([x.reshape(horizon, n), u.reshape(horizon, m)])


def stack_rows(parts: Sequence[tuple[sp.csr_array, int]], columns: int) -> sp.csr_array:
    """Return rows one after the other, each part shifted to its first column; scipy takes several times as long."""
    entries = np.cumsum([0, *(part.nnz for part, _ in parts)]).tolist()
    indices = [part.indices + first for part, first in parts]
    pointers = [part.indptr[1:] + first for (part, _), first in zip(parts, entries, strict=False)]
    data = np.concatenate([np.zeros(0), *(part.data for part, _ in parts)])
    pointers = np.concatenate([np.zeros(1, dtype=np.int32), *pointers])
    indices = np.concatenate([np.zeros(0, dtype=np.int32), *indices])
    return sp.csr_array((data, indices, pointers), shape=(len(pointers) - 1, columns))


@dataclass(frozen=True, eq=False)
class MultiplierLayout:
    """The position of each multiplier in one flat array of all multipliers but eta."""

    shape: tuple[int, int, int]  # T, n, m
    mu: int
    nu: int
    rho_x: int  # (Re, Im) of every bin of a state, state by state
    rho_u: int
    terms: tuple[int, ...]
    names: tuple[tuple[str, tuple[int, int]], ...]  # of the terms, with the shape of their values
    count: int

    def multipliers(self, eta: Array, targets: Indices, duals: Array, eta_C: float) -> Multipliers:
        """Return the multipliers of the maximum principle: eta, and sums of duals by their targets (-1: none)."""
        T, n, m = self.shape
        values = np.bincount(targets + 1, duals, minlength=self.count + 1)[1:].astype(np.float64)
        stages = zip(self.names, np.split(values, self.terms)[1:], strict=True)
        return Multipliers(
            eta_C=eta_C,
            eta=eta.reshape(T, n),
            mu=values[self.mu : self.nu].reshape(T + 1, n),
            nu=values[self.nu : self.rho_x].reshape(T, m),
            rho_x=_bins(values[self.rho_x : self.rho_u], n),
            rho_u=_bins(values[self.rho_u : (*self.terms, self.count)[0]], m),
            stage={name: part.reshape(shape) for (name, shape), part in stages},
        )

    def flat(self, multipliers: Multipliers) -> Array:
        """Return all multipliers but eta in one array, the inverse of ``multipliers``."""
        bins = (np.stack([of.T.real, of.T.imag], axis=-1) for of in (multipliers.rho_x, multipliers.rho_u))
        terms = (multipliers.stage.get(name, np.zeros(shape)) for name, shape in self.names)
        return np.concatenate([part.ravel() for part in (multipliers.mu, multipliers.nu, *bins, *terms)])


def _bins(pairs: Array, components: int) -> ComplexArray:
    """Return multipliers (bins, components) from (Re, Im) of every bin, component by component."""
    of_bins = pairs.reshape(components, -1, 2)
    return (of_bins[:, :, 0] + 1j * of_bins[:, :, 1]).T


def dense_rows(problem: OptimalControlProblem) -> DenseRows:
    """Return the dense rows of stop bands, masks, energy bounds, and of a frequency response."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    of_u, of_x = 2 * int(problem.control_stop.sum()), 2 * int(problem.state_stop.sum())
    count, entries, variables = of_u + of_x, of_u * T + of_x * (T + 1), (T + 1) * n + T * m
    if problem.response is not None:
        count, entries = count + T * n, entries + T * n * T * m
    for term in problem.terms:
        rows, size = term.map.dense_size
        count, entries = count + rows, entries + size
    return DenseRows(count, entries, variables)


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


def _same_recursion(new: OptimalControlProblem, old: OptimalControlProblem) -> bool:
    """Whether the dynamics are the same but for their offset."""
    if new.dynamics is old.dynamics:
        return True
    if any(one.response is not None for one in (new, old)):
        return False
    return all(np.array_equal(getattr(new.linear, name), getattr(old.linear, name)) for name in ("A", "B"))
