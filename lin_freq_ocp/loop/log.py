"""The log of a generated controller, judged afterwards: every plan is proven from the data of the problem."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum
from functools import partial
from pathlib import Path

import numpy as np

from lin_freq_ocp.base.activity import tell
from lin_freq_ocp.base.arrays import Array, Mask, brief
from lin_freq_ocp.base.atomic import reason
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import plural, runs_in_words, runs_of
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.loop.embedded import log_header, step_problem
from lin_freq_ocp.loop.record import LoopRecord
from lin_freq_ocp.loop.step_problem import ControlLimits, complete_reference, excess, first_known_states, known_states
from lin_freq_ocp.loop.step_tables import REALS
from lin_freq_ocp.loop.windows import WindowedPlanner, has_windows
from lin_freq_ocp.methods.condensed.plans import UNLIMITED
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.spectrum.base import FrequencyConstraint, WindowSpectra, map_constraints
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.resolver import PlannedStart, Resolver, proven_in_batch
from lin_freq_ocp.transform.reductions import Change
from lin_freq_ocp.transform.reformulations import Translation, translation_of

MORE_DIGITS = re.compile(rf"(?<![0-9.])0*\.?0*[1-9](\.?[0-9]){{{REALS['float'].digits},}}")  # than float has
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

    ``cut_off`` says that its last line was incomplete, and ``rounding`` is that of its numbers, relative.
    """

    states: Array
    references: Array | None
    controls: Array
    statuses: tuple[StepStatus, ...]
    cut_off: bool
    rounding: float


@dataclass(frozen=True, eq=False)
class CertifiedLog(ControllerLog):
    r"""The log of a generated controller with the proofs of its steps.

    Attributes
    ----------
    states, controls : (N, n), (N, m)
        As logged; without the states that follow from the controls alone.
    references : (N, n) or None
        As logged.
    statuses : tuple of StepStatus
        As logged.
    cut_off : bool
        Whether the last line of the log was incomplete, and left out.
    rounding : float
        Relative rounding of its numbers: that of float if none of them has more digits, else that of double.
    problem : OptimalControlProblem
        That of a step, with its soft constraints.
    findings : tuple of LogFinding
        "proven", "infeasible, proven", "plan before", "deviates", "has a plan", "not proven" or "no state".
    planned : (N, m)
        First control of the optimal plan from each state; not a number where there is none.
    costs, gaps : (N,)
        Of these plans; the gap to a rigorous lower bound is relative to the terms of the cost.
    differences : (N,)
        Largest difference of a control from the planned one, relative to the largest control of the plan, or to the
        bound on the side of the planned control if that is smaller. 0 if it moves a state by no more than rounding.
        With windows, the part that rounding of the state and of the levels explains is left out; infinite if no plan
        that begins with the logged control keeps these levels.
    windows : tuple of WindowSpectra
        The spectra of all windows of the applied controls, with their limits, from the logged controls alone.

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
    windows: tuple[WindowSpectra, ...] = ()

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
            gap, apart = np.abs(self.gaps[proven]).max(), np.abs(self.controls - self.planned)[proven].max()
            lines.append(f"proven steps: largest gap {gap:.0e}; controls within {apart:.0e} of the optimal plans")
        deviating = np.flatnonzero([finding is LogFinding.DEVIATES for finding in self.findings])
        if len(deviating):
            apart = np.abs(self.controls - self.planned)[deviating]
            furthest = apart.max(where=~np.isnan(apart), initial=0.0)  # not a number where there is no plan
            where = runs_in_words(runs_of(deviating))
            lines.append(f"steps that deviate, by {furthest:.0e} at most: {where}")
        lines += [f"applied windows of {one.name}: at most {one.ratios.max():.3f} of the limit" for one in self.windows]
        return "\n".join([*lines, *(["the last line was incomplete and is left out"] if self.cut_off else [])])


def read_log(path: Path, problem: OptimalControlProblem) -> ControllerLog:
    """Read a log of a controller of this problem; ProblemError with the line if it is none."""
    n, m = int((~known_states(problem.linear)).sum()), problem.control_dim
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
    real = REALS["double" if any(map(MORE_DIGITS.search, lines)) else "float"]
    return ControllerLog(values[:, :n], references, values[:, -1 - m : -1], statuses, cut_off, real.epsilon)


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
    known = known_states(stated.linear)
    starts = _starts_of_plans(stated, known, log, delay)
    resolver, verdicts, windows = Resolver(stated), dict[int, _Verdict](), tuple[WindowSpectra, ...]()
    steps, changes = np.flatnonzero(valid).tolist(), [Change(x) for x in starts]
    for k, given in enumerate([] if log.references is None else log.references):
        changes[k] = Change(starts[k], references={"x_ref": complete_reference(stated, known, given)})
    if has_windows(problem):
        rounding = next(real.tolerance for real in REALS.values() if real.epsilon == log.rounding)
        spectrum = map_constraints(problem.control_spectrum, partial(_raise_windows, 1 + rounding))
        planner, steps = WindowedPlanner(replace(problem, control_spectrum=spectrum), penalties, delay), []
        verdicts = _windowed_verdicts(planner, log, changes, rounding, tolerance)
        applied = np.vstack([np.zeros((delay, stated.control_dim)), log.controls])[: len(starts)]
        windows = LoopRecord(problem, (), acted=applied).spectra()
    for first in range(0, len(steps), STEPS_AT_ONCE):
        tell(f"{first} of {len(steps)} steps certified")
        groups = dict[int, dict[int, PlannedStart]]()  # by the problem whose states have the same origin
        for k in steps[first : first + STEPS_AT_ONCE]:
            plan = resolver.plan(starts[k]) if log.references is None else None
            if plan is not None:
                groups.setdefault(id(plan.translation), {})[k] = plan
            elif resolver.excluded(changes[k]):
                verdicts[k] = _Verdict(Status.INFEASIBLE)
            else:
                outcome = resolver.solve(changes[k])
                resolver.remember_ray(outcome)
                verdicts[k] = _Verdict.of(outcome, tolerance)
        for group in groups.values():
            for k, one in proven_in_batch(group).items():
                proven = _Verdict(Status.OPTIMAL, one.cost, one.gap)
                verdicts[k] = proven.with_plan(group[k].translation, Trajectory(one.x, one.u), tolerance)
            for k in group.keys() - verdicts:
                verdicts[k] = _Verdict.of(group[k].certified(None), tolerance)
    each, limits = [verdicts.get(k, _Verdict(None)) for k in range(len(starts))], ControlLimits.of(stated)
    differences = np.full(len(starts), np.nan)
    for k, one in verdicts.items():
        if one.plan is not None:
            differences[k] = _difference(stated, log.rounding, starts[k], log.controls[k], one.plan, one.moved)
    agrees = [
        difference <= tolerance and not limits.violated(x, u, log.rounding)
        for difference, x, u in zip(differences, starts, log.controls, strict=True)
    ]
    none = np.full(stated.control_dim, np.nan)
    return CertifiedLog(
        **vars(log),
        problem=stated,
        findings=tuple(map(_finding_of_step, log.statuses, each, agrees)),
        planned=np.array([none if one.plan is None else one.plan.u[0] for one in each]),
        costs=np.array([one.cost for one in each]),
        gaps=np.array([one.gap for one in each]),
        differences=differences,
        windows=windows,
    )


def _raise_windows(factor: float, one: FrequencyConstraint) -> FrequencyConstraint:
    """Return a limit on windows that is higher by a factor; other constraints stay."""
    return one if one.levels is None or not one.remembers else one.at_levels(factor * one.levels)


def _windowed_verdicts(
    planner: WindowedPlanner, log: ControllerLog, changes: Sequence[Change], rounding: float, tolerance: float
) -> dict[int, _Verdict]:
    """Return the verdicts on the plans of a controller with windows, each after the controls that were logged.

    The levels of a step are those of a plan that begins with the control logged before: it exists if that control was
    right, and its rest keeps them. The rest of the optimal plan, which begins with another one, need not. Where the
    logged control is not that of the step, another one acted, and the controller goes on from the rest of its plan.
    """
    verdicts = dict[int, _Verdict]()
    for k, (status, change) in enumerate(zip(log.statuses, changes, strict=True)):
        begin = np.asarray(change.initial_state)
        found = planner.plan(begin, None if change.references is None else change, UNLIMITED)
        moved = planner.shift(begin, log.rounding, rounding)
        apart = _difference(planner.stated, log.rounding, begin, log.controls[k], found.trajectory, moved)
        acted = status <= StepStatus.SOFTENED and apart > tolerance
        held = acted or planner.hold(begin, log.controls[k]) or found.raised > rounding
        planner.apply(log.controls[k])
        if status is StepStatus.NO_STATE or not found.plan.settled:
            continue
        outcome = found.certified(None)
        if outcome.status.solved:
            one = _Verdict.of(outcome, tolerance)
            satisfied, exceeded = one.satisfied and found.raised <= tolerance, one.exceeded or found.raised > 0
            moved = moved if held else np.full_like(moved, -np.inf)
            verdicts[k] = replace(one, status=outcome.status, satisfied=satisfied, exceeded=exceeded, moved=moved)
    return verdicts


def _starts_of_plans(problem: OptimalControlProblem, known: Mask, log: ControllerLog, delay: int) -> Array:
    """Return the states from which the logged plans begin, (N, n): measured ones, and those that follow from controls.

    With a delay, the control that was returned last leads from the measured state to them. It also acts at a step
    without a state.
    """
    step, m = problem.form.stepper(problem.horizon), problem.control_dim
    starts, kept = np.zeros((len(log.states), problem.state_dim)), first_known_states(problem, known)
    returned, acting = np.zeros(m), np.zeros(m)
    for k, status in enumerate(log.statuses):
        x, valid = starts[k], status is not StepStatus.NO_STATE
        x[~known], x[known] = (log.states[k] if valid else 0.0), kept
        acting, returned = returned, log.controls[k] if valid else returned
        after = step(0, x, acting if delay else returned)
        kept = after[known]
        if delay:
            starts[k] = after
    return starts


def _difference(
    problem: OptimalControlProblem, rounding: float, x: Array, u: Array, plan: Trajectory, moved: Array | None
) -> float:
    """Return the largest difference of a control from the first one of a plan from x, relative to its size.

    A difference is none where rounding has ``moved`` the planned control by as much. Where that is not known, it is
    none if it moves a state by no more than the rounding of its terms: a controller that removes this rounding in one
    step differs by as much.
    """
    planned, (A, B, d) = plan.u[0], problem.linear.gains()
    bounds = np.where(planned > 0, problem.control_tube.upper[0], -problem.control_tube.lower[0])
    sizes = np.abs(plan.u).max(axis=0)
    sizes, apart = np.where(bounds > 0, np.minimum(sizes, bounds), sizes), np.abs(u - planned)
    if moved is None:
        rounded = rounding * (A @ np.abs(x) + B @ np.abs(planned) + d)
        apart[((B * apart <= rounded[:, None]) & (B > 0)).any(axis=0)] = 0.0
    else:
        apart = np.maximum(apart - moved, 0.0)
    return float(np.divide(apart, sizes, out=np.where(apart > 0, np.inf, 0.0), where=sizes > 0).max())


@dataclass(frozen=True)
class _Verdict:
    """A status that is proven, or None, with the plan and its cost and gap.

    ``satisfied`` says that the plan violates no soft constraint by more than the tolerance, and ``exceeded`` that it
    violates one at all. ``moved`` is how far rounding moves its first control, (m,).
    """

    status: Status | None
    cost: float = float("nan")
    gap: float = float("nan")
    plan: Trajectory | None = None
    satisfied: bool = True
    exceeded: bool = False
    moved: Array | None = None

    @classmethod
    def of(cls, outcome: Outcome, tolerance: float) -> _Verdict:
        """Return the proven status of an outcome, and its plan."""
        certificate, plan = outcome.certificate, outcome.trajectory
        if outcome.status is Status.INFEASIBLE or certificate is None or plan is None:
            return cls(Status.INFEASIBLE if outcome.status is Status.INFEASIBLE else None)
        proven = outcome.status.solved and (certificate.pmp == "satisfied" or certificate.globally_optimal)
        gap = float("nan") if certificate.gap is None else certificate.gap
        verdict = cls(Status.OPTIMAL if proven else None, certificate.cost, gap)
        return verdict.with_plan(translation_of(outcome.problem), plan, tolerance) if outcome.status.solved else verdict

    def with_plan(self, translation: Translation, plan: Trajectory, tolerance: float) -> _Verdict:
        """Return the verdict with its plan, compared with the soft constraints."""
        satisfied, exceeded = not excess(translation, plan, tolerance), bool(excess(translation, plan, 0.0))
        return replace(self, plan=plan, satisfied=satisfied, exceeded=exceeded)


def _finding_of_step(status: StepStatus, verdict: _Verdict, agrees: bool) -> LogFinding:
    """Return the finding about a step from its status, the verdict on its problem, and whether controls agree."""
    if status is StepStatus.NO_STATE:
        return LogFinding.NO_STATE
    if status is StepStatus.CAPPED:
        return LogFinding.FALLBACK
    if verdict.status is None:
        return LogFinding.UNPROVEN
    if status is StepStatus.INFEASIBLE:
        return LogFinding.INFEASIBLE if verdict.status is Status.INFEASIBLE else LogFinding.REFUTED
    as_stated = verdict.satisfied if status is StepStatus.PLANNED else verdict.exceeded
    proven = verdict.status is Status.OPTIMAL and agrees and as_stated
    return LogFinding.PROVEN if proven else LogFinding.DEVIATES
