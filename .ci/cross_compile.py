"""Compile the C sources of the package for every system.

    python .ci/cross_compile.py FOLDER [COMPILER]

The libraries are written into FOLDER as into the package, by the compiler of the PyPI package ziglang. With a COMPILER,
such as cc, they are compiled for this system alone.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import lin_freq_ocp
from lin_freq_ocp.methods.native_code import PORTABLE, SYSTEM

PACKAGE = Path(lin_freq_ocp.__file__).parent
SOURCES = sorted((PACKAGE / "methods").rglob("*.c"))
TARGETS = {
    "linux-x86_64": "x86_64-linux-gnu.2.17",
    "linux-aarch64": "aarch64-linux-gnu.2.17",
    "darwin-x86_64": "x86_64-macos.11.0",
    "darwin-arm64": "aarch64-macos.11.0",
    "win32-amd64": "x86_64-windows-gnu",
}
"""The targets of the compiler by sys.platform and platform.machine()."""


def compile_source(command: Sequence[str], source: Path, folder: Path, system: str) -> None:
    """Write a library into a folder, where its source is in the package."""
    target = folder / source.relative_to(PACKAGE.parent).with_name(f"{source.stem}-{system}.so")
    target.parent.mkdir(parents=True, exist_ok=True)
    subprocess.run([*command, *PORTABLE, "-s", str(source), "-o", str(target), "-lm"], check=True)
    target.with_name(f"{source.stem}.lib").unlink(missing_ok=True)  # for linkers on Windows, of no use here


def main(folder: str, *compiler: str) -> None:
    """Compile all sources."""
    for source in SOURCES:
        if compiler:
            compile_source(compiler, source, Path(folder), SYSTEM)
            continue
        for system, target in TARGETS.items():
            command = [sys.executable, "-m", "ziglang", "cc", "-target", target]
            compile_source(command, source, Path(folder), system)


if __name__ == "__main__":
    main(*sys.argv[1:])
