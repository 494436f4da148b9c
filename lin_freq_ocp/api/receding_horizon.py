"""Receding-horizon control: the controller, and the record of its closed loop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Literal, final

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.api.result import Result, present_as
from lin_freq_ocp.api.solve import raise_for
from lin_freq_ocp.base.activity import activity, report_progress
from lin_freq_ocp.base.arrays import Array, positive_integer, real_array
from lin_freq_ocp.base.errors import LinFreqOCPError, ProblemError
from lin_freq_ocp.base.names import ByName
from lin_freq_ocp.base.phrases import html_table
from lin_freq_ocp.files.solution_files import write_table
from lin_freq_ocp.loop.controller import Controller
from lin_freq_ocp.loop.record import LoopRecord, plant_of
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.box import SetOrSets
from lin_freq_ocp.solving.method import Method
from lin_freq_ocp.transform.reductions import Change

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@final
class ClosedLoop(LoopRecord):
    """The record of a closed loop, with the fields and arrays of ``LoopRecord``.

    Methods
    -------
    plot()
        A figure of states, controls, their spectra over time, limited windows, and the times of the steps.
    spectra(control_spectrum, state_spectrum, output_spectrum)
        The spectra of the windows of applied controls and measured states, with the limits of Spectrograms.
    save(folder)
        Write a report page.
    to_csv(path)
        Write a row for each step.

    Examples
    --------
    >>> controller = lfo.RecedingHorizon(lfo.library.double_integrator())
    >>> loop = controller.run([0.0, 0.0], steps=3)
    >>> loop.states.shape, loop.controls.shape
    ((4, 2), (3, 1))
    """

    def plot(self) -> Figure:
        """Return a figure of states, controls, their spectra over time, limited windows, and the times of the steps."""
        from lin_freq_ocp.pages.figures.loop import loop_figure  # Matplotlib is slow to import

        return loop_figure(self)

    def save(self, folder: str | PathLike[str]) -> Path:
        """Write a self-contained HTML page and its figures into a folder; return the page's path."""
        from lin_freq_ocp.pages.report.page import save_loop_report  # Matplotlib is slow to import

        return save_loop_report(self, Path(folder))

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write a row for each step, with its state, control, status, cost, gap and times."""
        rows = self.table
        write_table(path, rows[0] if rows else ["step"], (row.values() for row in rows))

    def __repr__(self) -> str:
        ended = f", stopped: {self.stopped}" if self.stopped else ""
        return f"ClosedLoop({len(self.steps)} steps of {self.problem.name or 'a problem'}{ended})"

    def __str__(self) -> str:
        return "\n".join([repr(self), *(f"{term:9} {text}" for term, text in self.facts)])

    def _repr_html_(self) -> str:
        return html_table(repr(self), self.facts)


@final
class RecedingHorizon:
    """Model predictive control: each step solves the problem from the measured state and applies the first control.

    The state set does not constrain the measured state. Frequency constraints hold over the horizon of each plan. A
    ``Spectrogram`` also constrains samples that were applied or measured before, and its windows are fixed in time.
    docs/receding_horizon.md states the consequences for the closed loop.

    Parameters
    ----------
    problem : OptimalControlProblem
        The measured state replaces its initial state. The past of a spectrogram is that before the first step.
    method : str or Method
        As for ``solve``. With "auto" and "spectral", the Fourier-domain method is set up once if it applies. Over
        smooth pieces "auto" is "nonsmooth", a local optimum from the plan before; ``lfo.solvers.Nonsmooth()`` also
        bounds the cost of every step from below, which takes up to 10 s each.
    soft : mapping of str to float, optional
        Constraints to relax at a step without a solution: fields of the problem ("state_set", "terminal_state",
        "stage_rows", "control_spectrum", "state_spectrum", "output_spectrum"), and the penalty of each per unit of
        violation. Penalties above the multipliers are exact.
    delay : {0, 1}
        With 1, the control of a step acts one step after its measurement, and zero acts before the first one.
    time_limit : float, optional
        Seconds for each solve. A step without an answer in this time applies the better of two plans: the best point
        until then, and the plan of the step before, simulated from the measured state. A feasible plan is better than
        an infeasible one; of two feasible plans the one with less cost, of two infeasible ones the one with less
        violation.
    certify : {"each", "later"}
        "later": a step whose problem differs from the last in its initial state alone returns the control of a plan
        that is not judged yet, some ten times as fast; ``certify()`` judges all of them. A step without such a plan is
        solved and judged at once.
    max_changes : int, optional
        With ``certify="later"``: the most changes of the working set in a step after the first, so that all steps take
        about the same time. Softened problems have as many again. Where the working set has not settled by then, the
        step applies the better of the plan where it ended and the rest of the plan before, with the feedback of the
        method and within the bounds of the controls; its status is "limit", and nothing is proven for it.
        ``log.changes`` counts them.

    Raises
    ------
    ProblemError
        If an option does not fit the problem.
    UnsupportedError
        If the method does not exist, or does not take this problem.

    References
    ----------
    Rawlings, Mayne and Diehl, "Model Predictive Control", 2nd edition, 2017. Hours, Zeilinger, Gondhalekar and Jones,
    "Constrained spectrum control", IEEE Transactions on Automatic Control 60, 2015.

    Examples
    --------
    >>> controller = lfo.RecedingHorizon(lfo.library.double_integrator())
    >>> controller.step([0.0, 0.0]).shape
    (1,)
    """

    def __init__(
        self,
        problem: OptimalControlProblem,
        method: str | Method = "auto",
        soft: Mapping[str, float] | None = None,
        delay: int = 0,
        time_limit: float | None = None,
        certify: Literal["each", "later"] = "each",
        max_changes: int | None = None,
    ):
        self._controller = Controller(problem, method, soft, delay, time_limit, certify, max_changes)

    @property
    def problem(self) -> OptimalControlProblem:
        """Return the given problem."""
        return self._controller.problem

    @property
    def soft(self) -> dict[str, float]:
        """Return the penalty of each field that may be softened."""
        return dict(self._controller.penalties)

    @property
    def delay(self) -> int:
        """Return by how many steps a control acts after its measurement."""
        return self._controller.delay

    @property
    def log(self) -> ClosedLoop:
        """Return the steps until now."""
        return present_as(ClosedLoop, self._controller.record)

    def step(
        self,
        state: ArrayLike | ByName,
        references: Mapping[str, ArrayLike | ByName] | None = None,
        bounds: Mapping[str, SetOrSets] | None = None,
        disturbance: ArrayLike | None = None,
        applied: ArrayLike | ByName | None = None,
    ) -> Array:
        """Return the control (m,) for a measured state.

        The state, references and ``applied`` may be mappings from the names of components to their values.

        Parameters
        ----------
        state : (n,)
            The measured state, which may lie outside the state set. States of linear dynamics that follow from the
            controls alone may be left out, all or none, such as the last control that ``rate_limited`` adds. At the
            first step these are those of the problem's initial state, zero where it has none.
        references : mapping, optional
            "x_ref" and "u_ref", and the linear costs "q" and "r", such as prices of energy, over the coming horizon, as
            in QuadraticCost; x_ref may leave out the same states as ``state``, whose references are then those of the
            problem.
        bounds : mapping, optional
            "state_set" and "control_set" over the coming horizon, as in OptimalControlProblem.
        disturbance : (n,) or (T, n), optional
            The disturbance that is expected to be added to the coming states (linear dynamics).
        applied : (m,), optional
            The control that has acted in place of the last one returned.

        Raises
        ------
        ProblemError
            If a measurement, a reference or a bound does not fit the problem. The step is then not recorded.
        InfeasibleError, LimitError, NumericalError, UnboundedError
            If there is neither a plan nor a replacement (see ``time_limit``); with ``.result``.
        UnsupportedError
            If there is a ``max_changes``, and the condensed method does not take the problem.
        """
        tracked = None if references is None else self._controller.references_at_names(references)
        preview = Change(references=tracked, bounds=bounds, disturbance=disturbance)
        step, outcome = self._controller.advance(state, preview, applied)
        if step is None:
            assert outcome is not None  # the problem was solved as a whole
            raise_for(present_as(Result, outcome))
            raise AssertionError("an outcome without a plan is an error")
        return step.control

    @activity("certifying the plans")
    def certify(self) -> ClosedLoop:
        """Judge all plans that were not judged yet (``certify="later"``), and return the steps until now."""
        self._controller.certify()
        return self.log

    def run(
        self,
        initial_state: ArrayLike | ByName,
        steps: int,
        plant: object = None,
        references: Mapping[str, ArrayLike | ByName] | None = None,
        disturbance: ArrayLike | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> ClosedLoop:
        """Run the loop with a plant, and return the record with all earlier steps.

        Parameters
        ----------
        initial_state : (n,)
            As for ``step``; without the states that follow from the controls, a given plant has none of them either.
        steps : int
        plant : callable, control.StateSpace, dynamics, or None
            A function from x (n,) and u (m,) to the next state, in the order of its parameters if they have these
            names; one that needs three arguments also takes the step, first. None for the model of the problem.
        references : mapping, optional
            "x_ref", "u_ref", "q" and "r", of steps + T samples or more; each step sees those of its horizon.
        disturbance : (steps, n), optional
            Added to the state that the plant returns, with as many components; the controller does not know it.
        progress : callable, optional
            Called with the numbers of finished and of all steps, before the first step and after each.
            Default: a line on a terminal or in a notebook.

        Returns
        -------
        ClosedLoop
            After Ctrl-C, a step without a plan, or an error of the plant: the steps until then, with the reason in
            ``stopped``.

        Raises
        ------
        ProblemError
            If the initial state, the plant, the references or the disturbance do not fit the problem.
        """
        count, horizon = positive_integer("steps", steps), self.problem.horizon
        initial_state = self._controller.at_names("initial_state", initial_state)
        x = self._controller.completed("initial_state", initial_state)
        if plant is not None and np.size(initial_state) == self._controller.unknown_dim:
            x = real_array("initial_state", initial_state).reshape(-1)
        n, next_state = len(x), plant_of(plant, self.problem, len(x))
        noise = np.zeros((count, n)) if disturbance is None else real_array("disturbance", disturbance)
        if noise.shape != (count, n):
            raise ProblemError("disturbance", f"shape {noise.shape}", f"shape {(count, n)}")
        tracked = dict[str, Array]()  # with a row for each sample that some step sees
        for name, value in self._controller.references_at_names(references).items():
            rows = real_array(f"references.{name}", value)
            if rows.ndim != 2 or len(rows) < count + horizon:
                expected = f"at least {count + horizon} rows, one per sample"
                raise ProblemError(f"references.{name}", f"shape {rows.shape}", expected)
            tracked[name] = rows
        stopped, delay = "", self._controller.delay
        acting = np.zeros(self.problem.control_dim)
        try:
            with report_progress(progress, "running the loop", "{} of {} steps".format) as report:
                tell = report or (lambda done, count: None)
                for k in range(count):
                    tell(k, count)
                    first = k + delay
                    ahead = {name: rows[first : first + horizon + (name == "x_ref")] for name, rows in tracked.items()}
                    control = self.step(x, references=ahead or None)
                    x = next_state(k, x, acting if delay else control) + noise[k]
                    acting = control
                tell(count, count)
        except KeyboardInterrupt:
            stopped = "interrupted"
        except LinFreqOCPError as error:
            stopped = str(error)
        return replace(self.log, final_state=self._controller.completed("final_state", x), stopped=stopped)
