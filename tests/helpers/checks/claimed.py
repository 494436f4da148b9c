"""What a mixed-integer solver claims of a mode sequence, compared with that sequence solved again."""

from __future__ import annotations

from dataclasses import dataclass

from lin_freq_ocp import OptimalControlProblem
from lin_freq_ocp.methods import Candidate, solve_convex
from lin_freq_ocp.methods.hybrid import SolverClaim

# Part of the cost by which a claim may differ: the solver meets rows of order 1 to 1e-6, and several add up
CLAIMED = 1e-5


@dataclass(frozen=True, eq=False)
class Resolved:
    """A claimed sequence, solved again: its candidate, its cost if it was solved, and what the claim got wrong."""

    candidate: Candidate
    cost: float | None
    message: str


def resolved(problem: OptimalControlProblem, claim: SolverClaim, backend: str = "clarabel") -> Resolved:
    """Solve the convex program of the claimed sequence, and say in words what the claim got wrong."""
    assert claim.sequence is not None
    candidate = solve_convex(problem.with_modes(claim.sequence), backend)
    if candidate.status != "optimal" or candidate.trajectory is None:
        message = f"the program of the claimed sequence ended as {candidate.status} ({candidate.message})"
        return Resolved(candidate, None, message)
    cost = problem.value(candidate.trajectory.x, candidate.trajectory.u)
    allowed = CLAIMED * max(1.0, abs(cost))
    return Resolved(candidate, cost, "; ".join(differences(claim, cost, allowed, "its sequence")))


def differences(claim: SolverClaim, cost: float, allowed: float, source: str) -> list[str]:
    """Return in words where the claim differs by more than is allowed from the cost of what ``source`` names."""
    found: list[str] = []
    if claim.cost is not None and abs(claim.cost - cost) > allowed:
        which = "above" if claim.cost > cost else "below"
        found.append(f"the claimed cost {claim.cost:.9g} is {which} that of {source}, {cost:.9g}")
    if claim.bound is not None and claim.bound > cost + allowed:
        found.append(f"the claimed bound {claim.bound:.9g} is above the cost {cost:.9g} of a trajectory")
    return found
