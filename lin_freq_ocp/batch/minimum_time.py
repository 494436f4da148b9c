"""The least feasible horizon: by bisection where feasibility is monotone, else horizon by horizon from below."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum

from lin_freq_ocp.base.arrays import brief
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.batch.grid import Source, problem_at, require_parameters
from lin_freq_ocp.certificate.bound import NUMERICAL
from lin_freq_ocp.problem.ocp import OptimalControlProblem, require_problem
from lin_freq_ocp.problem.trajectory import Multipliers
from lin_freq_ocp.solving.outcome import Outcome


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
    best: Outcome | None = None  # at the least horizon that is feasible
    practical: set[int] = field(default_factory=set)  # of those in ``rays``, where the ray is numerical: no proof
    last: Outcome | None = None  # at the largest horizon that is solved, and not feasible
    interrupted: bool = False

    @property
    def horizon(self) -> int | None:
        """Return the least horizon that is feasible, or None."""
        return None if self.best is None else self.best.problem.horizon

    def of(self, verdict: Verdict) -> list[int]:
        """Return the horizons with a verdict, in increasing order."""
        return sorted(T for T, given in self.verdicts.items() if given == verdict)

    @property
    def proven(self) -> list[int]:
        """Return the horizons that are infeasible by a rigorous ray, in increasing order."""
        return sorted(self.rays.keys() - self.practical)

    def keep(self, horizon: int, outcome: Outcome) -> Verdict:
        """Keep what a solve says about a horizon."""
        verdict, self.interrupted = verdict_of(outcome), outcome.interrupted
        if self.interrupted and verdict == Verdict.UNDECIDED:
            return verdict
        self.verdicts[horizon] = verdict
        if verdict == Verdict.FEASIBLE:
            self.best = outcome if self.horizon is None or horizon < self.horizon else self.best
        elif self.last is None or horizon > self.last.problem.horizon:
            self.last = outcome
        if outcome.ray is not None and verdict == Verdict.INFEASIBLE:
            self.rays[horizon] = outcome.ray
            self.practical |= {horizon} if outcome.bound == NUMERICAL else set()
        return verdict


def verdict_of(outcome: Outcome) -> Verdict:
    """Return what an outcome proves about feasibility, whatever its cost."""
    if outcome.primal:
        return Verdict.FEASIBLE
    return Verdict.INFEASIBLE if outcome.status == Status.INFEASIBLE else Verdict.UNDECIDED


def searched(
    low: int,
    high: int,
    monotone: bool,
    solve: Callable[[int], Outcome],
    progress: Callable[[int, str], None] | None = None,
) -> Search:
    """Search the horizons; Ctrl-C ends it with what is decided."""
    search = Search(low, high)
    try:
        while not search.interrupted:
            horizon = _next_of_bisection(search) if monotone else _next_from_below(search)
            if horizon is None:
                break
            verdict = search.keep(horizon, solve(horizon))
            if progress is not None:
                progress(horizon, verdict)
    except KeyboardInterrupt:
        search.interrupted = True
    return search


def _next_from_below(search: Search) -> int | None:
    following = search.low + len(search.verdicts)
    return following if search.horizon is None and following <= search.high else None


def _next_of_bisection(search: Search) -> int | None:
    """Return the horizon to solve next: the last one, then the middle of those between the proven ends."""
    if not search.verdicts:
        return search.high
    above = search.high + 1 if search.horizon is None else search.horizon
    below = max(search.of(Verdict.INFEASIBLE), default=search.low - 1)
    unknown = [T for T in range(below + 1, above) if T not in search.verdicts]
    return unknown[len(unknown) // 2] if unknown else None


def checked_horizons(given: object) -> tuple[int, int]:
    """Return the ends of a range of horizons."""
    expected = "two whole numbers (lo, hi), 1 <= lo <= hi"
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        raise ProblemError("horizons", brief(given), expected)
    low, high = given
    whole = all(isinstance(one, int) and not isinstance(one, bool) for one in (low, high))
    if not whole or low < 1:
        raise ProblemError("horizons", brief(given), expected)
    if low > high:
        raise ProblemError("horizons", brief(given), expected, "Exchange them?")
    return low, high


def stated(source: Source, horizon: int) -> OptimalControlProblem:
    """Return the problem at a horizon: of a function, what it returns; of a problem, the same data."""
    if callable(source):
        problem = problem_at(source, {"horizon": horizon})
        if problem.horizon != horizon:
            expected = f"a problem of the horizon {horizon}"
            raise ProblemError("problem", f"a function that returns the horizon {problem.horizon}", expected)
        return problem
    if horizon == source.horizon:
        return source
    try:
        return replace(source, horizon=horizon)
    except ProblemError as error:
        advice = f"The problem cannot be stated at the horizon {horizon}; give a function of the horizon instead."
        raise ProblemError(error.field, error.got, error.expected, advice) from None


def require_source(source: Source) -> None:
    """Raise ProblemError unless this is a problem, or a function that takes a horizon."""
    if callable(source):
        require_parameters(source, ["horizon"], "problem")
    else:
        require_problem(source)
