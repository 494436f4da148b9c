"""The outcome of a solve as plain data: its status, the best point, the proofs, or why there is no point."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.phrases import html_table, term_rows
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.between_samples import BetweenSamples, bounds_between_samples
from lin_freq_ocp.certificate.bound import RIGOROUS, Bound
from lin_freq_ocp.certificate.rays import Conflict, Direction, InfeasibilityProof, proof_margin
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.methods.candidate import Attempt, Reason
from lin_freq_ocp.problem.description import problem_remarks
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.terms.quantity import Reading
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory
from lin_freq_ocp.transform.level_rows import LevelUse, level_use
from lin_freq_ocp.transform.reductions import Reduced

SMALL_MARGIN = 1e-5
"""Margin of an infeasibility proof below which rounding of the data may explain it: the sparse program may still find a
point that satisfies every constraint within the judge's tolerance."""

MOST_READINGS = 8  # of limited spectra in a text, those nearest to their limits


@dataclass(frozen=True)
class Cure:
    """The smallest relaxation of one block of constraints that restores feasibility, the others unchanged.

    Attributes
    ----------
    block : str
        As in a Conflict.
    amount : float
        The distance by which its bounds move outwards, in the units of the problem; for an end, the sum of the changes
        of its components, each divided by the size that the data state of it; for a stop band, the number of bins that
        it gives up at each edge; for an energy bound, the increase of the root of its limit.
    words : str
        The old and the new value.

    Examples
    --------
    >>> print(lfo.results.Cure("terminal state", 0.1, "[1., 0.] -> [0.9, 0.]"))
    terminal state: [1., 0.] -> [0.9, 0.]
    """

    block: str
    amount: float
    words: str

    def __str__(self) -> str:
        return f"{self.block}: {self.words}"


@dataclass(frozen=True)
class Explanation:
    """Why a problem has no solution.

    Attributes
    ----------
    family : tuple of str
        An infeasible subset of the blocks of constraints: with the dynamics, no trajectory satisfies all of them.
    irreducible : bool
        Whether the subset becomes feasible if any one block is left out; False only if a solver was unsure of that, or
        the time was over.
    cures : tuple of Cure
        For each block of the subset that can restore feasibility alone: the smallest relaxation that does.

    Examples
    --------
    >>> print(lfo.results.Explanation(("initial state", "terminal state"), True, ()))
    conflict  initial state, terminal state
    """

    family: tuple[str, ...]
    irreducible: bool
    cures: tuple[Cure, ...]

    def __str__(self) -> str:
        lines = [f"conflict  {', '.join(self.family)}" + ("" if self.irreducible else " (perhaps fewer)")]
        lines += [f"repair    {cure}" for cure in self.cures]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return html_table("No trajectory satisfies all constraints", term_rows(str(self).splitlines()))


class Evidence(ABC):
    """A proof of the answer that only some kinds of problems have, such as a search tree."""

    @property
    @abstractmethod
    def lower_bound(self) -> float:
        """Return the verified lower bound on the cost of every trajectory; inf if there is no trajectory."""

    @abstractmethod
    def verified(self, problem: OptimalControlProblem) -> Bound | None:
        """Check the evidence once more, and return the bound that it proves."""

    @abstractmethod
    def recovered(self, reduced: Reduced) -> Evidence:
        """Return the evidence for the given problem from that of the reduced one, with its multipliers and bounds."""

    @abstractmethod
    def __str__(self) -> str: ...


class Judged(NamedTuple):
    """A trajectory with its multipliers and the certificate of both."""

    trajectory: Trajectory
    multipliers: Multipliers
    certificate: Certificate

    def with_bound(self, bound: Bound | None) -> Judged:
        """Return the same with another bound on the optimal cost."""
        return self._replace(certificate=replace(self.certificate, bound=bound))


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of a solve; a field that does not apply is None.

    Attributes
    ----------
    problem : OptimalControlProblem
    status : Status
        How it ended; equal to its text, such as "optimal".
    method : str
        The shorthand of the method.
    backend : str or None
        The solver of the methods "convex" and "miqp"; others need none.
    seconds : dict
        Wall time of "setup" (rows, scaling), "solve" (the backend) and "certify".
    trajectory, multipliers, certificate : or None
        The best point, whatever the status, its multipliers and its certificate.
    infeasibility : InfeasibilityProof or None
        If infeasible, or claimed so, by a ray: multipliers with eta_C = 0, their bound, the constraints in conflict.
    message : str
        Why it ended so.
    interrupted : bool
        Whether Ctrl-C ended it; the fields then hold the best point until that moment.
    direction : Direction or None
        If unbounded: the verified direction along which every constraint holds and the cost decreases without bound.
    options : dict
        Keywords of solve: "method", "backend", "time_limit", "tolerance", and "node_limit", "start" and "global_bound"
        if given.
    sequence : (T,) integers or None
        With modes: the mode at every time.
    evidence : Evidence or None
        With modes: the search tree, and its bound, which the judge verified.
    explanation : Explanation or None
        If ``lfo.solve`` raised an InfeasibleError: the constraints in conflict, and the smallest relaxation that helps.
    reason : str
        Why "auto" chose the method; empty if the user did.
    attempts : tuple of Attempt
        What was tried, in this order: how each answer ended, and why another one was asked for.
    any_point : bool
        Whether the solve ended at the first trajectory that satisfies every constraint, as ``minimum_time`` asks for.
    has_trajectory : bool
        If unbounded: whether a trajectory is known that satisfies every constraint. With it, the claim is proven.
    """

    problem: OptimalControlProblem
    status: Status
    method: str
    backend: str | None
    seconds: dict[str, float]
    trajectory: Trajectory | None = None
    multipliers: Multipliers | None = None
    certificate: Certificate | None = None
    infeasibility: InfeasibilityProof | None = None
    message: str = ""
    interrupted: bool = False
    direction: Direction | None = None
    options: dict[str, object] = field(default_factory=dict[str, object])
    sequence: Indices | None = None
    evidence: Evidence | None = None
    explanation: Explanation | None = None
    reason: str = ""
    attempts: tuple[Attempt, ...] = ()
    any_point: bool = False
    has_trajectory: bool = False

    @cached_property
    def attempt(self) -> Attempt:
        """What ``attempts`` says of this answer, with the reason why another one may follow."""
        if self.interrupted or self.status == Status.LIMIT:
            reason = Reason.STOPPED
        elif self.status == Status.OPTIMAL:
            satisfied = self.certificate is None or self.certificate.pmp == "satisfied"
            reason = Reason.PROVEN if satisfied and self.multipliers is not None else Reason.MULTIPLIERS
        elif self.status == Status.INFEASIBLE and self.bound == RIGOROUS:
            clear = self.ray is None or proof_margin(self.problem, self.ray) > SMALL_MARGIN
            reason = Reason.PROVEN if clear else Reason.NEARLY_FEASIBLE
        elif self.infeasibility is not None:
            reason = Reason.CLAIMED
        else:
            unbounded = Reason.PROVEN if self.has_trajectory else Reason.UNBOUNDED
            solved = {Status.LOCALLY_OPTIMAL: Reason.LOCALLY_OPTIMAL, Status.UNBOUNDED: unbounded}
            reason = solved.get(self.status, Reason.FEASIBLE if self.primal else Reason.FAILED)
        return Attempt(self.method, self.status, reason, self.message)

    @property
    def primal(self) -> bool:
        """Whether there is a point that satisfies every constraint, within the judge's tolerance."""
        return self.certificate is not None and self.certificate.feasible

    @property
    def dual(self) -> bool:
        """Whether there is a proof: a lower bound on the cost, or a rigorous ray of infeasibility or one of descent."""
        infeasible = self.status == Status.INFEASIBLE and self.bound == RIGOROUS
        return infeasible or self.direction is not None or self.lower_bound is not None

    @property
    def cost(self) -> float | None:
        """Return J of the trajectory."""
        return None if self.certificate is None else self.certificate.cost

    @property
    def lower_bound(self) -> float | None:
        """Return the judge's bound on the optimal cost."""
        if self.certificate is None and self.evidence is not None and np.isfinite(self.evidence.lower_bound):
            return self.evidence.lower_bound
        return None if self.certificate is None else self.certificate.lower_bound

    @property
    def bound(self) -> str | None:
        """Return the scope of the bound on the cost or of the proof of infeasibility; None if there is neither.

        "rigorous": every trajectory; "numerical": trajectories near the best one, or, of a claim of infeasibility,
        those up to the sizes that the message says.
        """
        if self.infeasibility is not None:
            return self.infeasibility.bound.kind
        if self.status == Status.INFEASIBLE:  # by a search tree or by boxes
            return RIGOROUS
        bound = None if self.certificate is None else self.certificate.bound
        return None if self.lower_bound is None else RIGOROUS if bound is None else bound.kind

    @property
    def ray(self) -> Multipliers | None:
        """Return the multipliers with eta_C = 0 that exclude trajectories; with the bound "numerical", not all."""
        return None if self.infeasibility is None else self.infeasibility.multipliers

    @property
    def conflict(self) -> tuple[Conflict, ...] | None:
        """Return the blocks of constraints that the proof of infeasibility uses."""
        if self.infeasibility is None:
            return None
        margin_at = self.problem.margin_at
        return tuple(replace(one, margin=margin_at(one.block, one.times)) for one in self.infeasibility.conflict)

    @property
    def gap(self) -> float | None:
        """Return (cost - lower_bound) / S, where S is the sum of the absolute terms of the cost."""
        return None if self.certificate is None else self.certificate.gap

    @property
    def level_use(self) -> LevelUse | None:
        """Return how the control uses its levels; None where it has none, or there is no trajectory."""
        return None if self.trajectory is None else level_use(self.problem, self.trajectory.u)

    @cached_property
    def between_samples(self) -> BetweenSamples | None:
        """The state bounds between the samples; None without a continuous plant, state bounds or a trajectory."""
        return None if self.trajectory is None else bounds_between_samples(self.problem, self.trajectory)

    @cached_property
    def readings(self) -> tuple[Reading, ...]:
        """The values of limited spectra and their limits, in the unit of the limit; none without a trajectory."""
        plan = self.trajectory
        return (
            () if plan is None else tuple(one for term in self.problem.terms for one in term.readings(plan.x, plan.u))
        )

    @property
    def remarks(self) -> list[str]:
        """Return what in the problem limits nothing, or everything, and which references lie outside their bounds."""
        return problem_remarks(self.problem, self.problem.terms)

    @property
    def solver(self) -> str:
        """Return the method, with its backend if it has one."""
        return self.method if self.backend is None else f"{self.method}, {self.backend}"

    @property
    def control(self) -> Array | None:
        """Return u, shape (T, m)."""
        return None if self.trajectory is None else self.trajectory.u

    def __str__(self) -> str:
        words = [text for text in (self.message, *self.remarks) if text]
        lines = [f"status    {self.status}" + (f": {'; '.join(words)}" if words else "")]
        lines += [] if self.certificate is None else [str(self.certificate)]
        lines += [] if self.evidence is None else [str(self.evidence)]
        levels = self.level_use
        lines += [] if levels is None else [f"levels    {levels}"]
        lines += [] if self.between_samples is None else [f"between   {self.between_samples}"]
        nearest = sorted(self.readings, key=lambda reading: -reading.ratio)[:MOST_READINGS]
        lines += [f"spectrum  {reading}" for reading in self.readings if reading in nearest]
        more = len(self.readings) - len(nearest)
        lines += [f"spectrum  {more} more, each farther from its limit"] if more else []
        lines.append(f"method    {self.solver}" + (f": {self.reason}" if self.reason else ""))
        lines.append("time      " + ", ".join(f"{phase} {seconds:.3g} s" for phase, seconds in self.seconds.items()))
        return "\n".join([str(self.problem), *lines])
