"""A proof of the answer to a problem: its sections in turn, and what the checker makes of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from flint import ctx
from lfo_check import Failed

from lin_freq_ocp.analysis.mode_tree import ModeTree
from lin_freq_ocp.arrays import Array
from lin_freq_ocp.certificate.peaks.proven import proven_peak
from lin_freq_ocp.errors import SolveError
from lin_freq_ocp.problem.frequencies import at_frequencies
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.proof.checked import checked
from lin_freq_ocp.proof.convex import convex_problem
from lin_freq_ocp.proof.dual import Dual, dual_of
from lin_freq_ocp.proof.enclosure import Enclosure
from lin_freq_ocp.proof.growth import precision
from lin_freq_ocp.proof.interior import interior
from lin_freq_ocp.proof.lines import line, rows
from lin_freq_ocp.proof.room import least_room, share_towards
from lin_freq_ocp.proof.statement import problem_lines
from lin_freq_ocp.proof.tree import TreeDual, sequence_problem, written_nodes
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged

MARGINS = (2.0**-46, 2.0**-40, 2.0**-34, 2.0**-27, 2.0**-20)  # room to limits relative to sizes, tried in turn
CLAIM_SLACK = 1e-9  # by which the claim is wider than what is proven, relative to it
TREE_BITS = 192  # of balls, without a linear system to solve in them; products of three doubles are exact
LEVEL = 2.0**-40  # by which the proven level of a soft mask is above the largest value found


@dataclass(frozen=True, eq=False)
class Point:
    """Controls from an initial state, with the mode at every time and the levels of masks over all frequencies."""

    start: Array  # x_0, (n,)
    controls: Array  # (T, m)
    modes: list[int]
    levels: list[float]

    def lines(self) -> Iterator[str]:
        """Yield the section POINT."""
        yield line(section="point", x=self.start, levels=np.array(self.levels))
        for t, (u, mode) in enumerate(zip(rows(self.controls), self.modes, strict=True)):
            yield line(t=t, u=u, mode=mode)


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
        If the outcome has nothing to prove, or its multipliers prove nothing.
    """
    if outcome.tree is not None:
        return _of_tree(outcome, outcome.tree)
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
    bare = Proof(problem, bits, Enclosure(-np.inf, np.inf), None, dual)
    found = None if outcome.ray is not None else _with_point(bare, outcome, at)
    proof, enclosure = (bare, _confirmed(bare, outcome)) if found is None else found
    return replace(proof, claim=_claimed(enclosure)), enclosure


def _of_tree(outcome: Outcome, tree: ModeTree) -> tuple[Proof, Enclosure]:
    """Return a proof by a search over modes, with the point of the best sequence alone if the checker accepts it."""
    problem, found = outcome.problem, None
    _require_stated(problem)
    dual = TreeDual(problem, written_nodes(problem, tree))
    bare = Proof(problem, TREE_BITS, Enclosure(-np.inf, np.inf), None, dual)
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
    problem, inner = bare.problem, None
    for margin in MARGINS:
        if inner is None and least_room(problem, at) < margin:
            inner = interior(outcome, problem, at)
            if inner is None:
                return None
        share = 0.0 if inner is None else share_towards(problem, at, inner, margin)
        if share < 1:
            proof = replace(bare, point=_point(problem, at if inner is None else between(at, inner, share)))
            with suppress(Failed):
                return proof, checked(proof.lines())
    return None


def between(at: Trajectory, inner: Trajectory, share: float) -> Trajectory:
    """Return the trajectory at a share of the way from one to another."""
    return Trajectory(at.x + share * (inner.x - at.x), at.u + share * (inner.u - at.u))


def _point(problem: OptimalControlProblem, at: Trajectory) -> Point:
    """Return the point of a trajectory within its bounds."""
    levels = list[float]()
    for term in problem.terms:
        if term.everywhere is not None:
            found = proven_peak(term.everywhere, term.everywhere.map.signal(at.x, at.u)).found
            levels.append(1.0 if term.hard else max(1.0, found * (1 + LEVEL)))
    start, u = problem.state_tube.project(at.x)[0], problem.control_tube.project(at.u)
    return Point(start, u, [0] * problem.horizon, levels)


def _confirmed(proof: Proof, outcome: Outcome) -> Enclosure:
    """Return what the checker makes of a proof; SolveError if it proves nothing."""
    try:
        return checked(proof.lines())
    except Failed as failed:
        raise SolveError(f"The multipliers prove nothing ({failed}).", outcome) from failed


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
