"""How far maps and regions of modes are exceeded while another mode holds: what big-M rows need, and no more.

While mode j holds at t, (x_t, u_t) lies in a domain D_tj: the region of j, the hard linear rows of the stage sets, an
interval that x_t is known to lie in, the bounds of u_t, and f_j(x_t, u_t) in the bounds of x_{t+1}. Over it,

    below_ij <= f_j - f_i <= above_ij,      G_i x + H_i u - h_i <= regions_ij,

and the images f_j(D_tj) of all modes that can hold give the interval of x_{t+1}. Every figure is a small linear program
in units of the half widths of the intervals; those of one time are solved together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog

from lin_freq_ocp.errors import NumericalError, UnsupportedError
from lin_freq_ocp.problem.arrays import Array, Mask
from lin_freq_ocp.problem.maps import StageMap
from lin_freq_ocp.problem.measures import stated_sizes
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.penalties import Below, Norm
from lin_freq_ocp.problem.piecewise_affine import ModeArrays

RELAXATION = 1e-6
"""Rows of a domain, in half widths, are relaxed by this much, ten times what a linear program or a mixed-integer solver
lets pass; a domain that is empty even so belongs to a mode that cannot hold."""

OUTWARD = 1e-6
"""Part of its range over the box by which every figure is enlarged, for the tolerances (1e-7) of the linear program."""

LEAST_HALF_WIDTH = 1e-9
"""An interval (a fixed state is one) is thought this wide, relative to the natural size of its component, so that what
is exceeded can be told in half widths; far below the 1e-6 to which anybody can say on which side of a border a point is."""

ROUNDING = 1e-12
"""Part of the largest terms of a figure that is rounding of their sum."""

INFEASIBLE, UNBOUNDED = 2, 3
"""What scipy's linprog calls these."""


@dataclass(frozen=True, eq=False)
class Excesses:
    """What maps and rows of mode i exceed while mode j holds.

    Attributes
    ----------
    possible : (T, modes)
        Whether a mode can hold at all; the figures of one that cannot are 0.
    below, above : (T, modes i, modes j, n)
        Least and largest f_j - f_i.
    regions : (T, modes i, modes j, rows)
        Largest G_i x + H_i u - h_i; 0 where there is no row.
    """

    possible: Mask
    below: Array
    above: Array
    regions: Array


@dataclass(frozen=True, eq=False)
class _Stage:
    """One time: maps F y + c of all modes, regions G y <= h, further rows, all in y = (x, u)."""

    F: Array
    c: Array
    G: Array
    h: Array
    rows: Array
    limits: Array
    lower: Array
    upper: Array
    next_lower: Array
    next_upper: Array

    @property
    def key(self) -> bytes:
        """Return what tells this stage from others."""
        return b"".join(np.ascontiguousarray(part).tobytes() for part in vars(self).values())

    def domain(self, j: int) -> tuple[Array, Array]:
        """Return rows and limits of mode j, in v = (y - centre) / half widths, each of norm 1."""
        region = np.isfinite(self.h[j])
        above, below = np.isfinite(self.next_upper), np.isfinite(self.next_lower)
        rows = np.vstack([self.G[j][region], self.rows, self.F[j][above], -self.F[j][below]])
        images = (self.next_upper - self.c[j])[above], (self.c[j] - self.next_lower)[below]
        limits = np.concatenate([self.h[j][region], self.limits, *images])
        rows, limits = _normalised(rows * self.half, limits - rows @ self.centre)
        most = 2 * np.sqrt(rows.shape[1])  # no row exceeds half of this: beyond it, all limits are alike
        return rows, np.clip(limits, -most, most)

    @property
    def centre(self) -> Array:
        """Return the middle of the box of y."""
        return (self.lower + self.upper) / 2

    @property
    def half(self) -> Array:
        """Return the half widths of the box of y."""
        return (self.upper - self.lower) / 2


@dataclass(frozen=True, eq=False)
class _Step:
    """The excesses of one time, and the interval of the next state."""

    possible: Mask
    below: Array
    above: Array
    regions: Array
    lower: Array
    upper: Array


def excesses(problem: OptimalControlProblem) -> Excesses:
    """Return the excesses of a problem with piecewise-affine dynamics.

    Raises
    ------
    UnsupportedError
        If nothing bounds a control or a state that the others depend on, naming it.
    NumericalError
        If a linear program does not end with an answer.
    """
    T, n = problem.horizon, problem.state_dim
    arrays, tube, controls = problem.piecewise.arrays(T), problem.state_tube, problem.control_tube
    further = _further_rows(problem)
    units = np.concatenate(stated_sizes(problem))
    names = (*problem.state_names, *problem.control_names)
    modes, rows = arrays.h.shape[1:]
    found = Excesses(
        possible=np.zeros((T, modes), dtype=bool),
        below=np.zeros((T, modes, modes, n)),
        above=np.zeros((T, modes, modes, n)),
        regions=np.zeros((T, modes, modes, rows)),
    )
    known: dict[bytes, _Step] = {}
    lower, upper = tube.lower[0], tube.upper[0]
    for t in range(T):
        box = np.append(lower, controls.lower[t]), np.append(upper, controls.upper[t])
        box = _widened(*_bounded(*box, *further[t], units, names, t), LEAST_HALF_WIDTH * units)
        stage = _stage(arrays, t, *further[t], *box, tube.lower[t + 1], tube.upper[t + 1])
        step = known.setdefault(stage.key, _step(stage)) if stage.key not in known else known[stage.key]
        for name in ("possible", "below", "above", "regions"):
            getattr(found, name)[t] = getattr(step, name)
        if not step.possible.any():
            break
        lower = np.clip(step.lower, tube.lower[t + 1], tube.upper[t + 1])
        upper = np.clip(step.upper, tube.lower[t + 1], tube.upper[t + 1])
    return found


def _stage(
    arrays: ModeArrays,
    t: int,
    rows: Array,
    limits: Array,
    lower: Array,
    upper: Array,
    next_lower: Array,
    next_upper: Array,
) -> _Stage:
    return _Stage(
        F=np.concatenate([arrays.A[t], arrays.B[t]], axis=-1),
        c=arrays.offset[t],
        G=np.concatenate([arrays.G[t], arrays.H[t]], axis=-1),
        h=arrays.h[t],
        rows=rows,
        limits=limits,
        lower=lower,
        upper=upper,
        next_lower=next_lower,
        next_upper=next_upper,
    )


def _step(stage: _Stage) -> _Step:
    modes, n = stage.c.shape
    domains = [stage.domain(j) for j in range(modes)]
    excess = _least_excesses(domains)
    possible = excess <= RELAXATION
    below, above = np.zeros((2, modes, modes, n))
    regions = np.zeros((modes, modes, stage.h.shape[1]))
    hulls = np.full((2, n), -np.inf)
    asked: list[tuple[Array, Array, Array]] = []
    holding = np.flatnonzero(possible)
    for j in holding:
        rows, limits = domains[j]
        differences = (stage.F[j] - stage.F).reshape(-1, stage.F.shape[-1])
        objectives = np.vstack(
            [stage.F[j], -stage.F[j], differences, -differences, stage.G.reshape(-1, len(stage.half))]
        )
        asked.append((objectives, rows, limits + RELAXATION + excess[j]))
    for j, largest in zip(holding, _largest(stage, asked), strict=True):
        image, fallen, up, down, region = np.split(largest, np.cumsum([n, n, modes * n, modes * n]))
        hulls = np.maximum(hulls, [image + stage.c[j], fallen - stage.c[j]])
        offsets = stage.c[j] - stage.c
        above[:, j], below[:, j] = up.reshape(modes, n) + offsets, offsets - down.reshape(modes, n)
        limited = np.isfinite(stage.h)
        regions[:, j] = np.where(limited, region.reshape(stage.h.shape) - np.where(limited, stage.h, 0.0), 0.0)
    return _Step(possible, below, above, regions, -hulls[1], hulls[0])


def _least_excesses(domains: Sequence[tuple[Array, Array]]) -> Array:
    """Return by how much the rows of each domain must be relaxed for a point of the box to satisfy them, (modes,)."""
    blocks = [np.column_stack([rows, np.full(len(rows), -1.0)]) for rows, _ in domains]
    columns = blocks[0].shape[1]
    cost = np.tile(np.append(np.zeros(columns - 1), 1.0), len(blocks))
    bounds = np.tile([[-1.0, 1.0]] * (columns - 1) + [[0.0, np.inf]], (len(blocks), 1))
    limits = np.concatenate([limits for _, limits in domains])
    return _solved(cost, sp.block_diag(blocks, format="csr"), limits, bounds)[columns - 1 :: columns]


def _largest(stage: _Stage, asked: Sequence[tuple[Array, Array, Array]]) -> list[Array]:
    """Return the largest value of each objective'y over each domain, rows v <= limits, enlarged outward."""
    scaled = [objectives * stage.half for objectives, _, _ in asked]
    weights = np.vstack([*scaled, np.zeros((0, len(stage.half)))])
    live = np.abs(weights).sum(axis=1) > 0
    counts = np.cumsum([len(part) for part in scaled])
    sizes = np.abs(weights).sum(axis=1)
    blocks = [
        (rows, limits)
        for (_, rows, limits), alive in zip(asked, np.split(live, counts[:-1]) if asked else [], strict=True)
        for _ in range(int(alive.sum()))
    ]
    largest = np.zeros(len(weights))
    if blocks:
        cost = -weights[live] / sizes[live, None]
        matrix = sp.block_diag([rows for rows, _ in blocks], format="csr")
        bounds = np.tile([[-1.0, 1.0]], (cost.size, 1))
        v = _solved(cost.ravel(), matrix, np.concatenate([limits for _, limits in blocks]), bounds)
        largest[live] = -(cost * v.reshape(cost.shape)).sum(axis=1) * sizes[live]
    middles = np.concatenate([objectives @ stage.centre for objectives, _, _ in asked] or [np.zeros(0)])
    terms = np.concatenate([np.abs(one) @ np.abs(stage.centre) for one, _, _ in asked] or [np.zeros(0)])
    return np.split(largest + OUTWARD * sizes + middles + ROUNDING * terms, counts[:-1]) if asked else []


def _solved(cost: Array, matrix: Any, limits: Array, bounds: Array) -> Array:
    """Return the minimiser of a linear program that has one."""
    answer: Any = linprog(cost, matrix, limits, bounds=bounds, method="highs")
    if answer.status != 0:
        raise NumericalError(f"A linear program about the domains of modes ended as: {answer.message}")
    return np.asarray(answer.x)


def _normalised(rows: Array, limits: Array) -> tuple[Array, Array]:
    """Return rows of norm 1, or 0."""
    norms = np.linalg.norm(rows, axis=1)
    sizes = np.where(norms > 0, norms, np.where(limits != 0, np.abs(limits), 1.0))
    return rows / sizes[:, None], limits / sizes


def _widened(lower: Array, upper: Array, least: Array) -> tuple[Array, Array]:
    """Return the box with half widths of at least ``least``."""
    centre, half = (lower + upper) / 2, np.maximum((upper - lower) / 2, least)
    return centre - half, centre + half


def _bounded(
    lower: Array, upper: Array, rows: Array, limits: Array, units: Array, names: Sequence[str], t: int
) -> tuple[Array, Array]:
    """Return the box with bounds that follow from the rows where none are stated."""
    low, high = lower.copy(), upper.copy()
    scaled, right = _normalised(rows * units, limits)
    bounds = np.column_stack([lower / units, upper / units])
    for sign, side, word in ((1.0, high, "upper"), (-1.0, low, "lower")):
        for k in np.flatnonzero(~np.isfinite(side)):
            cost = np.zeros(len(units))
            cost[k] = -sign
            answer: Any = linprog(cost, scaled, right, bounds=bounds, method="highs")
            if answer.status == INFEASIBLE:
                side[k] = np.clip(0.0, low[k], high[k])  # no point at all: every domain will turn out empty
            elif answer.status != 0:
                raise UnsupportedError(
                    f"big-M: got no {word} bound of {names[k]} at t = {t}; expected bounded states and controls. "
                    "Give it one in the state, control or initial set."
                )
            else:
                side[k] = units[k] * (answer.x[k] + sign * OUTWARD * max(1.0, abs(answer.x[k])))
    return low, high


def _further_rows(problem: OptimalControlProblem) -> list[tuple[Array, Array]]:
    """Return, for every t < T, hard rows (rows, n+m) and limits that hold for (x_t, u_t) beside bounds and modes."""
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    parts: list[list[tuple[Array, Array]]] = [[(np.zeros((0, n + m)), np.zeros(0))] for _ in range(T)]
    for term in problem.terms:
        if not isinstance(term.map, StageMap) or not isinstance(term.penalty, (Below, Norm)):
            continue
        stage, shape = term.map, term.shape
        C, D = (
            np.broadcast_to(0.0 if matrix is None else matrix, (*shape, columns))
            for matrix, columns in ((stage.C, n), (stage.D, m))
        )
        matrices, constant = np.concatenate([C, D], axis=-1), np.broadcast_to(stage.constant, shape)
        below = isinstance(term.penalty, Below)
        given = (term.penalty.limit, term.penalty.weight) if below else (term.penalty.radius, term.penalty.weight)
        limit, weight = (_per_entry(part, shape, below) for part in given)
        holds = np.isfinite(limit) & np.isinf(weight)
        for g, t in enumerate(stage.times):
            if t < T and holds[g].any():
                for sign in (1.0,) if below else (1.0, -1.0):  # |v_k| <= |v| <= radius, in every norm
                    chosen = holds[g]
                    parts[t].append((sign * matrices[g][chosen], (limit[g] - sign * constant[g])[chosen]))
    return [(np.vstack([rows for rows, _ in part]), np.concatenate([limit for _, limit in part])) for part in parts]


def _per_entry(value: Array, shape: tuple[int, ...], by_entry: bool) -> Array:
    """Return limits or weights (groups, dim), of one per entry or one per group."""
    given = np.asarray(value, dtype=np.float64)
    return np.broadcast_to(given if by_entry else np.broadcast_to(given, shape[:1])[:, None], shape)
