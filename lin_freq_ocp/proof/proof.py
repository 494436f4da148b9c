"""A proof of the answer to a problem: its sections in turn, and what the checker makes of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from flint import ctx
from lfo_check import Failed

from lin_freq_ocp.analysis.mode_tree import ModeTree
from lin_freq_ocp.errors import SolveError
from lin_freq_ocp.problem.frequencies import at_frequencies
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.proof.checked import checked
from lin_freq_ocp.proof.convex import convex_problem
from lin_freq_ocp.proof.dual.dual import Dual, dual_of
from lin_freq_ocp.proof.dual.growth import precision
from lin_freq_ocp.proof.enclosure import Enclosure
from lin_freq_ocp.proof.lines import line
from lin_freq_ocp.proof.point.point import Point, points
from lin_freq_ocp.proof.statement.problem import problem_lines
from lin_freq_ocp.proof.tree import TreeDual, sequence_problem, written_nodes
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged

UNCHECKED_MARGIN = (2.0**-36,)  # room to limits relative to sizes, of a point that is not tried
UNCHECKED_SLACK = 1e-6  # by which the claim is wider than what the certificate says, relative to the cost
CLAIM_SLACK = 1e-9  # by which the claim is wider than what is proven, relative to it
TREE_BITS = 192  # of balls, without a linear system to solve in them; products of three doubles are exact
NOTHING = Enclosure(-np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class Proof:
    """A lower bound by a dual, or by those of a search tree, and an upper one by a point."""

    problem: OptimalControlProblem
    bits: int
    claim: Enclosure
    point: Point | None
    dual: Dual | TreeDual

    def lines(self) -> Iterator[str]:
        """Yield the file, line by line."""
        yield line(format="lfo-proof", version=1, bits=self.bits)
        yield from problem_lines(self.problem)
        yield line(section="claim", lower=self.claim.lower, upper=self.claim.upper)
        if self.point is not None:
            yield from self.point.lines()
        yield from self.dual.lines()
        yield line(section="end")


def proof_of(outcome: Outcome) -> tuple[Proof, Enclosure]:
    """Return a proof of what a solve found, and what the checker makes of it.

    Raises
    ------
    UnsupportedError
        If the format does not hold the problem.
    SolveError
        If the outcome has nothing to prove, its multipliers prove nothing, or its cost lies outside of what is proven.
    """
    proof, enclosure = _of_linear(outcome) if outcome.tree is None else _of_tree(outcome, outcome.tree)
    _require_cost(outcome, enclosure)
    return proof, enclosure


def _of_linear(outcome: Outcome) -> tuple[Proof, Enclosure]:
    """Return a proof of an answer for linear dynamics, with a point if the checker accepts one."""
    bare, at = _without_point(outcome)
    found = None if outcome.ray is not None else _with_point(bare, outcome, at)
    proof, enclosure = (bare, _confirmed(bare, outcome)) if found is None else found
    return replace(proof, claim=_claimed(enclosure)), enclosure


def unchecked_proof(outcome: Outcome) -> Proof:
    """Return a proof of what a solve found of linear dynamics, without a check; errors are those of ``proof_of``.

    It claims what the certificate says, a little less.
    """
    bare, at = _without_point(outcome)
    if outcome.ray is not None:
        return replace(bare, claim=Enclosure(np.inf, np.inf))
    certificate, bound = outcome.certificate, outcome.lower_bound
    slack = UNCHECKED_SLACK * (0.0 if certificate is None else certificate.cost_scale)
    lower = -np.inf if bound is None else bound - slack
    for point, moved in points(bare.problem, outcome, at, UNCHECKED_MARGIN):
        upper = bare.problem.value(moved.x, moved.u) + slack
        return replace(bare, point=point, claim=Enclosure(lower, upper))
    return replace(bare, claim=Enclosure(lower, np.inf))


def _without_point(outcome: Outcome) -> tuple[Proof, Trajectory]:
    """Return a proof of a lower bound alone, without a claim, and the trajectory at which it is tight."""
    at, multipliers = outcome.trajectory, outcome.multipliers
    if outcome.ray is not None:
        at, multipliers = _rest(outcome.problem), outcome.ray
    if at is None or multipliers is None:
        raise SolveError(f"There is nothing to prove: the solve ended as '{outcome.status}'.", outcome)
    problem = convex_problem(at_frequencies(outcome.problem, multipliers.frequencies))
    _require_stated(problem)
    bits = precision(problem.linear.A, problem.horizon)
    with ctx.workprec(bits):
        dual = dual_of(problem, at, multipliers)
    return Proof(problem, bits, NOTHING, None, dual), at


def _of_tree(outcome: Outcome, tree: ModeTree) -> tuple[Proof, Enclosure]:
    """Return a proof by a search over modes, with the point of the best sequence alone if the checker accepts it."""
    problem, found = convex_problem(outcome.problem), None
    _require_stated(problem)
    dual = TreeDual(problem, written_nodes(problem, tree))
    bare = Proof(problem, TREE_BITS, NOTHING, None, dual)
    if outcome.sequence is not None:
        with suppress(SolveError, Failed):
            alone, _ = proof_of(solve_judged(sequence_problem(problem, outcome.sequence)))
            point = alone.point and replace(alone.point, modes=outcome.sequence.tolist())
            proof = replace(bare, bits=max(TREE_BITS, alone.bits), point=point)
            found = proof, checked(proof.lines())
    proof, enclosure = (bare, _confirmed(bare, outcome)) if found is None else found
    return replace(proof, claim=_claimed(enclosure)), enclosure


def _with_point(bare: Proof, outcome: Outcome, at: Trajectory) -> tuple[Proof, Enclosure] | None:
    """Return the proof with the point nearest to the trajectory that the checker accepts; None if there is none."""
    for point, _ in points(bare.problem, outcome, at):
        proof = replace(bare, point=point)
        with suppress(Failed):
            return proof, checked(proof.lines())
    return None


def _confirmed(proof: Proof, outcome: Outcome) -> Enclosure:
    """Return what the checker makes of a proof; SolveError if it proves nothing."""
    try:
        return checked(proof.lines())
    except Failed as failed:
        raise SolveError(f"The multipliers prove nothing ({failed}).", outcome) from failed


def _require_cost(outcome: Outcome, proven: Enclosure) -> None:
    """Raise SolveError unless the certified cost lies in a proven interval, up to the gap that certificates allow."""
    certificate = outcome.certificate
    if certificate is None or not certificate.feasible:
        return
    cost, slack = certificate.cost, certificate.allowed_gap
    if not proven.lower - slack <= cost <= proven.upper + slack:
        raise SolveError(
            f"The certified cost {cost!r} lies outside of the proven interval, {proven}. The file states a Hessian "
            "that is indefinite by rounding as one that is raised to be semidefinite, and this moves the optimum. Take "
            "the rounding out of Q, R, S or P, or count the states from nearer to their references.",
            outcome,
        )


def _claimed(proven: Enclosure) -> Enclosure:
    """Return a claim that is a little wider than what is proven: the checker may round otherwise elsewhere."""
    if proven.infeasible:
        return proven
    ends = [abs(one) for one in (proven.lower, proven.upper) if np.isfinite(one)]
    slack = CLAIM_SLACK * max(ends, default=0.0)
    return Enclosure(proven.lower - slack, proven.upper + slack)


def _require_stated(problem: OptimalControlProblem) -> None:
    """Raise UnsupportedError if the format does not hold the problem."""
    for _ in problem_lines(problem):
        pass


def _rest(problem: OptimalControlProblem) -> Trajectory:
    """Return the point nearest to zero within the bounds, at every time."""
    n, m, T = problem.state_dim, problem.control_dim, problem.horizon
    return Trajectory(problem.state_tube.project(np.zeros((T + 1, n))), problem.control_tube.project(np.zeros((T, m))))
