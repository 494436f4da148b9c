"""The outcome of a solve as plain data: its status, the best point, what is proven of it, or why there is none."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.between_samples import BetweenSamples, between_samples
from lin_freq_ocp.certificate.bound import RIGOROUS, Bound
from lin_freq_ocp.certificate.rays import Conflict, Direction, InfeasibilityProof
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.problem.level_rows import LevelUse, level_use
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reductions import Inverse
from lin_freq_ocp.problem.trajectory import Multipliers, Trajectory


@dataclass(frozen=True)
class Cure:
    """The least change of one block, all others as they are, after which there is a solution.

    Attributes
    ----------
    block : str
        As in a Conflict.
    amount : float
        By how much its bounds move outwards, in the units of the problem; for an end, the largest move of a component
        relative to its size; for a stop band, how many of its bins are passed on each edge; for an energy bound, of the
        root of its limit.
    words : str
        From what to what.

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
        Blocks of constraints that, with the dynamics, cannot hold together.
    irreducible : bool
        Whether each was taken away in turn, and the others could then hold together; False only where a solver was
        unsure or the time was over.
    cures : tuple of Cure
        For each block of the family that cures the whole problem by giving way alone: the least by which it must.

    Examples
    --------
    >>> print(lfo.results.Explanation(("initial state", "terminal state"), True, ()))
    together  initial state, terminal state
    """

    family: tuple[str, ...]
    irreducible: bool
    cures: tuple[Cure, ...]

    def __str__(self) -> str:
        lines = [f"together  {', '.join(self.family)}" + ("" if self.irreducible else " (perhaps fewer)")]
        lines += [f"cure      {cure}" for cure in self.cures]
        return "\n".join(lines)


class Evidence(ABC):
    """What only some kinds of problems have to prove an answer: a search tree."""

    @property
    @abstractmethod
    def lower_bound(self) -> float:
        """Return the bound on the cost of every trajectory that the judge verified; inf if there is none."""

    @abstractmethod
    def verified(self, problem: OptimalControlProblem) -> Bound | None:
        """Check the evidence once more, and return the bound that it proves."""

    @abstractmethod
    def recovered(self, inverse: Inverse) -> Evidence:
        """Return the evidence of a reduced problem as evidence for the given one: its multipliers, and its bounds."""

    @abstractmethod
    def __str__(self) -> str: ...


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
        The best point found, whatever the status, and what is proven of it.
    infeasibility : InfeasibilityProof or None
        If infeasible by a ray: the verified multipliers with eta_C = 0, their bound, and the constraints in conflict.
    message : str
        Why it ended so.
    interrupted : bool
        Whether Ctrl-C ended it; the best point until then is here.
    direction : Direction or None
        If unbounded: the verified direction along which every constraint holds and the cost decreases without bound.
    options : dict
        Keywords of solve: "method", "backend", "time_limit", "tolerance", and "node_limit", "start" and "global_bound"
        if given.
    sequence : (T,) integers or None
        With modes: the mode at every time.
    evidence : Evidence or None
        With modes: the search tree, and the bound that the judge verified of it.
    explanation : Explanation or None
        If ``lfo.solve`` raised an InfeasibleError: the constraints in conflict, and the least change that helps.
    reason : str
        Why "auto" took the method; empty if it was asked for.
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
        """Return what the bound on the cost, or the proof of infeasibility, holds for; None where there is neither.

        "rigorous": every trajectory; "numerical": those near the one found, or, of infeasibility, of practical size.
        """
        if self.infeasibility is not None:
            return self.infeasibility.bound.kind
        if self.status == Status.INFEASIBLE:  # by a search tree or by boxes
            return RIGOROUS
        found = None if self.certificate is None else self.certificate.bound
        return None if self.lower_bound is None else RIGOROUS if found is None else found.kind

    @property
    def ray(self) -> Multipliers | None:
        """Return the verified multipliers with eta_C = 0 of an infeasible problem; None where no ray proves it."""
        return None if self.infeasibility is None else self.infeasibility.multipliers

    @property
    def conflict(self) -> tuple[Conflict, ...] | None:
        """Return the blocks of constraints that the proof of infeasibility rests on."""
        return None if self.infeasibility is None else self.infeasibility.conflict

    @property
    def gap(self) -> float | None:
        """Return (cost - lower_bound) / S, S what the terms of the cost add up to."""
        return None if self.certificate is None else self.certificate.gap

    @property
    def level_use(self) -> LevelUse | None:
        """Return how the control uses its levels; None where it has none, or there is no trajectory."""
        return None if self.trajectory is None else level_use(self.problem, self.trajectory.u)

    @cached_property
    def between_samples(self) -> BetweenSamples | None:
        """The state bounds between the samples; None without a continuous plant, state bounds or a trajectory."""
        return None if self.trajectory is None else between_samples(self.problem, self.trajectory)

    @property
    def solver(self) -> str:
        """Return the method, with its backend if it has one."""
        return self.method if self.backend is None else f"{self.method}, {self.backend}"

    @property
    def control(self) -> Array | None:
        """Return u, shape (T, m)."""
        return None if self.trajectory is None else self.trajectory.u

    def __str__(self) -> str:
        lines = [f"status    {self.status}" + (f": {self.message}" if self.message else "")]
        lines += [] if self.certificate is None else [str(self.certificate)]
        lines += [] if self.evidence is None else [str(self.evidence)]
        levels = self.level_use
        lines += [] if levels is None else [f"levels    {levels}"]
        lines += [] if self.between_samples is None else [f"between   {self.between_samples}"]
        lines.append(f"method    {self.solver}" + (f": {self.reason}" if self.reason else ""))
        lines.append("time      " + ", ".join(f"{what} {seconds:.3g} s" for what, seconds in self.seconds.items()))
        return "\n".join([str(self.problem), *lines])
