"""The sections NODES and DUAL of a search tree over modes: its masks, and the multipliers and tangent points of leaves.

The masks are those that the judge's reach confirms. Where a node's modes at the time of a split are not all among its
children's, the others lead nowhere: each is a leaf of its own without multipliers. Below a node that reaches nothing
there is nothing to write.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lin_freq_ocp.analysis.mode_tree import ModeMultipliers, ModeTree
from lin_freq_ocp.arrays import Array, Indices, Mask
from lin_freq_ocp.certificate.modes.bound import LeafJudge, reached_nodes
from lin_freq_ocp.certificate.modes.reach import Stages
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.proof.lines import Text, encoded, line


@dataclass(frozen=True, eq=False)
class Node:
    """A node of the file: what it keeps at the time of its parent's split, and the leaf's multipliers, if any."""

    parent: int
    stage: int
    modes: Indices
    stages: Stages | None
    proof: ModeMultipliers | None


def written_nodes(problem: OptimalControlProblem, tree: ModeTree) -> list[Node]:
    """Return the nodes of the file, parents before their children."""
    reached, _ = reached_nodes(problem, tree)
    children: dict[int, list[int]] = {}
    for index, node in enumerate(tree.nodes):
        children.setdefault(node.parent, []).append(index)
    found, waiting = list[Node](), [(0, -1, 0, np.arange(len(problem.piecewise.modes)))]
    while waiting:
        index, parent, t, modes = waiting.pop()
        stages, below = reached[index], children.get(index, [])
        split = stages is not None and below
        found.append(Node(parent, t, modes, stages, None if split else tree.nodes[index].proof))
        if stages is None or not below:
            continue
        number, t = len(found) - 1, tree.nodes[below[0]].stage
        chosen = [np.flatnonzero(tree.nodes[child].allowed[t]) for child in below]
        waiting += [(child, number, t, kept) for child, kept in zip(below, chosen, strict=True)]
        left = np.setdiff1d(np.flatnonzero(stages[t].modes), np.concatenate(chosen))
        found += [Node(number, t, np.array([i]), None, None) for i in left]
    return found


def node_lines(nodes: list[Node]) -> Iterator[str]:
    """Yield the section NODES."""
    yield line(section="nodes", reach=True)
    for number, node in enumerate(nodes):
        parent = Text("null") if node.parent < 0 else node.parent
        yield line(node=number, parent=parent, t=node.stage, modes=node.modes.tolist())


def leaf_stage_lines(problem: OptimalControlProblem, judge: LeafJudge, node: Node) -> Iterator[str]:
    """Yield the stages of a leaf's dual, from T to 0."""
    stages, proof = node.stages, node.proof
    assert stages is not None
    assert proof is not None
    at, eta, T = judge.minimisers(stages, proof), proof.multipliers.eta, problem.horizon
    bounded = np.isfinite(problem.piecewise.arrays(T).h)
    yield line(t=T, z=at.end, eta=eta[T - 1])
    for t in reversed(range(T)):
        fields = {"z": by_edge(at.z[t], at.edges[t], keep=True)}
        fields |= {
            name: text for name, text in multiplier_texts(proof, at.edges[t], bounded[t], t).items() if text != "{}"
        }
        if t:
            fields["eta"] = Text(encoded(eta[t - 1]))
        yield line(**{"t": t}, **fields)


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
    return Text("{" + ", ".join(f"{json.dumps(key)}: {encoded(value)}" for key, value in entries.items()) + "}")
