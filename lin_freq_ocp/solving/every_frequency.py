"""Masks at every frequency, by exchange: a method solves problems with masks at finitely many frequencies.

A round adds the frequencies of all local maxima of |V| above the limit, and drops those without a multiplier, or next
to an added one. For a residual vibration, frequencies are points (natural frequency, damping ratio) of a box. A problem
with finitely many of the constraints is a relaxation: its infeasibility proof and its bound are those of the problem,
and its trajectory is judged at every frequency.

References: Hettich and Kortanek, SIAM Review 35, 1993 (semi-infinite programming: exchange methods).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lin_freq_ocp.base.arrays import Array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.tolerances import GAP_TOLERANCE, PEAK_TOLERANCE
from lin_freq_ocp.certificate.verdict import judge
from lin_freq_ocp.methods.candidate import Candidate
from lin_freq_ocp.problem.hybrid.mode_tree import ModeTree
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reformulations import at_frequencies
from lin_freq_ocp.problem.terms.semi_infinite import peaks_above
from lin_freq_ocp.problem.terms.term import Term
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.solving.judging import judged
from lin_freq_ocp.solving.method import Method, Request, seconds_left
from lin_freq_ocp.solving.outcome import Outcome

EXCESS = 1e-9  # of |V| over its limit, relative: what interior points leave on the frequencies that they know
ROUNDS = 30  # five or six reach EXCESS: convergence is quadratic
IDLE = 1e-6  # part of the largest multiplier below which a frequency is dropped: without it the cost is the same
APART = 1e-4  # of the distance of two bins: |V| differs there by 5e-8 at most, relative to its largest value
LESS = 0.5  # part of the excess of a round that a round must leave at most, once it is below SMALL
SMALL = 2e-7  # below the excess that the judge allows

Frequencies = dict[str, Array]


def solved_by(
    method: Method, problem: OptimalControlProblem, request: Request, tolerance: float | None = None
) -> Outcome:
    """Solve a problem by a method, in rounds if it has masks at every frequency."""
    if all(term.everywhere is None for term in problem.terms):
        return method.solve(problem, request)
    return solve_at_every_frequency(problem, method, request, tolerance)


def solve_at_every_frequency(
    problem: OptimalControlProblem, method: Method, request: Request, tolerance: float | None = None
) -> Outcome:
    """Solve a problem with masks at every frequency by any method, and judge the answer."""
    request = replace(request, again=None, tree=None)
    end = now() + request.time_limit
    frequencies = {term.name: term.map.places for term in problem.terms if term.everywhere is not None}
    seconds, excess, rounds = dict[str, float](), np.inf, list[_Round]()
    for _ in range(ROUNDS):
        left = seconds_left(end, now())
        relaxed = at_frequencies(problem, frequencies, relaxed=True)
        found = method.solve(relaxed, request if left is None else replace(request, time_limit=left))
        seconds |= {what: seconds.get(what, 0.0) + value for what, value in found.seconds.items()}
        if found.trajectory is None or found.multipliers is None:
            rounds.append(_Round(found, frequencies, np.inf))
            break
        added, largest = _added(problem, frequencies, found.trajectory)
        rounds.append(_Round(found, frequencies, largest))
        converged = largest <= EXCESS or (largest < SMALL and largest > LESS * excess)
        if converged or found.status == Status.LIMIT or found.interrupted:
            break
        excess = largest
        frequencies = _next(problem, frequencies, added, found.trajectory, found.multipliers)
    proven = [one for one in rounds if one.found.status == Status.OPTIMAL and one.excess < PEAK_TOLERANCE]
    best = min(proven, key=lambda one: one.excess) if proven else rounds[-1]
    return best.restated(problem, seconds, tolerance)


def _added(
    problem: OptimalControlProblem, frequencies: Frequencies, trajectory: Trajectory
) -> tuple[Frequencies, float]:
    """Return the frequencies of peaks above their limit, by name of the term, and the largest excess."""
    added, largest = Frequencies(), 0.0
    for term in problem.terms:
        if term.everywhere is not None:
            raised = _raised(term, frequencies[term.name], trajectory)
            above = raised * (1.0 + EXCESS / 2)
            added[term.name], ratios = peaks_above(term.everywhere, trajectory.x, trajectory.u, above)
            largest = max(largest, float(ratios.max(initial=raised)) / raised - 1.0)
    return added, largest


def _raised(term: Term, frequencies: Array, trajectory: Trajectory) -> float:
    """Return the factor by which a soft mask is paid to be exceeded at its frequencies; 1 of a hard one."""
    if term.hard or term.everywhere is None:
        return 1.0
    values, limits = term.everywhere.map.placed(frequencies), term.everywhere.limit_at(frequencies)
    size = np.linalg.norm(values.values(trajectory.x, trajectory.u), axis=1)
    return float((size / limits).max(initial=1.0))


def _next(
    problem: OptimalControlProblem,
    frequencies: Frequencies,
    added: Frequencies,
    trajectory: Trajectory,
    multipliers: Multipliers,
) -> Frequencies:
    """Return the frequencies of the next round."""
    found = Frequencies()
    for term in problem.terms:
        if term.everywhere is None:
            continue
        own, new = frequencies[term.name], added[term.name]
        weight = np.linalg.norm(multipliers.stage[term.name], axis=1)
        kept = weight > IDLE * weight.max(initial=0.0)
        nearest = term.everywhere.distances(own, new).min(axis=1, initial=np.inf)
        joined = np.unique(np.concatenate([own[kept & (nearest > APART)], new]), axis=0)
        found[term.name] = joined if len(joined) else own
    return found


@dataclass(frozen=True, eq=False)
class _Round:
    """The outcome of a relaxed problem with masks at these frequencies."""

    found: Outcome
    frequencies: Frequencies
    excess: float  # of |V| at other frequencies, relative to the limit

    def restated(self, problem: OptimalControlProblem, seconds: dict[str, float], tolerance: float | None) -> Outcome:
        """Return the outcome for the problem itself, judged at every frequency."""
        found = self.found
        if problem.dynamics.mode_names:
            return self._of_modes(problem, seconds)
        candidate = Candidate(
            "infeasible" if found.ray is not None else _claimed(found.status),
            found.trajectory,
            self._placed(found.multipliers),
            self._placed(found.ray),
            message=found.message,
            seconds=seconds,
            interrupted=found.interrupted,
            descent=None if found.direction is None else Trajectory(found.direction.x, found.direction.u),
        )
        outcome = judged(problem, candidate, found.method, found.backend, tolerance)
        return replace(outcome, reason=found.reason)

    def _of_modes(self, problem: OptimalControlProblem, seconds: dict[str, float]) -> Outcome:
        """Return the outcome of a search over modes: its bound is that of the relaxed problem, below the optimum."""
        found, multipliers = self.found, self._placed(self.found.multipliers)
        outcome = replace(found, problem=problem, multipliers=multipliers, seconds=seconds, tree=self._placed_tree())
        if found.certificate is None or found.trajectory is None or multipliers is None:
            return outcome
        certificate = judge(problem, found.trajectory, multipliers)
        old = found.certificate
        certificate = replace(certificate, bound=old.bound, borders=old.borders, descent=old.descent)
        if found.status not in (Status.OPTIMAL, Status.LOCALLY_OPTIMAL):
            return replace(outcome, certificate=certificate)
        proven = max(old.gap or 0.0, 0.0) + GAP_TOLERANCE if found.status == Status.OPTIMAL else -np.inf
        status = certificate.status_within(proven)
        if status != found.status:
            message = f"at the frequencies of {plural(len(self.frequencies), 'mask')} only"
            return replace(outcome, certificate=certificate, status=status, message=message)
        return replace(outcome, certificate=certificate)

    def _placed_tree(self) -> ModeTree | None:
        tree = self.found.tree
        if tree is None:
            return None
        proofs = [
            None if node.proof is None else replace(node.proof, multipliers=self._placed(node.proof.multipliers))
            for node in tree.nodes
        ]
        nodes = zip(tree.nodes, proofs, strict=True)
        return replace(tree, nodes=tuple(replace(node, proof=proof) for node, proof in nodes))

    def _placed(self, multipliers: Multipliers | None) -> Multipliers | None:
        """Return multipliers with the frequencies that they stand at; those of zero are left out."""
        if multipliers is None:
            return None
        stage, frequencies = dict(multipliers.stage), Frequencies()
        for name, w in self.frequencies.items():
            weights = multipliers.stage.get(name, np.zeros((len(w), 2)))
            used = np.flatnonzero(weights.any(axis=1))
            stage[name], frequencies[name] = weights[used], w[used]
        return replace(multipliers, stage=stage, frequencies=frequencies)


def _claimed(status: Status) -> str:
    return str(status) if status in (Status.UNBOUNDED, Status.LIMIT, Status.NUMERICAL_ERROR) else "optimal"
