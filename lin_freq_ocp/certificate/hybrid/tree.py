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

Of a cost that is never negative, a trajectory that costs less than a level stays near its references: where a diagonal
of curvatures m is below the Hessians, m/2 (x - x_ref)^2 of any time is less than the level. Beside bounds that are far
from a small motion, that box is the region to search. J* is at least the least of D within the box and the level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.polyhedra import box_minimiser
from lin_freq_ocp.certificate.bound import NEVER_NEGATIVE, RIGOROUS, Bound, box_minimum
from lin_freq_ocp.certificate.hamiltonian import Extremal, diagonal_curvature, extremal_at
from lin_freq_ocp.certificate.reach import cost_is_never_negative
from lin_freq_ocp.certificate.tolerances import (
    ARITHMETIC_ROUNDING,
    FINITE,
    INFINITE,
    INTERVAL_ROUNDING,
    RADIUS_MARGIN,
    STATE_ROUNDING,
)
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.hybrid.levels import cost_unit
from lin_freq_ocp.problem.hybrid.mode_tree import ModeMultipliers, ModeTree, PathMultipliers
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.transform.hybrid.forms import boxes_of_steps, piecewise_affine
from lin_freq_ocp.transform.limits import replace_bounds


@dataclass(frozen=True, eq=False)
class ReachedSets:
    """The reachable sets of a mask of modes: at each time the state lies in a box, lower .. upper (T+1, n).

    ``modes`` (T, modes) can be active; pair_lower, pair_upper (T, modes, n + m) bound (x, u) in their regions.
    """

    lower: Array
    upper: Array
    modes: Mask
    pair_lower: Array
    pair_upper: Array


SIDE_BY_SIDE = 64  # masks in one array: with more, arrays do not fit into the cache


class IntervalReach:
    """Forward interval propagation for one problem.

    ``whole`` are the stages of all mode sequences, None if there is no trajectory; each of their states also lies in
    the zonotope of its time, centre + generators [-1, 1]^count.
    """

    def __init__(self, problem: OptimalControlProblem):
        arrays, T = piecewise_affine(problem).arrays(problem.horizon), problem.horizon
        x = np.maximum(problem.state_tube.lower, -INFINITE), np.minimum(problem.state_tube.upper, INFINITE)
        self._maps, self._offset, n, pairs = arrays.maps, arrays.offset, problem.state_dim, boxes_of_steps(problem)
        u = [side[..., n:] for side in pairs]
        self._sizes = np.abs(self._maps)
        self._rising, self._falling = (self._maps + self._sizes) / 2, (self._maps - self._sizes) / 2
        middle, half = (u[0] + u[1]) / 2, (u[1] - u[0]) / 2
        self._A, self._pushed = self._maps[..., :n], np.einsum("tkij,tkj->tki", arrays.B, middle) + arrays.offset
        self._pushes = arrays.B * half[:, :, None]
        self._push_sizes = np.abs(self._pushes).sum(axis=-1)
        self._rows, self._limits = arrays.rows, np.minimum(arrays.h, INFINITE)
        used = (self._limits < FINITE)[..., None]
        self._above, self._below = (self._rows > 0) & used, (self._rows < 0) & used
        self._divisors = np.where(self._rows == 0, 1.0, self._rows)
        everything = np.ones((1, T, self._rows.shape[1]), dtype=bool)
        stated = ReachedSets(*x, everything[0], *pairs)
        self.zonotopes = [((x[0][0] + x[1][0]) / 2, np.diag((x[1][0] - x[0][0]) / 2))]
        self.whole = self._propagate(stated, everything, np.zeros(1, dtype=int), np.full(1, T))[0]

    def restricted_each(self, masks: Mask) -> list[ReachedSets | None]:
        """Return the stages of each mask (count, T, modes), or None if they are empty."""
        whole, found = self.whole, list[ReachedSets | None]()
        if whole is None:
            return [None] * len(masks)
        for start in range(0, len(masks), SIDE_BY_SIDE):
            some = masks[start : start + SIDE_BY_SIDE]
            changed: Mask = np.asarray((whole.modes & ~some).any(axis=2))
            last = changed.shape[1] - 1 - changed[:, ::-1].argmax(axis=1)
            found += self._propagate(whole, some, np.where(changed.any(axis=1), changed.argmax(axis=1), last + 1), last)
        return found

    def _propagate(self, within: ReachedSets, masks: Mask, first: Indices, last: Indices) -> list[ReachedSets | None]:
        """Propagate masks side by side, each of which restricts known stages at times from first to last, (count,).

        Their zonotopes are those of this object, to which those of the first mask are added where they are not known.
        """
        (count, T, _), n, m = masks.shape, within.lower.shape[1], self._pushes.shape[-1]
        modes, paths = within.modes & masks, np.arange(count)
        lower, upper, low, high = (
            np.repeat(part[None], count, axis=0)
            for part in (within.lower, within.upper, within.pair_lower, within.pair_upper)
        )
        going, empty, sizes = np.ones(count, dtype=bool), np.zeros(count, dtype=bool), np.zeros(count, dtype=int)
        centres, generators = np.zeros((count, n)), np.zeros((count, n, n + m * T))  # of which ``sizes`` are used
        for t in range(T):
            for i in np.flatnonzero(first == t):
                centres[i], known = self.zonotopes[t]
                sizes[i] = known.shape[1]
                generators[i, :, : sizes[i]] = known
            at = paths[(first <= t) & going]
            if not len(at):
                continue
            box_low, box_high, possible = self._cut_boxes(
                t,
                np.concatenate([np.maximum(low[at, t, :, :n], lower[at, None, t]), low[at, t, :, n:]], axis=-1),
                np.concatenate([np.minimum(high[at, t, :, :n], upper[at, None, t]), high[at, t, :, n:]], axis=-1),
            )
            # the images of the boxes, as intervals and as zonotopes
            ends, rising, falling, offset = (box_low, box_high), self._rising[t], self._falling[t], self._offset[t]
            size = (self._sizes[t] @ np.maximum(*map(np.abs, ends))[..., None])[..., 0] + np.abs(offset)
            image_low = (rising @ box_low[..., None] + falling @ box_high[..., None])[..., 0] + offset
            image_high = (rising @ box_high[..., None] + falling @ box_low[..., None])[..., 0] + offset
            image_low, image_high = image_low - INTERVAL_ROUNDING * size, image_high + INTERVAL_ROUNDING * size
            centre = (self._A[t] @ centres[at, None, :, None])[..., 0] + self._pushed[t]
            spread = self._A[t] @ generators[at, None, :, : sizes[at].max()]
            radius = np.abs(spread).sum(axis=-1) + self._push_sizes[t]
            radius = radius + INTERVAL_ROUNDING * (np.abs(centre) + radius)
            before = lower[at, t + 1], upper[at, t + 1]
            image_low = np.maximum(np.maximum(image_low, centre - radius), before[0][:, None])
            image_high = np.minimum(np.minimum(image_high, centre + radius), before[1][:, None])
            left = modes[at, t] & possible & (image_low <= image_high).all(axis=-1)
            modes[at, t], low[at, t], high[at, t] = left, box_low, box_high
            lower[at, t + 1] = np.where(left[..., None], image_low, np.inf).min(axis=1)
            upper[at, t + 1] = np.where(left[..., None], image_high, -np.inf).max(axis=1)
            number = left.sum(axis=1)
            empty[at] = number == 0
            same = (lower[at, t + 1] == before[0]).all(axis=1) & (upper[at, t + 1] == before[1]).all(axis=1)
            going[at] = (number > 0) & ~(same & (number > 1) & (last[at] <= t))  # else nothing changes at later times
            # the zonotope of the image of a single mode; of several, the box around them
            only, single, several = left.argmax(axis=1), np.flatnonzero(number == 1), np.flatnonzero(number > 1)
            one, used = at[single], spread.shape[3]
            generators[at] = 0.0
            generators[one, :, :used] = spread[single, only[single]]
            pushes = self._pushes[t, only[single]].swapaxes(1, 2)
            generators[one[:, None], :, sizes[one, None] + np.arange(m)] = pushes
            centres[one], sizes[one] = centre[single, only[single]], sizes[one] + m
            many = at[several]
            box = lower[many, t + 1], upper[many, t + 1]
            generators[many[:, None], np.arange(n), np.arange(n)] = (box[1] - box[0]) / 2
            centres[many], sizes[many] = (box[0] + box[1]) / 2, n
            if len(self.zonotopes) == t + 1 and going[0]:
                self.zonotopes.append((centres[0].copy(), generators[0, :, : sizes[0]].copy()))
        return [
            None if empty[i] else ReachedSets(lower[i], upper[i], modes[i], low[i], high[i]) for i in paths.tolist()
        ]

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

    def bound_for(self, problem: OptimalControlProblem) -> Bound | None:
        """Return the bound of the tree, or that of a cost that is never negative, whichever is better."""
        if self.value < 0 and cost_is_never_negative(problem):
            return Bound(0.0, RIGOROUS, sets=NEVER_NEGATIVE)
        source = f"a search tree of {self.leaves} {'leaf' if self.leaves == 1 else 'leaves'}, each checked"
        return Bound(self.value, RIGOROUS, sets=source) if np.isfinite(self.value) else None


def within_level(problem: OptimalControlProblem, level: float) -> OptimalControlProblem:
    """Return the problem with bounds that every trajectory of a cost below the level satisfies."""
    boxes = level_boxes(problem, level)
    if boxes is None:
        return problem
    state_set, control_set = map(replace_bounds, (problem.state_set, problem.control_set), boxes)
    return problem.derived(state_set=state_set, control_set=control_set)


def level_boxes(problem: OptimalControlProblem, level: float) -> tuple[Box, Box] | None:
    """Return bounds of states, (T+1, n), and controls, (T, m), of all trajectories that cost less than the level.

    None if the cost may be negative, or if the controls have levels of their own.
    """
    negative = problem.cost.has_formulas or not cost_is_never_negative(problem)
    if level == np.inf or negative or problem.level_sizes.any():
        return None
    T, n, m, cost = problem.horizon, problem.state_dim, problem.control_dim, problem.quadratic
    of_stage, of_end = diagonal_curvature(cost.stage_hessians), diagonal_curvature(cost.P)
    if of_stage is None or of_end is None:
        return None
    of_stage = np.broadcast_to(of_stage, (T, n + m))
    tubes, sides = (problem.state_boxes, problem.control_tube), list[Box]()
    curvatures = np.vstack([of_stage[:, :n], of_end]), of_stage[:, n:]
    for tube, curvature, reference in zip(tubes, curvatures, (cost.x_ref, cost.u_ref), strict=True):
        far = np.full(curvature.shape, np.inf)
        radius = RADIUS_MARGIN * np.sqrt(np.divide(2 * level, curvature, out=far, where=curvature > 0))
        radius += STATE_ROUNDING * np.abs(reference)
        # a side without a bound keeps none: which problems the search takes does not depend on their size
        pairs = ((given, reference + side) for given, side in zip(tube.bounds, (-radius, radius), strict=True))
        limits = (np.where(np.isinf(given), given, np.clip(end, tube.lower, tube.upper)) for given, end in pairs)
        sides.append(Box(*limits))
    return sides[0], sides[1]


def tree_bound(problem: OptimalControlProblem, tree: ModeTree, end: float = np.inf) -> TreeBound:
    """Check that the leaves of a tree cover all sequences, and compute the bound of the multipliers of each leaf.

    Leaves that are not checked before ``end``, by ``clock.now``, have no bound.
    """
    problem = within_level(problem, tree.level)
    reached, covers = reached_nodes(problem, tree)
    parents = {node.parent for node in tree.nodes}
    leaves = [index for index in range(len(tree.nodes)) if index not in parents]
    bounds, proven = np.full(len(tree.nodes), np.nan), dict[int, tuple[ReachedSets, ModeMultipliers]]()
    for index in leaves:
        stages, proof = reached[index], tree.nodes[index].proof
        bounds[index] = np.inf if stages is None else -np.inf
        if stages is not None and proof is not None:
            proven[index] = stages, proof
    bounds[list(proven)] = LeafJudge(problem).bounds(list(proven.values()), end)
    unit, error = cost_unit(problem)
    if unit > 0:  # the least cost that is no lower
        bounds = np.maximum(bounds, np.ceil((bounds - error) / unit) * unit - error)
    value = min(float(np.nanmin(bounds)), tree.level) if covers and len(bounds) else -np.inf
    return TreeBound(value, covers, bounds)


def reached_nodes(problem: OptimalControlProblem, tree: ModeTree) -> tuple[list[ReachedSets | None], bool]:
    """Return the reachable stages of each node (None: empty), and whether the leaves cover all sequences."""
    nodes, (T, modes) = tree.nodes, (problem.horizon, len(piecewise_affine(problem).modes))
    children: dict[int, list[int]] = {}
    for index, node in enumerate(nodes):
        if node.allowed.shape != (T, modes) or not (-1 <= node.parent < index) or (node.parent < 0) != (index == 0):
            return [None] * len(nodes), False
        children.setdefault(node.parent, []).append(index)
    # the masks that the splits leave, and for each split one of each mode that no child has
    masks, others = np.ones((len(nodes), T, modes), dtype=bool), list[tuple[int, Mask]]()
    unclear = list[int]()
    for index in range(len(nodes)):
        below = children.get(index, [])
        times = {nodes[child].stage for child in below}
        if not below:
            continue
        t = times.pop()
        if times or not 0 <= t < T:
            unclear.append(index)
            continue
        chosen = np.array([nodes[child].allowed[t] for child in below])
        masks[below] = masks[index]
        masks[below, t] &= chosen
        for i in np.flatnonzero(masks[index, t] & ~chosen.any(axis=0)):
            others.append((index, masks[index].copy()))
            others[-1][1][t] = np.arange(modes) == i
    found = IntervalReach(problem).restricted_each(np.concatenate([masks, *(mask[None] for _, mask in others)]))
    reached, left = found[: len(nodes)], found[len(nodes) :]
    covers = bool(nodes) and all(
        stages is None or not (stages.modes & ~node.allowed).any() for stages, node in zip(reached, nodes, strict=True)
    )
    covers &= all(reached[index] is None for index in unclear)
    return reached, covers and all(stages is None for stages in left)


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
        self._problem = problem.with_dynamics(at_rest)
        self._arrays = piecewise_affine(problem).arrays(T)
        self._maps, self._rows = self._arrays.maps, self._arrays.rows
        self._sizes = np.abs(self._maps), np.abs(self._rows)
        self._bounded = np.isfinite(self._arrays.h)
        x = np.broadcast_to(cost.x_ref, (T + 1, n))
        u = np.broadcast_to(cost.u_ref, (T, m))
        self._centre = Trajectory(x, u)
        self._cost = problem.value(x, u)
        self._y = np.hstack([self._centre.x[:-1], self._centre.u])
        self._images = np.einsum("tijk,tk->tij", self._maps, self._y) + self._arrays.offset
        limits = np.where(self._bounded, self._arrays.h, 0.0)
        self._slack = np.einsum("tirk,tk->tir", self._rows, self._y) - limits
        hessians = np.broadcast_to(cost.stage_hessians, (T, n + m, n + m))[:, None, None]
        self._hessians = _Hessians(hessians), _Hessians(cost.P)
        self._rising, self._falling = np.maximum(self._maps, 0.0), np.minimum(self._maps, 0.0)
        self._shape = T, len(piecewise_affine(problem).modes), n

    def bounds(self, leaves: Sequence[tuple[ReachedSets, ModeMultipliers]], end: float = np.inf) -> Array:
        """Return D of each leaf; for eta_C = 0, inf if it is above zero and -inf else.

        Leaves that are not checked before ``end``, by ``clock.now``, have -inf.
        """
        found, groups = np.full(len(leaves), -np.inf), dict[tuple[float, bool], list[int]]()
        for index, (_, proof) in enumerate(leaves):  # leaves in one array have multipliers of the same shapes
            groups.setdefault((proof.multipliers.eta_C, proof.paths is None), []).append(index)
        for (eta_C, _), group in groups.items():
            for start in range(0, len(group), LEAVES_SIDE_BY_SIDE):
                some = group[start : start + LEAVES_SIDE_BY_SIDE]
                if now() <= end:
                    found[some] = self._bounds([leaves[index] for index in some], eta_C)
        return found

    @np.errstate(over="ignore", invalid="ignore")
    def _bounds(self, leaves: Sequence[tuple[ReachedSets, ModeMultipliers]], eta_C: float) -> Array:
        """Return D of leaves side by side, the first axis of all arrays."""
        parts, centre, n = self._leaf_parts(leaves), self._centre, self._shape[2]
        boxes, last, x = parts.boxes, self._y.shape[1] - centre.u.shape[1], centre.x
        # phi_t(i, j) for every pair of modes, and the sizes of its terms, (leaves, T, modes, modes or 1)
        slope, size = self._slopes(parts)
        low, high = boxes.low[:, :-1, :, None], boxes.high[:, :-1, :, None]
        minima, spread = self._hessians[0].least(eta_C, slope, low, high)
        after = np.zeros((1, 1, 1, 1))
        if parts.images.any():  # the least <nu, x> over the boxes that follow
            low, high = (part[:, 1:, None, :, :n] + x[1:, None, None] for part in (boxes.low, boxes.high))
            after = (parts.images * np.where(parts.images > 0, low, np.where(parts.images < 0, high, 0.0))).sum(axis=-1)
        constants = (parts.region @ self._slack[..., None])[..., 0] - (parts.ahead @ self._images[..., None])[..., 0]
        constants = constants + (parts.behind @ x[:-1, :, None])[..., 0][..., None] + after
        sizes = (size * spread).sum(-1) + (parts.region @ np.abs(self._slack)[..., None])[..., 0]
        sizes += np.abs(minima) + np.abs(after) + (np.abs(parts.ahead) @ np.abs(self._images)[..., None])[..., 0]
        sizes += (np.abs(parts.behind) @ np.abs(x[:-1, :, None]))[..., 0][..., None]
        lengths = minima + constants
        after = np.zeros((len(leaves), self._shape[1]))
        for t, edges in reversed(list(enumerate(np.moveaxis(self._edges(boxes), 1, 0)))):
            after = np.where(edges, lengths[:, t] + after[:, None], np.inf).min(axis=2)
        rounding = np.where(boxes.allowed[..., None], sizes, 0.0).max(axis=(2, 3)).sum(axis=1)
        extremals = parts.extremals
        end_slope = np.array([e.slopes[-1, :last] for e in extremals]).astype(np.float64)
        end_box = boxes.low[:, -1, 0, :last], boxes.high[:, -1, 0, :last]
        final, largest = self._hessians[1].least(eta_C, end_slope, *end_box)
        values = np.empty(len(leaves))
        for k, extremal in enumerate(extremals):
            eta, gaps, cost = extremal.multipliers.eta, extremal.terms_gap, self._cost if eta_C else 0.0
            size_x = extremal.slope_terms[-1, :last]
            at_centre = float((eta * centre.x[1:]).sum())
            at_centre += sum(extremal.frequency_terms)
            terms = float(rounding[k]) + float(size_x.astype(np.float64) @ largest[k]) + abs(float(final[k]))
            terms += abs(cost) + abs(gaps) + float((np.abs(eta) * np.abs(centre.x[1:])).sum()) + abs(at_centre)
            terms += float(sum(term.gap_terms.sum() for term in extremal.terms))
            value = cost - gaps + at_centre + float(after[k].min()) + float(final[k]) - ARITHMETIC_ROUNDING * terms
            values[k] = value
        if eta_C == 0:
            return np.where(values > 0, np.inf, -np.inf)
        return np.where(np.isnan(values), -np.inf, values)

    def minimisers(self, stages: ReachedSets, proof: ModeMultipliers) -> Minimisers:
        """Return the minimisers of the stages of D, as far as a box with infinite bounds has them."""
        eta_C, n = proof.multipliers.eta_C, self._shape[2]
        with np.errstate(invalid="ignore"):
            parts = self._leaf_parts([(stages, proof)])
        (of_stage, of_end), boxes, extremal = self._hessians, parts.boxes, parts.extremals[0]
        slope, low, high = self._slopes(parts)[0][0], boxes.low[0, :, :, None], boxes.high[0, :, :, None]
        v = box_minimiser(slope, eta_C * of_stage.hessian, low[:-1], high[:-1])
        slope = extremal.slopes[-1, :n].astype(np.float64)
        last = box_minimiser(slope, eta_C * of_end.hessian, low[-1, 0, 0, :n], high[-1, 0, 0, :n])
        return Minimisers(self._edges(boxes)[0], v + self._y[:, None, None], last + self._centre.x[-1])

    def _leaf_parts(self, leaves: Sequence[tuple[ReachedSets, ModeMultipliers]]) -> _LeafParts:
        """Return e_tij, v_{t-1,i}, nu_tij and lambda_tij of leaves, with what else their bounds are made of."""
        (T, modes, n), proofs = self._shape, [proof for _, proof in leaves]
        paths = [proof.paths or PathMultipliers(np.zeros((T, 1, n)), np.zeros((T, 1, 1, n))) for proof in proofs]
        vertices, images = np.array([part.vertices for part in paths]), np.array([part.images for part in paths])
        region = np.array([proof.region if proof.paths else proof.region[:, :, None] for proof in proofs])
        behind = np.zeros((len(leaves), T, vertices.shape[2], n))
        behind[:, 1:] = vertices[:, :-1]
        eta = np.array([proof.multipliers.eta for proof in proofs])
        # boxes around the centre, and the modes that may follow each other; mode 0 at T
        reached, y = [stages for stages, _ in leaves], self._y
        allowed = np.array([stages.modes for stages in reached])
        following = np.zeros_like(allowed)
        following[:, :-1], following[:, -1, 0] = allowed[:, 1:], True
        low, high = np.zeros((2, len(leaves), T + 1, modes, y.shape[1]))
        pairs = ((stages.pair_lower, stages.pair_upper, stages.lower[-1], stages.upper[-1]) for stages in reached)
        of_low, of_high, end_low, end_high = (np.array(part) for part in zip(*pairs, strict=True))
        for part, bounds, end in ((low, of_low, end_low), (high, of_high, end_high)):
            part[:, :-1] = np.where(allowed[..., None], _with_infinities(bounds) - y[:, None], 0.0)
            part[:, -1, 0, :n] = _with_infinities(end) - self._centre.x[-1]
        return _LeafParts(
            extremals=[extremal_at(self._problem, self._centre, proof.multipliers) for proof in proofs],
            ahead=eta[:, :, None, None] + vertices[:, :, None] + images,
            behind=behind,
            images=images,
            region=np.where(self._bounded[:, :, None], np.maximum(region, 0.0), 0.0),
            boxes=_Boxes(allowed, following, low, high),
        )

    def _slopes(self, parts: _LeafParts) -> tuple[Array, Array]:
        """Return the slopes of phi_t(i, j) at the centre and their terms' sizes, (leaves, T, modes, modes | 1, k)."""
        n, extremals = self._shape[2], parts.extremals
        at_centre, terms = [e.slopes[:-1] for e in extremals], [e.slope_terms[:-1] for e in extremals]
        slope, size = (np.array(part).astype(np.float64)[:, :, None, None] for part in (at_centre, terms))
        slope = slope - parts.ahead @ self._maps + parts.region @ self._rows
        size = size + np.abs(parts.ahead) @ self._sizes[0] + parts.region @ self._sizes[1]
        slope[..., :n] += parts.behind[..., None, :]
        size[..., :n] += np.abs(parts.behind)[..., None, :]
        return slope, size

    def _edges(self, boxes: _Boxes) -> Mask:
        """Return which modes can follow each other, (leaves, T, modes, modes); after the last time, mode 0 for x_T."""
        n = self._shape[2]
        low, high = (np.clip(part[:, :-1, ..., None], -INFINITE, INFINITE) for part in (boxes.low, boxes.high))
        least = (self._rising @ low + self._falling @ high)[..., 0] + self._images
        most = (self._rising @ high + self._falling @ low)[..., 0] + self._images
        size = (self._sizes[0] @ np.maximum(np.abs(low), np.abs(high)))[..., 0] + np.abs(self._images)
        size = INTERVAL_ROUNDING * (size + np.abs(self._centre.x[1:, None]))
        next_low, next_high = (part[:, 1:, :, :n] + self._centre.x[1:, None] for part in (boxes.low, boxes.high))
        meets = (least - size)[:, :, :, None] <= next_high[:, :, None]
        meets &= (most + size)[:, :, :, None] >= next_low[:, :, None]
        return boxes.allowed[..., None] & boxes.following[:, :, None] & meets.all(axis=-1)


LEAVES_SIDE_BY_SIDE = 32  # leaves in one array: with more, arrays do not fit into the cache


@dataclass(frozen=True, eq=False)
class _Boxes:
    """Of leaves: modes (leaves, T, modes), those that may follow, boxes (leaves, T+1, modes, k) around the centre."""

    allowed: Mask
    following: Mask
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class _LeafParts:
    """Parts of D of several leaves: e, v of the time before, nu and lambda of the head of the file, and the rest."""

    extremals: Sequence[Extremal]
    ahead: Array
    behind: Array
    images: Array
    region: Array
    boxes: _Boxes


class _Hessians:
    """1/2 v'H v for Hessians (..., k, k), to be minimised over boxes with slopes."""

    def __init__(self, hessian: Array):
        self.hessian, self._curvature = hessian, diagonal_curvature(hessian)
        own = np.diagonal(hessian, axis1=-2, axis2=-1)
        self._diagonal = self._curvature is not None and np.array_equal(self._curvature, own)

    def least(self, eta_C: float, slope: Array, low: Array, high: Array) -> tuple[Array, Array]:
        """Return a lower bound on slope v + eta_C/2 v'H v over boxes (..., k), and the largest |v_j| counting there."""
        if eta_C < 0 or (self._curvature is None and eta_C):
            return np.full(slope.shape[:-1], -np.inf), np.zeros_like(slope)
        curvature = np.zeros(()) if self._curvature is None else eta_C * self._curvature
        reachable = np.where(np.isfinite(low) & np.isfinite(high), np.maximum(np.abs(low), np.abs(high)), 0.0)
        if self._diagonal or not eta_C:
            return box_minimum(slope, curvature, low, high).sum(-1), reachable
        hessian = eta_C * self.hessian
        v = box_minimiser(slope, hessian, low, high)  # any v gives a bound
        gradient = (hessian * v[..., None, :]).sum(-1)
        there = (slope * v).sum(-1) + 0.5 * (v * gradient).sum(-1)
        return there + box_minimum(slope + gradient, curvature, low - v, high - v).sum(-1), reachable


def _with_infinities(bound: Array) -> Array:
    return np.where(np.abs(bound) < FINITE, bound, np.sign(bound) * np.inf)
