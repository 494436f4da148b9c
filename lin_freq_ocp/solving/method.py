"""The protocol of methods, objects that hold their options and solve problems, and the order of their answers."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import Field, dataclass, replace
from typing import ClassVar, Protocol

import numpy as np

from lin_freq_ocp.base.clock import seconds_left
from lin_freq_ocp.base.errors import UnsupportedError
from lin_freq_ocp.methods.candidate import Attempt, Progress, Reason
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.outcome import Outcome
from lin_freq_ocp.solving.solver_cache import SearchCache, SolverCache
from lin_freq_ocp.transform.reductions import Change
from lin_freq_ocp.transform.starts import Start

Report = Callable[[Progress], None]


@dataclass(frozen=True, eq=False)
class Request:
    """The request to a method: a limit in seconds, a callback for the progress of a search, and its start.

    ``tolerance`` loosens the tolerance of the judge, which is CONDITION_TOLERANCE by default. ``cached`` is the solver
    cache of the same problem, with the change from that problem to this one; ``tree`` is the cache of the search of the
    step before in a control loop. Without ``proof``, an optimum may be what a solver claims: that of an intermediate
    problem, or a first guess. With ``any_point``, a trajectory that satisfies every constraint is an answer: masks at
    every frequency need no optimum.
    """

    time_limit: float = np.inf
    tolerance: float | None = None
    progress: Report | None = None
    start: Start | None = None
    cached: tuple[SolverCache, Change] | None = None
    tree: SearchCache | None = None
    proof: bool = True
    any_point: bool = False

    def with_end(self, end: float) -> Request:
        """Return the request with the time left until the end, by ``clock.now``, as its limit."""
        left = seconds_left(end)
        return self if left is None else replace(self, time_limit=left)


def take_best(answers: Iterable[Outcome | Attempt], enough: tuple[Reason, ...] = ()) -> Outcome:
    """Take answers in turn until one is proven, stopped or ``enough``; return the best, the later one of equals.

    An attempt in place of an answer is one that does not count; UnsupportedError if there is no other.
    """
    best, attempts, interrupted = None, list[Attempt](), False
    for answer in answers:
        if isinstance(answer, Attempt):
            attempts.append(answer)
            continue
        reason, interrupted = answer.attempt.reason, answer.interrupted
        attempts += answer.attempts or [answer.attempt]
        if best is None or reason > best.attempt.reason or (reason == best.attempt.reason and _as_good(answer, best)):
            best = answer
        if reason in (Reason.STOPPED, Reason.PROVEN, *enough):
            break
    if best is None:
        raise UnsupportedError(" Before that: ".join(reversed(dict.fromkeys(attempt.message for attempt in attempts))))
    return replace(best, attempts=tuple(attempts), interrupted=interrupted)


def _as_good(answer: Outcome, best: Outcome) -> bool:
    """Whether of two answers for one reason, this has no more violation, and its claim holds up to the same sizes."""
    if answer.infeasibility is not None and best.infeasibility is not None:
        return answer.infeasibility.bound.multiple >= best.infeasibility.bound.multiple
    if answer.certificate is None or best.certificate is None:
        return best.certificate is None
    return answer.primal or answer.certificate.violation <= best.certificate.violation


class Method(Protocol):
    """A method of solution, with its options as fields."""

    __dataclass_fields__: ClassVar[dict[str, Field[object]]]
    shorthand: ClassVar[str]  # the text that stands for the method in ``solve(problem, method)``
    takes_start: ClassVar[bool]  # whether it can begin with a trajectory, control or mode sequence of the user

    def solve(self, problem: OptimalControlProblem, request: Request) -> Outcome:
        """Solve a problem, and judge the answer."""
        ...
