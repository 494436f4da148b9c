"""The methods for piecewise-affine dynamics: search, solve the best sequence alone, judge the point and the tree.

The tree is the evidence of the outcome. In a control loop, the search of the next step reuses the relaxations and a
cover of the sequences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import chain
from typing import ClassVar

import numpy as np

from lin_freq_ocp.base.arrays import Indices
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.bound import Bound
from lin_freq_ocp.certificate.hybrid.tree import TreeBound, level_boxes, tree_bound, within_level
from lin_freq_ocp.certificate.tolerances import CONDITION_TOLERANCE
from lin_freq_ocp.certificate.verdict import Certificate, judge
from lin_freq_ocp.methods.candidate import Candidate, SolveOptions, require_convex, zero_multipliers
from lin_freq_ocp.methods.convex.sparse_program import ProgramCache, convex_candidates
from lin_freq_ocp.methods.correction import trajectory_at_rest
from lin_freq_ocp.methods.hybrid.search.branch_and_bound import CoverNode, TreeSearch
from lin_freq_ocp.methods.hybrid.search.common import GAP, SearchLimits, SearchOutcome, SearchProgress, refine_leaves
from lin_freq_ocp.methods.hybrid.search.enumeration import enumerate_sequences
from lin_freq_ocp.methods.hybrid.search.mixed import AGREEMENT, solve_miqp
from lin_freq_ocp.methods.hybrid.search.parts import search_in_parts
from lin_freq_ocp.problem.hybrid.mode_tree import ModeTree
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.hybrid.path_relaxation import PathRelaxation
from lin_freq_ocp.program.hybrid.relaxation import ModeRelaxation
from lin_freq_ocp.solving.hybrid.certify_modes import best_multipliers
from lin_freq_ocp.solving.hybrid.fixed_modes import FixedModes, fix_modes
from lin_freq_ocp.solving.hybrid.smooth import outcome_of_search
from lin_freq_ocp.solving.judging import judge_nearest
from lin_freq_ocp.solving.method import Request
from lin_freq_ocp.solving.outcome import Evidence, Judged, Outcome
from lin_freq_ocp.solving.solver_cache import SearchCache
from lin_freq_ocp.transform.reductions import Reduced
from lin_freq_ocp.transform.starts import Start


@dataclass(frozen=True, eq=False)
class TreeEvidence(Evidence):
    """The nodes of a search, with the multipliers that prove its leaves, and the bound that the judge verified."""

    tree: ModeTree
    bound: TreeBound

    @property
    def lower_bound(self) -> float:
        """Return the bound of the tree."""
        return self.bound.value

    def verified(self, problem: OptimalControlProblem) -> Bound | None:
        """Check all nodes once more."""
        return tree_bound(problem, self.tree).bound_for(problem)

    def recovered(self, reduced: Reduced) -> TreeEvidence:
        """Return the tree with the multipliers of all proofs, and the bounds, of the given problem."""
        nodes, bound, cost = list(self.tree.nodes), self.bound, reduced.cost
        for index, node in enumerate(nodes):
            if node.proof is not None:
                multipliers = reduced.multipliers(node.proof.multipliers)
                nodes[index] = replace(node, proof=replace(node.proof, multipliers=multipliers))
        bound = replace(bound, value=bound.value + cost, bounds=bound.bounds + cost)
        return TreeEvidence(replace(self.tree, nodes=tuple(nodes), level=self.tree.level + cost), bound)

    def __str__(self) -> str:
        return f"tree      {len(self.tree.nodes)} nodes, {self.bound.leaves} leaves, each checked"


def tree_of(outcome: Outcome) -> TreeEvidence | None:
    """Return the search tree of an outcome, if it has one."""
    return outcome.evidence if isinstance(outcome.evidence, TreeEvidence) else None


class TreeCache(SearchCache):
    """The relaxations of a search, a cover of the sequences of the next step, and the programs of single sequences."""

    def __init__(self):
        self.programs = ProgramCache()
        self._last: OptimalControlProblem | None = None  # the base of the last search
        self._relaxation: ModeRelaxation | None = None
        self._cover: Sequence[CoverNode] = ()
        self._base: OptimalControlProblem | None = None
        self.solved, self.levels = 0, ()

    def set_base(self, base: OptimalControlProblem | None) -> None:
        """Set the problem from which the next one differs in its initial state alone; None without one."""
        self._base, self.solved = base, 0

    def search(
        self,
        problem: OptimalControlProblem,
        limits: SearchLimits,
        progress: Callable[[SearchProgress], None] | None,
        start: Indices | None,
    ) -> SearchOutcome:
        """Search with the relaxations and the cover of the last search, and cache those of this one."""
        relaxation, cover = self._relaxation, self._cover
        same = self._base is not None and self._base is self._last
        if relaxation is not None and same and self.levels == (limits.level,):
            search = TreeSearch(problem, limits, progress, relaxation)
        else:
            search = TreeSearch(problem, limits, progress)
            cover = [replace(node, duals=None) for node in cover]  # whose units belong to other data
        self._cover = ()  # in case the search fails
        outcome = search.run(start, cover=cover)
        self.solved += outcome.nodes
        self._last, self._relaxation, self._cover = self._base, search.final_relaxation, search.cover_after_step()
        self.levels = (limits.level,)
        return replace(outcome, resume=None)  # the cover is that of this tree


SEQUENCE_BACKEND = "clarabel"  # solves the best sequence accurately, for its multipliers
PROOF_MARGIN = 1.5  # multiple of the measured time of the proof that is kept back when a search is continued
LEAST_FURTHER = 0.1  # of the time searched before: a shorter continuation is not worth a second proof
UNPROVEN = (Status.LOCALLY_OPTIMAL, Status.NUMERICAL_ERROR)
LEAST_PROOF_SECONDS = 0.25  # seconds for the best sequence and the leaves, even if the search has used all the time


@dataclass(frozen=True)
class _Search:
    """The options of a search over mode sequences, and the outcome from the end of the search."""

    gap: float = GAP
    node_limit: int | None = None

    shorthand: ClassVar[str]
    takes_start: ClassVar[bool]

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Search below the cost of rest, without a proof below others; judge the best sequence's trajectory and tree.

        In a loop, the cost below which the last search was is the first, unless rest costs far less by now.
        """
        require_convex(problem)
        end, found, tried = now() + request.time_limit, list[Outcome](), set[float]()
        T, n, m = problem.horizon, problem.state_dim, problem.control_dim
        rest = trajectory_at_rest(problem, Trajectory(np.zeros((T + 1, n)), np.zeros((T, m))))
        most = np.inf if rest is None else FALL * LEVEL_MARGIN * problem.value(rest.x, rest.u)
        known = [] if request.tree is None else [one for one in request.tree.levels if one <= most or one == np.inf]
        for level in chain(known, _levels(problem, rest, found, end)):
            if level in tried:
                continue
            tried.add(level)
            found.append(self._prove(problem, request.with_end(end) if found else request, level))
            if found[-1].status not in UNPROVEN or found[-1].interrupted or now() >= end:
                break
        return max(found, key=lambda one: (one.status not in UNPROVEN, one.primal, _bound_of(one)))

    def _prove(self, problem: OptimalControlProblem, request: Request, level: float) -> Outcome:
        """Search for costs below a level, and judge what is found."""
        limits = SearchLimits(self.gap, request.time_limit, self.node_limit or SearchLimits.nodes, level)
        started = now()
        found = self._search(within_level(problem, level), limits, request)
        searched, end = now() - started, started + request.time_limit
        seconds = {"setup": found.setup, "solve": searched - found.setup}
        programs = request.tree.programs if isinstance(request.tree, TreeCache) else None
        outcome = _judge_search(problem, self.shorthand, found, self.gap, seconds, end, level, programs)
        if found.resume is not None and not outcome.interrupted:
            # time is left: the judge needs less than what was kept back. After a search that is longer by a factor, it
            # needs about that factor more
            certified = PROOF_MARGIN * (now() - started - searched)
            further = (end - now() - certified) / (1 + certified / searched)
            if further > LEAST_FURTHER * searched:
                clock = now()
                longer = found.resume(further)
                seconds = {**seconds, "solve": seconds["solve"] + now() - clock}
                after = _judge_search(problem, self.shorthand, longer, self.gap, seconds, end, level, programs)
                certify = outcome.seconds["certify"] + after.seconds["certify"]
                outcome = after if _bound_of(after) >= _bound_of(outcome) else outcome
                outcome = replace(outcome, seconds={**after.seconds, "certify": certify})
        if found.message == limits.out_of_time == outcome.message:
            spent = outcome.seconds
            shares = f"{spent['setup'] + spent['solve']:.3g} s of search, {spent['certify']:.3g} s of proof"
            outcome = replace(outcome, message=f"{outcome.message}: {shares}")
        return outcome

    def _search(self, problem: OptimalControlProblem, limits: SearchLimits, request: Request) -> SearchOutcome:
        raise NotImplementedError


@dataclass(frozen=True)
class BranchAndBound(_Search):
    """Branch and bound over mode sequences (piecewise-affine dynamics; docs/mode_search.md).

    Attributes
    ----------
    gap : float
        Relative gap (J - D)/S to prove.
    node_limit : int, optional
        Relaxations to solve at most.
    executor : concurrent.futures.Executor, optional
        Searches sub-trees with its workers. The answer does not depend on how many there are.

    Examples
    --------
    >>> problem = lfo.library.pendulum_with_wall(horizon=4)
    >>> lfo.solve(problem, lfo.solvers.BranchAndBound(gap=1e-4)).status
    'optimal'
    """

    executor: Executor | None = None

    shorthand: ClassVar[str] = "branch_and_bound"
    takes_start: ClassVar[bool] = True

    def _search(self, problem: OptimalControlProblem, limits: SearchLimits, request: Request) -> SearchOutcome:
        first = None if request.start is None else request.start.sequence
        if self.executor is not None:
            return search_in_parts(problem, limits, self.executor, request.progress, first)
        if isinstance(request.tree, TreeCache):
            return request.tree.search(problem, limits, request.progress, first)
        return TreeSearch(problem, limits, progress=request.progress).run(first)


@dataclass(frozen=True)
class Enumeration(_Search):
    """All mode sequences, one after the other (piecewise-affine dynamics, short horizons).

    Attributes
    ----------
    gap, node_limit
        As for ``BranchAndBound``.

    Examples
    --------
    >>> problem = lfo.library.pendulum_with_wall(horizon=4)
    >>> lfo.solve(problem, lfo.solvers.Enumeration()).status
    'optimal'
    """

    shorthand: ClassVar[str] = "enumerate"
    takes_start: ClassVar[bool] = False

    def _search(self, problem: OptimalControlProblem, limits: SearchLimits, request: Request) -> SearchOutcome:
        return enumerate_sequences(problem, limits, request.progress)


@dataclass(frozen=True)
class MixedInteger:
    """A mixed-integer solver's mode sequence, which branch and bound then proves or improves.

    Attributes
    ----------
    backend : str
        "auto" (SCIP), "scip" or "daqp".
    gap, node_limit
        As for ``BranchAndBound``, which follows.

    Examples
    --------
    >>> lfo.solvers.MixedInteger(backend="daqp").gap
    1e-06
    """

    backend: str = "auto"
    gap: float = GAP
    node_limit: int | None = None

    shorthand: ClassVar[str] = "miqp"
    takes_start: ClassVar[bool] = False

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Search from the solver's sequence on; the message names a claim that turns out wrong."""
        require_convex(problem)
        backend = "scip" if self.backend == "auto" else self.backend
        seconds = request.time_limit
        end = now() + seconds
        claim = solve_miqp(problem, backend, None if np.isinf(seconds) else seconds, self.gap)
        left = max(seconds - sum(claim.seconds.values()), LEAST_PROOF_SECONDS)
        start = None if claim.sequence is None else Start(claim.sequence, None)
        search = BranchAndBound(self.gap, self.node_limit)
        result = search.solve(problem, replace(request, time_limit=left, start=start, tree=None))
        seconds = {name: claim.seconds.get(name, 0.0) + spent for name, spent in result.seconds.items()}
        late = now() > end and result.message and not result.interrupted  # it names the rest of the limit
        message = SearchLimits(seconds=request.time_limit).out_of_time if late else result.message
        result = replace(result, method=self.shorthand, backend=backend, seconds=seconds, message=message)
        claimed, proven = ("nothing" if cost is None else f"{cost:.9g}" for cost in (claim.cost, result.cost))
        certificate, agreed = result.certificate, False
        if claim.cost is not None and certificate is not None:
            agreed = abs(claim.cost - certificate.cost) <= max(self.gap, AGREEMENT) * certificate.cost_scale
        if result.status == Status.OPTIMAL and not agreed:
            message = f"{backend} ended with {claimed} ('{claim.message}'), the optimum is {proven}"
            return replace(result, message=message)
        return result


def _levels(
    problem: OptimalControlProblem, rest: Trajectory | None, found: Sequence[Outcome], end: float
) -> Iterator[float]:
    """Yield the costs below which to search: that of rest; if nothing is found, that of a single mode; and any."""
    yield _level_of(problem, rest)
    if all(one.trajectory is None for one in found):
        limit = None if end == np.inf else end - now()
        sequences = (np.full(problem.horizon, mode) for mode in range(len(problem.mode_names)))
        points = [_solve_sequence(problem, sequence, limit, None) for sequence in sequences]
        yield min((_level_of(problem, one.trajectory) for one in points if one is not None), default=np.inf)
    yield np.inf


def _bound_of(outcome: Outcome) -> float:
    return -np.inf if outcome.lower_bound is None else outcome.lower_bound


FALL = 1e3  # part of the level of a loop's last step below which that of rest replaces it, with new relaxations
LEVEL_MARGIN = 2.0  # of the cost of a trajectory: an optimum lies well inside the box of costs below this


def _level_of(problem: OptimalControlProblem, trajectory: Trajectory | None) -> float:
    """Return a cost below which to search, as a trajectory costs less; inf if it is not feasible, or makes no bound."""
    level = np.inf if trajectory is None else LEVEL_MARGIN * problem.value(trajectory.x, trajectory.u)
    if trajectory is None or level <= 0 or level_boxes(problem, level) is None:
        return np.inf
    return level if judge(problem, trajectory, zero_multipliers(problem, 1.0)).feasible else np.inf


def _judge_search(
    problem: OptimalControlProblem,
    method: str,
    outcome: SearchOutcome,
    gap: float,
    seconds: dict[str, float],
    end: float,
    level: float,
    programs: ProgramCache | None = None,
) -> Outcome:
    """Return the outcome of a search: its best sequence solved alone, and its tree checked leaf by leaf.

    ``programs`` are those of sequences of like problems. The search was for costs below ``level``.
    """
    outcome = replace(outcome, tree=replace(outcome.tree, level=level))
    clock = now()
    left = max(end - clock, LEAST_PROOF_SECONDS)
    end, limit = clock + left, None if left == np.inf else left
    point = None if outcome.sequence is None else _solve_sequence(problem, outcome.sequence, limit, programs)
    certificate = None if point is None else point.certificate
    proof = tree_bound(problem, outcome.tree, end)
    unproven = now() > end
    scale = level if certificate is None else certificate.cost_scale
    needed = np.inf if certificate is None else certificate.cost - gap / 2 * scale  # half of it is a reserve
    if unproven and not outcome.interrupted:
        outcome = replace(outcome, message=f"{outcome.message or 'time limit'}; not all leaves were proven in time")
    for kind in (PathRelaxation, ModeRelaxation):  # near a cost of zero, solutions of the second are more accurate
        if not outcome.message and not proof.value >= needed:
            weak = np.flatnonzero(proof.bounds < needed)
            below = level if point is None else min(level, _level_of(problem, point.trajectory))
            tree = replace(outcome.tree, level=below)  # which covers these trajectories, too
            tree = refine_leaves(within_level(problem, below), tree, weak, end, kind, scale)
            bound = tree_bound(problem, tree, end)
            if bound.value > proof.value:
                outcome, proof = replace(outcome, tree=tree), bound
    judged = None if point is None else point.with_bound(proof.bound_for(problem))
    ending = _status(outcome, None if judged is None else judged.certificate, proof, gap)
    seconds = {**seconds, "certify": now() - clock}
    evidence = TreeEvidence(outcome.tree, proof)
    return outcome_of_search(problem, method, judged, ending, seconds, outcome.interrupted, outcome.sequence, evidence)


def _solve_sequence(
    problem: OptimalControlProblem, sequence: Indices, time_limit: float | None, programs: ProgramCache | None
) -> Judged | None:
    """Return the first feasible answer for a mode sequence alone, as the judge finds; else the first of all."""
    first = None
    reduced = fix_modes(problem, sequence)
    options = SolveOptions(time_limit=time_limit)
    for candidate in convex_candidates(reduced.problem, SEQUENCE_BACKEND, options, programs):
        for point in _judge_candidate(reduced, candidate):
            if point.certificate.feasible:
                return point
            first = first or point
    return first


def _judge_candidate(reduced: FixedModes, candidate: Candidate) -> Iterator[Judged]:
    """Yield the trajectories of a candidate for a mode sequence, judged with the best multipliers."""
    if candidate.trajectory is None or candidate.multipliers is None:
        return
    nearest = judge_nearest(reduced.problem, candidate, CONDITION_TOLERANCE)
    for trajectory in reduced.trajectories(nearest.trajectory):
        yield best_multipliers(reduced.given, trajectory, reduced.multipliers(nearest.multipliers, trajectory))


def _status(
    outcome: SearchOutcome, certificate: Certificate | None, proof: TreeBound, gap: float
) -> tuple[Status, str]:
    """Return the status of the result, and why it is not optimal."""
    if certificate is None:
        if outcome.message:
            return Status.LIMIT, outcome.message
        if outcome.sequence is None and proof.value == np.inf:
            message = f"proven by a search tree: none of its {proof.leaves} leaves contains a trajectory"
            return Status.INFEASIBLE, message
        return Status.NUMERICAL_ERROR, "no trajectory was found, and infeasibility is not proven"
    status = certificate.status_within(gap)
    if status == Status.OPTIMAL and not outcome.interrupted:
        return status, ""
    if outcome.message:
        return Status.LIMIT, outcome.message
    if not certificate.feasible:
        message = f"the best mode sequence, solved alone, violates: {certificate.worst.name}"
        return Status.NUMERICAL_ERROR, message
    return status, f"the search closed its tree, but only the bound {proof.value:.12g} is proven"
