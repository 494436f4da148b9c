"""A generated controller, compiled and called from Python."""

from __future__ import annotations

import ctypes
import re
import subprocess
from pathlib import Path

import numpy as np

from lin_freq_ocp.methods import compiler

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover")
MEMORY = 4 << 20  # bytes, more than any controller of the tests needs


def compile_command(*options: str) -> list[str]:
    """Return the command that compiles the sources of a folder, with all warnings as errors."""
    found = compiler()
    assert found is not None
    return [found, *STRICT, *options, "controller.c", "lfo_kernel.c"]


class CompiledController:
    """The controller of a folder; ``step``, ``applied`` and ``plan`` are those of controller.h."""

    def __init__(self, folder: Path, real: str, states: int, controls: int, horizon: int, references: bool = False):
        self.measured = int(re.findall(r"CONTROLLER_MEASURED (\d+)", (folder / "controller.h").read_text())[0])
        library = folder / "controller.so"
        if not library.exists():
            command = compile_command("-O0", "-fPIC", "-shared", "-o", library.name)
            subprocess.run([*command, "-lm"], cwd=folder, check=True)
        self._library = ctypes.CDLL(str(library))
        self._memory = ctypes.create_string_buffer(MEMORY)
        self.dtype, self.references = np.dtype(np.float64 if real == "double" else np.float32), references
        self.u = np.zeros(controls, self.dtype)
        self._shapes = (horizon + 1, states), (horizon, controls)
        self.begin()

    def begin(self) -> None:
        """Forget all steps."""
        self._library.controller_begin(self._memory)

    @property
    def bytes(self) -> bytes:
        """Return the memory of the controller."""
        return self._memory.raw

    def step(self, x: np.ndarray, reference: np.ndarray | None = None) -> tuple[int, np.ndarray]:
        """Return the status and the control of a measured state."""
        assert len(x) == self.measured
        given = [np.array(x, self.dtype), *([np.array(reference, self.dtype)] if self.references else []), self.u]
        status = self._library.controller_step(self._memory, *(ctypes.c_void_p(part.ctypes.data) for part in given))
        return status, self.u.astype(float)

    def applied(self, u: np.ndarray) -> None:
        """Tell that another control acts than the one returned last."""
        self._library.controller_applied(self._memory, ctypes.c_void_p(np.array(u, self.dtype).ctypes.data))

    def plan(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the states and controls of the last plan."""
        x, u = (np.zeros(shape, self.dtype) for shape in self._shapes)
        self._library.controller_plan(self._memory, *(ctypes.c_void_p(part.ctypes.data) for part in (x, u)))
        return x.astype(float), u.astype(float)


def write_log(
    path: Path,
    states: np.ndarray,
    controls: np.ndarray,
    statuses: list[int],
    references: np.ndarray | None = None,
    digits: int = 17,
) -> Path:
    """Write a log, and return its path."""
    signals = {"x": states, "r": references, "u": controls}
    given = {letter: signal for letter, signal in signals.items() if signal is not None}
    letters = [f"{letter}{i + 1}" for letter, signal in given.items() for i in range(signal.shape[1])]
    rows = [
        ",".join([*(f"{value:.{digits}g}" for value in row), str(int(status))])
        for row, status in zip(np.hstack([*given.values()]), statuses, strict=True)
    ]
    path.write_text("\n".join([",".join([*letters, "status"]), *rows]) + "\n")
    return path
