"""Every example with BLAS threads as the machine has them and with one, while another process is busy.

    python scripts/benchmark.py threads [--examples NAME ...] [--write]

"Several" sets no variable, as in a user's process; "one" has OPENBLAS_NUM_THREADS=1. Each example runs in a process of
its own, one after the other. "CPU" is the processor time of all threads of that process.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path

import psutil
from rich.table import Table

from benchmark.record import Record, build_parser

ROOT = Path(__file__).parents[2]
EXAMPLES = {path.stem: path for path in sorted((ROOT / "examples").glob("*/*.py"))}
HEADS = ("example", "several: seconds", "one: seconds", "several: CPU", "one: CPU")
VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def busy_process() -> Generator[None]:
    """Keep one processor busy."""
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as busy:
        try:
            yield
        finally:
            busy.kill()


def measured(path: Path, threads: str | None) -> tuple[float, float]:
    """Return the seconds and the processor time of an example with so many threads; None for those of the machine."""
    environment = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    environment |= {"MPLBACKEND": "agg"} | ({} if threads is None else {"OPENBLAS_NUM_THREADS": threads})
    before, start = psutil.Process().cpu_times(), time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(path)]
        subprocess.run(command, cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL)
    after, seconds = psutil.Process().cpu_times(), time.perf_counter() - start
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return seconds, used


def main(arguments: Sequence[str]) -> None:
    """Print a row for each example."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--examples", nargs="+", default=list(EXAMPLES), metavar="NAME")
    given, table = parser.parse_args(arguments), Table(*HEADS, title="examples while another process is busy")
    with Record(given.write) as record, busy_process():
        for name in given.examples:
            several, one = measured(EXAMPLES[name], None), measured(EXAMPLES[name], "1")
            table.add_row(name, *(f"{pair[i]:.1f}" for i in (0, 1) for pair in (several, one)))
        record.show(table)
