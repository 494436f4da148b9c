"""The stages of the global bound, and cells of states with affine functions below the cost-to-go.

For any multipliers, every feasible trajectory has J >= constant + sum_t c_t(x_t, u_t) + c_T(x_T), where the quadratics
c_t hold the signals of the frequency multipliers, which vanish in the sum, and the affine minorants <lambda+, L> - h*
of terms h(L(x, u)) (hamiltonian.py).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.certificate.hamiltonian import require_fitting
from lin_freq_ocp.formulas.jets import interval_jets, values_of
from lin_freq_ocp.problem.hybrid.piecewise_smooth import SmoothMode
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth

# Of the absolute terms of a bound, subtracted; boxes widen by this part
ROUNDING = 64 * float(np.finfo(np.float64).eps)
FLATNESS = 1e-12  # curvature over the largest, or slope over all of it, below which a direction is flat
SHADOW_WIDENING = 1e-6  # part by which bounds that follow from the cost are widened: far above their rounding errors


@dataclass(frozen=True, eq=False)
class StageCosts:
    """Quadratics 1/2 y'H y + b'y of y = (x_t, u_t), with a constant for all of them together.

    hessians : (T, n + m, n + m), linear : (T, n + m), terminal_hessian : (n, n), terminal_linear : (n,);
    ``size`` is the sum of the absolute terms of the constant.
    """

    hessians: Array
    linear: Array
    terminal_hessian: Array
    terminal_linear: Array
    constant: float
    size: float


def stage_costs(problem: OptimalControlProblem, multipliers: Multipliers) -> StageCosts:
    """Return the stage costs of a problem with its frequency multipliers and those of its terms."""
    T, n, m, cost = problem.horizon, problem.state_dim, problem.control_dim, problem.quadratic
    require_fitting(problem, multipliers)
    x_ref, u_ref = np.broadcast_to(cost.x_ref, (T + 1, n)), np.broadcast_to(cost.u_ref, (T, m))
    y_ref = np.hstack([x_ref[:T], u_ref])
    hessians = np.array(np.broadcast_to(cost.stage_hessians, (T, n + m, n + m)))
    of_reference = np.einsum("tij,tj->ti", hessians, y_ref)
    linear_costs = np.concatenate([np.broadcast_to(cost.q, (T, n)), np.broadcast_to(cost.r, (T, m))], axis=1)
    terminal = cost.P @ x_ref[T]
    constants = [*(0.5 * (y_ref * of_reference).sum(1)), float(0.5 * x_ref[T] @ terminal)]
    in_x, in_u = problem.in_time(multipliers.rho_x), time_signal(multipliers.rho_u, T)
    by_formulas = [one.name for one in problem.path_constraints]  # which bound the boxes, or cost nothing or more
    for term in problem.terms:
        if term.name in by_formulas:
            continue
        values = term.map.values(x_ref, u_ref)
        weights = term.penalty.subgradient(multipliers.stage.get(term.name, np.zeros(term.shape)), 1.0)
        pulled_x, pulled_u = term.map.pull_back(weights, (x_ref.shape, u_ref.shape))
        in_x, in_u = in_x + pulled_x, in_u + pulled_u
        constants += [*term.penalty.cost(values).ravel(), *(-term.penalty.gap(values, weights, 1.0)).ravel()]
        constants += [-float((pulled_x * x_ref).sum()), -float((pulled_u * u_ref).sum())]
    linear = linear_costs - of_reference + np.hstack([in_x[:T], in_u])
    terminal_linear = cost.p - terminal + in_x[T]
    size = float(np.abs(constants).sum() + np.abs(in_x * x_ref).sum() + np.abs(in_u * u_ref).sum())
    linear, P, terminal_linear = (np.asarray(part, dtype=np.float64) for part in (linear, cost.P, terminal_linear))
    return StageCosts(hessians, linear, P, terminal_linear, float(np.sum(constants)), size)


@dataclass(frozen=True, eq=False)
class PricedProblem:
    """A problem with priced costs and bounds: a trajectory that is not within them costs too much or is not feasible.

    lower, upper : (T, m), of the controls; lowest, highest : (T+1, n), of the states.
    """

    problem: OptimalControlProblem
    costs: StageCosts
    lower: Array
    upper: Array
    lowest: Array
    highest: Array

    @classmethod
    def below(cls, problem: OptimalControlProblem, costs: StageCosts, level: float) -> PricedProblem:
        """Return the stages of trajectories below a level of the cost without its constant."""
        n = problem.state_dim
        forms = [QuadraticForm(*parts) for parts in zip(costs.hessians, costs.linear, strict=True)]
        forms.append(QuadraticForm(costs.terminal_hessian, costs.terminal_linear))
        left = level - sum(form.least for form in forms) - least_by_formulas(problem)
        shadows = [form.shadow(max(left, 0.0) if np.isfinite(left) else np.inf) for form in forms]
        x, u = np.array([shadow[:, :n] for shadow in shadows]), np.array([shadow[:, n:] for shadow in shadows[:-1]])
        return cls(problem, costs, *_clip_shadow(u, problem.control_tube), *_clip_shadow(x, problem.state_tube))

    def modes(self, t: int) -> tuple[SmoothMode, ...]:
        """Return the modes at a time, within the hard path constraints of that time."""
        modes = piecewise_smooth(self.problem).modes
        constraints = [one for one in self.problem.path_constraints if one.hard_part is not None]
        pairs = [(h, float(e)) for one in constraints for h, e in zip(one.formulas, one.limits()[t], strict=True)]
        rows = [formula - limit for formula, limit in pairs if limit < np.inf]
        return tuple(replace(mode, region=(*mode.region, *rows)) for mode in modes) if rows else modes

    def cost(self, t: int, y: Array) -> Array:
        """Return c_t of pairs (points, n + m) without its formulas."""
        return 0.5 * np.einsum("pi,ij,pj->p", y, self.costs.hessians[t], y) + y @ self.costs.linear[t]

    def whole_cost(self, t: int, y: Array) -> Array:
        """Return c_t of pairs (points, n + m)."""
        formulas = [one for one in self.problem.cost.formulas[:1] if one is not None]
        return self.cost(t, y) + values_of(formulas, y, np.array([t])).sum(axis=1)


def least_by_formulas(problem: OptimalControlProblem) -> float:
    """Return a lower bound of the costs by formulas over the bounds of states and controls, -inf without one."""
    if not problem.cost.has_formulas:
        return 0.0
    least, states, controls = list[float](), problem.state_tube, problem.control_tube
    for t in range(problem.horizon):
        pairs = (states.lower, controls.lower), (states.upper, controls.upper)
        box = [np.append(x[t], u[t])[None] for x, u in pairs]
        costs = [mode.cost for mode in piecewise_smooth(problem).modes]
        least.append(min(float(interval_jets(cost, *box, curved=False, time=t).values[0].sum()) for cost in costs))
    terminal = [one for one in problem.cost.formulas[1:] if one is not None]
    box = [np.append(bound[-1], np.zeros(problem.control_dim))[None] for bound in (states.lower, states.upper)]
    least.append(float(interval_jets(terminal, *box, curved=False).values[0].sum()))
    total = float(np.sum(least) - ROUNDING * np.abs(least).sum())
    return -np.inf if np.isnan(total) else total


class QuadraticForm:
    """The quadratic 1/2 y'H y + b'y with H >= 0; ``least`` is its minimum, or -inf.

    It is taken apart in units in which the diagonal of H is 1, so that flat directions do not depend on units.
    """

    def __init__(self, hessian: Array, linear: Array):
        diagonal = np.diagonal(hessian)
        units = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        values, vectors = np.linalg.eigh(units[:, None] * hessian * units)
        curved, slope = values > FLATNESS * max(float(values[-1]), 0.0), units * linear
        along = vectors.T @ slope
        flat = np.abs(along[~curved]).max(initial=0.0) <= FLATNESS * float(np.abs(slope).max(initial=0.0))
        flat &= not linear[diagonal <= 0].any()
        self._flat_in = np.abs(vectors[:, ~curved]).max(axis=1, initial=0.0) > FLATNESS
        inverse = vectors[:, curved] / values[curved]
        self._centre = units * (-inverse @ along[curved])
        self._inverse = units**2 * (inverse * vectors[:, curved]).sum(axis=1)
        self.least = -0.5 * float((along[curved] ** 2 / values[curved]).sum()) if flat else -np.inf

    def shadow(self, above: float) -> Array:
        """Return bounds of all y at which the form exceeds its least by at most ``above``, (2, n + m)."""
        if above == np.inf:
            return np.stack([np.full(len(self._centre), -np.inf), np.full(len(self._centre), np.inf)])
        radius = np.sqrt(2 * above * self._inverse)
        widened = (1 + SHADOW_WIDENING) * radius + SHADOW_WIDENING * np.abs(self._centre)
        radius = np.where(self._flat_in, np.inf, widened)
        return np.stack([self._centre - radius, self._centre + radius])


def _clip_shadow(shadow: Array, box: Box) -> tuple[Array, Array]:
    """Return the intersection of shadows (times, 2, .) with a box; the nearest of the box where it is empty."""
    return np.clip(shadow[:, 0], box.lower, box.upper), np.clip(shadow[:, 1], box.lower, box.upper)


def index_tuples(shape: Indices) -> Indices:
    """Return the indices of all entries of an array of this shape, (entries, n)."""
    return np.indices(tuple(shape), dtype=np.intp).reshape(len(shape), -1).T


@dataclass(frozen=True, eq=False)
class Lattice:
    """A regular grid over the states at one time, and the cells of it that are looked at.

    Attributes
    ----------
    lower, width : (n,)
        The lower corner of the grid, and the width of a cell: 0 where the state is fixed.
    shape : (n,) integers
    cells : (cells, n) integers
        Indices of every cell.
    finest : (n,)
        Cells that are no wider are not halved.
    """

    lower: Array
    width: Array
    shape: Indices
    cells: Indices
    finest: Array

    @classmethod
    def full(cls, lower: Array, upper: Array, finest: Array, each: int) -> Lattice:
        """Return a lattice with ``each`` cells along each state, one where that is too narrow; all are looked at."""
        shape = np.where(upper - lower > finest, each, 1).astype(np.intp)
        return cls(lower, (upper - lower) / shape, shape, index_tuples(shape), finest)

    @property
    def upper(self) -> Array:
        """Return the upper corner, (n,)."""
        return self.lower + self.width * self.shape

    @property
    def split(self) -> Indices:
        """Return into how many parts a cell is cut along each state, (n,): 2, or 1 where it is too narrow."""
        return np.where(self.width > self.finest, 2, 1).astype(np.intp)

    @cached_property
    def centres(self) -> Array:
        """Return the centres of the cells, (cells, n)."""
        return self.lower + (self.cells + 0.5) * self.width

    @cached_property
    def _numbers(self) -> Indices:
        """Return the number of the cell at every index, -1 where it is not looked at."""
        numbers = np.full(tuple(self.shape), -1, dtype=np.intp)
        numbers[tuple(self.cells.T)] = np.arange(len(self.cells))
        return numbers

    def indices(self, x: Array, towards: int = 0) -> Indices:
        """Return the indices of points along each state, (..., n); towards -1 or 1, those that rounding may hide."""
        width = np.where(self.width > 0, self.width, 1.0)
        share = (x - self.lower) / width + towards * ROUNDING * (1 + np.abs(x / width))
        return np.asarray(np.clip(np.floor(np.nan_to_num(share)), 0, self.shape - 1), dtype=np.intp)

    def numbers(self, indices: Indices) -> Indices:
        """Return the numbers of the cells at indices (..., n), -1 where there is none."""
        return self._numbers[tuple(np.moveaxis(indices, -1, 0))]

    def variation(self, slopes: Array) -> Array:
        """Return the largest change of slopes (..., n) from the centre of a cell, (...)."""
        return (np.abs(slopes) * self.width / 2).sum(axis=-1)

    def halved(self, kept: Mask) -> tuple[Lattice, Indices]:
        """Return some of the cells cut into halves along each state that has a width, and the cell each comes from."""
        split = self.split
        corners = index_tuples(split)
        parents = np.repeat(np.flatnonzero(kept), len(corners))
        cells = self.cells[parents] * split + np.tile(corners, (int(kept.sum()), 1))
        first = cells.min(axis=0)
        lower, width = self.lower + first * (self.width / split), self.width / split
        return Lattice(lower, width, cells.max(axis=0) - first + 1, cells - first, self.finest), parents


@dataclass(frozen=True, eq=False)
class CostToGo:
    """An affine function below the cost-to-go on every cell, or the largest of several.

    Attributes
    ----------
    values, slopes : (cells, pieces), (cells, pieces, n)
        V is the largest of values + slopes (x - centre); inf where no trajectory goes on.
    first, last : (cells, n)
        Bounds of the states of a cell from which trajectories go on.
    """

    lattice: Lattice
    values: Array
    slopes: Array
    first: Array
    last: Array

    def pieces_at(self, cell: Indices, x: Array) -> Array:
        """Return the values of all pieces at points in cells, (points, pieces)."""
        return self.values[cell] + np.einsum("psn,pn->ps", self.slopes[cell], x - self.lattice.centres[cell])

    def slopes_at(self, cell: Indices, x: Array) -> Array:
        """Return the slopes of V at points in cells, (points, n)."""
        return self.slopes[cell, self.pieces_at(cell, x).argmax(axis=1)]

    def at(self, x: Array) -> Array:
        """Return V at points, (points,); inf where no trajectory goes on."""
        lattice = self.lattice
        cell = lattice.numbers(lattice.indices(np.nan_to_num(x)))
        goes_on = (cell >= 0) & ((x >= self.first[cell]) & (x <= self.last[cell])).all(axis=1)
        goes_on &= ((x >= lattice.lower) & (x <= lattice.upper)).all(axis=1)
        return np.where(goes_on, self.pieces_at(cell, x).max(axis=1), np.inf)

    @cached_property
    def least(self) -> Array:
        """Return a lower bound of V on every cell, (cells,)."""
        return (self.values - self.lattice.variation(self.slopes)).max(axis=1)

    def most(self, cell: Indices, parts: Lattice, slopes: Array) -> Array:
        """Return an upper bound of V - slopes (x - centre) on parts of cells (parts,), (parts, pieces)."""
        apart = self.slopes[cell][:, :, None] - slopes[:, None]
        return (self.pieces_at(cell, parts.centres)[:, :, None] + parts.variation(apart)).max(axis=1)


class Minima:
    """The least of V over ranges of indices, from blocks of 2^k cells along each state."""

    def __init__(self, after: CostToGo):
        lattice = after.lattice
        table = np.full(tuple(lattice.shape), np.inf)
        table[tuple(lattice.cells.T)] = after.least
        self._tables = [table]
        while max(table.shape) > 1:
            for axis, size in enumerate(table.shape):
                table = np.minimum.reduceat(table, np.arange(0, size, 2), axis=axis)
            self._tables.append(table)
        finite = np.isfinite(after.values)
        self.steepest = np.abs(after.slopes[finite]).max(axis=0, initial=0.0)  # of V along each state
        self.spread = float(np.ptp(after.values[finite])) if finite.any() else 0.0

    def least(self, first: Indices, final: Indices) -> Array:
        """Return a lower bound of V over the indices first .. final: that of the blocks they lie in."""
        level = np.ceil(np.log2((final - first).max(axis=1) + 1)).astype(int)
        minima = np.full(len(first), np.inf)
        for k in np.unique(level):
            rows = np.flatnonzero(level == k)
            ends = first[rows] >> k, final[rows] >> k
            for corner in np.ndindex(*[2] * first.shape[1]):
                at = tuple(ends[side][:, j] for j, side in enumerate(corner))
                minima[rows] = np.minimum(minima[rows], self._tables[k][at])
        return minima
