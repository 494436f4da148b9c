"""SpectralSolver: set up once, then solved for many ends, references and bounds (docs/spectral.md)."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import brief, positive_number
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.interrupts import interrupts_noted
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.methods.candidate import Candidate, contradiction_at_ends, require_convex
from lin_freq_ocp.methods.spectral.exchange import (
    VIOLATION_TOLERANCE,
    Exchange,
    ExchangeOutcome,
    deadline,
    first_working_set,
)
from lin_freq_ocp.methods.spectral.model import Lti, LtiUnits, lti_problem, natural_units, refusal, revised_units
from lin_freq_ocp.methods.spectral.qp import Stop
from lin_freq_ocp.methods.spectral.recovery import LtiMultipliers, in_units, recover, trajectory
from lin_freq_ocp.methods.spectral.reductions import row_form
from lin_freq_ocp.methods.spectral.rows import Rows
from lin_freq_ocp.methods.spectral.structure import Data, Structure
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import SetOrSets
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.transform.reductions import Change

ChangedProblem = tuple[OptimalControlProblem, Lti]


@dataclass(frozen=True, eq=False)
class SpectralSolution(Candidate):
    """A claimed solution, with its active rows for a warm start.

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


class _SetUp:
    """All that does not depend on data, in the given units."""

    def __init__(self, problem: OptimalControlProblem, units: LtiUnits):
        started = now()
        with one_blas_thread:
            self.units, self.lti = units, lti_problem(problem, units)
            try:
                self.structure = Structure(self.lti)
            except np.linalg.LinAlgError as error:
                text = f"method 'spectral': the data are too badly scaled ({error}). Use method 'convex'."
                raise UnsupportedError(text) from None
        self.coarser: dict[int, Structure] = {}
        self.seconds = now() - started

    def exchange(
        self, lti: Lti, first: Rows | None, tolerance: float, stop: Stop
    ) -> tuple[ExchangeOutcome, LtiMultipliers]:
        """Exchange from the first working rows; without any, from a guess. Recover the multipliers."""
        if first is None:
            first = first_working_set(lti, stop, self.coarser)
        data = Data(self.structure, lti)
        outcome = Exchange(data, first, tolerance, stop).run()
        return outcome, recover(data, outcome)


class SpectralSolver:
    """The Fourier-domain method for one problem, set up once.

    The set-up computes and caches all that is independent of ends, references, linear costs, offsets and bounds.
    All linear algebra runs on one BLAS thread: its matrices are small, and with more threads T = 1000 took 12 s instead
    of 0.3 s. Threads may share one solver; their solves run one after the other, as each changes the cache.

    Parameters
    ----------
    problem : OptimalControlProblem
        Linear time-invariant, with a constant convex quadratic stage cost. Polyhedral sets become joint rows;
        ``problem`` of the solver and of its solutions is then the problem with these rows.

    Raises
    ------
    UnsupportedError
        With the reason, if the problem is outside this class.

    References
    ----------
    docs/spectral.md derives the method. Nocedal and Wright, "Numerical Optimization", 2006: active sets, and parts of
    Mehrotra's interior-point method.

    Examples
    --------
    >>> solver = lfo.SpectralSolver(lfo.library.pendulum())
    >>> solver.solve().status
    'optimal'
    """

    def __init__(self, problem: OptimalControlProblem):
        require_convex(problem)
        rows, T = row_form(problem), problem.horizon
        self._end_rows = rows is not None and any((polyhedron.times == T).any() for polyhedron in rows.polyhedra)
        problem = problem if rows is None else rows.problem
        reason = refusal(problem)
        if reason is not None:
            raise UnsupportedError(f"method 'spectral': {reason}. Use method 'convex'.")
        self.problem = problem
        self._lock = threading.RLock()
        self._set_up = _SetUp(problem, natural_units(problem))

    def __getstate__(self) -> dict[str, object]:
        """Return the state without the lock, for another process."""
        return {name: value for name, value in self.__dict__.items() if name != "_lock"}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Restore the state, with a new lock."""
        self.__dict__.update(state, _lock=threading.RLock())

    def solve(
        self,
        initial_state: ArrayLike | ConvexSet | None = None,
        terminal_state: ArrayLike | ConvexSet | None = None,
        references: Mapping[str, ArrayLike] | None = None,
        bounds: Mapping[str, SetOrSets] | None = None,
        warm_start: SpectralSolution | None = None,
        tolerance: float | None = None,
        time_limit: float | None = None,
        disturbance: ArrayLike | None = None,
    ) -> SpectralSolution:
        """Solve, with other ends, references and bounds or a disturbance, if given.

        Parameters
        ----------
        initial_state, terminal_state : (n,) or set, optional
            Components that are fixed in the problem must be fixed, free ones free.
        references : mapping, optional
            "x_ref", "u_ref", "q" and "r", as in QuadraticCost.
        bounds : mapping, optional
            "state_set" and "control_set", as in OptimalControlProblem.
        warm_start : SpectralSolution, optional
            Its active rows are the first working set.
        tolerance : float, optional
            Relative violation of bounds to stop at.
        time_limit : float, optional
            Seconds; acts between rounds. It does not count the wait for a solve of another thread.
        disturbance : (n,) or (T, n), optional
            Added to the coming states.

        Raises
        ------
        ProblemError
            If new data do not fit the problem, or the tolerance or time limit is not above zero.
        UnsupportedError
            If a new set is neither a box nor a point, or there is a disturbance and a polyhedron at the end.
        """
        for field, value in (("tolerance", tolerance), ("time_limit", time_limit)):
            if value is not None:
                positive_number(field, value)
        change = Change(initial_state, terminal_state, references, bounds, disturbance)
        return self.solve_changed(change, warm_start, tolerance, time_limit)

    def solve_changed(
        self,
        change: Change,
        warm_start: SpectralSolution | None = None,
        tolerance: float | None = None,
        time_limit: float | None = None,
        known: ChangedProblem | None = None,
    ) -> SpectralSolution:
        """Solve the changed problem, if not given; see ``solve``."""
        with self._lock:
            started = now()
            problem, lti = known or self.changed_problem(change)
            ray = contradiction_at_ends(problem)
            if ray is not None:
                message, seconds = "an end lies outside the state set", {"setup": 0.0, "solve": now() - started}
                return SpectralSolution(Status.INFEASIBLE, ray=ray, message=message, seconds=seconds, problem=problem)
            first, allowed = None, tolerance or VIOLATION_TOLERANCE
            if warm_start is not None:
                self._require_same_shape(warm_start)
                first = warm_start.active
            with one_blas_thread, interrupts_noted() as interrupt, np.errstate(all="ignore"):
                stop = deadline(time_limit, interrupt.is_set)
                answer = outcome, _ = self._set_up.exchange(lti, first, allowed, stop)
                units = revised_units(self._set_up.units, outcome.signals.y) if outcome.status == "optimal" else None
                if units is not None:  # the first units were wrong
                    better = _SetUp(self.problem, units)
                    second = better.exchange(lti_problem(problem, units), None, allowed, stop)
                    if second[0].status == "optimal":
                        self._set_up, answer = better, second
                return replace(self._solution(problem, *answer, started), interrupted=interrupt.is_set())

    def solve_similar(self, problem: OptimalControlProblem, time_limit: float | None = None) -> SpectralSolution:
        """Solve a problem with other ends, linear costs, offsets and bounds; ProblemError for another structure."""
        with self._lock:
            return self.solve_changed(Change(), time_limit=time_limit, known=self.changed_problem(Change(), problem))

    def changed_problem(self, change: Change, known: OptimalControlProblem | None = None) -> ChangedProblem:
        """Return the changed problem, if not given, and its form in ``units``; ProblemError for another structure."""
        if change.disturbance is not None and self._end_rows:  # on x_T: rows on the step before, in which it acts
            raise UnsupportedError("method 'spectral': a disturbance moves the rows of a polyhedron at the end.")
        problem = known or change.apply(self.problem)
        if problem is self.problem:
            return problem, self.lti
        ends = ((change.initial_state, problem.initial_state), (change.terminal_state, problem.terminal_state))
        new_sets = [entry for sets in (change.bounds or {}).values() for entry in entries_of(sets)]
        for entry in (*new_sets, *(end for given, end in ends if given is not None)):
            if entry is not None and not all(member.soft for member in entry.members):
                raise UnsupportedError(f"method 'spectral': {type(entry).__name__}: only boxes. Use method 'convex'.")
        lti = self._changed_lti(change, problem)
        self._require_same_structure(change, lti)
        return problem, lti

    def _changed_lti(self, change: Change, problem: OptimalControlProblem) -> Lti:
        """Return the changed problem in ``units``; of other ends alone, all other arrays are the same."""
        data = change.bounds or change.references or change.disturbance is not None
        initial_state, terminal_state = change.initial_state, change.terminal_state
        all_data = data or (initial_state is None and terminal_state is None)
        ends_only = not (all_data or (terminal_state is not None and self.lti.soft))
        lti = self.lti.with_ends(problem.ends, self.units.x) if ends_only else None
        return lti or lti_problem(problem, self.units)

    def _require_same_structure(self, change: Change, lti: Lti) -> None:
        own = self.lti
        if lti.periodic != own.periodic:
            got, expected = brief(change.terminal_state), "None: the ends are periodic"
            raise ProblemError("terminal_state", got, expected, "Make a new SpectralSolver.")
        for field, old, new in (("initial_state", own.start, lti.start), ("terminal_state", own.end, lti.end)):
            if not np.array_equal(np.isnan(old), np.isnan(new)):
                got = "other fixed components than in the problem"
                raise ProblemError(field, got, "the same ones", "Make a new SpectralSolver.")
        points = zip(own.fixed_points, lti.fixed_points, strict=True)
        if not all(old is new or np.array_equal(old, new) for old, new in points):
            got = "other values fixed by lower == upper"
            raise ProblemError("bounds", got, "the same ones", "Make a new SpectralSolver.")

    def _require_same_shape(self, warm_start: SpectralSolution) -> None:
        if not isinstance(warm_start, SpectralSolution):
            raise ProblemError("warm_start", type(warm_start).__name__, "a SpectralSolution, which solve() returns")
        got, shape = (
            p and (p.horizon, p.state_dim, p.control_dim, sum(rows.rows for rows in p.stage_rows))
            for p in (warm_start.problem, self.problem)
        )
        if got != shape:
            expected = f"{shape}, a solution of this problem"
            raise ProblemError("warm_start", f"(horizon, states, controls, joint rows) = {got}", expected)

    def _solution(
        self, problem: OptimalControlProblem, outcome: ExchangeOutcome, scaled: LtiMultipliers, started: float
    ) -> SpectralSolution:
        """Return the solution in the user's units; infinite numbers are a numerical error."""
        status, message = Status(outcome.status), outcome.message
        finite = all(np.isfinite(part).all() for part in (scaled.eta, scaled.band, scaled.rho_x))
        multipliers = in_units(problem, self._set_up.lti, self._set_up.units, scaled) if finite else None
        if multipliers is None:
            status, message = Status.NUMERICAL_ERROR, f"{message}, with numbers that are not finite"
        infeasible = status == Status.INFEASIBLE
        return SpectralSolution(
            status=status,
            trajectory=None if infeasible or not finite else trajectory(outcome, self._set_up.units),
            multipliers=None if infeasible else multipliers,
            ray=multipliers if infeasible else None,
            message=message,
            seconds={"setup": self._set_up.seconds, "solve": now() - started},
            problem=problem,
            active=None if infeasible else outcome.working.rows().active(),
            rounds=outcome.rounds,
        )

    @property
    def units(self) -> LtiUnits:
        """Return the units of the method: revised ones after a solve that showed others to be wrong."""
        return self._set_up.units

    @property
    def lti(self) -> Lti:
        """Return the problem in these units."""
        return self._set_up.lti
