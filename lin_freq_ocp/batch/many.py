"""Many problems that differ in initial state and references, here or on an executor, recorded and resumed.

They are solved in parts, along a tour of the initial states: each solve starts from the answer of a near state. The
Fourier-domain method solves and judges a whole part at once where it applies; the other problems follow one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, Indices, brief, one_component, real_array
from lin_freq_ocp.base.clock import now
from lin_freq_ocp.base.errors import LinFreqOCPError, ProblemError
from lin_freq_ocp.base.status import Status
from lin_freq_ocp.batch.grid import fingerprint, require_executor
from lin_freq_ocp.batch.tasks import ERROR, OpenRecord, Work, finish_run, finish_tasks
from lin_freq_ocp.certificate.many import batch_judge_takes
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.method import Method
from lin_freq_ocp.solving.resolver import Resolver, proven_in_batch
from lin_freq_ocp.transform.reductions import Change

UNSOLVED = "unsolved"  # status of the problems that were left when Ctrl-C came

BLOCK = 1000  # states among which the nearest is looked for: 1000 steps of some 20 microseconds

# Problems that are solved one from the other and judged at once; in a worker they share one set-up
PART = 100

References = Mapping[str, ArrayLike]


@dataclass(frozen=True, eq=False)
class ManyOutcome:
    """The answers to many problems that differ in initial state and references.

    Attributes
    ----------
    problem : OptimalControlProblem
    items : tuple of Item
        One per problem, in the given order.
    interrupted : bool
        Whether Ctrl-C ended it before all were solved; the status of the others is "unsolved".
    """

    problem: OptimalControlProblem
    changes: tuple[Change | ProblemError, ...] = field(repr=False)
    items: tuple[Item, ...] = field(repr=False)
    resolver: Resolver = field(repr=False)
    interrupted: bool = False

    def __len__(self) -> int:
        return len(self.items)

    @property
    def statuses(self) -> tuple[str, ...]:
        """Return how each ended: a status of ``Result``, "error", or "unsolved"."""
        return tuple(item.status for item in self.items)

    @property
    def proven(self) -> bool:
        """Whether all are solved, and every status is proven."""
        return all(item.proven for item in self.items)

    @property
    def costs(self) -> Array:
        """Return the costs, (N,); not a number where no point satisfies every constraint."""
        return np.array([np.nan if item.cost is None else item.cost for item in self.items])

    @property
    def gaps(self) -> Array:
        """Return the gaps to a proven lower bound, relative to the terms of the cost, (N,), or not a number."""
        return np.array([np.nan if item.gap is None else item.gap for item in self.items])

    @property
    def messages(self) -> tuple[str, ...]:
        """Return why each ended so; empty for optima."""
        return tuple(item.message for item in self.items)

    @property
    def controls(self) -> Array:
        """Return the controls, (N, T, m); not a number where there are none."""
        return self._stack_answers("u", (self.problem.horizon, self.problem.control_dim))

    @property
    def states(self) -> Array:
        """Return the states, (N, T+1, n); not a number where there are none."""
        return self._stack_answers("x", (self.problem.horizon + 1, self.problem.state_dim))

    def _stack_answers(self, name: str, shape: tuple[int, int]) -> Array:
        values = np.full((len(self.items), *shape), np.nan)
        for value, item in zip(values, self.items, strict=True):
            if getattr(item, name) is not None:
                value[:] = getattr(item, name)
        return values


def run_many(
    problem: OptimalControlProblem,
    initial_states: object,
    references: References | Sequence[References] | None,
    executor: Executor | None,
    method: str | Method,
    time_limit: float | None,
    open_record: OpenRecord[Item],
    progress: Callable[[int, int], None] | None,
) -> ManyOutcome:
    """Solve all problems, unless interrupted; see ``lfo.solve_many``."""
    resolver = Resolver(problem, method)
    changes = changes_of(problem, initial_states, references)
    require_executor(executor, problem, {"method": [method]})
    keys = [
        "" if isinstance(change, ProblemError) else fingerprint((change.initial_state, change.references))
        for change in changes
    ]
    good = {key: change for key, change in zip(keys, changes, strict=True) if isinstance(change, Change)}
    options = {"method": method if isinstance(method, str) else repr(method), "time_limit": time_limit}

    def solve_missing(recorded: Mapping[str, Item]) -> Generator[Mapping[str, Item]]:
        missing = [key for key in good if key not in recorded]
        if missing and good[missing[0]].initial_state is not None:
            order: list[int] = tour(np.array([good[key].initial_state for key in missing], dtype=np.float64)).tolist()
            missing = [missing[i] for i in order]
        return _solve_parts(resolver, {key: good[key] for key in missing}, time_limit, executor)

    record = open_record({"fingerprint": fingerprint(problem), "options": options})
    found, interrupted = finish_run(list(good), solve_missing, record, progress)
    items = tuple(
        Item(ERROR, message=str(change)) if isinstance(change, ProblemError) else found.get(key, Item(UNSOLVED))
        for key, change in zip(keys, changes, strict=True)
    )
    return ManyOutcome(problem, tuple(changes), items, resolver, interrupted)


def _solve_parts(
    resolver: Resolver, changes: Mapping[str, Change], time_limit: float | None, executor: Executor | None
) -> Generator[Mapping[str, Item]]:
    """Yield the solved items; the problems of a part whose worker died are submitted again one by one."""
    if executor is None:
        for part in _split_parts(changes, PART).values():
            solved = solve_part(resolver, part, time_limit)
            yield solved.items
            if solved.interrupted:
                raise KeyboardInterrupt
        return

    work = Work[Mapping[str, Change], SolvedPart](
        partial(_solve_in_worker, resolver.problem, resolver.options.method, time_limit),
        lambda part, reason: SolvedPart(
            {key: Item(ERROR, message=f"lost with its worker: {reason}", lost=True) for key in part}
        ),
        lambda part: part.interrupted,
    )
    lost = dict[str, Change]()
    for size in (PART, 1):
        with closing(finish_tasks(work, _split_parts(changes if size > 1 else lost, size), executor)) as parts:
            for _, part in parts:
                if size > 1:
                    lost |= {key: changes[key] for key, item in part.items.items() if item.lost}
                yield {key: item for key, item in part.items.items() if size == 1 or key not in lost}


def _split_parts(changes: Mapping[str, Change], size: int) -> dict[str, dict[str, Change]]:
    entries = list(changes.items())
    return {str(first): dict(entries[first : first + size]) for first in range(0, len(entries), size)}


def _solve_in_worker(
    problem: OptimalControlProblem,
    method: str | Method,
    time_limit: float | None,
    changes: Mapping[str, Change],
    attempt: int,
) -> SolvedPart:
    """Solve a part in a worker; ``attempt`` makes it another task for a scheduler that keeps answers."""
    return solve_part(Resolver(problem, method), changes, time_limit)


def changes_of(
    problem: OptimalControlProblem, states: object, references: References | Sequence[References] | None
) -> list[Change | ProblemError]:
    """Return the change of each problem, or the error of its description.

    ProblemError if states and references differ in number, or no description is valid.
    """
    n = problem.state_dim
    if references is not None and not isinstance(references, (Mapping, Sequence)):
        expected = "a mapping with x_ref, u_ref, q or r, or a sequence of them"
        raise ProblemError("references", brief(references), expected)
    shared = references if isinstance(references, Mapping) else None
    each = None if references is None or isinstance(references, Mapping) else list(references)
    if states is None and each is None:
        raise ProblemError("initial_states", "None", f"an array (N, {n})", "Or references, one mapping per problem.")
    if states is None:
        rows: Sequence[object] = [None] * len(each or ())
    elif isinstance(states, (list, tuple)):  # their entries are checked below, one by one
        rows = states
    else:
        array = np.asarray(states)
        array = array[:, None] if array.ndim == 1 and n == 1 else array
        if array.ndim != 2 or array.shape[1] != n:
            raise ProblemError("initial_states", f"shape {array.shape}", f"(N, {n}): one initial state per row")
        rows = list(array)
    each = [shared] * len(rows) if each is None else each
    if len(each) != len(rows):
        raise ProblemError("references", f"{len(each)} of them", f"{len(rows)}, one per initial state")
    if not rows:
        raise ProblemError("initial_states", "nothing", f"an array (N, {n}), N at least 1")
    changes = list[Change | ProblemError]()
    for i, (state, of_problem) in enumerate(zip(rows, each, strict=True)):
        field = f"initial_states[{i}]"
        try:
            point = None if state is None else one_component(real_array(field, state), n)
            if point is not None and point.shape != (n,):
                raise ProblemError(field, f"shape {point.shape}", f"({n},)")
            if of_problem is not None:
                problem.with_references(of_problem)
            changes.append(Change(point, references=of_problem))
        except ProblemError as error:
            changes.append(error)
    if isinstance(changes[0], ProblemError) and not any(isinstance(change, Change) for change in changes):
        raise changes[0]
    return changes


@dataclass(frozen=True, eq=False)
class Item:
    """The answer to one of many problems, as plain data; None where there is nothing.

    ``proven`` says that its cost is within 1e-6 of a rigorous bound, or infeasibility is proven. ``x`` (T+1, n) and
    ``u`` (T, m) are the trajectory. ``lost`` says that its worker ended before the answer.
    """

    status: str
    proven: bool = False
    cost: float | None = None
    lower_bound: float | None = None
    gap: float | None = None
    message: str = ""
    seconds: float | None = None
    x: Array | None = field(default=None, repr=False)
    u: Array | None = field(default=None, repr=False)
    lost: bool = field(default=False, repr=False)


@dataclass(frozen=True, eq=False)
class SolvedPart:
    """Items by their keys, and whether Ctrl-C came before all were solved."""

    items: Mapping[str, Item]
    interrupted: bool = False


def solve_part(resolver: Resolver, changes: Mapping[str, Change], time_limit: float | None = None) -> SolvedPart:
    """Solve problems one after another, each from the one before; a failure is also an item."""
    items, interrupted = dict[str, Item](), False
    try:
        items, interrupted = _solve_batched(resolver, changes) if time_limit is None else ({}, False)
        for key in changes if not interrupted else ():
            if key not in items:
                items[key] = _solve_single(resolver, changes[key], time_limit)
    except KeyboardInterrupt:
        interrupted = True
    return SolvedPart({key: items[key] for key in changes if key in items}, interrupted)


def _solve_batched(resolver: Resolver, changes: Mapping[str, Change]) -> tuple[dict[str, Item], bool]:
    """Return the items that the condensed method solves and the batch judge proves, and whether Ctrl-C came."""
    states = [change.initial_state for change in changes.values() if change.references is None]
    if (
        len(states) < len(changes)
        or states[0] is None
        or not resolver.linear
        or not batch_judge_takes(resolver.problem)
    ):
        return {}, False
    started, keys = now(), list(changes)
    plans, interrupted = resolver.plan_batch(np.array(states, dtype=np.float64))
    proven = proven_in_batch(plans) if plans else {}
    optimal, seconds = str(Status.OPTIMAL), (now() - started) / len(keys)
    items = {
        keys[i]: Item(optimal, True, one.cost, one.lower_bound, one.gap, seconds=seconds, x=one.x, u=one.u)
        for i, one in proven.items()
    }
    return items, interrupted


def _solve_single(resolver: Resolver, change: Change, time_limit: float | None) -> Item:
    started = now()
    if resolver.excluded(change):
        message = "proven by a rigorous ray of another initial state"
        return Item(str(Status.INFEASIBLE), proven=True, message=message, seconds=now() - started)
    try:
        outcome = resolver.solve(change, time_limit)
    except LinFreqOCPError as error:
        return Item(ERROR, message=str(error), seconds=now() - started)
    if outcome.interrupted:
        raise KeyboardInterrupt
    if change.references is None:
        resolver.remember_ray(outcome)
    # Costs and trajectories are reported of feasible points only
    trajectory = outcome.trajectory if outcome.primal else None
    optimal = outcome.certificate is not None and outcome.certificate.globally_optimal
    infeasible = outcome.status in (Status.INFEASIBLE, Status.UNBOUNDED) and outcome.dual
    return Item(
        status=str(outcome.status),
        proven=optimal or infeasible,
        cost=outcome.cost if outcome.primal else None,
        lower_bound=outcome.lower_bound,
        gap=outcome.gap if outcome.primal else None,
        message=outcome.message,
        seconds=now() - started,
        x=None if trajectory is None else trajectory.x,
        u=None if trajectory is None else trajectory.u,
    )


def tour(states: Array) -> Indices:
    """Return an order of states (N, n), each near the one before, measured in their own spread."""
    spread = states.std(0)
    scaled = (states - states.mean(0)) / np.where(spread > 0, spread, 1.0)
    along = np.argsort(scaled[:, int(np.argmax(np.abs(scaled).max(0)))], kind="stable")
    blocks = [along[first : first + BLOCK] for first in range(0, len(along), BLOCK)]
    orders = list[Indices]()
    for block in blocks:  # from the first point, on to the nearest that is left
        points, left = scaled[block], np.ones(len(block), dtype=bool)
        order = np.zeros(len(block), dtype=np.intp)
        for step in range(1, len(block)):
            left[order[step - 1]] = False
            distance = ((points - points[order[step - 1]]) ** 2).sum(1)
            order[step] = np.argmin(np.where(left, distance, np.inf))
        orders.append(block[order])
    return np.concatenate(orders)
