"""A receding-horizon controller: each step solves a problem from the measured state and applies the first control.

If a solve ends without an answer, the controller applies the better of two plans: its best point, and the rest of the
previous plan. A feasible plan is better than an infeasible one. Of two feasible plans the cheaper one is better, prices
of soft constraints included; of two infeasible plans the one with the smaller violation. The judge decides feasibility.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, brief, known_entries, one_component, positive_integer, real_array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import ClosedLoopWarning, LinFreqOCPError, ProblemError, UnsupportedError, warn_user
from lin_freq_ocp.base.names import ByName, values_by_name
from lin_freq_ocp.base.phrases import short_name
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.certificate.verdict import judge
from lin_freq_ocp.loop.record import LoopRecord, Source, Step
from lin_freq_ocp.loop.step_problem import (
    ControlLimits,
    checked_penalties,
    complete_reference,
    data_per_time,
    depends_on_past,
    excess,
    first_known_states,
    free_first_state,
    known_states,
    limits_of_plans,
    soften,
    with_past,
)
from lin_freq_ocp.loop.windows import WindowedPlan, WindowedPlanner, has_windows, without_first_plan
from lin_freq_ocp.methods.candidate import zero_multipliers
from lin_freq_ocp.methods.condensed.plans import UNLIMITED, Budget
from lin_freq_ocp.problem.costs.quadratic import PREVIEWED
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.spectrum.base import EXCEEDED
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.families import family_of
from lin_freq_ocp.solving.hybrid.modes import TreeCache
from lin_freq_ocp.solving.judging import allowed_residual
from lin_freq_ocp.solving.method import Method
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.resolver import PlannedStart, Resolver, proven_in_batch
from lin_freq_ocp.transform.reductions import Change
from lin_freq_ocp.transform.reformulations import translation_of
from lin_freq_ocp.transform.simulation import simulate

NO_SOLUTION = (Status.INFEASIBLE, Status.INFEASIBLE_CLAIMED)


class Controller:
    """The state of a receding-horizon controller: its measurements, applied controls and plans."""

    def __init__(
        self,
        problem: OptimalControlProblem,
        method: str | Method = "auto",
        soft: Mapping[str, float] | None = None,
        delay: int = 0,
        time_limit: float | None = None,
        certify: str = "each",
        max_changes: int | None = None,
    ):
        require_problem(problem)
        if certify not in ("each", "later"):
            advice = 'With "later", certify() judges the steps until then.'
            raise ProblemError("certify", brief(certify), '"each" or "later"', advice)
        if max_changes is not None and certify == "each":
            advice = "The judge takes longer than some hundred changes do."
            raise ProblemError("max_changes", brief(max_changes), 'certify="later" with it', advice)
        if delay not in (0, 1) or isinstance(delay, bool):
            raise ProblemError("delay", brief(delay), "0, or 1 for a control that acts one step after its measurement")
        if delay and problem.uncertainty is not None:
            text = "delay: got 1, for a problem of robust, whose feedback acts on the measured state at once"
            raise UnsupportedError(f"{text}; expected 0. State the delay as a state of the model.")
        self.problem, self.penalties, self.delay = problem, checked_penalties(soft), int(delay)
        if limits_of_plans(problem):
            warn_user(limits_of_plans(problem), ClosedLoopWarning)
        self._problem = free_first_state(problem)
        plans_by_kernel = method in ("auto", "spectral")
        method = family_of(problem).in_loop if method == "auto" else method
        self._hard = Resolver(self._problem, method)
        self._soft = Resolver(soften(self._problem, self.penalties), method) if self.penalties else None
        self._trees = {one: TreeCache() for one in (self._hard, self._soft) if one is not None}
        self._remembers, self._method, self._limit = depends_on_past(problem), method, time_limit
        self._later = certify == "later"
        self._most = None if max_changes is None else positive_integer("max_changes", max_changes)
        self._steps: list[Step] = []
        self._applied: list[Array] = []
        self._step = problem.form.stepper(problem.horizon)
        self._limits = ControlLimits.of(soften(self._problem, self.penalties))
        self._known = known_states(problem.linear) if self._hard.linear else np.zeros(problem.state_dim, dtype=bool)
        self._planner = self._windowed_planner() if plans_by_kernel else None
        if data_per_time(problem):
            warn_user(data_per_time(problem), ClosedLoopWarning)
        self.unknown_dim = int((~self._known).sum())  # how many states do not follow from the controls alone

    @property
    def record(self) -> LoopRecord:
        """Return the record of all steps so far."""
        acted = np.array([np.zeros(self.problem.control_dim)] * self.delay + self._applied)[: len(self._steps)]
        acted = acted.reshape(-1, self.problem.control_dim)
        return LoopRecord(self.problem, tuple(self._steps), acted=acted, delay=self.delay, known=self._known)

    def advance(
        self, state: ArrayLike | ByName, preview: Change, applied: ArrayLike | ByName | None
    ) -> tuple[Step | None, Outcome | None]:
        """Plan from a measured state; return the step, None if there is no control, and the answer of its problem.

        ``WindowedPlanner`` plans windows of the applied control, ``Resolver.plan`` where only the state is new. What
        neither plans, ``Resolver.solve`` does, for the hard problem and then the soft one.

        ``preview`` has the references, bounds and disturbance that the step foresees over its horizon. ``applied`` is
        the control that acted in the last step, if it was not the controller's.
        """
        m = self.problem.control_dim
        acted = None if applied is None else self.measured("applied", self.at_names("applied", applied), m)
        x = self.completed("state", state, acted)
        if preview.references is not None:
            preview = replace(preview, references=self._completed_references(preview.references))
        if acted is not None and len(self._applied) > self.delay:
            if self._planner is not None:
                self._planner.correct(acted - self._applied[-1 - self.delay], 1 + self.delay)
            self._applied[-1 - self.delay] = acted
        started, plain, begin = now(), preview.starts_elsewhere, x
        if self.delay:  # the state to which the last control leads
            begin = self._step(0, x, self._applied[-1] if self._applied else np.zeros(self.problem.control_dim))
        if self._planner is not None:
            self._record(self._windowed_step(self._planner, x, begin, preview, started))
            return self._steps[-1], None
        if plain and not self._remembers:
            for resolver in self._trees:  # the hard problem, then the soft one
                resolver.prepare(begin)  # so that also the first step without a solution takes no longer than others
        quick = self._condensed_step(x, begin, started) if plain else None
        if quick is not None and not self._later:
            assert isinstance(quick.pending, PlannedStart)  # without limits it has settled
            quick = prove([quick], {0: quick.pending}).get(0)
            if quick is not None and quick.plan is not None:
                self._hard.note_moves(quick.plan)
        if quick is not None:
            self._record(replace(quick, reference=self._reference(preview)))
            return self._steps[-1], None
        hard, soft = self._answers(x, begin, preview)
        outcome, solved = hard if soft is None else soft, now()
        plan = self._applied_plan(outcome)
        if plan is None:
            return None, outcome
        own, compared = plan is outcome.trajectory, now() - solved
        source = Source.PLAN if soft is None else Source.SOFTENED
        if not own:
            source = Source.PREVIOUS_PLAN
        elif not outcome.status.solved:
            source = Source.BEST_POINT
        certified = sum(one.seconds.get("certify", 0.0) for one in (hard, soft) if one is not None)
        certificate, parts = outcome.certificate if own else None, ((self._hard, hard), (self._soft, soft))
        limits = self._limits if preview.bounds is None else ControlLimits.of(outcome.problem)
        step = Step(
            state=x,
            control=limits.clip(begin, plan.u[0].copy()),
            status=hard.status,
            source=source,
            method=outcome.solver,
            cost=outcome.problem.value(plan.x, plan.u),
            gap=float("nan") if certificate is None or certificate.gap is None else certificate.gap,
            satisfied=certificate is not None and certificate.pmp == "satisfied",
            solve_seconds=solved - started - certified,
            certify_seconds=certified + compared,
            excess=excess(translation_of(outcome.problem), plan) if soft is not None else {},
            nodes=sum(self._trees[one].solved for one, answer in parts if one and answer),
            plan=plan,
            reference=self._reference(preview),
        )
        self._record(step)
        return step, outcome

    def _windowed_planner(self) -> WindowedPlanner | None:
        """Return the planner of the condensed kernel where windows limit the controls; None where programs do."""
        if not has_windows(self.problem) or not self._hard.linear:
            return None
        try:
            planner = WindowedPlanner(self.problem, self.penalties, self.delay)
        except UnsupportedError:
            return None
        if without_first_plan(self.problem):
            warn_user(without_first_plan(self.problem), ClosedLoopWarning)
        return planner

    def _windowed_step(self, planner: WindowedPlanner, x: Array, begin: Array, preview: Change, started: float) -> Step:
        """Return the step of a plan that keeps the windows of the controls."""
        budget = UNLIMITED
        if self._steps:
            budget = Budget(self._most, np.inf if self._limit is None else started + self._limit)
        found = planner.plan(begin, None if preview.starts_elsewhere else self._change(begin, preview), budget)
        limits = self._limits if preview.bounds is None else ControlLimits.of(found.stated)
        control = limits.clip(begin, found.control)
        planner.apply(control)
        plan, source, ended = found.plan, Source.SOFTENED if found.exceeded else Source.PLAN, now()
        step = Step(
            x, control, None, source, "condensed", solve_seconds=ended - started, changes=plan.changes,
            pending=found, reference=self._reference(preview), raised=found.raised > EXCEEDED,
        )  # fmt: skip
        if step.raised and not self._steps:
            exceeds = (
                f"control_spectrum: the past exceeds the level of a window by {100 * found.raised:.0f} % at step 0"
            )
            warn_user(f"{exceeds}; the level is raised until this window is over.", ClosedLoopWarning)
        if plan.settled and self._later:
            return step
        if plan.settled:
            step = step.certified(found.certified(self._tolerance), now() - ended)
        else:
            status = Status.LIMIT if plan.eta_C else Status.INFEASIBLE_CLAIMED
            step = replace(step, status=status, source=Source.BEST_POINT, pending=None)
        return replace(step, plan=found.trajectory)

    def _reference(self, preview: Change) -> Array:
        """Return the reference of the states in the cost where a plan begins, (n,)."""
        x_ref = np.asarray((preview.references or {}).get("x_ref", self.problem.quadratic.x_ref), dtype=float)
        return np.zeros(self.problem.state_dim) + (x_ref[0] if x_ref.ndim == 2 else x_ref)

    def _record(self, step: Step) -> None:
        """Append a step; of the plans only the last is needed."""
        if self._steps and self._steps[-1].plan is not None:
            self._steps[-1] = replace(self._steps[-1], plan=None)
        self._steps.append(step)
        self._applied.append(step.control)

    def _condensed_step(self, x: Array, begin: Array, started: float) -> Step | None:
        """Return the step of a plan from ``begin`` that is not judged; None if only a solve helps.

        Where changes or time end before the working set has settled, it is the better of the interrupted plan and the
        rest of the last one; the first step, which sets up the method, has no limits. A step that is certified at once
        has none either, and no softened plan: that the hard problem has no solution, a solve proves.
        """
        if self._most is not None:
            without = [
                resolver.no_plans for resolver in self._trees if self._remembers or not resolver.can_plan_from(begin)
            ]
            if without:
                past = "windows of applied samples make each step another problem."
                raise UnsupportedError(f"max_changes: {past if self._remembers else without[0]}")
        if self._remembers:
            return None
        budget, source = UNLIMITED, Source.PLAN
        if self._steps and self._later:
            budget = Budget(self._most, np.inf if self._limit is None else started + self._limit)
        plan, changes = self._hard.plan(begin, budget), 0
        if plan is None and not self._hard.can_plan_from(begin):
            return None
        if self._soft is not None and self._later and not (plan and plan.plan.settled):
            changes = 0 if plan is None else plan.plan.changes
            softened = self._soft.plan(begin, budget)
            plan, source = (plan, source) if softened is None else (softened, Source.SOFTENED)
        if plan is None:
            return None
        changes += plan.plan.changes
        acting, status, last = plan, None, None
        if not plan.plan.settled:
            acting = plan.better_of(self._steps[-1].planned)
            source = Source.BEST_POINT if acting is plan else Source.PREVIOUS_PLAN
            status, last = Status.LIMIT, acting.trajectory
        return Step(
            state=x,
            control=self._limits.clip(begin, acting.control),
            status=status,
            source=source,
            method="condensed",
            solve_seconds=now() - started,
            changes=changes,
            plan=last,
            pending=None if last else plan,
        )

    def certify(self) -> None:
        """Judge the plans of all steps that were not judged yet; after Ctrl-C, the rest is left to the next call."""
        groups = dict[int, dict[int, PlannedStart]]()
        for k, step in enumerate(self._steps):
            if isinstance(step.pending, WindowedPlan):
                started = now()
                self._steps[k] = step.certified(step.pending.certified(self._tolerance), now() - started)
            elif step.pending is not None:
                groups.setdefault(id(step.pending.translation), {})[k] = step.pending
        for planned in groups.values():
            proven = prove(self._steps, planned)
            for k, one in planned.items():
                started = now()
                if k not in proven:
                    proven[k] = self._steps[k].certified(one.certified(self._tolerance), now() - started)
                self._steps[k] = proven[k]
        self._steps[:-1] = [replace(step, plan=None) for step in self._steps[:-1]]

    def _applied_plan(self, outcome: Outcome) -> Trajectory | None:
        """Return the plan of a step: its solution; without one, the better of its best point and the previous plan."""
        own = outcome.trajectory
        previous, rest = self._steps[-1].planned if self._steps else None, None
        if previous is not None and not outcome.status.solved and outcome.status not in NO_SOLUTION:
            with suppress(LinFreqOCPError):  # the rest of the plan leaves the regions of all modes, or overflows
                rest = simulate(outcome.problem, _shift_controls(previous.u))
        if rest is None:
            return own if outcome.status.solved or outcome.primal else None
        plans = [rest] if own is None else [own, rest]  # the first of two equally good ones
        return min(plans, key=lambda plan: rank(outcome.problem, plan, self._tolerance))

    def _answers(self, x: Array, begin: Array, preview: Change) -> tuple[Outcome, Outcome | None]:
        """Return the answer for the state where a plan begins and, if it is infeasible, that with soft constraints."""
        change = self._change(begin, preview)
        hard = self._solve_step(self._hard, change, x)
        if hard.status not in NO_SOLUTION or self._soft is None:
            return hard, None
        return hard, self._solve_step(self._soft, change, x)

    def _change(self, begin: Array, preview: Change) -> Change:
        """Return the change of the problem to a state where a plan begins, (n,), and to previewed data."""
        bounds = preview.bounds
        if bounds and bounds.get("state_set") is not None:
            first_free = free_first_state(replace(self._problem, state_set=bounds["state_set"], stage_rows=[]))
            bounds = {**bounds, "state_set": first_free.state_set}
        return replace(preview, initial_state=begin, bounds=bounds)

    @property
    def _tolerance(self) -> float | None:
        """Return the tolerance of the solver, None for its default."""
        return getattr(self._hard.method, "tolerance", None)

    def _solve_step(self, resolver: Resolver, change: Change, x: Array) -> Outcome:
        """Solve the problem of a step; steps with the same data share the set-up of the solver."""
        tree = self._trees[resolver]
        problem = resolver.problem
        if self._remembers:  # the states and controls before a plan that begins after the measured state
            states, controls = [step.state for step in self._steps], list(self._applied)
            if self.delay:
                states, controls = [*states, x], [np.zeros(self.problem.control_dim), *controls]
            dimensions = problem.state_dim, problem.control_dim
            of_x, of_u = (
                np.array(part).reshape(-1, size) for part, size in zip((states, controls), dimensions, strict=True)
            )
            last = self._steps[-1].planned if self._steps else None
            problem = with_past(problem, of_x, of_u, None if last is None else _shift_controls(last.u))
        if problem is not resolver.problem:
            known, resolver = resolver, Resolver(problem, self._method)
            resolver.take_programs(known)
        return resolver.solve(change, self._limit, self._later_plan(), tree)

    def _later_plan(self) -> Trajectory | None:
        """Return the last plan from its second step on, its last control repeated; None without one."""
        plan = self._steps[-1].planned if self._steps else None
        if plan is None:
            return None
        try:
            last = self._step(len(plan.u) - 1, plan.x[-1], plan.u[-1])
        except LinFreqOCPError:  # no mode holds there
            return None
        return Trajectory(np.vstack([plan.x[1:], last]), _shift_controls(plan.u))

    def at_names(self, field: str, value: ArrayLike | ByName, absent: float | None = None) -> ArrayLike:
        """Return the values of a field as numbers, also if they are stated by the names of states or controls.

        States that follow from the controls alone are left out if no name is one of theirs.
        """
        if not isinstance(value, Mapping):
            return value
        if field in ("applied", "references.u_ref", "references.r"):
            return values_by_name(field, value, self.problem.control_names, absent)
        names = self.problem.state_names
        unknown = [name for name, known in zip(names, self._known, strict=True) if not known]
        partial = field != "references.q" and set(value) <= {*unknown, *map(short_name, unknown)}
        return values_by_name(field, value, unknown if partial else names, absent)

    def references_at_names(self, given: Mapping[str, ArrayLike | ByName] | None) -> dict[str, ArrayLike]:
        """Return references as numbers, also those by name, of which an absent component is 0."""
        known_entries("references", given, PREVIEWED)
        return {name: self.at_names(f"references.{name}", value, absent=0.0) for name, value in (given or {}).items()}

    def completed(self, field: str, value: ArrayLike | ByName, acted: Array | None = None) -> Array:
        """Return a measured state, (n,), with the states that follow from the controls alone if they are left out.

        ``acted`` is the control that acted in the last step, if it was not the controller's.
        """
        n, left, value = self.problem.state_dim, self.unknown_dim, self.at_names(field, value)
        if left == n:
            return self.measured(field, value, n)
        vector = one_component(real_array(field, value), left)
        if vector.shape != (left,):
            return self.measured(field, vector, n, f"Or {(left,)}, without the states that follow from the controls.")
        if self._steps:
            none = np.zeros(self.problem.control_dim)
            own = self._applied[-1 - self.delay] if len(self._applied) > self.delay else none
            state = np.array(self._step(0, self._steps[-1].state, own if acted is None else acted))
        else:
            state = np.zeros(n)
            state[self._known] = first_known_states(self.problem, self._known)
        state[~self._known] = vector
        return state

    def _completed_references(self, references: Mapping[str, ArrayLike]) -> Mapping[str, ArrayLike]:
        """Return references of which x_ref may leave out the states that follow from the controls alone."""
        given = real_array("references.x_ref", references.get("x_ref", 0.0))
        if not given.ndim or not given.shape[-1] == self.unknown_dim < self.problem.state_dim:
            return references
        return {**references, "x_ref": complete_reference(self.problem, self._known, given)}

    def measured(self, field: str, value: ArrayLike, size: int, advice: str = "") -> Array:
        """Return a finite vector of this size; else ProblemError."""
        vector = one_component(real_array(field, value), size)
        if vector.shape != (size,):
            raise ProblemError(field, f"shape {vector.shape}", f"shape {(size,)}", advice)
        return vector


def _shift_controls(controls: Array) -> Array:
    """Return controls from the second on, the last one twice."""
    return np.vstack([controls[1:], controls[-1:]])


def prove(steps: Sequence[Step], planned: Mapping[int, PlannedStart]) -> dict[int, Step]:
    """Return the steps, by number, whose plans of one problem the batch judge proves optimal."""
    started = now()
    proven = proven_in_batch(planned)
    each = (now() - started) / len(planned)
    return {k: steps[k].proven(planned[k].translation, one, each) for k, one in proven.items()}


def rank(problem: OptimalControlProblem, trajectory: Trajectory, tolerance: float | None) -> tuple[bool, float]:
    """Return (infeasible, cost or violation), which is smaller for the better trajectory.

    ``tolerance`` is the tolerance of the solver, None for its default.
    """
    translation = translation_of(problem)
    multipliers = zero_multipliers(translation.problem, 0.0)  # so that the judge looks for no bound
    moved = translation.start(trajectory)
    certificate = judge(translation.problem, moved, multipliers, allowed_residual(tolerance))
    return (False, certificate.cost) if certificate.feasible else (True, certificate.violation)
