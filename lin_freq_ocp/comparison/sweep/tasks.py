"""The points of a sweep on an executor, as they finish; a point that is lost with its worker is given out again."""

from __future__ import annotations

import signal
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor
from multiprocessing import forkserver, get_all_start_methods, get_context, resource_tracker
from queue import SimpleQueue
from typing import ParamSpec, TypeVar

from lin_freq_ocp.backends.interrupt import interrupts_noted
from lin_freq_ocp.comparison.sweep.grid import Parameters
from lin_freq_ocp.comparison.sweep.point import INTERRUPTED, Row, failed_point, solve_point

RESUBMISSIONS = 2  # of a lost point: a worker may die by chance; after three losses the point itself is the reason
P = ParamSpec("P")
R = TypeVar("R")
Task = Callable[[Parameters, int], Row]  # solves one point, given how often it was lost before
Finished = Generator[tuple[str, Row]]  # keys and rows, in the order in which they finish


def finished(task: Task, points: Mapping[str, Parameters], executor: Executor | None) -> Finished:
    """Solve points on an executor; without one, one after another in this process.

    The task itself raises nothing, so an exception of a future means that its point was lost. If the executor takes no
    more work, like a process pool once a worker has died, a warning says so, and the remaining points are solved one
    after another in a process of their own: a point that kills it is lost alone.

    Closing the generator, or Ctrl-C, cancels what has not been started.
    """
    if executor is None:
        for key, parameters in points.items():
            row = task(parameters, 0)
            if row["status"] == INTERRUPTED:
                raise KeyboardInterrupt
            yield key, row
        return
    left = yield from _on(executor, task, points)
    if left:
        warnings.warn(
            f"The executor takes no more work: {len(left)} points are solved one after another, in a process of their "
            "own; stopping and resuming the sweep is faster.",
            RuntimeWarning,
            stacklevel=3,
        )
        yield from _apart(task, left)


class WorkerPool(ProcessPoolExecutor):
    """Worker processes that ignore Ctrl-C, which a terminal sends to all processes: this one handles it."""

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
        context.set_forkserver_preload(["__main__", solve_point.__module__])
        resource_tracker.ensure_running()  # which would unblock Ctrl-C again, if it were started below
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])  # inherited by the processes
        try:
            forkserver.ensure_running()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    else:
        context = get_context("spawn")
    return WorkerPool(workers, context, signal.signal, (signal.SIGINT, signal.SIG_IGN))


def _on(
    executor: Executor, task: Task, points: Mapping[str, Parameters]
) -> Generator[tuple[str, Row], None, dict[str, Parameters]]:
    """Solve points on an executor; return those that it did not take."""
    done, running = SimpleQueue[Future[Row]](), dict[Future[Row], str]()
    losses, left = Counter[str](), dict[str, Parameters]()

    def submit(key: str) -> None:
        try:
            future = executor.submit(task, points[key], losses[key])
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
            key, outcome = running.pop(future), _outcome(future)
            if not isinstance(outcome, str):
                yield key, outcome
                continue
            losses[key] += 1
            if losses[key] > RESUBMISSIONS:
                yield key, _lost(points[key], outcome)
            else:
                submit(key)
    except KeyboardInterrupt:
        for future, key in running.items():
            if future.done() and not isinstance(outcome := _outcome(future), str):
                yield key, outcome
        raise
    finally:
        for future in running:
            future.cancel()
    return left


def _apart(task: Task, points: Mapping[str, Parameters]) -> Finished:
    """Solve points one after another in a process of their own, a new one whenever it dies."""
    pool = process_pool(1)
    try:
        for key, parameters in points.items():
            outcome: Row | str = ""
            for attempt in range(1 + RESUBMISSIONS):
                try:
                    outcome = _outcome(pool.submit(task, parameters, attempt))
                except BrokenExecutor as error:
                    outcome = type(error).__name__
                if not isinstance(outcome, str):
                    break
                pool.shutdown()
                pool = process_pool(1)
            yield key, _lost(parameters, outcome) if isinstance(outcome, str) else outcome
    except BaseException:  # Ctrl-C, or the generator was closed
        pool.abandon()
        raise
    pool.shutdown()


def _outcome(future: Future[Row]) -> Row | str:
    """Return the row of a future, waiting for it, or in words why there is none."""
    try:
        row = future.result()
    except CancelledError:
        return "cancelled"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return INTERRUPTED if row["status"] == INTERRUPTED else row


def _lost(parameters: Parameters, reason: str) -> Row:
    return failed_point(parameters, f"given out {1 + RESUBMISSIONS} times and lost every time, at last with {reason}")
