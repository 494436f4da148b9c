"""Compilation by numba, once: numba caches the machine code next to the source, or in another folder if that is locked.

A file next to the cached code names the sources and the machine for which the cache is complete; the first call then
compiles nothing. It also registers changes of inlined functions, which numba does not notice.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import ParamSpec, Protocol, TypeVar, cast

import numba
from llvmlite import binding
from numba import types

from lin_freq_ocp.methods.native_code import compile_once

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")

REALS = tuple(types.Array(types.float64, dimensions, "C", readonly=True) for dimensions in range(4))
"""Types of contiguous arrays by their dimensions; they accept arrays that can be written, too."""

WRITTEN = tuple(types.Array(types.float64, dimensions, "C") for dimensions in range(4))
INDICES = types.Array(types.intp, 1, "C", readonly=True)

FASTMATH = {"contract", "nsz"}


class _Statistics(Protocol):
    cache_path: str | None


class _Dispatcher(Protocol):
    signatures: list[object]
    stats: _Statistics

    def compile(self, signature: tuple[types.Type, ...]) -> None: ...
    def disable_compile(self) -> None: ...


def jit(function: Callable[Arguments, Value]) -> Callable[Arguments, Value]:
    """Return the function as compiled code; if no folder is writable, each process compiles it again."""
    try:
        compiled = numba.njit(cache=True, fastmath=FASTMATH, error_model="numpy")(function)
    except RuntimeError:  # numba found no folder that it can write
        compiled = numba.njit(cache=False, fastmath=FASTMATH, error_model="numpy")(function)
    return cast("Callable[Arguments, Value]", compiled)


class Kernels:
    """The functions of a module that Python calls, each with the types of its arguments."""

    def __init__(self, sources: tuple[str, ...], *signatures: tuple[Callable[..., object], tuple[types.Type, ...]]):
        """Compile nothing yet; ``sources`` are the files of the code, first the one that defines the functions."""
        self._sources = [Path(source) for source in sources]
        self._kernels = [(cast("_Dispatcher", function), signature) for function, signature in signatures]

    @property
    def ready(self) -> bool:
        """Whether nothing remains to be compiled."""
        return self.loaded or ((record := self._record) is not None and record.exists())

    def prepare(self) -> None:
        """Compile everything, or load it from the cache; if that takes long, say so in the terminal."""
        if self.ready:
            if not self.loaded:
                self._load()
            return
        lock = self._folder / f"{self._sources[0].stem}.lock" if self._folder else None
        with compile_once("loops of the structured method", lock):
            if not self.ready:  # no other process has compiled it meanwhile
                # remove code of other sources, and of other inlined functions, which numba does not compare
                for ending in ("complete", "nbi", "nbc"):
                    for path in self._folder.glob(f"{self._sources[0].stem}.*.{ending}") if self._folder else ():
                        path.unlink(missing_ok=True)
            self._load()
            if self._record is not None:
                with suppress(OSError):
                    self._record.touch()

    def _load(self) -> None:
        """Compile each function, or load it from the cache."""
        for kernel, signature in self._kernels:
            with suppress(OSError):  # the function is compiled, but the cache could not be written
                kernel.compile(signature)
            kernel.disable_compile()

    @property
    def loaded(self) -> bool:
        """Whether this process has the code."""
        return all(kernel.signatures for kernel, _ in self._kernels)

    @property
    def _folder(self) -> Path | None:
        path = self._kernels[0][0].stats.cache_path
        return None if path is None else Path(path)

    @property
    def _record(self) -> Path | None:
        """The file whose existence says that all code is cached."""
        if self._folder is None:
            return None
        sources = [(path.stat().st_size, path.stat().st_mtime_ns) for path in self._sources]
        machine = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten(), platform.python_version()
        key = hashlib.sha256(repr((sources, machine, numba.__version__)).encode()).hexdigest()[:16]
        return self._folder / f"{self._sources[0].stem}.{key}.complete"
