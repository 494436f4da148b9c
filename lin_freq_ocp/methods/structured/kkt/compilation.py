"""Compilation by numba, once: machine code stays in numba's cache, next to the source or where else it can be written.

A file next to the cached code says for which sources and which machine it is complete. Only then is nothing compiled
at the first call; it also notes changes of inlined functions, which numba does not.
"""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import ClassVar, ParamSpec, Protocol, TypeVar, cast

import numba
from llvmlite import binding
from numba import types

from lin_freq_ocp.base.atomic import lock_file
from lin_freq_ocp.base.clock import now

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")

REALS = tuple(types.Array(types.float64, dimensions, "C", readonly=True) for dimensions in range(4))
"""Types of contiguous arrays by their dimensions; what may be written can be given for what is only read."""

WRITTEN = tuple(types.Array(types.float64, dimensions, "C") for dimensions in range(4))
INDICES = types.Array(types.intp, 1, "C", readonly=True)
WRITTEN_INDICES = types.Array(types.intp, 1, "C")

FASTMATH = {"contract", "nsz"}


class _Statistics(Protocol):
    cache_path: str | None


class _Dispatcher(Protocol):
    signatures: list[object]
    stats: _Statistics

    def compile(self, signature: tuple[types.Type, ...]) -> None: ...
    def disable_compile(self) -> None: ...


def jit(function: Callable[Arguments, Value]) -> Callable[Arguments, Value]:
    """Return the function as compiled code; without a folder for the cache, each process compiles it again."""
    try:
        return _compile(function, True)
    except RuntimeError:  # numba found no folder that it can write
        return _compile(function, False)


def inlined(function: Callable[Arguments, Value]) -> Callable[Arguments, Value]:
    """Return a function that becomes part of its only caller: compiled alone as well, it would take twice as long."""
    decorate = numba.njit(inline="always", fastmath=FASTMATH, error_model="numpy")
    return cast("Callable[Arguments, Value]", decorate(function))


def _compile(function: Callable[Arguments, Value], cache: bool) -> Callable[Arguments, Value]:
    decorate = numba.njit(cache=cache, fastmath=FASTMATH, error_model="numpy")
    return cast("Callable[Arguments, Value]", decorate(function))


class Kernels:
    """The functions of a module that Python calls, each with the types of its arguments."""

    registered: ClassVar[list[Kernels]] = []
    """Those of all modules imported so far: ``python -m lin_freq_ocp.methods.structured`` compiles them."""

    def __init__(self, sources: tuple[str, ...], *signatures: tuple[Callable[..., object], tuple[types.Type, ...]]):
        """Compile nothing yet; ``sources`` are the files that the code is made of, that of the functions first."""
        self._sources = [Path(source) for source in sources]
        self._kernels = [(cast("_Dispatcher", function), given) for function, given in signatures]
        self._loaded = False
        self.registered.append(self)

    @property
    def ready(self) -> bool:
        """Whether nothing remains to be compiled."""
        record = self._record
        return self.loaded or (record is not None and record.exists())

    def prepare(self) -> None:
        """Compile everything, or take it from the cache; a terminal is told when that takes long."""
        if self.loaded:
            return
        if self.ready:
            self._load()
            return
        start = now()
        _tell("lin_freq_ocp: compiling loops of the structured method, once ...")
        with self._lock():
            if not self.ready:  # no other process has compiled it meanwhile
                # what is cached of other sources goes, and versions of inlined functions, which numba does not compare
                for ending in ("complete", "nbi", "nbc"):
                    for path in self._folder.glob(f"{self._sources[0].stem}.*.{ending}") if self._folder else ():
                        path.unlink(missing_ok=True)
            self._load()
            if self._record is not None:
                with suppress(OSError):
                    self._record.touch()
        _tell(f"lin_freq_ocp: compiled in {now() - start:.0f} s")

    def _load(self) -> None:
        """Compile each function, or take it from the cache."""
        for kernel, given in self._kernels:
            with suppress(OSError):  # the code is there, only the cache could not be written
                kernel.compile(given)
            kernel.disable_compile()

    @contextmanager
    def _lock(self) -> Generator[None]:
        """Wait for another process that compiles the same; where files cannot be locked, both compile."""
        with ExitStack() as stack:
            if self._folder is not None:
                with suppress(OSError):  # a folder may be unwritable
                    self._folder.mkdir(parents=True, exist_ok=True)
                    file = stack.enter_context((self._folder / f"{self._sources[0].stem}.lock").open("w"))
                    stack.enter_context(lock_file(file))
            yield

    @property
    def loaded(self) -> bool:
        """Whether this process has the code."""
        self._loaded = self._loaded or all(kernel.signatures for kernel, _ in self._kernels)
        return self._loaded

    @property
    def _folder(self) -> Path | None:
        path = self._kernels[0][0].stats.cache_path
        return None if path is None else Path(path)

    @property
    def _record(self) -> Path | None:
        """The file that says that all code is cached."""
        if self._folder is None:
            return None
        sources = [(path.stat().st_size, path.stat().st_mtime_ns) for path in self._sources]
        machine = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten(), platform.python_version()
        key = hashlib.sha256(repr((sources, machine, numba.__version__)).encode()).hexdigest()[:16]
        return self._folder / f"{self._sources[0].stem}.{key}.complete"


def _tell(line: str) -> None:
    if sys.stderr.isatty():
        print(line, file=sys.stderr, flush=True)
