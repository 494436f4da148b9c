"""The methods for piecewise-affine dynamics: search, solve the best sequence alone, judge the point and the tree."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from lin_freq_ocp.arrays import Indices
from lin_freq_ocp.certificate.modes.bound import TreeBound, tree_bound
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.methods.claims import AGREEMENT
from lin_freq_ocp.methods.convex.sparse_program import require_convex, solve_convex
from lin_freq_ocp.methods.modes.branch_and_bound import BranchAndBound as TreeSearch
from lin_freq_ocp.methods.modes.enumeration import enumerate_sequences
from lin_freq_ocp.methods.modes.mixed import solve_miqp
from lin_freq_ocp.methods.modes.parts import search_in_parts
from lin_freq_ocp.methods.modes.search import GAP, SearchLimits, SearchOutcome, refined
from lin_freq_ocp.methods.modes.weights import weighted
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.solving.certify_modes import best_multipliers
from lin_freq_ocp.solving.method import Request
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.status import Status

SEQUENCE_BACKEND = "clarabel"
"""Solves the best sequence, accurately, for its multipliers."""

LEAST_TIME = 0.25
"""Seconds that are left to solve the best sequence, and to prove leaves, when the search has used them all."""


@dataclass(frozen=True)
class BranchAndBound:
    """Branch and bound over mode sequences (piecewise-affine dynamics; docs/mode_search.md).

    Attributes
    ----------
    gap : float
        Relative gap (J - D)/S to prove.
    node_limit : int, optional
        Relaxations to solve at most.
    executor : concurrent.futures.Executor, optional
        Searches sub-trees with its workers. The answer does not depend on how many there are.
    """

    gap: float = GAP
    node_limit: int | None = None
    executor: Executor | None = None

    shorthand: ClassVar[str] = "branch_and_bound"
    takes_start: ClassVar[bool] = True

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Search, and judge the best sequence's trajectory and the tree."""
        require_convex(problem)
        limits, executor = _limits(self.gap, self.node_limit, request), self.executor
        first = None if request.start is None else request.start.sequence

        def search() -> SearchOutcome:
            if executor is not None:
                return search_in_parts(problem, limits, executor, request.progress, first)
            return TreeSearch(problem, limits, progress=request.progress).run(first)

        return _timed(problem, self, request, search)


@dataclass(frozen=True)
class Enumeration:
    """All mode sequences, one after the other (piecewise-affine dynamics, short horizons).

    Attributes
    ----------
    gap : float
        Relative gap (J - D)/S to prove.
    node_limit : int, optional
        Relaxations to solve at most.
    """

    gap: float = GAP
    node_limit: int | None = None

    shorthand: ClassVar[str] = "enumerate"
    takes_start: ClassVar[bool] = False

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Enumerate, and judge the best sequence's trajectory and the tree."""
        require_convex(problem)
        limits = _limits(self.gap, self.node_limit, request)
        return _timed(problem, self, request, lambda: enumerate_sequences(problem, limits, request.progress))


@dataclass(frozen=True)
class MixedInteger:
    """A mixed-integer solver's mode sequence, which branch and bound then proves or improves.

    Attributes
    ----------
    backend : str
        "auto" (SCIP), "scip" or "daqp".
    gap : float
        Relative gap (J - D)/S to prove.
    node_limit : int, optional
        Relaxations to solve at most, in our search.
    """

    backend: str = "auto"
    gap: float = GAP
    node_limit: int | None = None

    shorthand: ClassVar[str] = "miqp"
    takes_start: ClassVar[bool] = False

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Return what our search, begun with the solver's sequence, proves; and whether its claim was right."""
        require_convex(problem)
        backend = "scip" if self.backend == "auto" else self.backend
        limits = _limits(self.gap, self.node_limit, request)
        end = time.perf_counter() + limits.seconds
        claim = solve_miqp(problem, backend, None if np.isinf(limits.seconds) else limits.seconds, limits.gap)
        left = max(limits.seconds - sum(claim.seconds.values()), LEAST_TIME)
        clock = time.perf_counter()
        outcome = TreeSearch(problem, replace(limits, seconds=left), progress=request.progress).run(claim.sequence)
        late = time.perf_counter() > end  # the search's own limit was what was left
        if late and outcome.words and not outcome.interrupted:
            outcome = replace(outcome, words=f"time limit of {limits.seconds:g} s")
        seconds = {**claim.seconds, "solve": claim.seconds["solve"] + time.perf_counter() - clock}
        result = replace(_judged(problem, "miqp", outcome, limits.gap, seconds, end), backend=backend)
        found, proven = ("nothing" if cost is None else f"{cost:.9g}" for cost in (claim.cost, result.cost))
        agreed = max(limits.gap, AGREEMENT)
        if result.status == Status.OPTIMAL and not _agree(claim.cost, result.certificate, agreed):
            return replace(result, message=f"{backend} ended with {found} ('{claim.words}'), the optimum is {proven}")
        return result


def _limits(gap: float, node_limit: int | None, request: Request) -> SearchLimits:
    return SearchLimits(gap, request.time_limit, node_limit or SearchLimits.nodes)


def _timed(
    problem: OptimalControlProblem,
    method: BranchAndBound | Enumeration,
    request: Request,
    search: Callable[[], SearchOutcome],
) -> Outcome:
    """Run a search of our own, and judge what it ends with."""
    started = time.perf_counter()
    found = search()
    seconds = {"setup": found.setup, "solve": time.perf_counter() - started - found.setup}
    return _judged(problem, method.shorthand, found, method.gap, seconds, started + request.time_limit)


def _agree(claimed: float | None, certificate: Certificate | None, gap: float) -> bool:
    if claimed is None or certificate is None:
        return False
    return abs(claimed - certificate.cost) <= gap * certificate.cost_scale


def _judged(
    problem: OptimalControlProblem,
    method: str,
    outcome: SearchOutcome,
    gap: float,
    seconds: dict[str, float],
    end: float,
) -> Outcome:
    clock = time.perf_counter()
    left = max(end - clock, LEAST_TIME)
    end = clock + left
    candidate = None
    if outcome.sequence is not None:
        alone, limit = problem.with_modes(outcome.sequence), None if left == np.inf else left
        candidate = solve_convex(alone, SEQUENCE_BACKEND, None, limit)
    certificate, multipliers = _certificate(problem, outcome.sequence, candidate)
    proof = tree_bound(problem, outcome.tree, end)
    unproven = time.perf_counter() > end
    needed = np.inf if certificate is None else certificate.cost - gap * certificate.cost_scale
    if unproven and not outcome.interrupted:
        outcome = replace(outcome, words=f"{outcome.words or 'time limit'}; not all leaves were proven in time")
    if not outcome.words and not proof.value >= needed:
        outcome = replace(outcome, tree=refined(problem, outcome.tree, np.flatnonzero(proof.bounds < needed), end))
        proof = tree_bound(problem, outcome.tree)
    if certificate is not None:
        certificate = replace(certificate, bound=proof.bound_for(problem))
    status, message = _status(outcome, certificate, proof, gap)
    return Outcome(
        problem=problem,
        status=status,
        method=method,
        backend=None,
        seconds={**seconds, "certify": time.perf_counter() - clock},
        trajectory=None if candidate is None else candidate.trajectory,
        multipliers=multipliers,
        certificate=certificate,
        message=message,
        interrupted=outcome.interrupted,
        sequence=outcome.sequence,
        tree=outcome.tree,
        tree_bound=proof,
    )


def _certificate(
    problem: OptimalControlProblem, sequence: Indices | None, candidate: Candidate | None
) -> tuple[Certificate | None, Multipliers | None]:
    """Judge the best sequence's trajectory with its multipliers, or with others where modes meet and its do not fit."""
    if sequence is None or candidate is None or candidate.trajectory is None or candidate.multipliers is None:
        return None, None
    first = weighted(problem, candidate.trajectory, sequence, candidate.multipliers)
    return best_multipliers(problem, candidate.trajectory, first)


def _status(
    outcome: SearchOutcome, certificate: Certificate | None, proof: TreeBound, gap: float
) -> tuple[Status, str]:
    """Return the status of the result, and in words why, where it is not optimal."""
    if certificate is None:
        if outcome.words:
            return Status.LIMIT, outcome.words
        if outcome.sequence is None and proof.value == np.inf:
            return (
                Status.INFEASIBLE,
                f"proven by a search tree of {proof.leaves} leaves, none of which has a trajectory",
            )
        return Status.NUMERICAL_ERROR, "no trajectory was found, and that there is none is not proven"
    status = certificate.status_within(gap)
    if status == Status.OPTIMAL and not outcome.interrupted:
        return status, ""
    if outcome.words:
        return Status.LIMIT, outcome.words
    if not certificate.feasible:
        words = f"the best mode sequence, solved alone, does not satisfy: {certificate.worst.name}"
        return Status.NUMERICAL_ERROR, words
    return status, f"the search closed its tree, of which only the bound {proof.value:.12g} is proven"
