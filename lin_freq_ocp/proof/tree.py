"""The sections NODES and DUAL of a search tree over modes: its masks, and the multipliers and tangent points of leaves.

The masks are those that the judge's reach confirms. If the children of a node do not have all of its modes at the time
of a split, no trajectory has the other modes: each is a leaf of its own without multipliers. Below a node that reaches
nothing there is nothing to write.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask
from lin_freq_ocp.certificate.hybrid.tree import LeafJudge, ReachedSets, reached_nodes
from lin_freq_ocp.problem.hybrid.mode_tree import ModeMultipliers, ModeTree
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.bands import time_signal
from lin_freq_ocp.proof.dual import domain_multipliers, signal_lines
from lin_freq_ocp.proof.statement import Text, Value, encode, line, multiplier_lines
from lin_freq_ocp.transform.hybrid.forms import piecewise_affine
from lin_freq_ocp.transform.limits import replace_bounds
from lin_freq_ocp.transform.reformulations import at_frequencies


@dataclass(frozen=True, eq=False)
class WrittenNode:
    """A node of the file: its modes at the time of its parent's split, and the multipliers if it is a leaf."""

    parent: int
    stage: int
    modes: Indices
    stages: ReachedSets | None
    proof: ModeMultipliers | None


def written_nodes(problem: OptimalControlProblem, tree: ModeTree) -> list[WrittenNode]:
    """Return the nodes of the file, parents before their children, of a problem within the level of the tree."""
    reached, _ = reached_nodes(problem, tree)
    children: dict[int, list[int]] = {}
    for index, node in enumerate(tree.nodes):
        children.setdefault(node.parent, []).append(index)
    found, waiting = list[WrittenNode](), [(0, -1, 0, np.arange(len(piecewise_affine(problem).modes)))]
    while waiting:
        index, parent, t, modes = waiting.pop()
        stages, below = reached[index], children.get(index, [])
        split = stages is not None and below
        found.append(WrittenNode(parent, t, modes, stages, None if split else tree.nodes[index].proof))
        if stages is None or not below:
            continue
        number, t = len(found) - 1, tree.nodes[below[0]].stage
        chosen = [np.flatnonzero(tree.nodes[child].allowed[t]) for child in below]
        waiting += [(child, number, t, kept) for child, kept in zip(below, chosen, strict=True)]
        left = np.setdiff1d(np.flatnonzero(stages.modes[t]), np.concatenate(chosen))
        found += [WrittenNode(number, t, np.array([i]), None, None) for i in left]
    return found


def sequence_problem(problem: OptimalControlProblem, sequence: Indices) -> OptimalControlProblem:
    """Return the linear problem of a mode sequence, with the fewest rows: a point must be strictly inside each.

    Rows of a single control are bounds, which may fix it (a level); those that a fixed x_0 decides are left out.
    """
    alone, remaining = problem.with_modes(sequence), list[StageRows]()
    T, free = problem.horizon, ~alone.state_tube.fixed[0]
    lower, upper = (_over_time(part, T, 1) for part in (alone.control_tube.lower, alone.control_tube.upper))
    for rows in alone.stage_rows:
        C, D, limits = (_over_time(part, T, ndim) for part, ndim in ((rows.C, 2), (rows.D, 2), (rows.e, 1)))
        limits[0, ~C[0][:, free].any(axis=1) & ~D[0].any(axis=1)] = np.inf
        single = ~C.any(axis=2) & (np.count_nonzero(D, axis=2) == 1) & np.isfinite(limits) & (rows.penalty is None)
        for t, i in np.argwhere(single):
            j = int(np.flatnonzero(D[t, i])[0])
            bound = limits[t, i] / D[t, i, j]
            if D[t, i, j] > 0:
                upper[t, j] = min(upper[t, j], bound)
            else:
                lower[t, j] = max(lower[t, j], bound)
        remaining.append(StageRows(rows.C, rows.D, np.where(single, np.inf, limits), rows.name, rows.penalty))
    controls = replace_bounds(alone.control_set, Box(lower, upper))
    return alone.derived(stage_rows=remaining, control_set=controls) if remaining else alone


def _over_time(part: Array, T: int, ndim: int) -> Array:
    """Return values that may be constant as an array over time of its own."""
    return np.array(np.broadcast_to(part, (T, *part.shape[-ndim:])))


@dataclass(frozen=True, eq=False)
class TreeDual:
    """The nodes of a search for costs below a level, and the multipliers of its leaves; the problem is within it."""

    problem: OptimalControlProblem
    nodes: list[WrittenNode]
    level: float

    def lines(self) -> Iterator[str]:
        """Yield the sections NODES and DUAL."""
        yield line(section="nodes", reach=True, **({"level": self.level} if self.level < np.inf else {}))
        for number, node in enumerate(self.nodes):
            parent = None if node.parent < 0 else node.parent
            yield line(node=number, parent=parent, t=node.stage, modes=node.modes.tolist())
        judge = LeafJudge(self.problem)
        for number, node in enumerate(self.nodes):
            if node.proof is not None and node.stages is not None:
                yield from _leaf_lines(self.problem, judge, number, node.stages, node.proof)


def _leaf_lines(
    problem: OptimalControlProblem, judge: LeafJudge, number: int, stages: ReachedSets, proof: ModeMultipliers
) -> Iterator[str]:
    """Yield the dual of a leaf."""
    given, at = proof.multipliers, judge.minimisers(stages, proof)
    problem, eta, T = at_frequencies(problem, given.frequencies), given.eta, problem.horizon
    yield line(section="dual", node=number, cost=int(given.eta_C > 0))
    yield from signal_lines(0, problem.in_time(given.rho_x)[: problem.state_samples])
    yield from signal_lines(problem.state_dim, time_signal(given.rho_u, T))
    yield from multiplier_lines(problem.terms, domain_multipliers(problem.terms, given))
    yield line(t=T, z=at.end, eta=eta[T - 1])
    bounded = np.isfinite(piecewise_affine(problem).arrays(T).h)
    for t in reversed(range(T)):
        fields: dict[str, Value] = {"z": by_edge(at.z[t], at.edges[t], keep=True)}
        texts = multiplier_texts(proof, at.edges[t], bounded[t], t)
        fields |= {name: text for name, text in texts.items() if text != "{}"}
        if t:
            fields["eta"] = eta[t - 1]
        yield line(t=t, **fields)


def multiplier_texts(proof: ModeMultipliers, edges: Mask, bounded: Mask, t: int) -> dict[str, Text]:
    """Return the multipliers of a stage that depend on modes; bounded (modes, rows): which rows there are."""
    paths, region = proof.paths, np.maximum(proof.region[t], 0.0)
    if paths is None:
        return {"region": by_edge(region[:, None], edges, bounded)}
    texts = {"region": by_edge(region, edges, bounded), "image": by_edge(paths.images[t], edges)}
    if t:
        before = paths.vertices[t - 1]
        texts["vertex"] = as_object({f"{i}": before[i] for i in np.flatnonzero(edges.any(axis=1)) if before[i].any()})
    return texts


def by_edge(values: Array, edges: Mask, used: Mask | None = None, keep: bool = False) -> Text:
    """Return values (modes, modes or 1, k) of pairs of modes, with zeros only if these are kept.

    Of each mode only the entries ``used`` (modes, k).
    """
    entries, several = dict[str, Array](), values.shape[1] > 1
    for i, j in np.argwhere(edges):
        value = values[i, j if several else 0]
        value = value if used is None else value[used[i]]
        if keep or value.any():
            entries[f"{i},{j}" if several else f"{i}"] = value
    return as_object(entries)


def as_object(entries: dict[str, Array]) -> Text:
    """Return numbers by key as JSON."""
    return Text("{" + ", ".join(f"{json.dumps(key)}: {encode(value)}" for key, value in entries.items()) + "}")
