"""Proofs of searches over modes: every leaf is checked, and modes that no child keeps are leaves that reach nothing."""

import re
from dataclasses import replace

import numpy as np
import pytest
from flint import arb_mat

import lin_freq_ocp as lfo
from helpers.hand_proofs import check, text, two_modes
from helpers.seeds import expensive, seeds
from lin_freq_ocp.proof import lfo_check, proof_of, written_nodes
from lin_freq_ocp.testing import PIECEWISE_AFFINE

GAP = 1e-6  # relative, of the search


def confirmed(result, folder):
    """Return the interval that the checker makes of the written proof."""
    result.write_proof(folder / "run.proof")
    with (folder / "run.proof").open("rb") as file:
        return [float(end) for end in lfo_check.check(file, lambda text: None)]


@pytest.mark.parametrize("name", seeds(PIECEWISE_AFFINE))
def test_the_interval_has_the_known_optimum(name, tmp_path):
    system, arguments, known = PIECEWISE_AFFINE[name]
    result = lfo.solve(lfo.library.by_name(system)(**arguments))
    lower, upper = confirmed(result, tmp_path)
    assert upper - lower <= GAP * abs(upper)
    if known is not None:
        assert lower - 1e-7 * abs(known) <= known <= upper + 1e-7 * abs(known)


def test_twenty_steps_of_the_rotation():
    proven = lfo.solve(lfo.library.switched_rotation(horizon=20)).enclosure
    assert 0 < proven.width <= GAP * proven.upper


@expensive
def test_enumerated_sequences_are_a_tree_too():
    problem = lfo.library.buck_affine(horizon=5)
    one, other = (lfo.solve(problem, method).enclosure for method in ("enumerate", "branch_and_bound"))
    assert one.lower <= other.upper
    assert other.lower <= one.upper


def test_levels_of_the_control():
    dynamics = lfo.LinearDynamics([[1.0, 0.5], [0.0, 1.0]], [[0.125], [0.5]])
    levels = lfo.sets.FiniteSet([[-1.0, 0.0, 1.0]])
    problem = lfo.OptimalControlProblem(
        dynamics, 4, lfo.QuadraticCost(Q=1.0, R=0.25, P=4.0), control_set=levels, initial_state=[1.0, 0.25]
    )
    result = lfo.solve(problem)
    assert result.enclosure.width <= GAP * result.enclosure.upper
    assert abs(result.cost - result.enclosure.upper) <= 1e-9 * result.cost


def test_an_infeasible_problem_has_a_tree_of_rays_and_of_leaves_that_reach_nothing(tmp_path):
    problem = replace(lfo.library.switched_rotation(horizon=4, initial_state=(-6, 7)), terminal_state=[5.0, 5.0])
    result = lfo.solve(problem, throw=False)
    assert result.status == "infeasible"
    assert confirmed(result, tmp_path) == [np.inf, np.inf]
    assert result.enclosure.infeasible


def test_modes_that_no_child_keeps_are_leaves_of_their_own():
    result = lfo.solve(lfo.library.buck_affine(horizon=6))
    nodes = written_nodes(result.problem, result.tree)
    assert len(nodes) >= len(result.tree.nodes)
    leaves = [node for number, node in enumerate(nodes) if number not in {other.parent for other in nodes}]
    assert any(node.proof is not None for node in leaves)
    for number, node in enumerate(nodes):
        kept = [set(other.modes.tolist()) for other in nodes if other.parent == number]
        if kept:
            times = {other.stage for other in nodes if other.parent == number}
            assert len(times) == 1
            assert set(np.flatnonzero(node.stages.modes[times.pop()]).tolist()) <= set.union(*kept)


@expensive
def test_a_leaf_that_reaches_nothing_need_not_be_in_the_tree():
    result = lfo.solve(lfo.library.cart_between_walls())
    tree = result.tree
    empty = next(k for k, node in enumerate(tree.nodes) if node.proof is None and np.isinf(node.bound))
    assert not any(node.parent == empty for node in tree.nodes)
    rest = (node for k, node in enumerate(tree.nodes) if k != empty)
    without = replace(tree, nodes=tuple(replace(one, parent=one.parent - (one.parent > empty)) for one in rest))
    proof, found = proof_of(replace(result, evidence=replace(result.evidence, tree=without)))
    assert len(proof.dual.nodes) == len(tree.nodes)
    assert found.width <= GAP * found.upper


@expensive
def test_a_leaf_that_is_not_proven_is_found():
    result = lfo.solve(lfo.library.buck_affine(horizon=6))
    tree = result.tree
    leaf = int(np.nanargmin(result.tree_bound.bounds))
    spoiled = replace(tree, nodes=tuple(replace(n, proof=None) if k == leaf else n for k, n in enumerate(tree.nodes)))
    with pytest.raises(lfo.errors.SolveError, match="prove nothing"):
        proof_of(replace(result, evidence=replace(result.evidence, tree=spoiled)))


def test_a_hessian_of_rank_one_costs_no_more_than_the_gap():
    c = np.random.default_rng(1).standard_normal((1, 2))
    problem = replace(lfo.library.switched_rotation(horizon=6), cost=lfo.QuadraticCost(Q=c.T @ c, R=1.0, P=c.T @ c))
    proven = lfo.solve(problem).enclosure
    assert proven.width <= GAP * proven.upper


@pytest.mark.parametrize("start", [1e-7, 1e-13])
def test_a_motion_far_smaller_than_its_bounds_is_enclosed(start):
    A, B = np.array([[1.0, 1.0], [0.0, 1.0]]), [[0.5], [1.0]]
    modes = [lfo.AffineMode(A + np.diag([0, c]), B, [0, 0], [[0, s]], h=[0]) for c, s in ((-0.1, 1), (0.1, -1))]
    problem = lfo.OptimalControlProblem(
        lfo.PiecewiseAffineDynamics(modes),
        6,
        lfo.QuadraticCost(Q=np.array([[0.5, 0.1], [0.1, 0.1]]), R=0.2, P=1.0),
        control_set=lfo.Box(-1, 1),
        state_set=lfo.Box(-5, 5),
        initial_state=[start, 0.0],
    )
    result = lfo.solve(problem)
    assert 0 < result.enclosure.lower <= result.cost
    assert result.enclosure.width <= GAP * result.cost


def with_level(level, lower, goal_slope=0):
    """Return the hand proof of two modes with a level, a claim, a linear end cost, and no dual of mode 0."""
    lines = two_modes()
    for one in lines:
        if one.get("section") == "nodes":
            one["level"] = level
        if one.get("section") == "claim":
            one["lower"] = lower
        if one.get("cost") == "end":
            one["linear"] = [goal_slope]
    first = next(k for k, one in enumerate(lines) if one.get("section") == "dual")
    return text(lines[:first] + lines[first + 3 :])


def test_what_costs_less_than_a_level_does_not_reach_mode_0(tmp_path):
    """Below 1/4 + 1/64, u is below 0.73 and x_1 above 2.27: from x_0 <= 0, x_1 = x_0 + u is not."""
    assert check(with_level(0.25 + 2.0**-6, 0.25), tmp_path).interval == ("0.25", "0.25")


@pytest.mark.parametrize(
    ("level", "lower", "slope", "reason"),
    [
        (0.125, 0.25, 0, "does not imply the claim"),  # what costs more than the level is not bounded
        (4.0, 0.25, 0, "the children of node 0|it has no dual"),  # mode 0 is within this level
        (0.26, 0.25, 1, "a cost that may be negative"),
        (-1.0, -1.0, 0, "a level above zero"),
    ],
)
def test_a_level_proves_no_more_than_it_may(level, lower, slope, reason, tmp_path):
    verdict = check(with_level(level, lower, slope), tmp_path)
    assert verdict.status == 1
    assert re.search(reason, verdict.printed)


@pytest.mark.parametrize(("last", "least"), [(0, 0.5), (1, 1.0), (2, 4.0)])
def test_the_last_pivot_is_the_least_with_a_component_of_one(last, least):
    """By hand: 1/2 = 1 - 1/2 and 1 = 2 - 1 are Schur complements of the coupled block; the third is alone."""
    assert lfo_check.least(arb_mat([[1, 1, 0], [1, 2, 0], [0, 0, 4]]), last) == least
