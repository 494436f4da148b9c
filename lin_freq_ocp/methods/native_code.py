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


def compiler() -> str | None:
    """Return the C compiler of this machine: CC, or the first one found; None without any."""
    names = filter(None, (os.environ.get("CC"), "cc", "gcc", "clang"))
    return next((path for path in map(shutil.which, names) if path), None)


@cache
def compiled_library(package: str, names: tuple[str, ...], purpose: str) -> ctypes.CDLL | None:
    """Return the library of files of a package, the last of which is compiled; None without a compiler.

    If the compilation fails: None, with a warning that names the ``purpose`` and what happens instead.
    """
    found = compiler()
    if found is None:
        return None
    source = resources.files(package)
    texts = {name: source.joinpath(name).read_text() for name in names}
    key = "\n".join([*texts.values(), found, *FLAGS, sysconfig.get_platform(), platform.node()])
    stem = Path(names[-1]).stem
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "lin_freq_ocp"
    target = folder / f"{stem}-{hashlib.sha256(key.encode()).hexdigest()[:16]}.so"
    try:
        if not target.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=target.parent) as work:
                for name, text in texts.items():
                    (Path(work) / name).write_text(text)
                command = [found, *FLAGS, f"{stem}.c", "-o", f"{stem}.so", "-lm"]
                subprocess.run(command, cwd=work, check=True, capture_output=True, timeout=SECONDS_TO_COMPILE)
                os.replace(Path(work) / f"{stem}.so", target)  # as a whole, if another process writes it meanwhile
        return ctypes.CDLL(str(target))
    except (OSError, subprocess.SubprocessError) as error:
        warnings.warn(f"{purpose}: {error}", RuntimeWarning, stacklevel=2)
        return None
