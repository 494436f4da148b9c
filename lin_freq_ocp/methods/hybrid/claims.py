"""What mixed-integer solvers claim of a problem; nothing of it is proven."""

from __future__ import annotations

from dataclasses import dataclass, field

from lin_freq_ocp.base.arrays import Indices
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.program.backends.base import Claim, Solution

DEFAULT_GAP = 1e-6  # relative gap asked of a solver, as accurate as its rows
AGREEMENT = 1e-6  # relative difference allowed between the claimed cost and that of the claimed trajectory

STATUS = {
    Claim.SOLVED: "optimal",
    Claim.INFEASIBLE: "infeasible",
    Claim.UNBOUNDED: "unbounded",
    Claim.LIMIT: "limit",
    Claim.TIME_LIMIT: "limit",
    Claim.INTERRUPTED: "interrupted",
    Claim.FAILED: "failed",
}


@dataclass(frozen=True, eq=False)
class SolverClaim:
    """The claim of a mixed-integer solver about a problem, in the problem's units."""

    status: str  # "optimal", "infeasible", "unbounded", "limit", "interrupted" or "failed"
    sequence: Indices | None  # modes (T,) of the best point found
    trajectory: Trajectory | None  # that point, as accurate as the solver's tolerances
    cost: float | None
    bound: float | None  # claimed lower bound on the cost
    message: str  # the solver's own status, and what is wrong with its claim
    seconds: dict[str, float] = field(default_factory=dict[str, float])  # wall times of "setup" and "solve"


def status_of(solution: Solution) -> tuple[str, str]:
    """Return the status of a solver's answer and its words; without a point, nothing is optimal."""
    if solution.claim is Claim.SOLVED and solution.z is None:
        return "failed", f"{solution.message}, without a point"
    return STATUS[solution.claim], solution.message
