"""A receding-horizon controller: at every step a problem from the measured state, of whose plan the first control."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.arrays import Array, brief, one_component, real_array
from lin_freq_ocp.errors import LinFreqOCPError, ProblemError
from lin_freq_ocp.loop.record import LoopRecord, Source, Step
from lin_freq_ocp.loop.softening import checked_penalties, excess, softened
from lin_freq_ocp.loop.step_solver import StepSolver
from lin_freq_ocp.loop.window import Preview, first_state_free, remembers, with_past
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.method import Method
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.status import Status

NO_SOLUTION = (Status.INFEASIBLE, Status.INFEASIBLE_CLAIMED)


class Controller:
    """The state of a receding-horizon controller: what it has measured, applied and planned."""

    def __init__(
        self,
        problem: OptimalControlProblem,
        method: str | Method = "auto",
        soft: Mapping[str, float] | None = None,
        delay: int = 0,
        time_limit: float | None = None,
    ):
        require_problem(problem)
        if delay not in (0, 1) or isinstance(delay, bool):
            raise ProblemError("delay", brief(delay), "0, or 1 for a control that acts one step after its measurement")
        self.problem, self.penalties, self.delay = problem, checked_penalties(soft), int(delay)
        self._problem = first_state_free(problem)
        self._soft = softened(self._problem, self.penalties) if self.penalties else None
        self._remembers, self._method, self._limit = remembers(problem), method, time_limit
        self._solver = StepSolver(self._problem, method, time_limit)
        self._steps: list[Step] = []
        self._applied: list[Array] = []
        self._step = problem.dynamics.stepper(problem.horizon)

    @property
    def record(self) -> LoopRecord:
        """Return the steps until now."""
        return LoopRecord(self.problem, tuple(self._steps))

    def advance(self, state: ArrayLike, preview: Preview, applied: ArrayLike | None) -> tuple[Step | None, Outcome]:
        """Plan from a measured state; return the step, None if there is no control, and the answer of its problem.

        ``applied`` is what has acted in place of the last control that can be known.
        """
        x = self.measured("state", state, self.problem.state_dim)
        if applied is not None and len(self._applied) > self.delay:
            self._applied[-1 - self.delay] = self.measured("applied", applied, self.problem.control_dim)
        started = time.perf_counter()
        hard, soft = self._answers(x, preview)
        outcome = hard if soft is None else soft
        answered = outcome.status.solved or (outcome.trajectory is not None and outcome.primal)
        plan = outcome.trajectory if answered else None if hard.status in NO_SOLUTION else self._later_plan()
        if plan is None:
            return None, outcome
        certified = sum(one.seconds.get("certify", 0.0) for one in (hard, soft) if one is not None)
        certificate = outcome.certificate if answered else None
        step = Step(
            state=x,
            control=plan.u[0].copy(),
            status=hard.status,
            source=_source(outcome, answered, soft is not None),
            method=outcome.solver,
            cost=float("nan") if outcome.cost is None or not answered else outcome.cost,
            gap=float("nan") if certificate is None or certificate.gap is None else certificate.gap,
            satisfied=certificate is not None and certificate.pmp == "satisfied",
            solve_seconds=time.perf_counter() - started - certified,
            certify_seconds=certified,
            excess=excess(outcome.problem, plan) if soft is not None else {},
            plan=plan,
        )
        if self._steps:  # of the plans only the last is needed
            self._steps[-1] = replace(self._steps[-1], plan=None)
        self._steps.append(step)
        self._applied.append(step.control)
        return step, outcome

    def _answers(self, x: Array, preview: Preview) -> tuple[Outcome, Outcome | None]:
        """Return the answer of the problem of a measured state, and of the softened one where it has no solution."""
        states, controls = (
            np.array(rows).reshape(-1, size)
            for rows, size in (
                ([step.state for step in self._steps] if self._remembers else [], self.problem.state_dim),
                (self._applied if self._remembers else [], self.problem.control_dim),
            )
        )
        begin = x
        if self.delay:  # a plan begins where the last control leads
            begin = self._step(0, x, self._applied[-1] if self._applied else np.zeros(self.problem.control_dim))
            states = np.concatenate([states, x[None]])
            controls = np.concatenate([np.zeros((1, self.problem.control_dim)), controls])
        hard = self._solved(self._problem, begin, preview, states, controls)
        if hard.status not in NO_SOLUTION or self._soft is None:
            return hard, None
        return hard, self._solved(self._soft, begin, preview, states, controls)

    def _solved(
        self, problem: OptimalControlProblem, begin: Array, preview: Preview, states: Array, controls: Array
    ) -> Outcome:
        later = self._later_plan()
        if problem is self._problem and not self._remembers:
            return self._solver.solve(problem, begin, preview, later)
        whole = with_past(problem, states, controls) if self._remembers else problem
        return StepSolver(whole, self._method, self._limit).solve(whole, begin, preview, later)

    def _later_plan(self) -> Trajectory | None:
        """Return the last plan from its second step on, its last control repeated; None without one."""
        plan = self._steps[-1].plan if self._steps else None
        if plan is None:
            return None
        try:
            last = self._step(len(plan.u) - 1, plan.x[-1], plan.u[-1])
        except LinFreqOCPError:  # no mode holds there
            return None
        return Trajectory(np.vstack([plan.x[1:], last]), np.vstack([plan.u[1:], plan.u[-1:]]))

    def measured(self, field: str, value: ArrayLike, size: int) -> Array:
        """Return a vector of this size; ProblemError if it is none, or not finite."""
        found = one_component(real_array(field, value), size)
        if found.shape != (size,):
            raise ProblemError(field, f"shape {found.shape}", f"shape {(size,)}")
        return found


def _source(outcome: Outcome, answered: bool, is_soft: bool) -> Source:
    if not answered:
        return Source.PREVIOUS_PLAN
    if is_soft:
        return Source.SOFTENED
    return Source.PLAN if outcome.status.solved else Source.BEST_POINT
