"""A lower bound on the cost of every trajectory of piecewise-smooth dynamics, by dynamic programming with intervals.

For up to three states. Backwards in time, every cell of a lattice of states gets affine functions V_t below

    min over u of   c_t(x, u) + V_{t+1}(f_t(x, u)),

with any slopes; D is the least of V_0 over X_0. c_t holds the signals of frequency multipliers, which vanish in the sum
over a feasible trajectory, so that for any multipliers D is a bound; its distance to the optimum is then at least the
duality gap of the frequency constraint. The minimum is taken over boxes of (x, u), modes, and cells that the image of a
box meets, each bounded by Taylor's formula of second order with enclosures of f, its gradient and its Hessian. Boxes
with weak bounds are bisected. Where a cell has no width, as a fixed end, the slope is chosen so that the bound is best.

What a box costs beyond V_t is its reduced cost; a trajectory costs at least D and the reduced costs of its boxes. Boxes
that only trajectories above the cutoff go through are dropped, and the cells that are left are halved and bounded
again: soon they are a tube around the best trajectories, however fine the lattice.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.certificate.hybrid.global_bound.lattice import (
    ROUNDING,
    CostToGo,
    Lattice,
    PricedProblem,
    index_tuples,
    stage_costs,
)
from lin_freq_ocp.certificate.hybrid.global_bound.samples import costs_to_come
from lin_freq_ocp.certificate.hybrid.global_bound.step import BackwardStep, Boxes, met_cells, second_order_least
from lin_freq_ocp.formulas.jets import interval_jets
from lin_freq_ocp.formulas.nodes import Formula
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.hybrid.forms import piecewise_smooth

Progress = Callable[[float], None] | None  # told the share of a level that is done
FINEST_CELL = 1e-12  # width over the largest state at which a cell is not halved: it consists of rounding errors

MAX_STATES = 3  # the number of cells grows with this power: four states would need hours
MAX_LATTICE = 4_000_000  # entries of a lattice: the image of a box may meet all of them, at 100 bytes each
LEVEL_BYTES = (
    256 * 2**20
)  # of lattices and boxes of a level to begin with: bisected and halved, they take some times as much
FIRST_CELLS = {1: 50, 2: 8, 3: 4}  # cells of each state on the first level, by the number of states
FIRST_BOXES = 16  # boxes of the controls of a cell on the first level; the root of it for each of two
CUTOFF_MARGIN = 5e-2  # part of the cost by which the first estimate of the cost-to-come may be too large
FIRST_LOSS = 1e-2  # part of the cost that the first level is expected to lose
STEP_SHARE = 0.25  # part of the gap of a level that all steps together may lose in the search for the least


@dataclass(frozen=True, eq=False)
class ValueBound:
    """D of one level, with cells and controls that nearly lead to it and their modes (T,): a start for a search."""

    value: float
    path: Trajectory | None = None
    sequence: Indices | None = None


def value_bounds(
    problem: OptimalControlProblem,
    multipliers: Multipliers,
    cost: float,
    gap: float,
    deadline: float = np.inf,
    progress: Callable[[int, float], None] | None = None,
    scale: float | None = None,
) -> Iterator[ValueBound]:
    """Yield bounds, each as close as the last or closer, until one is cost - gap, or the next level takes LEVEL_BYTES.

    Of the multipliers, eta is not used. The cost is that of a trajectory, inf if none is known: D is a bound for any
    value, but never more than cost - gap / 2. ``scale`` is S, for the loss expected of the first level. ``progress`` is
    called with the number of the level and how much of it is done, from 0 to 1. OutOfTimeError is raised at the
    deadline, by ``clock.now``; UnsupportedError for more than three states, for unbounded components, or if the first
    level takes LEVEL_BYTES.
    """
    costs, T = stage_costs(problem, multipliers), problem.horizon
    scale = scale or max(abs(cost), gap)
    cutoff, best = cost - gap / 2 - costs.constant, -np.inf
    stages = PricedProblem.below(problem, costs, cutoff)
    level, count = _first_level(stages, cost - costs.constant, scale), 0
    while level:
        count += 1
        lost = FIRST_LOSS * scale if best == -np.inf else cost - best
        tolerance = STEP_SHARE * (max(gap, lost) if np.isfinite(cost) else gap) / T
        done = _backward_pass(stages, level, tolerance, deadline, partial(progress, count) if progress else None)
        values = np.concatenate([np.abs(time.value.values[np.isfinite(time.value.values)]) for time in done])
        slack = ROUNDING * T * (costs.size + float(values.max(initial=0.0)))
        path, level = _cheapest_path(done), _next_level(done, cutoff)
        least = cutoff if level == [] else min(float(done[0].value.least.min(initial=np.inf)), cutoff)
        best = max(best, least + costs.constant - slack)
        del done, values
        yield ValueBound(best, *path)
        if best >= cost - gap or least == np.inf:
            return


@dataclass(frozen=True, eq=False)
class _Task:
    """The boxes to be bounded at a time; those above ``target`` (cells,), an estimate of c + V, are not bisected.

    ``left`` (cells,) is the cutoff less the least cost-to-come of the level before, None on the first level; ``before``
    is V_t of that level and ``parents`` (cells,) its cells, None at t = 0.
    """

    lattice: Lattice
    boxes: Boxes
    target: Array
    left: Array | None = None
    before: CostToGo | None = None
    parents: Indices | None = None

    def cutoff(self, slopes: Array) -> Array:
        """Return c + V - slopes (x - centre) of trajectories above the cutoff at least, (cells, pieces).

        They cost the cost-to-come less V_t(x) before t, at least, with V_t of the level before.
        """
        if self.left is None:
            return np.full(slopes.shape[:2], np.inf)
        if self.before is None or self.parents is None:
            return self.left[:, None] + self.lattice.variation(slopes)
        return self.left[:, None] + self.before.most(self.parents, self.lattice, slopes)


@dataclass(frozen=True, eq=False)
class _Done:
    """V_t, boxes, and the least reduced cost-to-go from each box and each cell: (boxes,), (cells,)."""

    value: CostToGo
    boxes: Boxes
    to_go: Array
    to_go_of_cells: Array


def _first_level(stages: PricedProblem, cost: float, scale: float) -> list[_Task]:
    """Return the tasks of the first level: in every cell and mode, a grid of boxes of the controls."""
    problem, m, lattices = stages.problem, stages.problem.control_dim, _lattices(stages)
    each, modes = max(1, round(FIRST_BOXES ** (1 / m))), len(piecewise_smooth(problem).modes)
    room = LEVEL_BYTES
    tasks: list[_Task] = []
    for time, (lattice, to_come) in enumerate(zip(lattices, costs_to_come(stages, lattices), strict=True)):
        t, x = min(time, problem.horizon - 1), lattice.centres
        width = (stages.upper[t] - stages.lower[t]) / each
        u = stages.lower[t] + (index_tuples(np.full(m, each)) + 0.5) * width
        centre = np.hstack([np.repeat(x, len(u), axis=0), np.tile(u, (len(x), 1))])
        widths = np.concatenate([lattice.width, width])
        radius = np.where(widths > 0, widths / 2 * (1 + ROUNDING) + ROUNDING * np.abs(centre), 0.0)
        boxes = Boxes.unbounded(
            np.tile(np.repeat(np.arange(len(x)), len(u)), modes),
            np.repeat(np.arange(modes), len(centre)),
            np.tile(centre, (modes, 1)),
            np.tile(radius, (modes, 1)),
            problem.state_dim,
        )
        room -= boxes.bytes
        if room < 0:
            text = f"no global bound: {problem.horizon} steps do not fit into memory; shorten the horizon."
            raise UnsupportedError(text)
        target = cost - to_come + CUTOFF_MARGIN * scale if np.isfinite(cost) else np.full(len(to_come), np.inf)
        tasks.append(_Task(lattice, boxes, target))
    return tasks


def _lattices(stages: PricedProblem) -> list[Lattice]:
    """Return the lattice of cells over the reachable set at each time."""
    problem, n = stages.problem, stages.problem.state_dim
    if n > MAX_STATES:
        raise UnsupportedError(f"no global bound: got {n} states; expected at most {MAX_STATES}.")
    lower, upper, bounds = stages.lowest[0], stages.highest[0], list[tuple[Array, Array]]()
    for t in range(problem.horizon + 1):
        for j in np.flatnonzero(~np.isfinite(lower) | ~np.isfinite(upper)):
            raise UnsupportedError(f"no global bound: {problem.state_names[j]} is not bounded at t = {t}; bound it.")
        bounds.append((lower, upper))
        if t == problem.horizon:
            break
        box = [np.append(part, bound[t])[None] for part, bound in ((lower, stages.lower), (upper, stages.upper))]
        for j in np.flatnonzero(~np.isfinite(box[0][0, n:]) | ~np.isfinite(box[1][0, n:])):
            raise UnsupportedError(f"no global bound: {problem.control_names[j]} is not bounded; bound it.")
        images = [interval_jets(mode.f, box[0], box[1], time=t).values for mode in piecewise_smooth(problem).modes]
        lower = np.maximum(np.min([image[0][0] for image in images], axis=0), stages.lowest[t + 1])
        upper = np.minimum(np.max([image[1][0] for image in images], axis=0), stages.highest[t + 1])
        upper = np.maximum(lower, upper)  # where that is empty, no image will meet the cell
    finest = FINEST_CELL * np.abs(bounds).max(axis=(0, 1))
    return [Lattice.full(lower, upper, finest, FIRST_CELLS[n]) for lower, upper in bounds]


def _backward_pass(
    stages: PricedProblem, level: list[_Task], tolerance: float, deadline: float, progress: Progress
) -> list[_Done]:
    """Return V_t and boxes for all times; the level is used up."""
    # of the terminal cost, the tangents at the centres: below it, as it is convex
    x, P = level[-1].lattice.centres, stages.costs.terminal_hessian
    linear, everywhere = stages.costs.terminal_linear, np.full(x.shape, np.inf)
    values = 0.5 * np.einsum("ci,ij,cj->c", x, P, x) + x @ linear
    values, slopes = values - ROUNDING * np.abs(values), x @ P + linear
    for formula in stages.problem.cost.formulas[1:]:
        if formula is not None:
            value, slope = terminal_minorants(formula, level[-1].lattice)
            values, slopes = values + value - ROUNDING * np.abs(value), slopes + slope
    last = CostToGo(level[-1].lattice, values[:, None], slopes[:, None], -everywhere, everywhere)
    none = level[-1].boxes.take(np.zeros(0, dtype=np.intp))
    done = [_Done(last, none, np.zeros(0), np.zeros(len(last.values)))]
    level.pop()
    T = len(level)
    for t in range(T - 1, -1, -1):
        task, after = level.pop(), done[-1]
        step = BackwardStep(stages, t, task.lattice, after.value, deadline)
        slopes, reached = step.slopes(task.boxes)
        target = np.minimum(reached - tolerance, task.target[:, None] + task.lattice.variation(slopes))
        value, boxes = step.values(task.boxes, slopes, target, task.cutoff(slopes), tolerance, LEVEL_BYTES // T)
        to_go = np.full(len(boxes.cell), np.inf)
        for box, cell in met_cells(boxes, after.value):
            np.minimum.at(to_go, box, after.to_go_of_cells[cell])
        to_go += boxes.reduced
        of_cells = np.full(len(value.values), np.inf)
        np.minimum.at(of_cells, boxes.cell, to_go)
        done.append(_Done(value, boxes, to_go, of_cells))
        if progress is not None:
            progress(1 - t / T)
    return done[::-1]


def terminal_minorants(formula: Formula, lattice: Lattice) -> tuple[Array, Array]:
    """Return affine functions below a terminal cost on all cells: values at their centres and slopes, (cells, n)."""
    (n, m), x = formula.dimensions, np.pad(lattice.centres, ((0, 0), (0, formula.dimensions[1])))
    half = lattice.width * (0.5 + ROUNDING) + ROUNDING * np.abs(lattice.centres)
    r = np.pad(half, ((0, 0), (0, m)))
    whole, centre = interval_jets([formula], x - r, x + r), interval_jets([formula], x, x, curved=False)
    slopes, none = 0.5 * (centre.slopes[0] + centre.slopes[1])[:, 0], np.zeros_like(r)
    lost = (0.5 * (centre.slopes[1] - centre.slopes[0])[:, 0] * r).sum(axis=1)
    curved = second_order_least([none, none], [part[:, 0].copy() for part in whole.curvatures], r)
    return centre.values[0][:, 0] - lost + np.minimum(curved, 0.0), slopes[:, :n]


def _cheapest_path(done: list[_Done]) -> tuple[Trajectory, Indices] | tuple[None, None]:
    """Return the centres of cells, controls and modes of boxes with the least reduced cost-to-go."""
    cell = int(np.argmin(done[0].value.least))
    x, u, modes = [done[0].value.lattice.centres[cell]], list[Array](), list[int]()
    for now, after in pairwise(done):
        rows = np.flatnonzero((now.boxes.cell == cell) & np.isfinite(now.to_go))
        if not len(rows):
            return None, None
        box = now.boxes.take(rows[[int(np.argmin(now.to_go[rows]))]])
        cells = np.concatenate([cell for _, cell in met_cells(box, after.value)])
        centres = after.value.lattice.centres[cells]
        far = np.abs(centres - 0.5 * (box.low + box.high)).sum(axis=1)
        nearest = np.lexsort([far, after.to_go_of_cells[cells]])[0]
        cell = int(cells[nearest])
        x.append(centres[nearest])
        u.append(box.centre[0, len(x[0]) :])
        modes.append(int(box.mode[0]))
    return Trajectory(np.array(x), np.array(u)), np.array(modes, dtype=np.intp)


def _next_level(done: list[_Done], cutoff: float) -> list[_Task] | None:
    """Return the halves of cells that a trajectory below the cutoff may go through; [] if none, None if too many."""
    to_come, room = done[0].value.least, float(LEVEL_BYTES)
    tasks: list[_Task] = []
    for t, (now, following) in enumerate(zip(done, [*done[1:], None], strict=True)):
        boxes = now.boxes.take(to_come[now.boxes.cell] + now.to_go < cutoff)
        alive = np.zeros(len(to_come), dtype=bool)
        alive[boxes.cell] = True
        if following is None:
            alive = to_come < cutoff
        if not alive.any():
            return []
        lattice, parents = now.value.lattice.halved(alive)
        entries, halves = lattice.shape.prod(), 1 << _spans_cell(boxes, now.value.lattice).sum(axis=1)
        room -= entries * lattice.cells.itemsize + halves.sum() / max(len(halves), 1) * boxes.bytes
        if room < 0 or entries > MAX_LATTICE:
            return None
        halves, target = _halve_cells(boxes, now.value.lattice, lattice, alive), np.full(len(parents), np.inf)
        if t == 0:
            tasks.append(_Task(lattice, halves, target, np.full(len(parents), cutoff)))
        else:
            tasks.append(_Task(lattice, halves, target, cutoff - to_come[parents], now.value, parents))
        if following is not None:
            reached = np.full(len(following.value.values), np.inf)
            for box, cell in met_cells(boxes, following.value):
                np.minimum.at(reached, cell, (to_come[boxes.cell] + boxes.reduced)[box])
            to_come = reached
    return tasks


def _spans_cell(boxes: Boxes, lattice: Lattice) -> Mask:
    """Whether boxes are as wide as their cells along each state in which these are halved, (boxes, n)."""
    return (boxes.radius[:, : len(lattice.width)] > lattice.width / 3) & (lattice.split > 1)


def _halve_cells(boxes: Boxes, coarse: Lattice, fine: Lattice, alive: Mask) -> Boxes:
    """Return the parts of boxes in each half of their cells."""
    n, split = len(coarse.width), coarse.split
    corners = index_tuples(split)
    rank = np.cumsum(alive) - 1
    whole = _spans_cell(boxes, coarse)
    side = boxes.centre[:, :n] > coarse.centres[boxes.cell]
    parts: list[Boxes] = []
    for i, corner in enumerate(corners):
        rows = np.flatnonzero((whole | (side == corner.astype(bool)) | (split == 1)).all(axis=1))
        cell = rank[boxes.cell[rows]] * len(corners) + i
        part, spans_cell = boxes.take(rows), whole[rows]
        half = fine.width / 2 * (1 + ROUNDING) + ROUNDING * np.abs(fine.centres[cell])
        part.centre[:, :n] = np.where(spans_cell, fine.centres[cell], part.centre[:, :n])
        part.radius[:, :n] = np.where(spans_cell, half, part.radius[:, :n])
        parts.append(Boxes.unbounded(cell, part.mode, part.centre, part.radius, n))
    return Boxes.joined(parts)
