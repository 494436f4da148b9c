"""Tasks, here or on an executor, as they finish; runs are recorded and resumed, and lost tasks are given out again."""

from __future__ import annotations

import os
import signal
import threading
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from multiprocessing import forkserver, get_all_start_methods, get_context, parent_process, resource_tracker
from queue import SimpleQueue
from typing import Generic, ParamSpec, Protocol, TypeVar

from lin_freq_ocp.base.errors import warn_user
from lin_freq_ocp.base.interrupts import interrupts_noted
from lin_freq_ocp.solving import solve

RESUBMISSIONS = 2  # of a lost point: a worker may die by chance; after three losses the point itself is the reason
ERROR = "error"  # status of a point that was not solved: it describes no problem, or its worker died
P = ParamSpec("P")
R = TypeVar("R")
Given = TypeVar("Given")
Answer = TypeVar("Answer")


class Record(Protocol[Answer]):
    """The answers of a run by their keys: those of an earlier run, and each new one as it is finished."""

    answers: Mapping[str, Answer]

    def append(self, key: str, answer: Answer) -> None:
        """Keep one more answer."""
        ...


# Opens the record of a run, given the data that identify the run; None keeps nothing.
OpenRecord = Callable[[Mapping[str, object]], AbstractContextManager[Record[Answer] | None]]


def finish_run(
    keys: Sequence[str],
    solve_missing: Callable[[Mapping[str, Answer]], Generator[Mapping[str, Answer]]],
    record: AbstractContextManager[Record[Answer] | None],
    progress: Callable[[int, int], None] | None,
) -> tuple[dict[str, Answer], bool]:
    """Return the answers, recorded ones first and the missing ones as they finish, and whether Ctrl-C ended the run.

    ``solve_missing`` is given the recorded answers and yields others, which it chooses. ``progress`` is given the
    numbers of answers and of keys.
    """
    with record as log:
        answers = {} if log is None else {key: log.answers[key] for key in keys if key in log.answers}
        try:
            if progress is not None:
                progress(len(answers), len(keys))
            with closing(solve_missing(dict(answers))) as parts:
                for part in parts:
                    for key, answer in part.items():
                        if log is not None:
                            log.append(key, answer)
                        answers[key] = answer
                    if progress is not None:
                        progress(len(answers), len(keys))
        except KeyboardInterrupt:
            return answers, True
    return answers, False


@dataclass(frozen=True)
class Work(Generic[Given, Answer]):
    """The task, called with the number of its losses; the answer for a lost point; whether Ctrl-C ended a task."""

    task: Callable[[Given, int], Answer]
    lost: Callable[[Given, str], Answer]
    interrupted: Callable[[Answer], bool]


def finish_tasks(
    work: Work[Given, Answer], points: Mapping[str, Given], executor: Executor | None
) -> Generator[tuple[str, Answer]]:
    """Do the work at all points on an executor; without one, one after another in this process.

    The task itself raises nothing, so an exception of a future means that its point was lost. If the executor takes no
    more work, like a process pool once a worker has died, a warning says so, and the remaining points are solved one
    after another in a process of their own: a point that kills it is lost alone.

    Closing the generator, or Ctrl-C, cancels the tasks that have not started.
    """
    if executor is None:
        for key, parameters in points.items():
            answer = work.task(parameters, 0)
            if work.interrupted(answer):
                raise KeyboardInterrupt
            yield key, answer
        return
    left = yield from _run_on_executor(executor, work, points)
    if left:
        warn_user(f"The executor takes no more work: {len(left)} points are solved one by one; resuming is faster.")
        yield from _run_in_own_process(work, left)


class WorkerPool(ProcessPoolExecutor):
    """Worker processes that end with this one, and ignore Ctrl-C: a terminal sends it to all, this one handles it."""

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Submit a task; Ctrl-C while processes start is acted on after they have."""
        with interrupts_noted() as interrupt:
            try:
                return super().submit(fn, *args, **kwargs)
            finally:
                if interrupt.is_set():
                    raise KeyboardInterrupt

    def abandon(self) -> None:
        """End all processes at once and discard their results."""
        processes = list((self._processes or {}).values())
        self.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()


def process_pool(workers: int) -> WorkerPool:
    """Return fresh worker processes; where the system can fork, of one process that has imported the package."""
    if "forkserver" in get_all_start_methods():
        context = get_context("forkserver")
        context.set_forkserver_preload(["__main__", solve.__name__])
        resource_tracker.ensure_running()  # which would unblock Ctrl-C again, if it were started below
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # inherited by the processes
        try:
            forkserver.ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    else:
        context = get_context("spawn")
    return WorkerPool(workers, context, _begin_work)


def _begin_work() -> None:
    """Let a worker ignore Ctrl-C, and end with its parent, even if the parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def end_with_parent() -> None:
        parent = parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()


def _run_on_executor(
    executor: Executor, work: Work[Given, Answer], points: Mapping[str, Given]
) -> Generator[tuple[str, Answer], None, dict[str, Given]]:
    """Do the work on an executor; return the points that it did not take."""
    done, running = SimpleQueue[Future[Answer]](), dict[Future[Answer], str]()
    losses, left = Counter[str](), dict[str, Given]()

    def submit(key: str) -> None:
        try:
            future = executor.submit(work.task, points[key], losses[key])
        except Exception:  # broken, shut down, disconnected: the exception depends on the executor
            left[key] = points[key]
            return
        running[future] = key
        future.add_done_callback(done.put)

    try:
        for key in points:
            submit(key)
        while running:
            future = done.get()
            key, outcome = running.pop(future), _outcome(work, future)
            if not isinstance(outcome, Lost):
                yield key, outcome
                continue
            losses[key] += 1
            if losses[key] > RESUBMISSIONS:
                yield key, _give_up(work, points[key], outcome)
            else:
                submit(key)
    except KeyboardInterrupt:
        for future, key in running.items():
            if future.done() and not isinstance(outcome := _outcome(work, future), Lost):
                yield key, outcome
        raise
    finally:
        for future in running:
            future.cancel()
    return left


def _run_in_own_process(work: Work[Given, Answer], points: Mapping[str, Given]) -> Generator[tuple[str, Answer]]:
    """Do the work one after another in a process of its own, a new one whenever it dies."""
    pool = process_pool(1)
    try:
        for key, parameters in points.items():
            outcome: Answer | Lost = Lost("")
            for attempt in range(1 + RESUBMISSIONS):
                try:
                    outcome = _outcome(work, pool.submit(work.task, parameters, attempt))
                except BrokenExecutor as error:
                    outcome = Lost(type(error).__name__)
                if not isinstance(outcome, Lost):
                    break
                pool.shutdown()
                pool = process_pool(1)
            yield key, _give_up(work, parameters, outcome) if isinstance(outcome, Lost) else outcome
    except BaseException:  # Ctrl-C, or the generator was closed
        pool.abandon()
        raise
    pool.shutdown()


@dataclass(frozen=True)
class Lost:
    """A point without an answer, and the reason in words."""

    reason: str


def _outcome(work: Work[Given, Answer], future: Future[Answer]) -> Answer | Lost:
    """Wait for a future, and return its answer or the reason why it has none."""
    try:
        answer = future.result()
    except CancelledError:
        return Lost("cancelled")
    except Exception as error:
        return Lost(f"{type(error).__name__}: {error}")
    return Lost("interrupted") if work.interrupted(answer) else answer


def _give_up(work: Work[Given, Answer], point: Given, lost: Lost) -> Answer:
    return work.lost(point, f"given out {1 + RESUBMISSIONS} times and lost every time, at last with {lost.reason}")
