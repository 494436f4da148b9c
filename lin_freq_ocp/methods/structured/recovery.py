"""The variables of the method: deviations from an origin in units of order 1, and the way back to the problem.

The origin has the references, and the value of a control where its bounds are equal. A control that is fixed at some
times leaves the stages there, unless it is in a row that couples times: its deviation is zero.

    y = columns * y',   row' = factor * row,   cost' = factor * cost;   z = factor of the row * z' / factor of the cost

Entries of y, limits of rows and cones are of order 1, and the steepest slope of the cost is 10. The first units are the
sizes in the data; a solution that is very different from them has units of its own.

Duals z are a list: dynamics (T+1, n), x_0 (n,), stages (T+1, p), equations flat, inequalities (count, 1), and
(balls, 1 + dim) for each family of balls, with H y + h + A'z = 0 where A are the rows of dynamics, x_0, G, equations,
inequalities, and minus those of balls. The multiplier of a value is the sum of its rows' duals, times 1 or -1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, ComplexArray, Indices, Mask
from lin_freq_ocp.methods.structured.stages import Balls, Coupling, Stages
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory

COST_LEVEL = 10.0  # steepest slope of the scaled cost, the others being smaller
UNIT_ROUNDING = 1e-12  # of the previous unit: smaller signals are rounding
UNNOTICED = 1e-3  # least unit of a component, relative to the change, over the horizon, that others would notice


@dataclass(frozen=True, eq=False)
class Origin:
    """Values of states and controls, those of u_T being zero, and which of them are fixed, (T+1, n+m)."""

    values: Array
    held: Mask
    states: int

    @property
    def x(self) -> Array:
        """Return the states, (T+1, n)."""
        return self.values[:, : self.states]

    @property
    def u(self) -> Array:
        """Return the controls, (T, m)."""
        return self.values[:-1, self.states :]


def origin_of(problem: OptimalControlProblem) -> Origin:
    """Return the origin of a problem."""
    T, n, m = problem.horizon, problem.state_dim, problem.control_dim
    values, held, tube = np.zeros((T + 1, n + m)), np.zeros((T + 1, n + m), dtype=bool), problem.control_tube
    # controls in rows that couple times are not fixed
    coupled = problem.control_stop.any(axis=0)
    for term in problem.terms:
        if term.map.stage_form(n, m) is None:
            form = term.map.spectrum_form(n, m)
            coupled = coupled | (True if form is None else form.row[n:] != 0)
    fixed = (tube.lower == tube.upper) & ~coupled
    values[:, :n] = problem.quadratic.x_ref
    values[:-1, n:] = np.where(fixed, tube.lower, problem.quadratic.u_ref)
    held[:-1, n:] = fixed
    return Origin(values, held, n)


@dataclass(frozen=True, eq=False)
class Units:
    """The units of y, (T+1, n+k), and the factors of every row after the dynamics and of the cost."""

    columns: Array
    rows: Array  # (rows,): of x_0, of stages, equations, inequalities and balls, flat
    cost: float


def scale_stages(stages: Stages, columns: Array, priced: Mask, y: Array | None = None) -> tuple[Stages, Units]:
    """Return the stages with y in units ``columns`` (T+1, n+k), and all units.

    The cost is measured by its slopes in the priced entries of y, at y or else where all are one unit.
    """
    n = stages.states
    G = stages.G * columns[:, None]
    of_stages = _stage_factors(G, stages.g, stages.cones)
    coupling, of_coupling = _scale_coupling(stages.coupling, columns)
    H, h = stages.H * columns[:, :, None] * columns[:, None, :], stages.h * columns
    typical = np.ones(h.shape)
    if y is not None:  # in the new units; a component that moves at all, no smaller than the change others would notice
        size = np.abs(y)
        typical = np.where(size.max(axis=0) > UNIT_ROUNDING, np.maximum(size / columns, UNNOTICED), 0.0)
    slopes = np.einsum("tij,tj->ti", np.abs(H), typical) + np.abs(h)
    steepest = float(slopes[priced].max(initial=0.0)) or float(slopes.max(initial=0.0))  # or there are only penalties
    cost = COST_LEVEL / steepest if np.isfinite(steepest) and steepest > 0 else 1.0
    A, B, d = scale_dynamics(stages.A, stages.B, stages.d, columns)
    changed = replace(
        stages,
        A=A,
        B=B,
        d=d,
        H=H * cost,
        h=h * cost,
        G=G * of_stages[:, :, None],
        g=stages.g * of_stages,
        initial=stages.initial / columns[0, :n],
        coupling=coupling,
        constant=stages.constant * cost,
    )
    return changed, Units(columns, np.concatenate([1 / columns[0, :n], of_stages.ravel(), of_coupling]), cost)


def scale_dynamics(A: Array, B: Array, d: Array, columns: Array) -> tuple[Array, Array, Array]:
    """Return A, B and d with y in units ``columns``."""
    n = A.shape[1]
    after = np.concatenate([columns[1:, :n], np.ones((1, n))])
    return A * columns[:, None, :n] / after[:, :, None], B * columns[:, None, n:] / after[:, :, None], d / after


def _stage_factors(G: Array, g: Array, cones: tuple[int, ...]) -> Array:
    """Return the factor of every row, (T+1, p): its limit, or that of its cone, becomes 1 unless its norm is larger."""
    norms, limits = np.sqrt((G**2).sum(2)), np.where(np.isfinite(g), np.abs(g), 0.0)
    sizes, first = np.maximum(norms, limits), g.shape[1] - sum(cones)
    for size in cones:
        cone = slice(first, first + size)
        head = sizes[:, first, None]
        sizes[:, cone] = np.where(head > 0, head, norms[:, cone].max(axis=1, keepdims=True))
        first += size
    return _inverse(sizes)


def _scale_coupling(coupling: Coupling, columns: Array) -> tuple[Coupling, Array]:
    units = columns[:, coupling.channels]
    end = columns[-1, coupling.terminal]
    factors = [1 / end]
    equations = []
    for part in coupling.equations:
        factors.append(_inverse(part.rows.scaled(np.ones(part.rows.count), units).norms()))
        equations.append(replace(part, rows=part.rows.scaled(factors[-1], units), right=part.right * factors[-1]))
    inequalities = []
    for part in coupling.inequalities:
        factors.append(_inverse(part.rows.scaled(np.ones(part.rows.count), units).norms()))
        inequalities.append(replace(part, rows=part.rows.scaled(factors[-1], units), limits=part.limits * factors[-1]))
    balls = []
    for part in coupling.balls:  # of radius 1, unless their slacks are larger
        count, plain = len(part.radius), part.rows.scaled(np.ones(part.rows.count), units)
        sizes = np.abs(part.radius)
        if part.heads is not None:
            sizes = np.maximum(sizes, part.heads.scaled(np.ones(count), units).norms())
        factor = _inverse(np.where(sizes > 0, sizes, plain.norms().reshape(count, -1).max(axis=1)))
        rows = part.rows.scaled(np.repeat(factor, part.dim), units)
        heads = None if part.heads is None else part.heads.scaled(factor, units)
        offset = None if part.offset is None else part.offset * factor[:, None]
        balls.append(Balls(rows, part.radius * factor, heads, offset))
        factors.append(np.repeat(factor, 1 + part.dim))
    changed = replace(
        coupling,
        terminal_state=coupling.terminal_state / end,
        equations=tuple(equations),
        inequalities=tuple(inequalities),
        balls=tuple(balls),
    )
    return changed, np.concatenate(factors)


def _inverse(sizes: Array) -> Array:
    return 1.0 / np.where(sizes > 0, sizes, 1.0)


def own_units(stages: Stages, y: Array, controls: int) -> Array:
    """Return the units of states and controls, (n+m,), in which y is of order 1, relative to those of the stages.

    None is smaller than the change that the others would notice through the dynamics.
    """
    n = stages.states
    size = np.abs(y[:, : n + controls]).max(axis=0)
    gain = np.abs(np.concatenate([stages.A, stages.B[:, :, :controls]], axis=2)).max(axis=0)
    part = UNNOTICED / stages.horizon
    size[:n] = np.maximum(size[:n], part * (gain @ size + np.abs(stages.d).max(axis=0)))
    counts = (gain > 0) & (size[:n, None] > 0)
    noticed = np.divide(size[:n, None], gain, out=np.full(gain.shape, np.inf), where=counts).min(axis=0)
    size = np.maximum(size, np.where(np.isfinite(noticed), part * noticed, 0.0))
    return np.where(size > UNIT_ROUNDING, size, 1.0)


def fix_unused_entries(stages: Stages, used: Mask) -> Stages:
    """Return the stages with Hessian 1 for the entries of y that are not used at a time, (T+1, n+k)."""
    H, (time, entry) = stages.H.copy(), np.nonzero(~used)
    H[time, entry, entry] = 1.0
    return replace(stages, H=H)


@dataclass(frozen=True, eq=False)
class MultiplierLayout:
    """Where each multiplier begins in one flat array of all of them; eta is not among them."""

    mu: int
    nu: int
    rho_x: int  # (Re, Im) of every bin of a state, state by state
    rho_u: int
    terms: tuple[int, ...]
    count: int


def multiplier_layout(problem: OptimalControlProblem) -> MultiplierLayout:
    """Return where the multipliers of a problem begin."""
    sizes = [
        problem.state_tube.lower.size,
        problem.control_tube.lower.size,
        2 * problem.state_stop.size,
        2 * problem.control_stop.size,
        *(groups * dim for groups, dim in (term.shape for term in problem.terms)),
    ]
    mu, nu, rho_x, rho_u, *terms = (int(first) for first in np.cumsum([0, *sizes]))
    return MultiplierLayout(mu, nu, rho_x, rho_u, tuple(terms[:-1]), terms[-1])


@dataclass(frozen=True, eq=False)
class Recovery:
    """The inverse of the assembly of a problem."""

    problem: OptimalControlProblem
    origin: Origin
    units: Units
    layout: MultiplierLayout
    targets: Indices  # of each dual after those of the dynamics, flat: the multiplier that it belongs to; -1: none
    signs: Array

    def trajectory(self, y: Array) -> Trajectory:
        """Return (x, u) from y (T+1, n+k)."""
        change = self.direction(y)
        return Trajectory(self.origin.x + change.x, self.origin.u + change.u)

    def direction(self, y: Array) -> Trajectory:
        """Return the change (dx, du) of a change of y."""
        n, m = self.problem.state_dim, self.problem.control_dim
        change = y * self.units.columns
        return Trajectory(change[:, :n], change[:-1, n : n + m])

    def multipliers(self, z: Sequence[Array], eta_C: float, y: Array | None = None) -> Multipliers:
        """Return the multipliers of the maximum principle from all duals; eta_C = 0 for a Farkas ray, without y."""
        problem, layout = self.problem, self.layout
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        duals = np.concatenate([part.ravel() for part in z[1:]]) * self.units.rows / self.units.cost
        values = np.zeros(layout.count + 1)  # the last for duals without a multiplier
        np.add.at(values, self.targets, self.signs * duals)
        eta = z[0][:-1] / self.units.columns[1:, :n] / self.units.cost
        shapes = [term.shape for term in problem.terms]
        multipliers = Multipliers(
            eta_C=eta_C,
            eta=eta,
            mu=values[layout.mu : layout.nu].reshape(T + 1, n),
            nu=values[layout.nu : layout.rho_x].reshape(T, m),
            rho_x=_bins(values[layout.rho_x : layout.rho_u], n),
            rho_u=_bins(values[layout.rho_u :][: 2 * problem.control_stop.size], m),
            stage={
                term.name: values[first : first + shape[0] * shape[1]].reshape(shape)
                for term, first, shape in zip(problem.terms, layout.terms, shapes, strict=True)
            },
        )
        if not self.origin.held.any():
            return multipliers
        # those of fixed controls follow from stationarity, nu = -(eta_C dJ/du - B'eta + (rows of stages)'lambda)
        slopes = -problem.linear.pull_back(eta)[1]
        for term in problem.terms:
            if term.map.stage_form(n, m) is not None:
                slopes += term.map.pull_back(multipliers.stage[term.name], ((T + 1, n), (T, m)))[1]
        if eta_C:
            assert y is not None  # the cost has slopes
            trajectory = self.trajectory(y)
            slopes += eta_C * problem.quadratic.gradient(trajectory.x, trajectory.u)[1]
        return replace(multipliers, nu=np.where(self.origin.held[:-1, n:], -slopes, multipliers.nu))


def _bins(pairs: Array, components: int) -> ComplexArray:
    """Return multipliers (bins, components) from (Re, Im) of every bin, component by component."""
    of_bins = pairs.reshape(components, -1, 2)
    return (of_bins[:, :, 0] + 1j * of_bins[:, :, 1]).T
