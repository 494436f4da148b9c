"""C sources of the package, called by ctypes: compiled once per user, or as a wheel brings them, without a compiler.

Without both, slower code computes the same, and the extra ``compiler`` is named.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from lin_freq_ocp.base.activity import activity
from lin_freq_ocp.base.atomic import lock_file, write_bytes
from lin_freq_ocp.base.clock import seconds_since
from lin_freq_ocp.base.errors import ProblemError, missing_extra, warn_user

SYSTEM = f"{sys.platform}-{platform.machine().lower()}"  # the ending of the name of a library in a wheel
# Without sums of several terms at once, the digits are those of any compiler and any processor. The other flags make
# nodes of the mode search, and stages of 50 states, 10 to 20 % faster
PORTABLE = ("-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-shared")
FLAGS = (*PORTABLE, "-march=native", "-fopenmp-simd", "-DLFO_SIMD")
PROCESSOR_SECONDS = 60  # of each process of the compiler, however busy the machine; Windows knows no such limit
SECONDS_TO_WAIT = 600.0  # seconds until a compiler is stopped that waits for something and uses no processor time
FAILED, DAY = ".failed", 86_400.0  # ending of the record of a failure, and the seconds for which it holds
SLOWER = "slower code computes the same"
# Lines of /proc/cpuinfo that name a processor and its instructions: of x86, ARM, POWER and RISC-V
PROCESSOR_LINES = ("vendor_id", "cpu family", "model", "flags", "CPU", "Features", "cpu\t", "isa")


def compiler() -> str | None:
    """Return the C compiler of this machine: CC, or the first one found; None without any."""
    names = filter(None, (os.environ.get("CC"), "cc", "gcc", "clang"))
    return next((path for path in map(shutil.which, names) if path), None)


def compile_command() -> list[str]:
    """Return the compiler of this machine, or the one in the package ziglang; empty without any."""
    found, package = compiler(), find_spec("ziglang")
    if found is None and package is not None and package.origin is not None:
        program = shutil.which(str(Path(package.origin).with_name("zig")))
        return [] if program is None else [program, "cc"]
    return [] if found is None else [found]


def processor() -> str:
    """Return the model and the instructions of this processor, which -march=native compiles for."""
    try:
        lines = Path("/proc/cpuinfo").read_text().split("\n\n", 1)[0].splitlines()
    except OSError:  # not Linux
        return platform.processor()
    return "\n".join(line for line in lines if line.startswith(PROCESSOR_LINES))


@contextmanager
def compile_once(subject: str, lock: Path) -> Generator[None]:
    """Say that something is compiled, and wait while another process compiles it.

    If the file cannot be locked, both compile.
    """
    with activity(f"compiling {subject}, once"), ExitStack() as stack:
        with suppress(OSError):  # it may be another user's
            stack.enter_context(lock_file(stack.enter_context(lock.open("w"))))
        yield


@cache
def name_extra() -> None:
    """Warn that there is no compiler, and name the extra that brings one: once a day, as failures are remembered."""
    with suppress(OSError):
        record = _library_path(f"no-compiler{FAILED}")
        if _holds(record):
            return
        record.touch()
    warn_user(str(missing_extra(f"No C compiler was found, {SLOWER}", "ziglang, which has one,", "compiler")))


@cache
def compiled_library(module: str, *names: str) -> ctypes.CDLL | None:
    """Return the library of files, named as seen from a module, the first of which is compiled.

    Without a compiler, or if the compilation fails, it is that of the wheel; None if there is none. Then a failure is a
    warning that says what to do. It is remembered for a day, or until compiler, source or processor change: others get
    no warning.
    """
    source, *_ = sources = [Path(module).parent / name for name in names]
    shipped, command = source.with_name(f"{source.stem}-{SYSTEM}.so"), compile_command()
    if not command:
        return load_library(shipped) or name_extra()
    machine = sysconfig.get_platform(), platform.node(), processor()
    key = repr(([file.read_bytes() for file in sources], command, os.stat(command[0]).st_mtime_ns, FLAGS, machine))
    try:
        target = _library_path(f"{source.stem}-{hashlib.sha256(key.encode()).hexdigest()[:16]}.so")
        record, library = target.with_suffix(FAILED), load_library(target)
        if library is None and not _holds(record):
            with compile_once(source.name, target.with_suffix(".lock")):
                library = load_library(target)  # another process may have compiled it meanwhile
                if library is None and not _holds(record):
                    library = _compile_library(command, source, target, record)
        return library or load_library(shipped)
    except OSError as error:
        library = load_library(shipped)
        if library is None:
            warn_user(f"{source.name} could not be compiled, {SLOWER}: {error}")
        return library


def load_library(path: Path) -> ctypes.CDLL | None:
    """Return a library; None if it is missing or damaged."""
    try:
        return ctypes.CDLL(str(path))
    except OSError:
        return None


def _library_path(name: str) -> Path:
    """Return the path of a library in the user's cache or, if that cannot be written, in the cache of this folder."""
    user = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")) / "lin_freq_ocp"
    for folder in (user, Path(__file__).parent / "__pycache__"):
        if folder.is_absolute():  # without a home folder, "~" stays in the path
            with suppress(OSError):
                folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder / name, os.R_OK) or os.access(folder, os.W_OK):
                return folder / name
    raise OSError(f"{user} cannot be written. Set XDG_CACHE_HOME to a folder that can be written")


def _holds(record: Path) -> bool:
    """Return whether the record of a failure is there, and younger than a day."""
    return record.exists() and seconds_since(record.stat().st_mtime) < DAY


def _compile_library(program: Sequence[str], source: Path, target: Path, record: Path) -> ctypes.CDLL:
    """Compile a library, which appears when it is complete, and load it; the record keeps a failure.

    The compiler has a group of its own: Ctrl-C ends this process, and is no failure of the compiler.
    """
    # Messages go to a file: a pipe would stay open while any process of the compiler lives
    with tempfile.TemporaryDirectory() as folder, (Path(folder) / "messages").open("wb") as messages:
        compiled = Path(folder) / target.name
        command = [*program, *FLAGS, str(source), "-o", str(compiled), "-lm"]
        if os.name == "posix":
            command = ["/bin/sh", "-c", f'ulimit -S -t {PROCESSOR_SECONDS}; exec "$@"', "sh", *command]
        try:
            subprocess.run(
                command, stdout=messages, stderr=messages, check=True, timeout=SECONDS_TO_WAIT, process_group=0,
                env=os.environ | {"ZIG_GLOBAL_CACHE_DIR": str(target.with_name("zig"))},  # without a home folder, too
            )  # fmt: skip
            write_bytes(target, compiled.read_bytes())
            return ctypes.CDLL(str(target))
        except (OSError, ProblemError, subprocess.SubprocessError) as error:
            record.write_text(f"{error}\n{Path(messages.name).read_text(errors='replace')}", encoding="utf-8")
            raise OSError(f"{record} says why. To try again before tomorrow, remove this file") from None
