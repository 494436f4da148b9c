"""The log of a generated controller, judged afterwards: every plan is proven from the data of the problem."""

from __future__ import annotations

from collections.abc import Mapping
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
from lin_freq_ocp.loop.embedded import log_header, step_problem
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solver_cache import Change

STEPS_AT_ONCE = 1000  # steps whose plans are kept until they are judged: some kB each


class StepStatus(IntEnum):
    """The status of a generated step, as in controller.h."""

    PLANNED = 0
    SOFTENED = 1
    CAPPED = 2
    INFEASIBLE = 3
    NO_STATE = 4


class LogFinding(StrEnum):
    """The finding about a logged step."""

    PROVEN = "proven"  # the control is the first one of a plan that is proven optimal
    INFEASIBLE = "infeasible, proven"  # and the plan before was applied
    FALLBACK = "plan before"  # was applied: the cap was reached
    DEVIATES = "deviates"  # the control is not that of the optimal plan
    REFUTED = "has a plan"  # although the step found none
    UNPROVEN = "not proven"
    NO_STATE = "no state"  # a measured value was not finite, or too large


@dataclass(frozen=True, eq=False)
class ControllerLog:
    """The lines of a log: states (N, n), references (N, n) or None, controls (N, m), and statuses.

    ``cut_off`` says that its last line was incomplete.
    """

    states: Array
    references: Array | None
    controls: Array
    statuses: tuple[StepStatus, ...]
    cut_off: bool


@dataclass(frozen=True, eq=False)
class CertifiedLog(ControllerLog):
    r"""The log of a generated controller with the proofs of its steps.

    Attributes
    ----------
    states, controls : (N, n), (N, m)
        As logged.
    references : (N, n) or None
        As logged.
    statuses : tuple of StepStatus
        As logged.
    cut_off : bool
        Whether the last line of the log was incomplete, and left out.
    problem : OptimalControlProblem
        That of a step, with its soft constraints.
    findings : tuple of LogFinding
        "proven", "infeasible, proven", "plan before", "deviates", "has a plan", "not proven" or "no state".
    planned : (N, m)
        First control of the optimal plan from each state; not a number where there is none.
    costs, gaps : (N,)
        Of these plans; the gap to a rigorous lower bound is relative to the terms of the cost.
    differences : (N,)
        Largest difference of a control from the planned one, relative to the largest bound of that control, or without
        one to the largest logged value.

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
    findings: tuple[LogFinding, ...]
    planned: Array
    costs: Array
    gaps: Array
    differences: Array

    def __len__(self) -> int:
        return len(self.findings)

    @property
    def proven(self) -> Mask:
        """Return which controls are proven to begin an optimal plan, (N,)."""
        return np.array([finding is LogFinding.PROVEN for finding in self.findings], dtype=bool)

    @property
    def table(self) -> list[dict[str, object]]:
        """Return a flat row for each step, for pandas.DataFrame."""
        columns = map(int, self.statuses), map(str, self.findings), self.costs, self.gaps, self.differences
        names = "step", "status", "finding", "cost", "gap", "difference"
        return [dict(zip(names, row, strict=True)) for row in zip(range(len(self)), *columns, strict=True)]

    def __str__(self) -> str:
        counts = [f"{count} {finding}" for finding in LogFinding if (count := self.findings.count(finding))]
        lines, proven = [f"{plural(len(self), 'step')}: {', '.join(counts)}"], self.proven
        if proven.any():
            gap, apart = np.abs(self.gaps[proven]).max(), self.differences[proven].max()
            lines.append(f"largest gap {gap:.0e}; controls within {apart:.0e} of the optimal plans")
        return "\n".join([*lines, *(["the last line was incomplete and is left out"] if self.cut_off else [])])


def read_log(path: Path, problem: OptimalControlProblem) -> ControllerLog:
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
        try:
            rows += [_log_row(line, header.count(","))] if line.strip() else []
        except ValueError as error:
            if i < len(lines):
                raise ProblemError(f"{path}: line {i}", brief(line), str(error)) from None
            cut_off = True  # where the power was lost
    if not rows:
        raise ProblemError(str(path), "no steps", "a line for each step, after the header")
    values, references = np.array(rows), np.array(rows)[:, n : 2 * n] if header == headers[1] else None
    statuses = tuple(StepStatus(int(status)) for status in values[:, -1])
    return ControllerLog(values[:, :n], references, values[:, -1 - m : -1], statuses, cut_off)


def _log_row(line: str, columns: int) -> list[float]:
    """Return the numbers of a line; ValueError with the expectation."""
    try:
        row = [float(entry) for entry in line.split(",")]
    except ValueError:
        row = []
    if len(row) != columns + 1 or row[-1] not in list(StepStatus):
        raise ValueError(f"{columns} numbers and a status from 0 to 4, with commas between them")
    if not np.isfinite(row).all() and row[-1] != StepStatus.NO_STATE:
        raise ValueError("finite numbers, but for steps of status 4")
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
    repeated, verdicts = Repeated(stated), dict[int, _Verdict]()
    steps, planned = np.flatnonzero(valid).tolist(), np.full(log.controls.shape, np.nan)
    for first in range(0, len(steps), STEPS_AT_ONCE):
        groups = dict[int, dict[int, PlannedStart]]()  # by the problem whose states have the same origin
        for k in steps[first : first + STEPS_AT_ONCE]:
            references, plan = None, None
            if log.references is None:
                plan = repeated.plan(starts[k])
            else:
                references = {"x_ref": np.tile(log.references[k], (stated.horizon + 1, 1))}
            change = Change(starts[k], references=references)
            if plan is not None:
                groups.setdefault(id(plan.translation), {})[k], planned[k] = plan, plan.control
            elif repeated.excluded(change):
                verdicts[k] = _Verdict(Status.INFEASIBLE)
            else:
                outcome = repeated.solve(change)
                repeated.keep(outcome)
                verdicts[k] = _Verdict.of(outcome)
                if outcome.status.solved and outcome.trajectory is not None:
                    planned[k] = outcome.trajectory.u[0]
        for group in groups.values():
            proven = proven_in_batch(group)
            verdicts |= {k: _Verdict(Status.OPTIMAL, one.cost, one.gap) for k, one in proven.items()}
            verdicts |= {k: _Verdict.of(plan.certified(None)) for k, plan in group.items() if k not in verdicts}
    each = [verdicts.get(k, _Verdict(None)) for k in range(len(starts))]
    limits = np.abs(stated.control_tube.bounds).max(axis=(0, 1))
    sizes = np.where(np.isfinite(limits), limits, np.abs(log.controls[valid]).max(axis=0, initial=0.0))
    differences = (np.abs(log.controls - planned) / np.where(sizes > 0, sizes, 1.0)).max(axis=1)
    return CertifiedLog(
        **vars(log),
        problem=stated,
        findings=tuple(map(_finding_of_step, log.statuses, (one.status for one in each), differences <= tolerance)),
        planned=planned,
        costs=np.array([one.cost for one in each]),
        gaps=np.array([one.gap for one in each]),
        differences=differences,
    )


@dataclass(frozen=True)
class _Verdict:
    """A status that is proven, or None, with the cost and the gap of the plan."""

    status: Status | None
    cost: float = float("nan")
    gap: float = float("nan")

    @classmethod
    def of(cls, outcome: Outcome) -> _Verdict:
        """Return the proven status of an outcome."""
        certificate = outcome.certificate
        if outcome.status is Status.INFEASIBLE or certificate is None:
            return cls(Status.INFEASIBLE if outcome.status is Status.INFEASIBLE else None)
        proven = outcome.status.solved and (certificate.pmp == "satisfied" or certificate.globally_optimal)
        gap = float("nan") if certificate.gap is None else certificate.gap
        return cls(Status.OPTIMAL if proven else None, certificate.cost, gap)


def _finding_of_step(status: StepStatus, verdict: Status | None, agrees: bool) -> LogFinding:
    """Return the finding about a step from its status, the proven status of its problem, and whether controls agree."""
    if status is StepStatus.NO_STATE:
        return LogFinding.NO_STATE
    if status is StepStatus.CAPPED:
        return LogFinding.FALLBACK
    if verdict is None:
        return LogFinding.UNPROVEN
    if status is StepStatus.INFEASIBLE:
        return LogFinding.INFEASIBLE if verdict is Status.INFEASIBLE else LogFinding.REFUTED
    return LogFinding.PROVEN if verdict is Status.OPTIMAL and agrees else LogFinding.DEVIATES
