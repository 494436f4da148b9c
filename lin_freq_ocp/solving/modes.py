"""solve() for piecewise-affine dynamics: search, solve the best sequence alone, judge the point and the tree."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from lin_freq_ocp.arrays import Indices
from lin_freq_ocp.certificate.bound import NEVER_NEGATIVE, Bound, cost_is_never_negative
from lin_freq_ocp.certificate.modes.bound import TreeBound, tree_bound
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.errors import UnsupportedError
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.methods.claims import AGREEMENT
from lin_freq_ocp.methods.convex.sparse_program import require_convex, solve_convex
from lin_freq_ocp.methods.modes.branch_and_bound import BranchAndBound
from lin_freq_ocp.methods.modes.enumeration import enumerate_sequences
from lin_freq_ocp.methods.modes.mixed import solve_miqp
from lin_freq_ocp.methods.modes.parts import search_in_parts
from lin_freq_ocp.methods.modes.search import SearchLimits, SearchOutcome, SearchProgress, refined
from lin_freq_ocp.methods.modes.weights import weighted
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.result import Result
from lin_freq_ocp.solving.certify_modes import best_multipliers
from lin_freq_ocp.solving.starts import Start

MODE_METHODS = ("enumerate", "branch_and_bound", "miqp")

SEQUENCE_BACKEND = "clarabel"
"""Solves the best sequence, accurately, for its multipliers."""

LEAST_TIME = 0.25
"""Seconds that are left to solve the best sequence, and to prove leaves, when the search has used them all."""

Report = Callable[[SearchProgress], None]


def solve_modes(
    problem: OptimalControlProblem,
    method: str,
    backend: str,
    limits: SearchLimits,
    progress: Report | None,
    executor: Executor | None,
    start: Start | None = None,
) -> Result:
    """Return what a search over modes ends with, judged.

    Raises
    ------
    UnsupportedError
        If the method or backend is not for piecewise-affine dynamics, the cost is not convex, or a set is unbounded.
    """
    require_convex(problem)
    method = "branch_and_bound" if method == "auto" else method
    if method not in MODE_METHODS:
        known = ", ".join(map(repr, MODE_METHODS))
        raise UnsupportedError(f"method: got {method!r}, which takes linear dynamics; expected one of {known}.")
    if backend != "auto" and method != "miqp":
        raise UnsupportedError(f"backend: got {backend!r}; the method {method!r} needs none: leave it 'auto'.")
    started, first = time.perf_counter(), None if start is None else start.sequence
    end = started + limits.seconds
    if method == "enumerate":
        outcome = enumerate_sequences(problem, limits, progress)
    elif method == "miqp":
        return _through_solver(problem, "scip" if backend == "auto" else backend, limits, progress)
    elif executor is not None:
        outcome = search_in_parts(problem, limits, executor, progress, first)
    else:
        outcome = BranchAndBound(problem, limits, progress=progress).run(first)
    seconds = {"setup": outcome.setup, "solve": time.perf_counter() - started - outcome.setup}
    return _judged(problem, method, outcome, limits.gap, seconds, end)


def _through_solver(
    problem: OptimalControlProblem, backend: str, limits: SearchLimits, progress: Report | None
) -> Result:
    """Return what our search, begun with a mixed-integer solver's sequence, proves; and whether its claim was right."""
    end = time.perf_counter() + limits.seconds
    claim = solve_miqp(problem, backend, None if np.isinf(limits.seconds) else limits.seconds, limits.gap)
    left = max(limits.seconds - sum(claim.seconds.values()), LEAST_TIME)
    clock = time.perf_counter()
    outcome = BranchAndBound(problem, replace(limits, seconds=left), progress=progress).run(claim.sequence)
    late = time.perf_counter() > end  # the search's own limit was what was left
    if late and outcome.words and not outcome.interrupted:
        outcome = replace(outcome, words=f"time limit of {limits.seconds:g} s")
    seconds = {**claim.seconds, "solve": claim.seconds["solve"] + time.perf_counter() - clock}
    result = replace(_judged(problem, "miqp", outcome, limits.gap, seconds, end), backend=backend)
    found, proven = ("nothing" if cost is None else f"{cost:.9g}" for cost in (claim.cost, result.cost))
    agreed = max(limits.gap, AGREEMENT)
    if result.status == "optimal" and not _agree(claim.cost, result.certificate, agreed):
        return replace(result, message=f"{backend} ended with {found} ('{claim.words}'), the optimum is {proven}")
    return result


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
) -> Result:
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
        certificate = replace(certificate, bound=_bound(problem, proof))
    status, message = _status(outcome, certificate, proof, gap)
    return Result(
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


def _bound(problem: OptimalControlProblem, proof: TreeBound) -> Bound | None:
    """Return the bound of a tree, or that of a cost that is never negative, whichever is better."""
    if proof.value < 0 and cost_is_never_negative(problem):
        return Bound(0.0, "rigorous", sets=NEVER_NEGATIVE)
    words = f"a search tree of {proof.leaves} {'leaf' if proof.leaves == 1 else 'leaves'}, each checked"
    return Bound(proof.value, "rigorous", sets=words) if np.isfinite(proof.value) else None


def _certificate(
    problem: OptimalControlProblem, sequence: Indices | None, candidate: Candidate | None
) -> tuple[Certificate | None, Multipliers | None]:
    """Judge the best sequence's trajectory with its multipliers, or with others where modes meet and its do not fit."""
    if sequence is None or candidate is None or candidate.trajectory is None or candidate.multipliers is None:
        return None, None
    first = weighted(problem, candidate.trajectory, sequence, candidate.multipliers)
    return best_multipliers(problem, candidate.trajectory, first)


def _status(outcome: SearchOutcome, certificate: Certificate | None, proof: TreeBound, gap: float) -> tuple[str, str]:
    """Return the status of the result, and in words why, where it is not optimal."""
    if certificate is None:
        if outcome.words:
            return "limit", outcome.words
        if outcome.sequence is None and proof.value == np.inf:
            return "infeasible", f"proven by a search tree of {proof.leaves} leaves, none of which has a trajectory"
        return "numerical_error", "no trajectory was found, and that there is none is not proven"
    status = certificate.status_within(gap)
    if status == "optimal" and not outcome.interrupted:
        return status, ""
    if outcome.words:
        return "limit", outcome.words
    if not certificate.feasible:
        words = f"the best mode sequence, solved alone, does not satisfy: {certificate.worst.name}"
        return "numerical_error", words
    return status, f"the search closed its tree, of which only the bound {proof.value:.12g} is proven"
