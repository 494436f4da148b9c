"""Branch and bound over mode sequences, with incumbents from rounding and from flips of modes.

A node is a mask of modes. Its relaxation bounds the cost of all sequences within. The next node is the newest until a
first sequence is found, and then the one with the least bound. It is split at the time at which the relaxed step misses
the true dynamics most, weighted by the adjoint. A node is closed if its bound comes within the gap of the best sequence
found; its multipliers prove that.

In a control loop, a search begins with a cover of all mode sequences. After a step, the tree of the problem before is
shifted by one time: splits at time 0 are dropped, with all nodes that have another mode there; masks and duals move to
the time before; the last time is new, with all modes (Marcucci and Tedrake, IEEE TAC 66(6), 2021). Modes that the reach
excluded come back, since the state may be disturbed. Every path of splits still has a node for each mode, so that the
cover holds all sequences, whichever mode at time 0 is followed.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lin_freq_ocp.base.arrays import Indices, Mask
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import NumericalError
from lin_freq_ocp.methods.hybrid.search.common import (
    TOLERANCES,
    SearchLimits,
    SearchOutcome,
    SearchProgress,
    one_mode_each,
    solve_relaxation,
    tree_with_proofs,
)
from lin_freq_ocp.methods.hybrid.search.level_rounding import level_rounding
from lin_freq_ocp.methods.hybrid.search.node import NodeSolution
from lin_freq_ocp.problem.hybrid.levels import cost_unit
from lin_freq_ocp.problem.hybrid.mode_tree import ModeNode
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.program.hybrid.path_relaxation import PathRelaxation
from lin_freq_ocp.program.hybrid.relaxation import ModeRelaxation
from lin_freq_ocp.program.hybrid.rows import Duals
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine
from lin_freq_ocp.transform.hybrid.mode_reach import Reach
from lin_freq_ocp.transform.simulation import simulate
from lin_freq_ocp.transform.sizes import search_scale

Shift = Callable[[Duals], Duals | None]


@dataclass(frozen=True, eq=False)
class CoverNode:
    """A node: its parent and the time at which that was split (-1 for the root), its mask, and duals for a leaf."""

    parent: int
    stage: int
    allowed: Mask
    duals: Duals | None


def shifted_cover(
    nodes: Sequence[ModeNode], duals: Sequence[Duals | None], first: int, shift: Shift
) -> tuple[CoverNode, ...]:
    """Return the cover that a tree leaves after a step in mode ``first``; ``shift`` moves duals by one time."""
    children: dict[int, list[int]] = {}
    for index, node in enumerate(nodes[1:], start=1):
        if node.bound < np.inf or duals[index] is not None:  # the reach alone has closed the others
            children.setdefault(node.parent, []).append(index)
    cover: list[CoverNode] = []
    pending = [(0, -1, -1, np.ones_like(nodes[0].allowed))]
    while pending:
        index, parent, stage, mask = pending.pop()
        descendants = children.get(index, [])
        while descendants and nodes[descendants[0]].stage == 0:
            followed = [child for child in descendants if nodes[child].allowed[0, first]]
            index = followed[0] if followed else -1  # -1: a leaf of which nothing is known
            descendants = children.get(index, [])
        leaf_duals = None if descendants or index < 0 else duals[index]
        cover.append(CoverNode(parent, stage, mask, None if leaf_duals is None else shift(leaf_duals)))
        if descendants:
            split, position = nodes[descendants[0]].stage, len(cover) - 1
            chosen = [nodes[child].allowed[split] for child in descendants]
            pending += [
                (child, position, split - 1, _restrict_at(mask, split - 1, row))
                for child, row in zip(descendants, chosen, strict=True)
            ]
            others = ~np.any(chosen, axis=0)
            if others.any():
                pending.append((-1, position, split - 1, _restrict_at(mask, split - 1, others)))
    return tuple(cover)


def _restrict_at(mask: Mask, t: int, row: Mask) -> Mask:
    restricted = mask.copy()
    restricted[t] &= row
    return restricted


SHARE_OF_GAP = 0.5  # part of the gap at which leaves are closed; the rest is for the tolerance of a node's solver
ROUNDING_EVERY = 8  # nodes between two attempts to round a relaxed point to a sequence, once there is a sequence
INTERRUPTED_SEARCH = "interrupted"  # message of a search that Ctrl-C ended
CURVED_LOSS = 0.1  # part of d'H d in the loss of a step that misses by d: fewer nodes than with all or none of it

OpenNode = tuple[float, int, NodeSolution]  # bound, index, relaxation


@dataclass
class TreeSearch:
    """One search; ``run`` it once."""

    problem: OptimalControlProblem
    limits: SearchLimits = field(default_factory=SearchLimits)
    progress: Callable[[SearchProgress], None] | None = None
    relaxation: ModeRelaxation | None = None  # of a problem that starts elsewhere

    def __post_init__(self):
        self._started = now()
        given = self.relaxation
        self._relaxation = given.moved(self.problem) if given else PathRelaxation(self.problem, self.limits.level)
        self._arrays, self._rounding = self._relaxation.reach.arrays, level_rounding(self.problem)
        self._nodes: list[ModeNode] = []
        self._duals: list[Duals | None] = []
        self._heap: list[OpenNode] = []
        self._best: Indices | None = None
        self._cost, self._scale, self._unit = np.inf, 0.0, cost_unit(self.problem)[0]
        self._tried: set[bytes] = set()
        self._solved, self._next_rounding = 0, 0
        self._setup = now() - self._started

    def run(
        self,
        start: Indices | None = None,
        within: Reach | None = None,
        until_open: float = np.inf,
        cover: Sequence[CoverNode] = (),
    ) -> SearchOutcome:
        """Search from a sequence (T,), within a reach; stop when ``until_open`` nodes are open (see ``open_nodes``).

        With a cover of all sequences, begin at its leaves.
        """
        self._until_open, message = until_open, ""
        modes, parents = np.arange(len(piecewise_affine(self.problem).modes)), {node.parent for node in cover}
        sequences = [] if start is None else [start]
        leaves = [index for index in range(len(cover)) if index not in parents]
        try:
            masks = [sequence[:, None] == modes for sequence in sequences] + [cover[index].allowed for index in leaves]
            reaches = self._relaxation.reach.from_start_each(masks)  # all at once: a single one takes as long as ten
            self._try(sequences, reaches)
            if cover:
                message = self._open_cover(cover, dict(zip(leaves, reaches[len(sequences) :], strict=True)))
            else:
                everything = np.ones((self.problem.horizon, len(modes)), dtype=bool)
                reach = self._relaxation.reach.from_start(everything) if within is None else within
                root = None if reach is None else self._relax_node(reach, self._cutoff)
                self._open([(everything, root)], -1, -1, -np.inf)
        except KeyboardInterrupt:
            message = INTERRUPTED_SEARCH
        return self._finish(message)

    def resume(self, seconds: float) -> SearchOutcome:
        """Continue a search that stopped at its time limit, for so many more seconds."""
        self.limits = replace(self.limits, share=(now() - self._started + seconds) / self.limits.seconds)
        return self._finish("")

    def _finish(self, message: str) -> SearchOutcome:
        """Search to the end, unless a message says that a limit was reached, and return the outcome."""
        try:
            message = message or self._loop()
        except KeyboardInterrupt:
            message = INTERRUPTED_SEARCH
        tree = tree_with_proofs(self._relaxation, self._nodes, self._duals)
        resume, interrupted = None, message == INTERRUPTED_SEARCH
        if message == self.limits.out_of_time and self._heap:
            resume = self.resume
        return SearchOutcome(self._best, self._cost, tree, message, interrupted, self._solved, self._setup, resume)

    @property
    def final_relaxation(self) -> ModeRelaxation:
        """Return the relaxations of the problem searched."""
        return self._relaxation

    def cover_after_step(self) -> tuple[CoverNode, ...]:
        """Return the cover that the tree leaves for the problem one time later.

        Empty if nothing was found, or if no duals move with it: then a search from the root solves fewer nodes.
        """
        relaxation = self._relaxation
        if self._best is None or not self._nodes or not isinstance(relaxation, PathRelaxation) or not relaxation.proves:
            return ()
        cover = shifted_cover(self._nodes, self._duals, int(self._best[0]), relaxation.later)
        return cover if any(node.duals is not None for node in cover) else ()

    def _loop(self) -> str:
        """Split the node with the least bound until none is open; return which limit stopped the search, or ""."""
        while self._heap and self._heap[0][0] < self._cutoff and len(self._heap) < self._until_open:
            message = self.limits.reached(now() - self._started, self._solved)
            if message:
                return message
            if self._best is None:  # dive: split the newest node until a sequence is found
                newest = max(range(len(self._heap)), key=lambda position: self._heap[position][1])
                bound, index, answer = self._heap.pop(newest)
                heapq.heapify(self._heap)
            else:
                bound, index, answer = heapq.heappop(self._heap)
            if self.progress is not None:
                least, seconds = min(bound, self._heap[0][0]) if self._heap else bound, now() - self._started
                self.progress(SearchProgress(self._cost, least, self._solved, len(self._heap), seconds))
            # a child for each of the modes left at some time
            t = self._stage_to_split(answer)
            masks = one_mode_each(answer.reach.allowed, t)
            reaches = self._relaxation.reach.after(answer.reach, t, [mask[t] for mask in masks])
            solutions = [None if reach is None else self._relax_node(reach, self._cutoff) for reach in reaches]
            self._open(list(zip(masks, solutions, strict=True)), index, t, bound)
        leaves = (node for node in self._nodes if (node.allowed.sum(axis=1) == 1).all())
        if any(node.bound == -np.inf for node in leaves):  # the time was over before one was solved
            return self.limits.reached(now() - self._started, self._solved)
        return ""

    @property
    def open_nodes(self) -> list[tuple[int, Reach]]:
        """Return the nodes still to be split, the least bound first."""
        return [(index, answer.reach) for bound, index, answer in sorted(self._heap) if bound < self._cutoff]

    def _open_cover(self, cover: Sequence[CoverNode], reaches: Mapping[int, Reach | None]) -> str:
        """Add the nodes of a cover, whose leaves have reaches; solve the leaves that their duals leave open.

        Those with the least bound come first.
        """
        nodes = [ModeNode(node.parent, node.stage, node.allowed, -np.inf, None) for node in cover]
        duals, open_ = list[Duals | None](None for _ in cover), list[tuple[float, int, Reach]]()
        claims = dict[int, tuple[Reach, Duals]]()
        for index, reach in reaches.items():
            start_duals = cover[index].duals
            if reach is not None and start_duals is not None:
                claims[index] = reach, start_duals
        proven = dict(zip(claims, self._relaxation.proven_each(list(claims.values())).tolist(), strict=True))
        for index, reach in reaches.items():
            bound = np.inf if reach is None else proven.get(index, -np.inf)
            duals[index] = claims[index][1] if index in claims else None
            nodes[index] = replace(nodes[index], bound=bound)
            if reach is not None and bound < np.inf:
                open_.append((bound, index, reach))
        self._nodes, self._duals = nodes, duals
        for bound, index, reach in sorted(open_, key=lambda one: one[:2]):
            message = self.limits.reached(now() - self._started, self._solved)
            if message:
                return message
            if bound < self._cutoff:
                answer = self._relax_node(reach, self._cutoff)
                if answer.bound >= bound:  # else the duals that the cover brought prove more
                    self._duals[index] = answer.duals
                bound = max(bound, answer.bound)
                self._nodes[index] = replace(self._nodes[index], allowed=reach.allowed, bound=bound)
                self._consider(index, answer)
        return ""

    def _open(self, answers: list[tuple[Mask, NodeSolution | None]], parent: int, stage: int, bound: float) -> None:
        """Add nodes, all at once so that an interrupt leaves none out, and look in each for better sequences."""
        first, inherited = len(self._nodes), self._duals[parent] if parent >= 0 else None
        for allowed, answer in answers:
            if answer is None:
                self._nodes.append(ModeNode(parent, stage, allowed, np.inf, None))
                self._duals.append(None)
            else:
                self._nodes.append(ModeNode(parent, stage, answer.reach.allowed, max(bound, answer.bound), None))
                # those of the parent also hold for the child, and may prove more than those of a rough solution
                self._duals.append(answer.duals if answer.duals and answer.bound >= bound else inherited)
        if parent >= 0:
            self._duals[parent] = None
        for index, (_, answer) in enumerate(answers, start=first):
            if answer is not None:
                self._consider(index, answer)

    def _consider(self, index: int, answer: NodeSolution) -> None:
        """Try the sequences that a node suggests, and keep it for splitting unless its bound closes it."""
        bound = self._nodes[index].bound
        if bound == np.inf:
            return
        if answer.sequence is not None:
            if answer.bound < self._cutoff:  # else its solver stopped there, and its point is not the optimum
                self._accept(answer.sequence, answer)
            return
        if bound < self._cutoff:
            heapq.heappush(self._heap, (bound, index, answer))
            if index >= self._next_rounding or self._best is None:
                self._try(self._round_answer(answer))
                self._next_rounding = index + ROUNDING_EVERY

    def _round_answer(self, answer: NodeSolution) -> Iterator[Indices]:
        """Yield levels near the relaxed controls; without levels, the largest weights and the modes of a simulation."""
        if answer.trajectory is None or answer.weights is None:
            return
        if self._rounding is not None:
            start, end = answer.trajectory.x[0], self._started + self.limits.search_seconds
            yield self._rounding.sequence_near(answer.trajectory.u, self.problem.initial_box.project(start), end)
            return
        yield np.argmax(np.where(answer.reach.allowed, answer.weights, -1.0), axis=1)
        try:
            replayed = simulate(self.problem, answer.trajectory.u, answer.trajectory.x[0])
        except NumericalError:  # the controls lead out of all regions
            return
        yield self._arrays.active(replayed.x, replayed.u).argmax(axis=1)

    def _try(self, sequences: Iterable[Indices], reaches: Sequence[Reach | None] = ()) -> None:
        """Solve sequences until one is the best so far; ``reaches`` are those of the first of them."""
        before, modes = self._best, np.arange(len(piecewise_affine(self.problem).modes))
        for number, sequence in enumerate(sequences):
            if self._best is not before or now() - self._started > self.limits.search_seconds:
                return
            if sequence.tobytes() not in self._tried:
                self._tried.add(sequence.tobytes())
                known, mask = number < len(reaches), sequence[:, None] == modes
                reach = reaches[number] if known else self._relaxation.reach.from_start(mask)
                if reach is not None:
                    self._accept(sequence, self._relax_node(reach, self._cost))

    def _accept(self, sequence: Indices, answer: NodeSolution) -> None:
        """Keep a sequence if it is the best so far, and try those with one mode flipped across a facet.

        The facets with the largest multipliers come first.
        """
        if answer.trajectory is None or answer.duals is None or not answer.bound < self._cost:
            return
        self._cost, self._best = answer.bound, sequence
        self._scale = search_scale(self.problem, answer.trajectory)
        largest = self._relaxation.multipliers(answer.duals).region_along(sequence).max(axis=1, initial=0.0)
        active = self._arrays.active(answer.trajectory.x, answer.trajectory.u)
        flips = list[Indices]()
        for t in (t for t in np.argsort(-largest) if largest[t] > 0):
            for mode in np.flatnonzero(active[t]):
                flips.append(sequence.copy())
                flips[-1][t] = mode
        self._try(flip for flip in flips if (flip != sequence).any())

    def _stage_to_split(self, answer: NodeSolution) -> int:
        """Return the time, of those with several modes left, with the largest estimated loss of the relaxation.

        A relaxed step that misses the true dynamics by d changes the cost by about <|eta_t|, |d|> and a part of d'H d.
        """
        several, duals = answer.reach.allowed.sum(axis=1) > 1, answer.duals
        if answer.trajectory is None or answer.weights is None or duals is None:
            return int(np.argmax(several))
        x, u = answer.trajectory.x, answer.trajectory.u
        nearest = np.argmin(self._arrays.distance(x, u), axis=1)
        images = self._arrays.images(x, u)[np.arange(len(u)), nearest]
        miss, eta = np.abs(x[1:] - images), self._relaxation.adjoint(duals)
        loss = (miss * np.abs(eta)).sum(axis=1) + CURVED_LOSS * miss**2 @ self._relaxation.state_curvature
        undecided = 1 - answer.weights.max(axis=1)
        return int(np.lexsort((undecided, np.where(several, loss, -1.0)))[-1])

    @property
    def _cutoff(self) -> float:
        if not np.isfinite(self._cost):
            return np.inf
        share = SHARE_OF_GAP * self.limits.gap * self._scale
        return self._cost - max(share, self._unit - share)

    def _relax_node(self, reach: Reach, cutoff: float) -> NodeSolution:
        self._solved += 1
        end = self._started + self.limits.search_seconds
        return solve_relaxation(self._relaxation, reach, TOLERANCES, end, cutoff)
