"""Exit statuses and tables of what a solve or a certificate says."""

from __future__ import annotations

from lin_freq_ocp.api.result import Result
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.cli.console import NO_SOLUTION, NOT_PROVEN, PROVEN, print_lines, print_table
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.starting import INTERRUPTED
from lin_freq_ocp.status import Status


def exit_status(result: Result) -> int:
    """Return the exit status of a result."""
    if result.interrupted:
        return INTERRUPTED
    if result.status in (Status.INFEASIBLE, Status.UNBOUNDED):
        return NO_SOLUTION
    if result.tree is not None:  # extremal is not optimal where there are modes: what counts is the gap
        return PROVEN if result.status == Status.OPTIMAL else NOT_PROVEN
    return NOT_PROVEN if result.certificate is None else certificate_status(result.certificate)


def certificate_status(certificate: Certificate) -> int:
    """Return the exit status of a certificate."""
    extremal = certificate.pmp == "satisfied" and certificate.normal
    return PROVEN if extremal or certificate.globally_optimal else NOT_PROVEN


def print_conflict(result: Result) -> None:
    """Print the constraints in conflict, and what would help."""
    for one in result.conflict or ():
        print_lines(f"conflict  {one}")
    if result.explanation is not None:
        print_lines(str(result.explanation))


def print_certificate(problem: OptimalControlProblem, certificate: Certificate | None) -> None:
    """Print the conditions and the bound, if there is a certificate."""
    if certificate is not None:
        from lin_freq_ocp.report.tables import certificate_table

        print_table(certificate_table(problem, certificate), ("scale", "tolerance", "residual", "worst at"))
