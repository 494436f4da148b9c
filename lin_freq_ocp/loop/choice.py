"""Of the point where a solve ended without an answer, and the plan of the step before, the better one.

A feasible one is better than one that is not; of two feasible ones that of lower cost, prices of soft constraints
included; of two others the one that violates the constraints less. The judge says what is feasible.
"""

from __future__ import annotations

from dataclasses import replace

from lin_freq_ocp.certificate.verdict import judge
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.reformulations import translation_of
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.hybrid.smooth import no_multipliers
from lin_freq_ocp.solving.judging import allowed_residual


def better(problem: OptimalControlProblem, one: Trajectory, other: Trajectory, tolerance: float | None) -> Trajectory:
    """Return the better trajectory, the first if they are as good; ``tolerance`` is that asked of the solver."""
    return min(one, other, key=lambda given: rank(problem, given, tolerance))


def rank(problem: OptimalControlProblem, trajectory: Trajectory, tolerance: float | None) -> tuple[bool, float]:
    """Return what is less for the better trajectory: whether it is infeasible, and its cost, or else its violation."""
    near = translation_of(problem)
    none = replace(no_multipliers(near.problem), eta_C=0.0)  # so that the judge looks for no bound
    certificate = judge(near.problem, near.translated(trajectory), none, allowed_residual(tolerance))
    return (False, certificate.cost) if certificate.feasible else (True, certificate.violation)
