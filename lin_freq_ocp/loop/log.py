"""The log of a generated controller, judged afterwards: every plan is proven from the data of the problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from pathlib import Path

import numpy as np

from lin_freq_ocp.base.arrays import Array, Mask, brief
from lin_freq_ocp.base.atomic import reason
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import plural
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.batch.repeated import PlannedStart, Repeated, proven_in_batch
from lin_freq_ocp.loop.generate import log_header, step_problem
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.kept import Change
from lin_freq_ocp.solving.outcome import Outcome

AT_ONCE = 1000  # steps whose plans are kept until they are judged: some kB each


class StepStatus(IntEnum):
    """What a generated step returned, as in controller.h."""

    PLANNED = 0
    SOFTENED = 1
    CAPPED = 2
    INFEASIBLE = 3
    NO_STATE = 4


class Finding(StrEnum):
    """What is known of a logged step."""

    PROVEN = "proven"  # the control is the first one of a plan that is proven optimal
    INFEASIBLE = "infeasible, proven"  # and the plan before was applied
    FALLBACK = "plan before"  # was applied: the cap was reached
    DEVIATES = "deviates"  # the control is not that of the optimal plan
    REFUTED = "has a plan"  # although the step found none
    UNPROVEN = "not proven"
    NO_STATE = "no state"  # a measured value was not finite, or too large


@dataclass(frozen=True, eq=False)
class Log:
    """The lines of a log: states (N, n), references (N, n) or None, controls (N, m), and statuses.

    ``cut_off`` says that its last line was incomplete.
    """

    states: Array
    references: Array | None
    controls: Array
    statuses: tuple[StepStatus, ...]
    cut_off: bool = False


@dataclass(frozen=True, eq=False)
class CertifiedLog:
    r"""The log of a generated controller with what is proven of its steps.

    Attributes
    ----------
    problem : OptimalControlProblem
        That of a step, with its soft constraints.
    states, controls : (N, n), (N, m)
        As logged.
    references : (N, n) or None
        As logged.
    statuses : tuple of StepStatus
        As logged.
    findings : tuple of Finding
        "proven", "infeasible, proven", "plan before", "deviates", "has a plan", "not proven" or "no state".
    planned : (N, m)
        First control of the optimal plan from each state; not a number where there is none.
    costs, gaps : (N,)
        Of these plans; the gap to a rigorous lower bound is relative to the terms of the cost.
    differences : (N,)
        Largest difference of a control from the planned one, relative to the largest bound of that control, or without
        one to the largest logged value.
    cut_off : bool
        Whether the last line of the log was incomplete, and left out.

    Examples
    --------
    >>> controller = lfo.RecedingHorizon(lfo.library.double_integrator(horizon=20, terminal_state=None))
    >>> log = "x1,x2,u1,status\n0,0,0,0\n"  # of a step that measured zero and returned zero
    >>> with open("log.csv", "w") as file:
    ...     _ = file.write(log)
    >>> print(lfo.certify_log(controller, "log.csv").findings[0])
    proven
    """

    problem: OptimalControlProblem
    states: Array
    controls: Array
    references: Array | None
    statuses: tuple[StepStatus, ...]
    findings: tuple[Finding, ...]
    planned: Array
    costs: Array
    gaps: Array
    differences: Array
    cut_off: bool = False

    def __len__(self) -> int:
        return len(self.findings)

    @property
    def proven(self) -> Mask:
        """Return which controls are proven to begin an optimal plan, (N,)."""
        return np.array([finding is Finding.PROVEN for finding in self.findings], dtype=bool)

    @property
    def table(self) -> list[dict[str, object]]:
        """Return a flat row for each step, for pandas.DataFrame."""
        return [
            {
                "step": k,
                "status": int(self.statuses[k]),
                "finding": str(self.findings[k]),
                "cost": float(self.costs[k]),
                "gap": float(self.gaps[k]),
                "difference": float(self.differences[k]),
            }
            for k in range(len(self))
        ]

    def __str__(self) -> str:
        counts = {finding: self.findings.count(finding) for finding in Finding}
        parts = [f"{count} {finding}" for finding, count in counts.items() if count]
        proven = self.proven
        lines = [f"{plural(len(self), 'step')}: {', '.join(parts)}"]
        if proven.any():
            gap, apart = np.abs(self.gaps[proven]).max(), self.differences[proven].max()
            lines.append(f"largest gap {gap:.0e}; controls within {apart:.0e} of the optimal plans")
        if self.cut_off:
            lines.append("the last line was incomplete and is left out")
        return "\n".join(lines)


def read_log(path: Path, problem: OptimalControlProblem) -> Log:
    """Read a log of a controller of this problem; ProblemError with the line if it is none."""
    n, m = problem.state_dim, problem.control_dim
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError as error:
        raise ProblemError(str(path), reason(error), "a log that can be read") from None
    headers = [log_header(n, m, references) for references in (False, True)]
    header = lines[0].strip()
    if header not in headers:
        raise ProblemError(f"{path}: line 1", brief(header), f'"{headers[0]}", or with references "{headers[1]}"')
    rows, cut_off = list[list[float]](), False
    for i, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        try:
            rows.append(_log_row(f"{path}: line {i}", line, header.count(",") + 1))
        except ProblemError:
            if i < len(lines):
                raise
            cut_off = True  # where the power was lost
    if not rows:
        raise ProblemError(str(path), "no steps", "a line for each step, after the header")
    values, referred = np.array(rows), header == headers[1]
    return Log(
        values[:, :n],
        values[:, n : 2 * n] if referred else None,
        values[:, -1 - m : -1],
        tuple(StepStatus(int(status)) for status in values[:, -1]),
        cut_off,
    )


def _log_row(location: str, line: str, count: int) -> list[float]:
    """Return the numbers of a line."""
    try:
        row = [float(entry) for entry in line.split(",")]
    except ValueError:
        row = []
    if len(row) != count:
        raise ProblemError(location, brief(line), f"{count} numbers, with commas between them")
    if row[-1] not in list(StepStatus):
        raise ProblemError(location, f"status {row[-1]:g}", "a status from 0 to 4")
    if not np.isfinite(row).all() and row[-1] != StepStatus.NO_STATE:
        raise ProblemError(location, brief(line), "finite numbers, but for steps of status 4")
    return row


def certify_log(
    problem: OptimalControlProblem, penalties: Mapping[str, float], delay: int, path: Path, tolerance: float
) -> CertifiedLog:
    """Judge the steps of a log; see ``lfo.certify_log``."""
    stated = step_problem(problem, penalties)
    log = read_log(path, stated)
    valid = np.array([status is not StepStatus.NO_STATE for status in log.statuses], dtype=bool)
    starts = log.states
    if delay:  # the control before leads to the state from which a plan begins
        acting, step = np.vstack([np.zeros_like(log.controls[:1]), log.controls[:-1]]), stated.dynamics.stepper(1)
        starts = np.array([step(0, x, u) if ok else x for x, u, ok in zip(log.states, acting, valid, strict=True)])
    repeated, count = Repeated(stated), len(starts)
    verdicts: list[Status | None] = [None] * count
    planned, costs, gaps = np.full(log.controls.shape, np.nan), np.full(count, np.nan), np.full(count, np.nan)
    steps = np.flatnonzero(valid)
    for first in range(0, len(steps), AT_ONCE):
        pending = dict[int, PlannedStart]()
        for k in steps[first : first + AT_ONCE].tolist():
            x_ref = None if log.references is None else np.tile(log.references[k], (stated.horizon + 1, 1))
            change = Change(starts[k], references=None if x_ref is None else {"x_ref": x_ref})
            plan = repeated.plan(starts[k]) if x_ref is None else None
            if plan is not None:
                pending[k], planned[k] = plan, plan.control
            elif repeated.excluded(change):
                verdicts[k] = Status.INFEASIBLE
            else:
                outcome = repeated.solve(change)
                repeated.keep(outcome)
                verdicts[k], costs[k], gaps[k] = _verdict(outcome)
                if outcome.status.solved and outcome.trajectory is not None:
                    planned[k] = outcome.trajectory.u[0]
        groups = dict[int, dict[int, PlannedStart]]()
        for k, plan in pending.items():
            groups.setdefault(id(plan.translation), {})[k] = plan
        for group in groups.values():
            for k, proof in proven_in_batch(group).items():
                verdicts[k], (costs[k], gaps[k]) = Status.OPTIMAL, proof
        for k, plan in pending.items():
            if verdicts[k] is None:
                verdicts[k], costs[k], gaps[k] = _verdict(plan.certified(None))
    limits = np.abs(stated.control_tube.bounds).max(axis=(0, 1))
    largest = np.abs(log.controls[valid]).max(axis=0, initial=0.0)
    sizes = np.where(np.isfinite(limits), limits, largest)
    differences = (np.abs(log.controls - planned) / np.where(sizes > 0, sizes, 1.0)).max(axis=1)
    findings = _findings(log.statuses, verdicts, differences <= tolerance)
    return CertifiedLog(
        stated, log.states, log.controls, log.references, log.statuses, findings, planned, costs, gaps, differences,
        log.cut_off,
    )  # fmt: skip


def _verdict(outcome: Outcome) -> tuple[Status | None, float, float]:
    """Return a status that is proven, or None, with the cost and the gap of the point."""
    certificate, nothing = outcome.certificate, float("nan")
    if outcome.status is Status.INFEASIBLE:
        return Status.INFEASIBLE, nothing, nothing
    if certificate is None:
        return None, nothing, nothing
    gap = nothing if certificate.gap is None else certificate.gap
    proven = outcome.status.solved and (certificate.pmp == "satisfied" or certificate.globally_optimal)
    return Status.OPTIMAL if proven else None, certificate.cost, gap


def _findings(statuses: Sequence[StepStatus], verdicts: Sequence[Status | None], agree: Mask) -> tuple[Finding, ...]:
    """Return what is known of each step from its status, what is proven of its problem, and whether controls agree."""
    table = {
        (True, Status.OPTIMAL): Finding.PROVEN,
        (True, Status.INFEASIBLE): Finding.DEVIATES,
        (False, Status.OPTIMAL): Finding.REFUTED,
        (False, Status.INFEASIBLE): Finding.INFEASIBLE,
    }
    found = list[Finding]()
    for status, verdict, same in zip(statuses, verdicts, agree, strict=True):
        if status is StepStatus.NO_STATE:
            found.append(Finding.NO_STATE)
        elif status is StepStatus.CAPPED:
            found.append(Finding.FALLBACK)
        elif verdict is None:
            found.append(Finding.UNPROVEN)
        else:
            has_plan = status is not StepStatus.INFEASIBLE
            finding = table[has_plan, verdict]
            found.append(Finding.DEVIATES if finding is Finding.PROVEN and not same else finding)
    return tuple(found)
