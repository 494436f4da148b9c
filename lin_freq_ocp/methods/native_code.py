"""C sources of the package, compiled once per user and called by ctypes."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sysconfig
import tempfile
import warnings
from functools import cache
from importlib import resources
from pathlib import Path

FLAGS = ("-std=c99", "-O3", "-march=native", "-fno-math-errno", "-fopenmp-simd", "-DLFO_SIMD", "-fPIC", "-shared")
SECONDS_TO_COMPILE = 60.0
# Lines of /proc/cpuinfo that name a processor and its instructions: of x86, ARM, POWER and RISC-V
PROCESSOR_LINES = ("vendor_id", "cpu family", "model", "flags", "CPU", "Features", "cpu\t", "isa")


def compiler() -> str | None:
    """Return the C compiler of this machine: CC, or the first one found; None without any."""
    names = filter(None, (os.environ.get("CC"), "cc", "gcc", "clang"))
    return next((path for path in map(shutil.which, names) if path), None)


def processor() -> str:
    """Return the model and the instructions of this processor, which -march=native compiles for."""
    try:
        lines = Path("/proc/cpuinfo").read_text().split("\n\n", 1)[0].splitlines()
    except OSError:  # not Linux
        return platform.processor()
    return "\n".join(line for line in lines if line.startswith(PROCESSOR_LINES))


@cache
def compiled_library(package: str, names: tuple[str, ...], purpose: str) -> ctypes.CDLL | None:
    """Return the library of files of a package, the last of which is compiled; None without a compiler.

    If the compilation fails: None, with a warning that names the ``purpose`` and what happens instead.
    """
    found = compiler()
    if found is None:
        return None
    source = resources.files(package)
    texts = {name: source.joinpath(name).read_text(encoding="utf-8") for name in names}
    machine = sysconfig.get_platform(), platform.node(), processor()
    key = "\n".join([*texts.values(), found, *FLAGS, *machine])
    stem = Path(names[-1]).stem
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "lin_freq_ocp"
        target = (folder / f"{stem}-{hashlib.sha256(key.encode()).hexdigest()[:16]}.so").absolute()
        try:
            return ctypes.CDLL(str(target))
        except OSError:  # not compiled yet, or damaged
            _compile_library(found, texts, stem, target)
        return ctypes.CDLL(str(target))
    except (OSError, RuntimeError, subprocess.SubprocessError) as error:  # RuntimeError: no home folder
        warnings.warn(f"{purpose}: {error}", RuntimeWarning, stacklevel=2)
        return None


def _compile_library(found: str, texts: dict[str, str], stem: str, target: Path) -> None:
    """Compile a source to a file that is replaced as a whole, if another process writes it meanwhile."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as work:
        for name, text in texts.items():
            (Path(work) / name).write_text(text, encoding="utf-8")
        command, compiled = [found, *FLAGS, f"{stem}.c", "-o", f"{stem}.so", "-lm"], Path(work) / f"{stem}.so"
        subprocess.run(command, cwd=work, check=True, capture_output=True, timeout=SECONDS_TO_COMPILE)
        with compiled.open("rb+") as file:
            os.fsync(file.fileno())  # a power failure after the replacement would leave half of it
        os.replace(compiled, target)
