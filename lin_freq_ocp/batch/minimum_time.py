"""The least feasible horizon of a range, by bisection where feasibility is proven monotone, and from below otherwise.

Feasibility is monotone if zeros can be appended: after any feasible trajectory of T steps, u_T = 0 keeps the state, or
at least keeps it within the bounds of the end, and that is feasible for T + 1 steps. Joint rows must hold at every such
end, or at those that one step within all rows reaches: linear programs decide that. ``obstacles`` checks what this
needs, one condition after another; costs, and constraints that may be violated at a price, play no part. The conditions
are sufficient: where one fails, nothing is said.

A search is a sweep over the horizon that chooses its points. It writes the file of a sweep.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial

import numpy as np

from lin_freq_ocp.base.activity import activity_step
from lin_freq_ocp.base.arrays import Array, Mask, brief
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import ProblemError, UnsupportedError
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.batch.grid import Source, fingerprint, point_key, problem_at, require_parameters
from lin_freq_ocp.batch.sweep import Row, collect_band_warnings, failed_point, row_of
from lin_freq_ocp.batch.tasks import Record, Work, finish_run, finish_tasks
from lin_freq_ocp.certificate.bound import NUMERICAL, RIGOROUS
from lin_freq_ocp.problem.costs.quadratic import QuadraticCost
from lin_freq_ocp.problem.dynamics.linear import LinearDynamics
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.sets.base import ConvexSet
from lin_freq_ocp.problem.sets.box import Box
from lin_freq_ocp.problem.sets.stage_rows import StageRows
from lin_freq_ocp.problem.spectrum.base import entries_of
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.solving.families import Options
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solve import solve_judged
from lin_freq_ocp.transform.reformulations import RATE_LIMIT

AT_ONCE = 4  # horizons that an executor gets
ROUNDING = 1e-13  # relative, of A x + d: the drift over 10^4 steps stays far below what the judge allows

At = Callable[[int], OptimalControlProblem]


class Verdict(StrEnum):
    """What is proven of one horizon."""

    FEASIBLE = "feasible"
    INFEASIBLE = "infeasible"
    UNDECIDED = "undecided"


@dataclass(eq=False)
class Search:
    """The horizons from ``low`` to ``high`` that are decided so far."""

    low: int
    high: int
    verdicts: dict[int, Verdict] = field(default_factory=dict)
    rays: dict[int, Multipliers] = field(default_factory=dict)
    excluded: set[int] = field(default_factory=set)  # by proofs for every trajectory, recorded ones too
    recorded: set[int] = field(default_factory=set)  # whose verdict was read from a file, without its evidence
    points: set[int] = field(default_factory=set)  # that are feasible by a trajectory that is no optimum
    claimed: set[int] = field(default_factory=set)  # infeasible by the word of a solver, which guides the search
    best: Outcome | None = None  # at the least horizon that is feasible
    last: Outcome | None = None  # at the largest horizon that is solved, and not feasible
    interrupted: bool = False

    @property
    def horizon(self) -> int | None:
        """Return the least horizon that is feasible, or None."""
        return min(self.of(Verdict.FEASIBLE), default=None)

    def of(self, verdict: Verdict) -> list[int]:
        """Return the horizons with a verdict, in increasing order."""
        return sorted(T for T, known in self.verdicts.items() if known == verdict)

    @property
    def proven(self) -> list[int]:
        """Return the horizons that are proven infeasible, in increasing order."""
        return sorted(self.excluded)

    @property
    def without_evidence(self) -> list[int]:
        """Return the decisive horizons whose optimum or ray is not known: a file has neither, a search few optima."""
        least = self.horizon
        infeasible = {T for T in self.of(Verdict.INFEASIBLE) if least is not None and T == least - 1}
        decisive = {max(self.verdicts, default=0) if least is None else least, *infeasible}
        return sorted(decisive & (self.recorded | self.points))

    def keep(self, horizon: int, outcome: Outcome | None) -> Verdict:
        """Keep the verdict and the evidence of a solve; a lost solve leaves the horizon undecided.

        A horizon that a point decided keeps it if the solve for the optimum decides nothing. If that proves that there
        is no trajectory, rounding decides: the search goes on, and asks for the evidence of other horizons again.
        """
        verdict, decided = verdict_of(outcome), horizon in self.points
        self.recorded.discard(horizon)
        self.points.discard(horizon)
        if decided and verdict == Verdict.UNDECIDED:
            return Verdict.FEASIBLE
        self.verdicts[horizon] = verdict
        if decided and verdict == Verdict.INFEASIBLE:
            self.best, self.recorded = None, self.recorded | set(self.of(Verdict.FEASIBLE))
        if outcome is None:
            return verdict
        if verdict == Verdict.FEASIBLE:
            self.points |= {horizon} if outcome.any_point else set()
            self.best = outcome if self.best is None or horizon <= self.best.problem.horizon else self.best
        elif self.last is None or horizon >= self.last.problem.horizon:
            self.last = outcome
        if outcome.dual and verdict == Verdict.INFEASIBLE:
            self.excluded.add(horizon)
            if outcome.ray is not None:
                self.rays[horizon] = outcome.ray
        if outcome.status == Status.INFEASIBLE_CLAIMED:
            self.claimed.add(horizon)
        return verdict

    def recall(self, horizon: int, row: Row) -> None:
        """Keep the recorded verdict of a horizon, which comes without its evidence."""
        self.recorded.add(horizon)
        if row["cost"] is not None:
            self.verdicts[horizon] = Verdict.FEASIBLE
        elif row["status"] == Status.INFEASIBLE and row["bound"] != NUMERICAL:  # as earlier versions recorded it
            self.verdicts[horizon] = Verdict.INFEASIBLE
            if row["bound"] is not None:
                self.excluded.add(horizon)
        else:
            self.verdicts[horizon] = Verdict.UNDECIDED
            if row["status"] in (Status.INFEASIBLE, Status.INFEASIBLE_CLAIMED):
                self.claimed.add(horizon)


def verdict_of(outcome: Outcome | None) -> Verdict:
    """Return the verdict of a solve on its horizon, whatever its cost."""
    if outcome is not None and outcome.primal:
        return Verdict.FEASIBLE
    return Verdict.INFEASIBLE if outcome is not None and outcome.status == Status.INFEASIBLE else Verdict.UNDECIDED


@dataclass(frozen=True, eq=False)
class SolvedHorizon:
    """The outcome at a horizon, None if its worker was lost, and its row."""

    outcome: Outcome | None
    row: Row

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended the solve."""
        return self.outcome is not None and self.outcome.interrupted


SolveAt = Callable[[int, bool], Outcome]  # at a horizon, where any feasible trajectory may be an answer


def _solve_task(solve: SolveAt, given: tuple[int, bool], attempt: int) -> SolvedHorizon:
    """Solve in this process or in a worker; ``attempt`` makes it another task for a scheduler that keeps answers."""
    started, (horizon, any_point) = now(), given
    outcome = solve(horizon, any_point)
    return SolvedHorizon(outcome, row_of(outcome, {"horizon": horizon}, now() - started))


def search_horizons(
    low: int,
    high: int,
    monotone: bool,
    solve: SolveAt,
    progress: Callable[[int, str], None] | None = None,
    executor: Executor | None = None,
    record: AbstractContextManager[Record[Row] | None] | None = None,
) -> Search:
    """Search the horizons, a run of tasks like a sweep; Ctrl-C ends it with the verdicts so far.

    Any feasible trajectory is an answer at a horizon that is not the least one in question.
    """
    search, told = Search(low, high), list[tuple[int, str]]()
    work = Work(
        partial(_solve_task, solve),
        lambda given, reason: SolvedHorizon(None, failed_point({"horizon": given[0]}, reason)),
        lambda solved: solved.interrupted and verdict_of(solved.outcome) == Verdict.UNDECIDED,
    )

    def solve_missing(recorded: Mapping[str, Row]) -> Generator[Mapping[str, Row]]:
        for key, row in recorded.items():
            search.recall(keys[key], row)
        while True:
            while horizons := _next_horizons(search, monotone, 1 if executor is None else AT_ONCE):
                points = {point_key({"horizon": T}): (T, any_point) for T, any_point in horizons.items()}
                with closing(finish_tasks(work, points, executor)) as parts:
                    for key, solved in parts:
                        horizon = points[key][0]
                        told.append((horizon, search.keep(horizon, solved.outcome)))
                        if solved.interrupted:  # decided, and not recorded
                            raise KeyboardInterrupt
                        yield {key: solved.row}
            if not (left := search.without_evidence):
                return
            for horizon in left:
                new, solved = horizon in search.points, _solve_task(solve, (horizon, False), 0)
                if work.interrupted(solved):
                    raise KeyboardInterrupt
                told.append((horizon, search.keep(horizon, solved.outcome)))
                if solved.interrupted:
                    raise KeyboardInterrupt
                if new and verdict_of(solved.outcome) != Verdict.UNDECIDED:
                    yield {point_key({"horizon": horizon}): solved.row}

    def tell(done: int, count: int) -> None:
        if progress is not None and told:
            progress(*told[-1])

    keys = {} if record is None else {point_key({"horizon": T}): T for T in range(low, high + 1)}
    _, search.interrupted = finish_run(list(keys), solve_missing, record or nullcontext(), tell)
    return search


def _next_horizons(search: Search, monotone: bool, count: int) -> dict[int, bool]:
    """Return the horizons to solve next: by bisection, at first the last one, or from below until one is feasible.

    With each, whether any feasible trajectory is an answer there. At the least horizon in question, the optimum is the
    answer of the search.
    """
    if monotone and not search.verdicts:
        return {search.high: search.low < search.high}
    above = search.high + 1 if search.horizon is None else search.horizon
    without = [*search.of(Verdict.INFEASIBLE), *search.claimed]
    below = max(without, default=search.low - 1) if monotone else search.low - 1
    unknown = [T for T in range(below + 1, above) if T not in search.verdicts]
    parts = min(count, len(unknown)) + 1
    chosen = [unknown[len(unknown) * i // parts] for i in range(1, parts)] if monotone else unknown[:count]
    return {T: T > unknown[0] for T in chosen}


def checked_horizons(given: object) -> tuple[int, int]:
    """Return the ends of a range of horizons."""
    expected = "two whole numbers (lo, hi), 1 <= lo <= hi"
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        raise ProblemError("horizons", brief(given), expected)
    low, high = given
    whole = all(isinstance(end, int) and not isinstance(end, bool) for end in (low, high))
    if not whole or low < 1:
        raise ProblemError("horizons", brief(given), expected)
    if low > high:
        raise ProblemError("horizons", brief(given), expected, "Exchange them?")
    return low, high


def problem_at_horizon(source: Source, horizon: int) -> OptimalControlProblem:
    """Return the problem at a horizon: the value of a function, or a problem with the same data.

    It is one of many: its bands do not warn.
    """
    if callable(source):
        with collect_band_warnings([]):
            problem = problem_at(source, {"horizon": horizon})
        if problem.horizon != horizon:
            expected = f"a problem of the horizon {horizon}"
            raise ProblemError("problem", f"a function that returns the horizon {problem.horizon}", expected)
        return problem
    if horizon == source.horizon:
        return source
    try:
        with collect_band_warnings([]):
            return replace(source, horizon=horizon)
    except ProblemError as error:
        advice = f"The problem cannot be stated at the horizon {horizon}; give a function of the horizon instead."
        raise ProblemError(error.field, error.got, error.expected, advice) from None


def solve_horizon(source: Source, options: Options, horizon: int, any_point: bool) -> Outcome:
    """Return the answer at a horizon."""
    with activity_step(f"horizon {horizon}"):
        return solve_judged(problem_at_horizon(source, horizon), options, any_point=any_point)


def require_source(source: Source) -> None:
    """Raise ProblemError unless this is a problem, or a function that takes a horizon."""
    if callable(source):
        require_parameters(source, ["horizon"], "problem.")
    else:
        require_problem(source)


@one_blas_thread
def obstacles(at: At, shortest: int, longest: int, same_data: bool) -> list[str]:
    """Return the conditions that fail for the problems of these horizons, in words; none: feasibility is monotone.

    ``same_data``: all of them are one problem, stated at these horizons; else their data are compared.
    """
    problem = at(longest)
    try:
        _ = problem.linear
    except UnsupportedError:
        return ["the dynamics are not linear"]
    found = [
        *_moving_ends(problem, shortest),
        *_sets_in_the_way(problem, shortest),
        *_rows_in_the_way(problem, shortest),
        *_spectra_in_the_way(problem),
    ]
    spectra = problem.control_spectrum, problem.state_spectrum, problem.output_spectrum
    same_data = same_data and not any(entries_of(given) for given in spectra)  # a band may have bins at some horizons
    return found if found or same_data else _data_differences(at, shortest, problem)


def _moving_ends(problem: OptimalControlProblem, first: int) -> Iterator[str]:
    """Yield the states that a control of zero moves out of the admissible ends, at some t from ``first`` on.

    Every component of A_t x + d_t is that of x, or within its bounds for all x of the bounds if nothing else limits it.
    """
    dynamics, end = problem.linear, problem.ends[1]
    A, d = _entries_from(dynamics.A, first, 2), _entries_from(dynamics.offset, first, 1)
    x, fixed, identity = np.where(end.fixed, end.lower, 0.0), end.fixed, np.eye(problem.state_dim)
    change = np.abs(A - identity)
    change = np.where((identity > 0) & (change <= ROUNDING), 0.0, change)
    moved = np.abs((A - identity) @ x + d) > ROUNDING * (np.abs(A) @ np.abs(x) + np.abs(x) + np.abs(d))
    moves = moved.any(axis=0) | change[..., ~fixed].any(axis=(0, 2))
    inside = (end.support(A) + d <= end.upper) & (end.lower <= d - end.support(-A))
    if moves.any():
        moves &= ~inside.all(axis=0) | _limited_with_others(problem)
    if moves.any():
        names = ", ".join(problem.state_names[i] for i in np.flatnonzero(moves))
        yield f"with a control of zero the state does not stay at every admissible end ({names})"


def _limited_with_others(problem: OptimalControlProblem) -> Mask:
    """Return the states that an end, a state set or an equation on both ends limits together with others, (n,)."""
    terms = [term for term in problem.terms if term.hard and not term.kind.is_spectrum]
    terms = [term for term in terms if term.kind.of == "states" or term.kind.is_link]
    x, u = np.zeros((problem.horizon + 1, problem.state_dim)), np.zeros((problem.horizon, problem.control_dim))
    limited = np.zeros(problem.state_dim, dtype=bool)
    for i in range(problem.state_dim if terms else 0):
        last, always = x.copy(), x.copy()
        last[-1, i], always[:, i] = 1.0, 1.0
        values = [[term.map.values(state, u) for state in (x, last, always)] for term in terms]
        limited[i] = any((zero != one).any() or (zero != all_times).any() for zero, one, all_times in values)
    return limited


def _entries_from(values: Array, first: int, dimensions: int) -> Array:
    """Return the entries of times from ``first`` on, or the one of all times, with the time as axis 0."""
    return values[None] if values.ndim == dimensions else values[first:]


def _sets_in_the_way(problem: OptimalControlProblem, first: int) -> Iterator[str]:
    """Yield the sets that exclude a control of zero, or that depend on time, at later times."""
    tube, T = problem.control_tube, problem.horizon
    outside = ((tube.lower[first:] > 0) | (tube.upper[first:] < 0)).any()
    x, u = np.zeros((T + 1, problem.state_dim)), np.zeros((T, problem.control_dim))
    sets = [term for term in problem.terms if term.hard and term.kind.of == "controls" and not term.kind.is_spectrum]
    if outside or any((term.violation(x, u) > 0).any() for term in sets):
        yield "control_set: zero is not an admissible control at all later times"
    boxes = problem.state_boxes
    same = all((bound[first:] == bound[-1]).all() for bound in (boxes.lower, boxes.upper))
    if not same or not _constant_beyond_bounds(problem.state_set):
        yield "state_set: it depends on time"
    if not _constant_beyond_bounds(problem.control_set):
        yield "control_set: it depends on time"


def _constant_beyond_bounds(given: object) -> bool:
    """Whether the sets of a field, apart from their bounds, are one set for all times."""
    if not isinstance(given, (list, tuple)):
        return True
    return not any(one.members for one in given if isinstance(one, ConvexSet))


def _rows_in_the_way(problem: OptimalControlProblem, first: int) -> Iterator[str]:
    """Yield the families of joint rows that an admissible end, with a control of zero, can violate."""
    end = problem.ends[1]
    for rows in problem.stage_rows:
        C, e = _entries_from(rows.C, first, 2), _entries_from(rows.e, first, 1)
        violated = np.asarray((end.support(C) > e).reshape(-1, rows.rows).any(axis=0))
        if rows.penalty is None and violated.any() and not _follow_from_before(problem, first, rows, violated):
            advice = " (it does with following=0 in rate_limited)" if rows.name == RATE_LIMIT else ""
            yield f"stage_rows: '{rows.name}' does not hold at every admissible end with a control of zero{advice}"


def _follow_from_before(problem: OptimalControlProblem, first: int, rows: StageRows, some: Mask) -> bool:
    """Whether C_j x_T <= e_j is proven, for some rows, of all ends that one step reaches within bounds and rows.

    Each is a linear program: a problem of one step, whose bound the judge proves. Its bounds hold those of all steps
    from ``first`` - 1 on, and its rows are those that are the same in all of them. A component that steps do not move
    alike, such as a sum weighted by time, or that a state without limits moves, is free within the end: it has a
    control of its own.
    """
    before, dynamics, end = first - 1, problem.linear, problem.ends[1]
    hard = [one for one in problem.stage_rows if one.penalty is None]
    parts = {one.name: _steady(before, (one.C, 2), (one.D, 2), (one.e, 1)) for one in hard}
    families = {name: values for name, (values, same) in parts.items() if same.all()}
    if rows.name not in families:
        return False
    (A, B, d), alike = _steady(before, (dynamics.A, 2), (dynamics.B, 2), (dynamics.offset, 1))
    x, u = (
        Box(box.lower[before:].min(axis=0), box.upper[before:].max(axis=0))
        for box in (problem.state_boxes, problem.control_tube)
    )
    limited = np.isfinite([x.lower, x.upper]).any(axis=0) | np.vstack([C for C, _, _ in families.values()]).any(axis=0)
    alike = alike & ~A[:, ~limited].any(axis=1)
    free = np.eye(len(alike))[:, ~alike]
    step = OptimalControlProblem(
        LinearDynamics(A * alike[:, None], np.hstack([B * alike[:, None], free]), d * alike),
        1,
        QuadraticCost(),
        Box(np.append(u.lower, end.lower[~alike]), np.append(u.upper, end.upper[~alike])),
        initial_state=Box(np.where(limited, x.lower, 0.0), np.where(limited, x.upper, 0.0)),
        terminal_state=end,
        stage_rows=[
            StageRows(C, np.pad(D, ((0, 0), (0, free.shape[1]))), e, name) for name, (C, D, e) in families.items()
        ],
    )
    C, _, e = families[rows.name]
    for j in np.flatnonzero(some):
        found = solve_judged(replace(step, cost=QuadraticCost(p=-C[j])))
        if found.bound != RIGOROUS or (found.lower_bound is not None and found.lower_bound < -e[j]):
            return False
    return True


def _steady(first: int, *parts: tuple[Array, int]) -> tuple[list[Array], Mask]:
    """Return the last entry of each array, and which of their rows are the same at all times from ``first`` on."""
    entries = [_entries_from(values, first, dimensions) for values, dimensions in parts]
    same = [(one == one[-1]).reshape(*one.shape[:2], -1).all(axis=(0, 2)) for one in entries]
    return [one[-1] for one in entries], np.logical_and.reduce(same)


def _spectra_in_the_way(problem: OptimalControlProblem) -> Iterator[str]:
    """Yield the hard frequency constraints that appended samples can violate."""
    for name, stop in (("control_spectrum", problem.control_stop), ("state_spectrum", problem.state_stop)):
        if stop.any():
            yield f"{name}: a stop band removes bins of its own horizon"
    for term in problem.terms:
        if not term.hard or not term.kind.is_spectrum:
            continue
        if term.semi_infinite is None:
            yield f"{term.name}: it is about bins, or all samples, of its own horizon"
        elif (term.semi_infinite.map.window != 1).any():
            yield f"{term.name}: its window belongs to one horizon"
        elif (C := term.semi_infinite.map.C) is not None and any(problem.ends[1].support(y) != 0 for y in (C, -C)):
            yield f"{term.name}: the sample that is appended is not zero"


def _data_differences(at: At, shortest: int, longest: OptimalControlProblem) -> list[str]:
    """Return the fields whose data at a shorter horizon are not those of the longest one in its first steps."""
    for T in range(shortest, longest.horizon):
        problem, expected = at(T), _data_of_first_steps(longest, T)
        changed = [field for field, value in _data_of_first_steps(problem, T).items() if value != expected[field]]
        if changed:
            return [f"{', '.join(changed)}: not the same in the first steps at the horizons {T} and {longest.horizon}"]
    return []


def _data_of_first_steps(problem: OptimalControlProblem, horizon: int) -> dict[str, str]:
    """Return fingerprints of the data that decide feasibility in the first steps."""
    T, dynamics = horizon, problem.linear
    states, controls = problem.state_boxes, problem.control_tube
    rows = [
        (one.name, _entries_until(one.C, T, 2), _entries_until(one.D, T, 2), _entries_until(one.e, T, 1))
        for one in problem.stage_rows
        if one.penalty is None
    ]
    masks = list[object]()
    for term in problem.terms:
        if term.hard and term.kind.is_spectrum:
            mask = term.semi_infinite
            others = [] if mask is None else [value for field, value in vars(mask).items() if field != "map"]
            masks.append((term.name, mask and [mask.map.C, mask.map.D], others))
    found: dict[str, object] = {
        "dynamics": [
            _entries_until(dynamics.A, T, 2),
            _entries_until(dynamics.B, T, 2),
            _entries_until(dynamics.offset, T, 1),
        ],
        "control_set": [controls.lower[:T], controls.upper[:T], _members_beyond_bounds(problem.control_set)],
        "state_set": [states.lower[: T + 1], states.upper[: T + 1], _members_beyond_bounds(problem.state_set)],
        "initial_state": problem.initial_state,
        "terminal_state": problem.terminal_state,
        "stage_rows": rows,
        "frequency constraints": [*masks, bool(problem.control_stop.any()), bool(problem.state_stop.any())],
    }
    return {field: fingerprint(value) for field, value in found.items()}


def _entries_until(values: Array, horizon: int, dimensions: int) -> Array:
    return values if values.ndim == dimensions else values[:horizon]


def _members_beyond_bounds(given: object) -> object:
    return given.members if isinstance(given, ConvexSet) else None
