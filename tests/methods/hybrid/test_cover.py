"""A search that follows that of the step before: its cover has all sequences, its duals prove, its answer is new."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import lin_freq_ocp as lfo
from helpers.compilers import needs_kernel
from helpers.modes import random_problem
from helpers.seeds import seeds
from lin_freq_ocp.methods.hybrid import CoverNode, TreeSearch, shifted_cover, solve_relaxation
from lin_freq_ocp.problem.hybrid import ModeNode
from lin_freq_ocp.program.hybrid import PathRelaxation
from lin_freq_ocp.transform.hybrid import piecewise_affine

FIELDS = {
    "plain": {},
    "band": {"control_spectrum": lfo.stop_band(bins=[2])},
    "rows of the end": {"terminal_state": lfo.sets.Polyhedron([[1, 1], [-1, -1], [1, -1], [-1, 1]], np.full(4, 1.5))},
}


def stepped(problem, disturbance=0.0):
    """Return the search of a problem, the problem after its first step, and that step's later modes."""
    search = TreeSearch(problem)
    found = search.run()
    plan = lfo.solve(problem.with_modes(found.sequence)).trajectory
    return search, problem.with_ends(plan.x[1] + disturbance), np.append(found.sequence[1:], found.sequence[-1])


def leaves(cover: tuple[CoverNode, ...]) -> list[CoverNode]:
    parents = {node.parent for node in cover}
    return [node for index, node in enumerate(cover) if index not in parents]


@needs_kernel
@pytest.mark.parametrize("seed", seeds(range(6)))
def test_each_sequence_is_in_one_leaf_of_the_cover(seed):
    problem = random_problem(seed, horizon=5, kinks=1 + seed % 2)
    search, after, _ = stepped(problem)
    for step in range(3):
        cover, times = search.cover_after_step(), np.arange(5)
        masks = np.array([node.allowed for node in leaves(cover)])
        for sequence in product(range(len(piecewise_affine(problem).modes)), repeat=5):
            assert masks[:, times, sequence].all(axis=1).sum() == 1, (step, sequence)
        search = TreeSearch(after)
        assert search.run(cover=cover).sequence is not None


@pytest.mark.parametrize("first", [0, 1, 2])
def test_modes_that_the_reach_had_left_out_are_covered_again(first):
    """The reach has closed mode 1 at time 2, mode 2 was never possible there; after mode 0, time 0 was split."""
    whole = np.ones((3, 3), dtype=bool)

    def node(parent, t, mode, bound):
        allowed = whole.copy()
        if t >= 0:
            allowed[t] = np.arange(3) == mode
        return ModeNode(parent, t, allowed, bound, None)

    nodes = [node(-1, -1, 0, 0.0), node(0, 2, 0, 1.0), node(0, 2, 1, np.inf), node(1, 0, 0, 2.0), node(1, 0, 1, 3.0)]
    cover = shifted_cover(nodes, [None] * 5, first, lambda duals: duals)
    masks = np.array([leaf.allowed for leaf in leaves(cover)])
    assert len(masks) == 2
    for sequence in product(range(3), repeat=3):
        assert masks[:, np.arange(3), sequence].all(axis=1).sum() == 1, sequence


@needs_kernel
@pytest.mark.parametrize("fields", FIELDS.values(), ids=FIELDS)
@pytest.mark.parametrize("seed", seeds(range(4)))
def test_shifted_duals_prove_less_than_the_optimum_and_not_much_less(seed, fields):
    problem = random_problem(seed, horizon=6, **fields)
    search, after, _ = stepped(problem, 0.01)
    relaxation, best = search.final_relaxation.moved(after), lfo.solve(after).cost
    proven = []
    for node in leaves(search.cover_after_step()):
        reach = relaxation.reach.from_start(node.allowed)
        if reach is not None and node.duals is not None:
            exact = solve_relaxation(relaxation, reach).bound
            proven.append((relaxation.proven(reach, node.duals), exact))
    assert proven
    assert all(bound <= exact + 1e-6 * abs(best) for bound, exact in proven)
    assert min(bound for bound, _ in proven) > best - 0.9 * abs(best)


@pytest.mark.parametrize("seed", seeds(range(3)))
def test_moved_relaxations_are_those_of_the_moved_problem(seed):
    problem = random_problem(seed, horizon=5)
    _, after, _ = stepped(problem)
    moved, new = PathRelaxation(problem).moved(after), PathRelaxation(after)
    everything = np.ones((5, len(piecewise_affine(problem).modes)), dtype=bool)
    bounds = [solve_relaxation(one, one.reach.from_start(everything)).bound for one in (moved, new)]
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-6)


@pytest.mark.parametrize("disturbance", seeds([0.0, 0.02, 1.0]))
def test_a_search_from_a_cover_ends_with_the_same_answer(disturbance):
    """A disturbance of 1 leads into other modes than those that were planned."""
    others = 0
    for seed in range(4):
        search, after, later = stepped(random_problem(seed, horizon=5), disturbance)
        cover = search.cover_after_step()
        found = TreeSearch(after, relaxation=search.final_relaxation).run(later, cover=cover)
        best = lfo.solve(after, throw=False)
        assert (found.sequence is None) == (best.cost is None)
        if best.cost is not None:
            assert found.cost == pytest.approx(best.cost, rel=2e-6)
            others += int(not np.array_equal(found.sequence, later))
    assert others > 0 or disturbance < 1


def test_a_leaf_that_its_bound_closes_is_no_better_sequence():
    """Between the cutoff and the best cost, a solver stops before the point of the leaf is the optimum."""
    problem = random_problem(3, horizon=4)
    search = TreeSearch(problem)
    found = search.run()
    relaxation, best = search.final_relaxation, found.sequence.copy()
    other = best.copy()
    other[-1] = 1 - other[-1]
    reach = relaxation.reach.from_start(other[:, None] == np.arange(2))
    answer = solve_relaxation(relaxation, reach)
    assert answer.bound > found.cost
    width = 0.5 * search.limits.gap * search._scale
    closed = replace(answer, bound=found.cost - 0.5 * width)
    nodes = [ModeNode(-1, -1, reach.allowed, closed.bound, None)]
    search._nodes = nodes
    search._consider(0, closed)
    np.testing.assert_array_equal(search._best, best)
    search._consider(0, replace(answer, bound=found.cost - 2 * width))
    np.testing.assert_array_equal(search._best, other)


def test_without_duals_that_move_there_is_no_cover():
    """Rows of states at all times: shares of modes solve the nodes, and a search from the root needs fewer of them."""
    diamond = lfo.sets.Polyhedron([[1, 1], [-1, -1], [1, -1], [-1, 1]], np.full(4, 1.5))
    search = TreeSearch(random_problem(3, horizon=5, initial_state=[0.3, 0.2], state_set=diamond))
    assert search.run().sequence is not None
    assert search.final_relaxation.proves
    assert search.cover_after_step() == ()
