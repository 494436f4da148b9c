"""SpectralSolver: set up once, solve for many ends, references and bounds (docs/spectral.md)."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, brief, known_entries, positive_number
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.interrupts import interrupts_noted
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.methods.candidate import SOLVED_TOLERANCE, Candidate, contradiction_at_ends, require_convex
from lin_freq_ocp.methods.spectral import tolerances as tol
from lin_freq_ocp.methods.spectral.exchange import (
    Exchange,
    ExchangeOutcome,
    Stop,
    batch_working_sets,
    deadline,
    first_working_set,
)
from lin_freq_ocp.methods.spectral.model import Lti, LtiUnits, lti_problem, natural_units, refusal, revised_units
from lin_freq_ocp.methods.spectral.recovery import (
    Recovered,
    Together,
    in_units,
    recover,
    recover_batch,
    residuals,
    trajectory,
)
from lin_freq_ocp.methods.spectral.reductions import row_form
from lin_freq_ocp.methods.spectral.rows import Rows
from lin_freq_ocp.methods.spectral.structure import EndsModel, Structure, data_of, ends_model
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.program.program import Residuals


@dataclass(frozen=True, eq=False)
class SpectralSolution(Candidate):
    """A claimed solution, with what the next solve can start from.

    Attributes
    ----------
    problem : OptimalControlProblem or None
        The problem that was solved, with this solve's ends, references and bounds.
    active : Rows or None
        Rows with a multiplier: times t, rows f of [I; C D] acting on (x_t, u_t), sign +1 at upper and -1 at lower
        bounds, and weights in the method's own units.
    rounds : int
        Rounds of the exchange.

    Examples
    --------
    >>> solution = lfo.SpectralSolver(lfo.library.double_integrator()).solve()
    >>> solution.status, solution.rounds > 0
    ('optimal', True)
    """

    problem: OptimalControlProblem | None = None
    active: Rows | None = None
    rounds: int = 0


class MeasuredOutcome(NamedTuple):
    """How an exchange ended, with the multipliers and residuals of its point, or of its ray without residuals."""

    outcome: ExchangeOutcome
    found: Recovered
    measured: Residuals | None

    @property
    def accurate(self) -> bool:
        """Whether the point is a solution by its residuals."""
        return self.measured is not None and self.measured.worst <= SOLVED_TOLERANCE


class SpectralSolver:
    """The Fourier-domain method for one problem, set up once.

    Everything that does not depend on ends, references, linear costs, offsets and bounds is computed here, and kept.
    All linear algebra runs on one BLAS thread: its matrices are small, and threads made T = 1000 take 12 s, not 0.3 s.
    Threads may share one solver, whose solves then follow one another: what is kept is changed by each of them.

    Parameters
    ----------
    problem : OptimalControlProblem
        Linear time-invariant, with a constant convex quadratic stage cost. Polyhedral sets become joint rows: then
        ``problem`` of the solver and of its solutions is the problem in rows.

    Raises
    ------
    UnsupportedError
        With the reason, if the problem is outside this class.

    References
    ----------
    docs/spectral.md derives the method. Nocedal and Wright, "Numerical Optimization", 2006: active sets, and Mehrotra's
    interior-point method, of which parts are used.

    Examples
    --------
    >>> solver = lfo.SpectralSolver(lfo.library.pendulum())
    >>> solver.solve().status
    'optimal'
    """

    def __init__(self, problem: OptimalControlProblem):
        require_convex(problem)
        rows = row_form(problem)
        problem = problem if rows is None else rows.problem
        reason = refusal(problem)
        if reason is not None:
            raise UnsupportedError(f"method 'spectral': {reason}. Use method 'convex'.")
        self.problem = problem
        self._turn = threading.Lock()
        self._set_up(natural_units(problem))

    def __getstate__(self) -> dict[str, object]:
        """Return what another process needs; not the lock."""
        return {name: value for name, value in self.__dict__.items() if name != "_turn"}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Restore the state, with a new lock."""
        self.__dict__.update(state, _turn=threading.Lock())

    def _set_up(self, units: LtiUnits) -> None:
        """Compute everything that does not depend on data, in the given units."""
        started = now()
        with one_blas_thread():
            self._units, self._lti = units, lti_problem(self.problem, units)
            try:
                self._structure = Structure(self._lti)
            except np.linalg.LinAlgError as error:
                raise UnsupportedError(
                    f"method 'spectral': the data are too badly scaled ({error}). Use method 'convex'."
                ) from None
        self._coarser: dict[int, Structure] = {}
        self._solves = 0
        self._ends_model: EndsModel | None = None
        self._last_rows: Rows | None = None
        self.setup_seconds = now() - started

    @classmethod
    def _in_units(cls, problem: OptimalControlProblem, units: LtiUnits) -> SpectralSolver:
        """Return a solver for the same problem, set up in other units."""
        solver = cls.__new__(cls)
        solver.problem = problem
        solver._set_up(units)
        return solver

    def solve(
        self,
        initial_state: ArrayLike | ConvexSet | None = None,
        terminal_state: ArrayLike | ConvexSet | None = None,
        references: Mapping[str, ArrayLike] | None = None,
        bounds: Mapping[str, object] | None = None,
        warm_start: SpectralSolution | None = None,
        tolerance: float | None = None,
        time_limit: float | None = None,
    ) -> SpectralSolution:
        """Solve, with other ends, references or bounds than the problem's own where given.

        Parameters
        ----------
        initial_state, terminal_state : (n,) or set, optional
            Fixed and free components must stay what they are in the problem.
        references : mapping, optional
            "x_ref" and "u_ref", as in QuadraticCost.
        bounds : mapping, optional
            "state_set" and "control_set", as in OptimalControlProblem.
        warm_start : SpectralSolution, optional
            Its active rows are the first working set.
        tolerance : float, optional
            Relative violation of bounds to stop at.
        time_limit : float, optional
            Seconds; acts between rounds. It does not count the wait for a solve of another thread.

        Raises
        ------
        ProblemError
            If new data do not fit the problem, or the tolerance or time limit is not above zero.
        UnsupportedError
            If a new set is neither a box nor a point.
        """
        for field, value in (("tolerance", tolerance), ("time_limit", time_limit)):
            if value is not None:
                positive_number(field, value)
        with self._turn:
            started = now()
            problem, lti = self.changed_problem(initial_state, terminal_state, references, bounds)
            ray = contradiction_at_ends(problem)
            if ray is not None:
                message, both = ("an end lies outside the state set", {"setup": 0.0, "solve": now() - started})
                return SpectralSolution(Status.INFEASIBLE, ray=ray, message=message, seconds=both, problem=problem)
            first, allowed = None, tolerance or tol.VIOLATION_TOLERANCE
            if warm_start is not None:
                self._require_own(warm_start)
                first = warm_start.active
            with one_blas_thread(), interrupts_noted() as interrupt, np.errstate(all="ignore"):
                stop = deadline(time_limit, interrupt.is_set)
                answer = self._exchange(lti, first, allowed, stop)
                y, optimal = answer.outcome.signals.y, answer.outcome.status == "optimal"
                units = revised_units(self._units, y) if optimal else None
                if units is not None:  # the first turned out to be wrong
                    better = SpectralSolver._in_units(self.problem, units)
                    second = better._exchange(lti_problem(problem, units), None, allowed, stop)
                    if second.outcome.status == "optimal":
                        self.__dict__.update(better.__dict__)
                        answer = second
                return replace(self._solution(problem, answer, started), interrupted=interrupt.is_set())

    def changed_problem(
        self,
        initial_state: ArrayLike | ConvexSet | None,
        terminal_state: ArrayLike | ConvexSet | None,
        references: Mapping[str, ArrayLike] | None,
        bounds: Mapping[str, object] | None,
    ) -> tuple[OptimalControlProblem, Lti]:
        """Return the problem with new data, whose structure must be the same, and its form in ``units``."""
        changes = known_entries("bounds", bounds, ("state_set", "control_set"))
        problem = replace(self.problem, **changes) if changes else self.problem
        if references is not None:
            problem = problem.with_references(references)
        moved = initial_state is not None or terminal_state is not None
        if moved:
            problem = problem.with_ends(initial_state, terminal_state)
        if problem is self.problem:
            return self.problem, self._lti
        ends = ((initial_state, problem.initial_state), (terminal_state, problem.terminal_state))
        new_sets = [one for given in (bounds or {}).values() for one in entries_of(given)]
        for one in (*new_sets, *(end for given, end in ends if given is not None)):
            if one is not None and not all(member.soft for member in one.members):
                raise UnsupportedError(f"method 'spectral': {type(one).__name__}: only boxes. Use method 'convex'.")
        other = changes or references or (terminal_state is not None and self._lti.prices is not None)
        lti = None if other else self._lti.between(problem.ends, self._units.x)
        lti = lti or lti_problem(problem, self._units)
        if lti.periodic != self._lti.periodic:
            given = brief(terminal_state)
            raise ProblemError("terminal_state", given, "None: the ends are periodic", "Make a new SpectralSolver.")
        for field, old, new in (
            ("initial_state", self._lti.start, lti.start),
            ("terminal_state", self._lti.end, lti.end),
        ):
            if not np.array_equal(np.isnan(old), np.isnan(new)):
                raise ProblemError(
                    field, "other fixed components than in the problem", "the same ones", "Make a new SpectralSolver."
                )
        points = zip(self._lti.fixed_points, lti.fixed_points, strict=True)
        if not all(old is new or np.array_equal(old, new) for old, new in points):
            raise ProblemError(
                "bounds", "other values fixed by lower == upper", "the same ones", "Make a new SpectralSolver."
            )
        return problem, lti

    def _require_own(self, warm_start: SpectralSolution) -> None:
        if not isinstance(warm_start, SpectralSolution):
            raise ProblemError("warm_start", type(warm_start).__name__, "a SpectralSolution", "What solve() returned.")
        got, shape = (
            given and (given.horizon, given.state_dim, given.control_dim, sum(rows.rows for rows in given.stage_rows))
            for given in (warm_start.problem, self.problem)
        )
        if got != shape:
            raise ProblemError(
                "warm_start", f"(horizon, states, controls, joint rows) = {got}", f"{shape}, a solution of this problem"
            )

    def _exchange(self, lti: Lti, first: Rows | None, tolerance: float, stop: Stop) -> MeasuredOutcome:
        """Exchange from the first working rows, or a kept ray; with a stricter slope where residuals are too large."""
        if first is None:
            first = first_working_set(lti, stop, self._coarser)
        model = self._model_between(lti)
        if model is None:
            exchange = Exchange(self._structure, data_of(self._structure, lti), first, tolerance, stop)
            answer = self._measured_answer(exchange, exchange.run())
        else:
            data, point = model.at(lti)
            exchange = Exchange(self._structure, data, first, tolerance, stop, model.violations, point)
            ray = model.known_ray(data, point)
            answer = self._measured_answer(exchange, exchange.run() if ray is None else exchange.infeasible_by(ray))
            if ray is None and answer.outcome.ray is not None:
                model.keep_ray(answer.outcome.ray)
        if answer.outcome.status == "optimal" and not answer.accurate and stop() is None:
            exchange.slope_tolerance = tol.STRICT_SLOPE
            second = self._measured_answer(exchange, exchange.run())
            answer = second if second.accurate else answer
        return answer

    def _model_between(self, lti: Lti) -> EndsModel | None:
        """Return the model of other ends, from the second solve on, if the problem differs in nothing else."""
        self._solves += 1
        if self._solves == 1 or lti.bounds.lower is not self._lti.bounds.lower or lti.linear is not self._lti.linear:
            return None
        if self._solves == 2:
            self._ends_model = ends_model(self._structure, self._lti)
        model = self._ends_model
        return model if model is not None and model.bounds_ends_of(lti) else None

    def _measured_answer(self, exchange: Exchange, outcome: ExchangeOutcome) -> MeasuredOutcome:
        """Recover the multipliers, and measure the point with them."""
        found = recover(self._structure, exchange.data, outcome, exchange.spectrum)
        del exchange.spectrum  # large; further rounds make another
        return MeasuredOutcome(outcome, found, None if outcome.ray else residuals(exchange.data.lti, outcome, found))

    def _solution(self, problem: OptimalControlProblem, answer: MeasuredOutcome, started: float) -> SpectralSolution:
        """Return the solution in the user's units; not optimal with large residuals or numbers that are not finite."""
        outcome, measured = answer.outcome, answer.measured
        status, message = Status(outcome.status), outcome.message
        finite = all(np.isfinite(part).all() for part in (answer.found.eta, answer.found.band, answer.found.rho_x))
        multipliers = in_units(problem, self._lti, self._units, answer.found) if finite else None
        if multipliers is None:
            status, message = Status.NUMERICAL_ERROR, f"{message}, with numbers that are not finite"
        infeasible = status == Status.INFEASIBLE
        if status == Status.OPTIMAL and measured is not None and not answer.accurate:
            status, message = Status.NUMERICAL_ERROR, f"converged with residuals of {measured.worst:.1e}"
        return SpectralSolution(
            status=status,
            trajectory=None if infeasible or not finite else trajectory(outcome, self._units),
            multipliers=None if infeasible else multipliers,
            ray=multipliers if infeasible else None,
            residuals=measured,
            message=message,
            seconds={"setup": self.setup_seconds, "solve": now() - started},
            problem=problem,
            active=None if infeasible else outcome.working.rows().active(),
            rounds=outcome.rounds,
        )

    @property
    def units(self) -> LtiUnits:
        """Return the units of the method: revised ones after a solve that showed others to be wrong."""
        return self._units

    @property
    def lti(self) -> Lti:
        """Return the problem in these units."""
        return self._lti

    def solve_together(self, initial_states: Array) -> Together | None:
        """Solve from many initial states, each from the working rows of the one before, and all signals at once.

        Parameters
        ----------
        initial_states : (N, n)

        Returns
        -------
        Together or None
            Claims without residuals, for a judge. None where joint rows, state bands, or more than 2500 bounded values
            prevent it.
        """
        lti = self._lti
        if len(lti.F) > len(lti.M) or lti.prices is not None or len(self._structure.kkt.bands):
            return None
        if np.isnan(lti.start).any():
            return None
        if self._last_rows is None:
            self._last_rows = self.solve(initial_state=initial_states[0]).active  # which may revise the units
        with self._turn, one_blas_thread(), np.errstate(all="ignore"), interrupts_noted() as interrupt:
            self._ends_model = self._ends_model or ends_model(self._structure, self._lti)
            if self._ends_model is None:
                return None
            stop, rows, tolerance = deadline(None, interrupt.is_set), self._last_rows, tol.VIOLATION_TOLERANCE
            model, starts = self._ends_model, initial_states / self._units.x

            def solve_alone(i: int) -> None:  # if infeasible, the model keeps its ray, which may prove others so
                self._exchange(self._lti.at_points(starts[i], self._lti.end), rows, tolerance, stop)

            p = model.parameters(starts)
            batch = self._structure, model, p @ model.values, rows, tolerance, stop, solve_alone
            weights, found, self._last_rows = batch_working_sets(*batch)
            batched = recover_batch(self._structure, self._units, model, p, weights, found, self._last_rows)
            return replace(batched, interrupted=interrupt.is_set())
