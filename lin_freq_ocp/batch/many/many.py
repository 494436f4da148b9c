"""Many problems that differ in initial state and references, here or on an executor, recorded and resumed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from lin_freq_ocp.base.arrays import Array, brief, one_component, real_array
from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.resources import one_blas_thread
from lin_freq_ocp.batch.many.items import ERROR, UNSOLVED, Item, Part, solve_part
from lin_freq_ocp.batch.many.order import tour
from lin_freq_ocp.batch.many.repeated import Repeated
from lin_freq_ocp.batch.sweep.grid import fingerprint, require_picklable
from lin_freq_ocp.batch.sweep.tasks import Work, finished
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.solving.kept import Change
from lin_freq_ocp.solving.method import Method

HERE, SENT = 25, 100  # problems of a part: here, what Ctrl-C waits for; on an executor, what a set-up is shared by

References = Mapping[str, ArrayLike]


@dataclass(frozen=True, eq=False)
class ManyHead:
    """What makes two runs the same: the fingerprint of the problem, and the options."""

    fingerprint: str
    options: Mapping[str, object]


class ManyRecord(Protocol):
    """Where items are kept: those of an earlier run, and each as it is finished."""

    items: Mapping[str, Item]

    def append(self, key: str, item: Item) -> None:
        """Keep one more item."""
        ...


# Opens the record of a run, given what it is of; None keeps nothing.
OpenRecord = Callable[[ManyHead], AbstractContextManager[ManyRecord | None]]


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
    again: Repeated = field(repr=False)
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
        return self._stacked("u", (self.problem.horizon, self.problem.control_dim))

    @property
    def states(self) -> Array:
        """Return the states, (N, T+1, n); not a number where there are none."""
        return self._stacked("x", (self.problem.horizon + 1, self.problem.state_dim))

    def _stacked(self, name: str, shape: tuple[int, int]) -> Array:
        values = np.full((len(self.items), *shape), np.nan)
        for value, item in zip(values, self.items, strict=True):
            if getattr(item, name) is not None:
                value[:] = getattr(item, name)
        return values


def solved_many(
    problem: OptimalControlProblem,
    initial_states: object,
    references: References | Sequence[References] | None,
    executor: Executor | None,
    method: str | Method,
    time_limit: float | None,
    open_record: OpenRecord,
    progress: Callable[[int, int], None],
) -> ManyOutcome:
    """Solve all problems, unless interrupted; see ``lfo.solve_many``."""
    again = Repeated(problem, method)
    changes = changes_of(problem, initial_states, references)
    if executor is not None:
        if not isinstance(executor, Executor):
            advice = "Of a Dask client: client.get_executor()."
            raise ProblemError("executor", brief(executor), "a concurrent.futures.Executor, or None", advice)
        require_picklable(problem, {"method": [method]})
    keys = [_key(change) for change in changes]
    good = {key: change for key, change in zip(keys, changes, strict=True) if isinstance(change, Change)}
    head = ManyHead(fingerprint(problem), {"method": _method_name(method), "time_limit": time_limit})
    found, interrupted = dict[str, Item](), False
    with open_record(head) as record:
        found |= {} if record is None else {key: item for key, item in record.items.items() if key in good}
        progress(len(found), len(good))
        try:
            for part in _parts(again, _in_order(good, found), time_limit, executor):
                for key, item in part.items.items():
                    found[key] = item
                    if record is not None:
                        record.append(key, item)
                progress(len(found), len(good))
                if part.interrupted:
                    raise KeyboardInterrupt
        except KeyboardInterrupt:
            interrupted = True
    items = tuple(
        Item(ERROR, message=str(change)) if isinstance(change, ProblemError) else found.get(key, Item(UNSOLVED))
        for key, change in zip(keys, changes, strict=True)
    )
    return ManyOutcome(problem, tuple(changes), items, again, interrupted)


def changes_of(
    problem: OptimalControlProblem, states: object, references: References | Sequence[References] | None
) -> list[Change | ProblemError]:
    """Return how each problem differs, or why it is none; ProblemError if the numbers of both differ or none is one."""
    n = problem.state_dim
    if references is not None and not isinstance(references, (Mapping, Sequence)):
        raise ProblemError("references", brief(references), "a mapping with x_ref and u_ref, or a sequence of them")
    shared = references if isinstance(references, Mapping) else None
    each = None if references is None or isinstance(references, Mapping) else list(references)
    if states is None and each is None:
        raise ProblemError("initial_states", "None", f"an array (N, {n})", "Or references, one mapping per problem.")
    rows = [None] * len(each or ()) if states is None else _rows(states, n)
    each = [shared] * len(rows) if each is None else each
    if len(each) != len(rows):
        raise ProblemError("references", f"{len(each)} of them", f"{len(rows)}, one per initial state")
    if not rows:
        raise ProblemError("initial_states", "nothing", f"an array (N, {n}), N at least 1")
    found = [_change(problem, i, row, other) for i, (row, other) in enumerate(zip(rows, each, strict=True))]
    if isinstance(found[0], ProblemError) and not any(isinstance(one, Change) for one in found):
        raise found[0]
    return found


def _rows(states: object, n: int) -> Sequence[object]:
    """Return the initial states; an array must have the shape (N, n), entries of a list are checked later."""
    if isinstance(states, (list, tuple)):
        return states
    array = np.asarray(states)
    if array.ndim == 1 and n == 1:
        array = array[:, None]
    if array.ndim != 2 or array.shape[1] != n:
        raise ProblemError("initial_states", f"shape {array.shape}", f"(N, {n}): one initial state per row")
    return list(array)


def _change(
    problem: OptimalControlProblem, i: int, state: object, references: References | None
) -> Change | ProblemError:
    n, field = problem.state_dim, f"initial_states[{i}]"
    try:
        point = None if state is None else one_component(real_array(field, state), n)
        if point is not None and point.shape != (n,):
            raise ProblemError(field, f"shape {point.shape}", f"({n},)")
        if references is not None:
            problem.with_references(references)
    except ProblemError as error:
        return error
    return Change(point, references=references)


def _key(change: Change | ProblemError) -> str:
    return "" if isinstance(change, ProblemError) else fingerprint((change.initial_state, change.references))


def _method_name(method: str | Method) -> str:
    return method if isinstance(method, str) else repr(method)


def _in_order(changes: Mapping[str, Change], found: Mapping[str, Item]) -> dict[str, Change]:
    """Return what is not solved, each near the one before."""
    left = {key: change for key, change in changes.items() if key not in found}
    states = [change.initial_state for change in left.values()]
    if not states or states[0] is None:
        return left
    keys = list(left)
    return {keys[i]: left[keys[i]] for i in tour(np.array(states, dtype=np.float64))}


def _parts(
    again: Repeated, changes: Mapping[str, Change], time_limit: float | None, executor: Executor | None
) -> Iterator[Part]:
    """Yield what is solved; problems of a part that is lost are given out again one by one."""
    if executor is None:
        with one_blas_thread():
            for part in _split(changes, HERE).values():
                yield solve_part(again, part, time_limit)
        return
    work = Work(partial(_solve_sent, again.problem, again.name, time_limit), _lost, lambda part: part.interrupted)
    lost = dict[str, Change]()
    for size in (SENT, 1):
        with closing(finished(work, _split(changes if size > 1 else lost, size), executor)) as parts:
            for _, part in parts:
                if size > 1:
                    lost |= {key: changes[key] for key, item in part.items.items() if item.lost}
                yield Part({key: item for key, item in part.items.items() if size == 1 or key not in lost})


def _lost(changes: Mapping[str, Change], reason: str) -> Part:
    return Part({key: Item(ERROR, message=f"lost with its worker: {reason}", lost=True) for key in changes})


def _split(changes: Mapping[str, Change], size: int) -> dict[str, dict[str, Change]]:
    entries = list(changes.items())
    return {str(first): dict(entries[first : first + size]) for first in range(0, len(entries), size)}


def _solve_sent(
    problem: OptimalControlProblem,
    method: str | Method,
    time_limit: float | None,
    changes: Mapping[str, Change],
    attempt: int,
) -> Part:
    """Solve a part in a worker; ``attempt`` makes it another task for a scheduler that keeps answers."""
    with one_blas_thread():
        return solve_part(Repeated(problem, method), changes, time_limit)
