"""What mixed-integer solvers say of a problem: measured, and never believed."""

from __future__ import annotations

from dataclasses import dataclass, field

from lin_freq_ocp.arrays import Indices
from lin_freq_ocp.backends.base import Claim, Solution
from lin_freq_ocp.problem.trajectory import Trajectory

DEFAULT_GAP = 1e-6  # Relative gap asked of a solver: what its rows are met to; the claims it makes are no finer
# Part of the cost by which the claimed one may differ from that of the trajectory that the claim leads to
AGREEMENT = 1e-6

STATUS = {
    Claim.SOLVED: "optimal",
    Claim.INFEASIBLE: "infeasible",
    Claim.UNBOUNDED: "unbounded",
    Claim.LIMIT: "limit",
    Claim.INTERRUPTED: "interrupted",
    Claim.FAILED: "failed",
}


@dataclass(frozen=True, eq=False)
class SolverClaim:
    """What a mixed-integer solver says of a problem; nothing of it is proven.

    Attributes
    ----------
    status : str
        "optimal", "infeasible", "unbounded", "limit", "interrupted" or "failed", by its own word; "failed" also where
        the claimed point is none.
    sequence : (T,) or None
        Modes of the best point found.
    trajectory : Trajectory or None
        That point, as accurate as the solver's tolerances.
    cost : float or None
        Its cost J, in the problem's units, as far as the solver's point is a trajectory.
    bound : float or None
        A claimed lower bound on J.
    words : str
        The solver's own status, and what is wrong with its claim.
    seconds : dict
        Wall time of "setup" and "solve".
    """

    status: str
    sequence: Indices | None
    trajectory: Trajectory | None
    cost: float | None
    bound: float | None
    words: str
    seconds: dict[str, float] = field(default_factory=dict[str, float])


def status_of(solution: Solution) -> tuple[str, str]:
    """Return the status of a solver's answer, and its words: without a point, nothing is optimal."""
    if solution.claim is Claim.SOLVED and solution.z is None:
        return "failed", f"{solution.words}, without a point"
    return STATUS[solution.claim], solution.words
