"""The steps of a control loop, and the plants that take them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from lin_freq_ocp.base.arrays import Array, Indices, Mask, brief, real_array
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError, first_line
from lin_freq_ocp.base.names import argument_order
from lin_freq_ocp.base.phrases import count_all, number, plural
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.loop.step_problem import excess
from lin_freq_ocp.loop.windows import WindowedPlan
from lin_freq_ocp.problem.dynamics.base import Dynamics
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.problem_data import frequency_constraints
from lin_freq_ocp.problem.spectrum.base import Constraints, OutputSpectrum, WindowSpectra
from lin_freq_ocp.problem.trajectory import Trajectory
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.resolver import PlannedStart, ProvenPlan
from lin_freq_ocp.transform.reformulations import Translation, translation_of

NOT_JUDGED = "not judged"  # in place of a status
Plant = Callable[[int, Array, Array], Array]  # from k, x (n,) and u (m,) to the next state (n,)


class Source(StrEnum):
    """Where the control of a step comes from."""

    PLAN = "plan"  # of the problem of this step
    SOFTENED = "softened problem"  # of the problem with soft constraints: the hard one is infeasible
    BEST_POINT = "best point"  # of a solve, soft or hard, that ended without an answer
    PREVIOUS_PLAN = "previous plan"  # its rest is better than the best point, or there is no best point


@dataclass(frozen=True, eq=False)
class Step:
    """A step of a control loop.

    Attributes
    ----------
    state : (n,)
        Measured.
    control : (m,)
        Returned; with a delay, for the next step.
    status : Status or None
        Of the problem of this step, before anything was softened; None as long as its plan is not judged.
    source : Source
        Where the control comes from.
    method : str
        Of the answer.
    cost, gap : float
        Of the plan, and how far it can be above the optimum, relative; the gap is nan if it is not known.
    satisfied : bool
        Whether the conditions of the maximum principle hold.
    excess : dict
        By how much softened constraints are exceeded by the plan, by their names.
    solve_seconds, certify_seconds : float
        Wall time without, and of, the certificate.
    nodes : int
        Relaxations that a search over modes has solved; 0 without modes.
    changes : int
        Of the working set, for a plan of the condensed method that is judged later; 0 for others.
    plan : Trajectory or None
        From this step on.
    pending : PlannedStart or WindowedPlan or None
        The plan that is not judged yet.
    reference : (n,) or None
        Of the states in the cost, where the plan begins.
    raised : bool
        Whether the past exceeds the level of a window, which is raised to what the rest of the last plan makes of it.
    """

    state: Array
    control: Array
    status: Status | None
    source: Source
    method: str
    cost: float = float("nan")
    gap: float = float("nan")
    satisfied: bool = False
    solve_seconds: float = 0.0
    certify_seconds: float = 0.0
    excess: dict[str, float] = field(default_factory=dict[str, float])
    nodes: int = 0
    changes: int = 0
    plan: Trajectory | None = None
    pending: PlannedStart | WindowedPlan | None = None
    reference: Array | None = None
    raised: bool = False

    @property
    def planned(self) -> Trajectory | None:
        """Return the plan, judged or not."""
        return self.plan if self.pending is None else self.pending.trajectory

    def proven(self, translation: Translation, plan: ProvenPlan, seconds: float) -> Step:
        """Return the step of a plan that the batch judge has proven optimal.

        Its gap bounds the sum of all residuals of the maximum principle by their worth, with mu and nu as the slopes of
        the Lagrangian in x and u: the conditions hold.
        """
        figures = {"cost": plan.cost, "gap": plan.gap, "satisfied": True, "certify_seconds": seconds}
        return self._with_answer(Status.OPTIMAL, translation, Trajectory(plan.x, plan.u), figures)

    def certified(self, outcome: Outcome, seconds: float) -> Step:
        """Return the step with the judged outcome of its plan."""
        certificate, plan = outcome.certificate, outcome.trajectory
        assert certificate is not None  # the plan was judged
        assert plan is not None
        gap, satisfied = certificate.gap, certificate.pmp == "satisfied"
        figures = {"cost": certificate.cost, "gap": float("nan") if gap is None else gap, "satisfied": satisfied}
        figures["certify_seconds"] = seconds
        return self._with_answer(outcome.status, translation_of(outcome.problem), plan, figures)

    def _with_answer(
        self, status: Status, translation: Translation, plan: Trajectory, figures: Mapping[str, float]
    ) -> Step:
        """Return the step with the status and figures of its plan, and the violations of softened constraints.

        Where softened constraints are exceeded, it is claimed that the problem has no solution: multipliers have
        reached the penalties. Where none is, the plan solves the problem itself.
        """
        exceeded = excess(translation, plan) if self.source is Source.SOFTENED else {}
        status = Status.INFEASIBLE_CLAIMED if exceeded else status
        return replace(self, status=status, excess=exceeded, plan=plan, pending=None, **figures)


@dataclass(frozen=True, eq=False)
class LoopRecord:
    """The steps of a control loop.

    Attributes
    ----------
    problem : OptimalControlProblem
        As it was given to the controller.
    steps : sequence of Step
    final_state : (n,) or None
        After the last step, if it is known.
    stopped : str
        Why the loop ended before all its steps; empty if it did not.
    acted : (steps, m), or None
        The controls that have acted at the steps, if they are not those that the steps returned.
    delay : int
        By how many steps a plan begins after its measurement.
    known : (n,), or None
        The states that follow from the controls alone, where the loop computes them.
    """

    problem: OptimalControlProblem
    steps: Sequence[Step]
    final_state: Array | None = None
    stopped: str = ""
    acted: Array | None = None
    delay: int = 0
    known: Mask | None = None

    @property
    def states(self) -> Array:
        """Return the measured states, (steps, n), and the final one, if it is known, (steps + 1, n)."""
        last = [] if self.final_state is None else [self.final_state]
        return np.array([*(step.state for step in self.steps), *last]).reshape(-1, self.problem.state_dim)

    @property
    def controls(self) -> Array:
        """Return the controls of the steps, (steps, m)."""
        return np.array([step.control for step in self.steps]).reshape(-1, self.problem.control_dim)

    def spectra(
        self,
        control_spectrum: Constraints = None,
        state_spectrum: Constraints = None,
        output_spectrum: OutputSpectrum | Sequence[OutputSpectrum] | None = None,
    ) -> tuple[WindowSpectra, ...]:
        """Return the spectra of the windows of the applied controls and the measured states, with their limits.

        Parameters
        ----------
        control_spectrum, state_spectrum, output_spectrum : optional
            Spectrograms, such as those of ``lfo.spectrum.closed_loop``; by default those of the problem. None of a loop
            that is shorter than a window.

        Raises
        ------
        ProblemError
            If another constraint is given, or one that does not fit the signal.
        """
        problem, x, u = self.problem, self.states, self.controls if self.acted is None else self.acted
        given = {"state_spectrum": state_spectrum, "control_spectrum": control_spectrum}
        given |= {"output_spectrum": output_spectrum}
        own, found = not any(one is not None for one in given.values()), list[WindowSpectra]()
        for _, where, one, signal in frequency_constraints(problem, None if own else given, (len(x), len(u))):
            if not (own or one.remembers):
                raise ProblemError(where, brief(one), "a Spectrogram", "Such as lfo.spectrum.closed_loop(...).")
            found += one.measure(signal, where, x, u, problem.horizon + (signal.D is None))
        return tuple(found)

    @property
    def costs(self) -> Array:
        """Return the cost of the plan of each step, (steps,)."""
        return np.array([step.cost for step in self.steps])

    @property
    def gaps(self) -> Array:
        """Return the relative gap of the plan of each step, (steps,); nan where it is not known."""
        return np.array([step.gap for step in self.steps])

    @property
    def solve_seconds(self) -> Array:
        """Return the wall time of each step without its certificate, (steps,)."""
        return np.array([step.solve_seconds for step in self.steps])

    @property
    def certify_seconds(self) -> Array:
        """Return the wall time of each certificate, (steps,)."""
        return np.array([step.certify_seconds for step in self.steps])

    @property
    def nodes(self) -> Indices:
        """Return the relaxations that the search over modes has solved in each step, (steps,)."""
        return np.array([step.nodes for step in self.steps], dtype=np.intp)

    @property
    def changes(self) -> Indices:
        """Return the changes of the working set for the plan of each step that is judged later, (steps,)."""
        return np.array([step.changes for step in self.steps], dtype=np.intp)

    @property
    def satisfied(self) -> Mask:
        """Return at which steps the conditions of the maximum principle hold, (steps,)."""
        return np.array([step.satisfied for step in self.steps], dtype=bool)

    @property
    def sources(self) -> tuple[Source, ...]:
        """Return where the control of each step comes from."""
        return tuple(step.source for step in self.steps)

    @property
    def statuses(self) -> tuple[Status | None, ...]:
        """Return the status of the problem of each step; None where its plan is not judged."""
        return tuple(step.status for step in self.steps)

    @property
    def facts(self) -> list[tuple[str, str]]:
        """Return how the steps ended, the largest gap and the time of a step, in words."""
        facts = [("status", count_all("not judged" if status is None else status for status in self.statuses))]
        facts += [("control", count_all(self.sources))] if len(set(self.sources)) > 1 else []
        raised = sum(step.raised for step in self.steps)
        facts += [("windows", f"the past exceeds a level at {plural(raised, 'step')}")] if raised else []
        facts += [("stopped", self.stopped)] if self.stopped else []
        if np.isfinite(self.gaps).any():
            facts.append(("gap", f"at most {number(np.nanmax(self.gaps), 2)}, at step {int(np.nanargmax(self.gaps))}"))
        if len(self.steps):
            seconds = 1e3 * (self.solve_seconds + self.certify_seconds)
            facts.append(("time", f"{np.median(seconds):.2g} ms a step, at most {seconds.max():.2g} ms"))
        return facts

    @property
    def table(self) -> list[dict[str, object]]:
        """Return a flat row for each step, for pandas.DataFrame."""
        names = [*self.problem.state_names, *self.problem.control_names]
        fields = "method", "cost", "gap", "nodes", "changes", "excess", "solve_seconds", "certify_seconds"
        return [
            {
                "step": k,
                **dict(zip(names, [*step.state.tolist(), *step.control.tolist()], strict=True)),
                "status": NOT_JUDGED if step.status is None else str(step.status),
                "source": str(step.source),
                **{name: getattr(step, name) for name in fields},
                "excess": sum(step.excess.values()),
            }
            for k, step in enumerate(self.steps)
        ]


def plant_of(model: object, problem: OptimalControlProblem, states: int) -> Plant:
    """Return a model as a function of the step, the state and the control; ProblemError if it is no model.

    A given model has so many ``states``.
    """
    if model is None:
        return _plant_of_dynamics("problem.dynamics", problem.form, (problem.state_dim, problem.control_dim))
    expected_shape = states, problem.control_dim
    if isinstance(model, Dynamics):
        return _plant_of_dynamics("plant", model, expected_shape)
    if hasattr(model, "A") and hasattr(model, "B") and hasattr(model, "dt"):
        sampled = LinearDynamics.from_statespace(model, problem.sampling_time)
        return _plant_of_dynamics("plant", sampled, expected_shape)
    if not callable(model):
        expected = "a function of (x, u), a model of python-control, or dynamics"
        raise ProblemError("plant", brief(model), expected)
    return _plant_of_function(model, states)


def _plant_of_dynamics(field: str, dynamics: Dynamics, expected: tuple[int, int]) -> Plant:
    got = dynamics.state_dim, dynamics.control_dim
    if got != expected:
        raise ProblemError(field, f"{got} states and controls", f"{expected}, as the problem has")
    try:
        for steps in (1, 2):
            dynamics.require_horizon(steps)
    except ProblemError:
        advice = "Give the plant that is controlled."
        raise ProblemError(field, "dynamics given per time", "a plant that does not depend on time", advice) from None
    step = dynamics.stepper(1)
    return lambda k, x, u: step(0, x, u)


def _plant_of_function(function: Callable[..., object], n: int) -> Plant:
    try:
        try:
            order = argument_order(function)
        except TypeError:
            order = argument_order(function, ("k", "x", "u"))
    except TypeError as error:
        raise ProblemError("plant", f"{brief(function)} ({error})", "a function of (x, u) or (k, x, u)") from None

    def step(k: int, x: Array, u: Array) -> Array:
        try:
            returned = function(*({"k": k, "x": x, "u": u}[name] for name in order))
        except Exception as error:
            raise UnsupportedError(f"plant: at step {k} it raised {first_line(error)}") from error
        state = np.asarray(returned, dtype=float)
        if state.shape != (n,) or not np.isfinite(state).all():
            raise ProblemError("plant", f"{brief(returned)} at step {k}", f"a finite state of shape {(n,)}")
        return real_array("plant", state)

    return step
