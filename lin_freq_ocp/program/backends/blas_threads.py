"""One BLAS thread while small matrices are at work: handing parts of them to other threads costs more than it saves."""

from __future__ import annotations

import threading
from collections.abc import Generator
from contextlib import contextmanager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController


class _BlasThreads:
    """Counts the users of one BLAS thread; the last to leave restores what the first found."""

    def __init__(self) -> None:
        self._lock, self._users, self._before = threading.Lock(), 0, list[tuple[Any, int]]()

    def enter(self) -> None:
        with self._lock:
            self._users += 1
            if self._users == 1:
                threads = [(library, library.num_threads) for library in _blas_libraries()]
                self._before = [(library, before) for library, before in threads if before != 1]
                for library, _ in self._before:
                    library.set_num_threads(1)

    def leave(self) -> None:
        with self._lock:
            self._users -= 1
            if not self._users:
                for library, before in self._before:
                    library.set_num_threads(before)


_blas_threads = _BlasThreads()


@contextmanager
def one_blas_thread() -> Generator[None]:
    """Let linear algebra use one thread, as long as any thread of this process is within."""
    _blas_threads.enter()
    try:
        yield
    finally:
        _blas_threads.leave()


@cache
def _blas_libraries() -> list[Any]:
    return ThreadpoolController().select(user_api="blas").lib_controllers
