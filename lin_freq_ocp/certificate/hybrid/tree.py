"""The global lower bound of a piecewise-affine problem: a search tree, checked node by node.

For any multipliers, and any mask of modes with the boxes of its reach,

    J* within the mask >= D = min over sequences (i_t) of the mask of  sum_t phi_t(i_t, i_{t+1}),
    phi_t(i, j) = min over (x, u) in box_ti of
        l_t(x, u) - <e_tij, A_i x + B_i u + d_i> + <lambda_tij, G_i x + H_i u - h_i> + <v_{t-1,i}, x>
        + min over box_{t+1,j} of <nu_tij, x>,        e_tij = eta_t + v_tj + nu_tij,   lambda_tij >= 0,

with l_t of ``certificate.bound`` without its map. v and nu, zero without ``PathMultipliers``, add nothing above zero
along any trajectory: the terms of v cancel from stage to stage, and x_{t+1} is in box_{t+1,j}. D is a shortest path;
edges whose image misses the next box are none. The leaves of a tree cover all sequences, so the least D of all leaves
bounds the cost of every trajectory. Only masks and multipliers are taken from the search.

The boxes are those that every trajectory of a mask stays in, computed apart from the reach of the search. Intervals go
forward in time through the region and the map of each mode. As long as a single mode is possible, zonotopes enclose its
images as well: unlike intervals they do not grow under rotations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.polyhedra import box_minimiser
from lin_freq_ocp.certificate.bound import (
    NEVER_NEGATIVE,
    RIGOROUS,
    Bound,
    box_minimum,
    cost_is_never_negative,
    diagonal_curvature,
)
from lin_freq_ocp.certificate.hamiltonian import Extremal, extremal_at
from lin_freq_ocp.certificate.tolerances import ARITHMETIC_ROUNDING, FINITE, INFINITE, INTERVAL_ROUNDING
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.forms import piecewise_affine
from lin_freq_ocp.problem.hybrid.mode_tree import ModeMultipliers, ModeTree, PathMultipliers
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Stage:
    """The reachable set at a time: the state lies in lower .. upper, and in centre + generators [-1, 1]^count.

    ``modes`` (modes,) can be active; pair_lower, pair_upper (modes, n + m) bound (x, u) in their regions.
    """

    lower: Array
    upper: Array
    centre: Array
    generators: Array
    modes: Mask
    pair_lower: Array
    pair_upper: Array


SIDE_BY_SIDE = 64  # paths in one array: with more, arrays do not fit into the cache
Stages = tuple[Stage, ...]  # T + 1 of them; the last has no modes


class IntervalReach:
    """Forward interval propagation for one problem."""

    def __init__(self, problem: OptimalControlProblem):
        self._problem, arrays = problem, piecewise_affine(problem).arrays(problem.horizon)
        n, tube = problem.state_dim, problem.control_tube
        self._x = np.maximum(problem.state_tube.lower, -INFINITE), np.minimum(problem.state_tube.upper, INFINITE)
        self._u = np.maximum(tube.lower, -INFINITE), np.minimum(tube.upper, INFINITE)
        self._maps, self._offset = arrays.maps, arrays.offset
        self._sizes = np.abs(self._maps)
        self._rising, self._falling = (self._maps + self._sizes) / 2, (self._maps - self._sizes) / 2
        middle, half = (self._u[0] + self._u[1]) / 2, (self._u[1] - self._u[0]) / 2
        self._A, self._pushed = self._maps[..., :n], np.einsum("tkij,tj->tki", arrays.B, middle) + arrays.offset
        self._pushes = arrays.B * half[:, None, None]
        self._rows, self._limits = arrays.rows, np.minimum(arrays.h, INFINITE)
        used = (self._limits < FINITE)[..., None]
        self._above, self._below = (self._rows > 0) & used, (self._rows < 0) & used
        self._divisors = np.where(self._rows == 0, 1.0, self._rows)

    def whole(self) -> Stages | None:
        """Return the stages of all mode sequences, or None if there is no trajectory."""
        (lower, upper), modes, stages = self._x, self._rows.shape[1], list[Stage]()
        for t in range(self._problem.horizon + 1):
            controls = [side[min(t, len(side) - 1)] for side in self._u]  # those of the last stage are not used
            pairs = (np.tile(np.append(x[t], u), (modes, 1)) for x, u in zip(self._x, controls, strict=True))
            stages.append(Stage(lower[t], upper[t], *_zonotope(lower[t], upper[t]), np.ones(modes, dtype=bool), *pairs))
        return None if self._forward([stages], [0], known=False) else tuple(stages)

    def restricted_each(self, choices: Sequence[tuple[Stages, int, Mask]]) -> list[Stages | None]:
        """Return, for each choice, its stages with only these modes (modes,) at a time, or None if they are empty.

        All are propagated in one array, which takes less time.
        """
        paths = [list(before) for before, _, _ in choices]
        for stages, (_, t, modes) in zip(paths, choices, strict=True):
            stages[t] = replace(stages[t], modes=stages[t].modes & modes)
        empty = self._forward(paths, [t for _, t, _ in choices], known=True)
        return [None if index in empty else tuple(stages) for index, stages in enumerate(paths)]

    def _forward(self, paths: list[list[Stage]], firsts: Sequence[int], known: bool) -> set[int]:
        """Propagate paths forward from the first times, in place; return the numbers of empty paths."""
        empty, settled = set[int](), set[int]()
        for t in range(min(firsts, default=0), self._problem.horizon):
            going = [i for i, first in enumerate(firsts) if first <= t and i not in empty and i not in settled]
            for start in range(0, len(going), SIDE_BY_SIDE):
                some = going[start : start + SIDE_BY_SIDE]
                steps = self._step(t, [paths[i][t] for i in some], [paths[i][t + 1] for i in some])
                for i, step in zip(some, steps, strict=True):
                    if step is None:
                        empty.add(i)
                        continue
                    stages, after = paths[i], step[1]
                    stages[t], several = step[0], np.count_nonzero(step[0].modes) > 1
                    same = (after.lower == stages[t + 1].lower).all() and (after.upper == stages[t + 1].upper).all()
                    if known and same and several:
                        settled.add(i)  # nothing changes at later times
                    else:
                        stages[t + 1] = after
        return empty

    def _step(self, t: int, now: Sequence[Stage], after: Sequence[Stage]) -> list[tuple[Stage, Stage] | None]:
        """Return the stages without modes whose image is empty, and the next stages within the other images."""
        n = len(now[0].lower)
        low, high = (np.array([getattr(stage, side) for stage in now]) for side in ("pair_lower", "pair_upper"))
        np.maximum(low[..., :n], np.array([stage.lower for stage in now])[:, None], out=low[..., :n])
        np.minimum(high[..., :n], np.array([stage.upper for stage in now])[:, None], out=high[..., :n])
        low, high, possible = self._cut_boxes(t, low, high)
        # the images of the boxes, as intervals and as zonotopes
        size = (self._sizes[t] @ np.maximum(np.abs(low), np.abs(high))[..., None])[..., 0] + np.abs(self._offset[t])
        rising, falling, rounding = self._rising[t], self._falling[t], INTERVAL_ROUNDING * size
        image_low = (rising @ low[..., None] + falling @ high[..., None])[..., 0] + self._offset[t] - rounding
        image_high = (rising @ high[..., None] + falling @ low[..., None])[..., 0] + self._offset[t] + rounding
        generators = np.zeros((len(now), 1, n, max(stage.generators.shape[1] for stage in now)))
        for i, stage in enumerate(now):
            generators[i, 0, :, : stage.generators.shape[1]] = stage.generators
        generators, pushes = self._A[t] @ generators, np.abs(self._pushes[t]).sum(axis=-1)
        centres = (self._A[t] @ np.array([stage.centre for stage in now])[:, None, :, None])[..., 0] + self._pushed[t]
        radius = np.abs(generators).sum(axis=-1) + pushes
        radius = radius + INTERVAL_ROUNDING * (np.abs(centres) + radius)
        image_low = np.maximum(np.maximum(image_low, centres - radius), np.array([s.lower for s in after])[:, None])
        image_high = np.minimum(np.minimum(image_high, centres + radius), np.array([s.upper for s in after])[:, None])
        possible_modes = np.array([stage.modes for stage in now]) & possible & (image_low <= image_high).all(axis=-1)
        lower = np.where(possible_modes[..., None], image_low, np.inf).min(axis=1)
        upper = np.where(possible_modes[..., None], image_high, -np.inf).max(axis=1)
        steps: list[tuple[Stage, Stage] | None] = []
        for i, (stage, following) in enumerate(zip(now, after, strict=True)):
            left = np.flatnonzero(possible_modes[i])
            if not len(left):
                steps.append(None)
                continue
            stage_now = Stage(
                stage.lower, stage.upper, stage.centre, stage.generators, possible_modes[i], low[i], high[i]
            )
            sets = _zonotope(lower[i], upper[i])
            if len(left) == 1:
                state_generators = generators[i, left[0], :, : stage.generators.shape[1]]
                sets = centres[i, left[0]], np.concatenate([state_generators, self._pushes[t, left[0]]], axis=-1)
            pairs = following.pair_lower, following.pair_upper
            steps.append((stage_now, Stage(lower[i], upper[i], *sets, following.modes, *pairs)))
        return steps

    def _cut_boxes(self, t: int, low: Array, high: Array) -> tuple[Array, Array, Mask]:
        """Return boxes (..., modes, k) cut by the rows of the regions, and which of them have a point."""
        rows, limits, above = self._rows[t], self._limits[t], self._above[t]
        least = np.where(rows > 0, low[..., None, :], high[..., None, :])  # where a row is least
        terms = rows * least
        margin = limits - terms.sum(axis=-1)
        margin += INTERVAL_ROUNDING * (np.abs(terms).sum(axis=-1) + np.abs(limits))
        ends = least + margin[..., None] / self._divisors[t]
        high = np.minimum(high, np.where(above, ends, np.inf).min(axis=-2))
        low = np.maximum(low, np.where(self._below[t], ends, -np.inf).max(axis=-2))
        return np.minimum(low, high), high, (margin >= 0).all(axis=-1) & (low <= high).all(axis=-1)


def _zonotope(lower: Array, upper: Array) -> tuple[Array, Array]:
    return (lower + upper) / 2, np.diag((upper - lower) / 2)


@dataclass(frozen=True, eq=False)
class TreeBound:
    """The bound that a search tree proves.

    Attributes
    ----------
    value : float
        A lower bound on the cost of every trajectory; inf if there is none, -inf if nothing is proven.
    covers : bool
        Whether the leaves cover all mode sequences.
    bounds : (nodes,)
        The bound of every leaf, as its multipliers prove it; NaN for nodes that were split.
    """

    value: float
    covers: bool
    bounds: Array

    @property
    def leaves(self) -> int:
        """Return the number of leaves."""
        return int((~np.isnan(self.bounds)).sum())

    @property
    def weakest(self) -> int:
        """Return the leaf with the least bound."""
        return int(np.nanargmin(self.bounds))

    def bound_for(self, problem: OptimalControlProblem) -> Bound | None:
        """Return the bound of the tree, or that of a cost that is never negative, whichever is better."""
        if self.value < 0 and cost_is_never_negative(problem):
            return Bound(0.0, RIGOROUS, sets=NEVER_NEGATIVE)
        source = f"a search tree of {self.leaves} {'leaf' if self.leaves == 1 else 'leaves'}, each checked"
        return Bound(self.value, RIGOROUS, sets=source) if np.isfinite(self.value) else None


def tree_bound(problem: OptimalControlProblem, tree: ModeTree, end: float = np.inf) -> TreeBound:
    """Check that the leaves of a tree cover all sequences, and compute the bound of the multipliers of each leaf.

    Leaves that are not checked before ``end``, by ``clock.now``, have no bound.
    """
    reached, covers = reached_nodes(problem, tree)
    parents = {node.parent for node in tree.nodes}
    judge, bounds = LeafJudge(problem), np.full(len(tree.nodes), np.nan)
    for index, (node, stages) in enumerate(zip(tree.nodes, reached, strict=True)):
        if index in parents:
            continue
        if stages is None:
            bounds[index] = np.inf
        else:
            late = now() > end
            bounds[index] = -np.inf if node.proof is None or late else judge.bound(stages, node.proof)
    value = float(np.nanmin(bounds)) if covers and len(bounds) else -np.inf
    return TreeBound(value, covers, bounds)


def reached_nodes(problem: OptimalControlProblem, tree: ModeTree) -> tuple[list[Stages | None], bool]:
    """Return the reachable stages of each node (None: empty), and whether the leaves cover all sequences."""
    reach = IntervalReach(problem)
    T, modes = problem.horizon, len(piecewise_affine(problem).modes)
    children: dict[int, list[int]] = {}
    for index, node in enumerate(tree.nodes):
        if node.allowed.shape != (T, modes) or not (-1 <= node.parent < index) or (node.parent < 0) != (index == 0):
            return [None] * len(tree.nodes), False
        children.setdefault(node.parent, []).append(index)
    reached: list[Stages | None] = [reach.whole()] + [None] * (len(tree.nodes) - 1)
    covers = bool(tree.nodes) and _is_covered(reached[0], tree, 0)
    level = [0]
    while level:
        parents = [index for index in level if reached[index] is not None and index in children]
        level = [child for index in parents for child in children[index]]
        choices: list[tuple[Stages, int, Mask]] = []
        others: list[tuple[Stages, int, Mask]] = []
        for index in parents:
            before, times = reached[index], {tree.nodes[child].stage for child in children[index]}
            t = times.pop()
            if before is None or times or not 0 <= t < T:
                return reached, False
            chosen = np.array([tree.nodes[child].allowed[t] for child in children[index]])
            choices += [(before, t, mask) for mask in chosen]
            left = np.flatnonzero(before[t].modes & ~chosen.any(axis=0))
            others += [(before, t, np.arange(modes) == i) for i in left]
        for child, stages in zip(level, reach.restricted_each(choices), strict=True):
            reached[child] = stages
            covers &= _is_covered(stages, tree, child)
        covers &= all(stages is None for stages in reach.restricted_each(others))
    return reached, covers


def _is_covered(stages: Stages | None, tree: ModeTree, index: int) -> bool:
    return stages is None or not (_allowed_modes(stages) & ~tree.nodes[index].allowed).any()


def _allowed_modes(stages: Stages) -> Mask:
    """Return which modes can hold, (T, modes)."""
    return np.array([stage.modes for stage in stages[:-1]])


@dataclass(frozen=True, eq=False)
class Minimisers:
    """Where the minima of D are taken: mode i at t and then j, (x, u) in z (T, modes, modes or 1, n + m), x_T in end.

    ``edges`` (T, modes, modes): which i and j can follow each other; at T - 1, j is 0.
    """

    edges: Mask
    z: Array
    end: Array


class LeafJudge:
    """Evaluates D for many leaves: data that do not depend on the leaf are computed once."""

    def __init__(self, problem: OptimalControlProblem):
        T, n, m, cost = problem.horizon, problem.state_dim, problem.control_dim, problem.quadratic
        named = problem.sampling_time, problem.state_names, problem.control_names  # as bands and terms know them
        at_rest = LinearDynamics(np.zeros((n, n)), np.zeros((n, m)), None, *named)
        self._problem = replace(problem, dynamics=at_rest)
        self._arrays = piecewise_affine(problem).arrays(T)
        self._maps, self._rows = self._arrays.maps, self._arrays.rows
        self._limits = np.where(np.isfinite(self._arrays.h), self._arrays.h, 0.0)
        x = np.broadcast_to(cost.x_ref, (T + 1, n))
        u = np.broadcast_to(cost.u_ref, (T, m))
        self._centre = Trajectory(x, u)
        self._cost = problem.value(x, u)
        self._y = np.hstack([self._centre.x[:-1], self._centre.u])
        self._images = np.einsum("tijk,tk->tij", self._maps, self._y) + self._arrays.offset
        self._slack = np.einsum("tirk,tk->tir", self._rows, self._y) - self._limits
        self._hessians = np.broadcast_to(cost.stage_hessians(), (T, n + m, n + m))
        self._rising, self._falling = np.maximum(self._maps, 0.0), np.minimum(self._maps, 0.0)
        self._shape = T, len(piecewise_affine(problem).modes), n

    @np.errstate(over="ignore", invalid="ignore")
    def bound(self, stages: Stages, proof: ModeMultipliers) -> float:
        """Return D; for eta_C = 0, inf if it is above zero and -inf else."""
        extremal, centre = extremal_at(self._problem, self._centre, proof.multipliers), self._centre
        eta, eta_C = proof.multipliers.eta, proof.multipliers.eta_C
        boxes, last = _boxes_of_stages(stages, self._y, centre.x[-1]), self._shape[2]
        # phi_t(i, j) for every pair of modes, and the sizes of its terms, (T, modes, modes or 1)
        x = centre.x
        ahead, behind, region = self._parts(proof)
        slope, size = self._slopes(extremal, proof)
        hessians = (proof.multipliers.eta_C * self._hessians)[:, None, None]
        minima, spread = _box_minimum(slope, hessians, boxes.low[:-1, :, None], boxes.high[:-1, :, None])
        after = np.zeros((1, 1, 1))
        if proof.paths is not None and proof.paths.images.any():  # the least <nu, x> over the boxes that follow
            images, n = proof.paths.images, self._shape[2]
            low, high = (part[1:, None, :, :n] + x[1:, None, None] for part in (boxes.low, boxes.high))
            after = (images * np.where(images > 0, low, np.where(images < 0, high, 0.0))).sum(axis=-1)
        constants = (region @ self._slack[..., None])[..., 0] - (ahead @ self._images[..., None])[..., 0]
        constants = constants + (behind @ x[:-1, :, None])[..., 0][:, :, None] + after
        sizes = (
            (size * spread).sum(-1) + (region @ np.abs(self._slack)[..., None])[..., 0] + np.abs(minima) + np.abs(after)
        )
        sizes += (np.abs(ahead) @ np.abs(self._images)[..., None])[..., 0]
        sizes += (np.abs(behind) @ np.abs(x[:-1, :, None]))[..., 0][:, :, None]
        lengths = minima + constants
        after = np.zeros(self._shape[1])
        for t, edges in reversed(list(enumerate(self._edges(boxes)))):
            after = np.where(edges, lengths[t] + after, np.inf).min(axis=1)
        rounding = float(np.where(boxes.allowed[..., None], sizes, 0.0).max(axis=(1, 2)).sum())
        end_slope = (extremal.eta_before[-1] - extremal.in_x[-1]).astype(np.float64)
        end_low, end_high = boxes.low[-1, 0, :last], boxes.high[-1, 0, :last]
        final, largest = _box_minimum(end_slope, eta_C * self._problem.quadratic.P, end_low, end_high)
        size_x = np.abs(extremal.eta_before[-1]) + extremal.in_x_terms[-1]
        cost = self._cost if eta_C else 0.0
        gaps = extremal.terms_gap
        at_centre = float((eta * centre.x[1:]).sum())
        at_centre += float((extremal.control_signal * centre.u).sum() + (extremal.state_signal * centre.x).sum())
        rounding += float(size_x.astype(np.float64) @ largest) + abs(float(final)) + abs(cost) + abs(gaps)
        rounding += float((np.abs(eta) * np.abs(centre.x[1:])).sum()) + abs(at_centre)
        rounding += float(sum(term.gap_terms.sum() for term in extremal.terms))
        value = cost - gaps + at_centre + float(after.min()) + float(final) - ARITHMETIC_ROUNDING * rounding
        if eta_C == 0:
            return np.inf if value > 0 else -np.inf
        return value if value == value else -np.inf

    def minimisers(self, stages: Stages, proof: ModeMultipliers) -> Minimisers:
        """Return the minimisers of the stages of D, as far as a box with infinite bounds has them."""
        eta_C, n = proof.multipliers.eta_C, self._shape[2]
        extremal = extremal_at(self._problem, self._centre, proof.multipliers)
        with np.errstate(invalid="ignore"):
            boxes = _boxes_of_stages(stages, self._y, self._centre.x[-1])
        hessians, end = (eta_C * self._hessians)[:, None, None], eta_C * self._problem.quadratic.P
        slope, low, high = self._slopes(extremal, proof)[0], boxes.low[:, :, None], boxes.high[:, :, None]
        v = box_minimiser(slope, hessians, low[:-1], high[:-1])
        slope = (extremal.eta_before[-1] - extremal.in_x[-1]).astype(np.float64)
        last = box_minimiser(slope, end, low[-1, 0, 0, :n], high[-1, 0, 0, :n])
        return Minimisers(self._edges(boxes), v + self._y[:, None, None], last + self._centre.x[-1])

    def _slopes(self, extremal: Extremal, proof: ModeMultipliers) -> tuple[Array, Array]:
        """Return the slopes of phi_t(i, j) at the centre and the sizes of their terms, (T, modes, modes | 1, n + m)."""
        n = self._shape[2]
        ahead, behind, region = self._parts(proof)
        slope_x, slope_u = extremal.eta_before - extremal.in_x, -extremal.in_u
        size_x, size_u = np.abs(extremal.eta_before) + extremal.in_x_terms, extremal.in_u_terms
        slope = np.hstack([slope_x[:-1], slope_u])[:, None, None] - ahead @ self._maps
        slope = (slope + region @ self._rows).astype(np.float64)
        size = np.hstack([size_x[:-1], size_u])[:, None, None] + np.abs(ahead) @ np.abs(self._maps)
        size = (size + region @ np.abs(self._rows)).astype(np.float64)
        slope[..., :n] += behind[:, :, None]
        size[..., :n] += np.abs(behind)[:, :, None]
        return slope, size

    def _parts(self, proof: ModeMultipliers) -> tuple[Array, Array, Array]:
        """Return e_tij, v_{t-1,i} and lambda_tij."""
        T, _, n = self._shape
        parts = proof.paths or PathMultipliers(np.zeros((T, 1, n)), np.zeros((T, 1, 1, n)))
        region_multipliers = proof.region if proof.paths else proof.region[:, :, None]
        region = np.where(np.isfinite(self._arrays.h)[:, :, None], np.maximum(region_multipliers, 0.0), 0.0)
        ahead = proof.multipliers.eta[:, None, None] + parts.vertices[:, None] + parts.images
        behind = np.zeros((T, parts.vertices.shape[1], n))
        behind[1:] = parts.vertices[:-1]
        return ahead, behind, region

    def _edges(self, boxes: _Boxes) -> Mask:
        """Return which modes can follow each other, (T, modes, modes); after the last time, mode 0 represents x_T."""
        n = self._shape[2]
        low, high = (np.clip(part[:-1, ..., None], -INFINITE, INFINITE) for part in (boxes.low, boxes.high))
        least = (self._rising @ low + self._falling @ high)[..., 0] + self._images
        most = (self._rising @ high + self._falling @ low)[..., 0] + self._images
        size = (np.abs(self._maps) @ np.maximum(np.abs(low), np.abs(high)))[..., 0] + np.abs(self._images)
        size = INTERVAL_ROUNDING * (size + np.abs(self._centre.x[1:, None]))
        next_low, next_high = (part[1:, :, :n] + self._centre.x[1:, None] for part in (boxes.low, boxes.high))
        meets = (least - size)[:, :, None] <= next_high[:, None]
        meets &= (most + size)[:, :, None] >= next_low[:, None]
        return boxes.allowed[:, :, None] & boxes.following[:, None] & meets.all(axis=-1)


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Modes (T, modes), those that may follow them, and boxes (T+1, modes, k) around the centre; mode 0 at T."""

    allowed: Mask
    following: Mask
    low: Array
    high: Array


def _boxes_of_stages(reached: Stages, y: Array, last: Array) -> _Boxes:
    allowed = _allowed_modes(reached)
    following = np.zeros_like(allowed)
    following[:-1], following[-1, 0] = allowed[1:], True
    (T, modes), n = allowed.shape, len(last)
    low, high = np.zeros((2, T + 1, modes, y.shape[1]))
    pairs = zip(*((stage.pair_lower, stage.pair_upper) for stage in reached[:-1]), strict=True)
    ends = reached[-1].lower, reached[-1].upper
    for part, bounds, end in zip((low, high), pairs, ends, strict=True):
        part[:-1] = np.where(allowed[..., None], _with_infinities(np.stack(bounds)) - y[:, None], 0.0)
        part[-1, 0, :n] = _with_infinities(end) - last
    return _Boxes(allowed, following, low, high)


def _box_minimum(slope: Array, hessian: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Return a lower bound on slope v + 1/2 v'H v over boxes (..., k), and the largest |v_j| that counts there."""
    curvature = diagonal_curvature(hessian)
    if curvature is None:
        return np.full(slope.shape[:-1], -np.inf), np.zeros_like(slope)
    diagonal = np.array_equal(curvature, np.diagonal(hessian, axis1=-2, axis2=-1))
    v = np.zeros_like(slope) if diagonal else box_minimiser(slope, hessian, low, high)  # any v gives a bound
    gradient = (hessian * v[..., None, :]).sum(-1)
    there = (slope * v).sum(-1) + 0.5 * (v * gradient).sum(-1)
    minimum = there + box_minimum(slope + gradient, curvature, low - v, high - v).sum(-1)
    reachable = np.where(np.isfinite(low) & np.isfinite(high), np.maximum(np.abs(low), np.abs(high)), 0.0)
    return minimum, reachable


def _with_infinities(bound: Array) -> Array:
    return np.where(np.abs(bound) < FINITE, bound, np.sign(bound) * np.inf)
