"""The record of a benchmark: its tables, with machine, load, versions, date and command of the run.

They go to the terminal and, with --write, into docs/benchmarks as Markdown.
"""

from __future__ import annotations

import argparse
import os
import platform
import shlex
import sys
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import TracebackType

from rich.console import Console
from rich.table import Table

import lin_freq_ocp as lfo

FOLDER = Path(__file__).parents[2] / "docs" / "benchmarks"
PACKAGES = (
    "numpy",
    "scipy",
    "clarabel",
    "cvxpy",
    "osqp",
    "piqp",
    "pyscipopt",
    "casadi",
    "do-mpc",
    "cvxpylayers",
    "diffcp",
)
BUSY = 0.5  # load of other processes from which on a time may be off by more than its second digit
WIDTH = 165  # columns where the output is no terminal


def build_parser(module: str, document: str | None) -> argparse.ArgumentParser:
    """Return a parser with the option --write, which describes a benchmark by the docstring of its module."""
    name = module.rpartition(".")[2]
    parser = argparse.ArgumentParser(
        prog=f"benchmark.py {name}", description=document, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", nargs="?", const=name, metavar="NAME", help="also into docs/benchmarks/NAME.md")
    return parser


class Record:
    """The tables of a run, with machine, versions, load, date and command; a file of them at the end, if it has a name.

    The load is that of the last minute, by all processes: before the run, and at its end, this process included.
    """

    def __init__(self, name: str | None = None, folder: Path = FOLDER):
        self.path = None if name is None else folder / f"{name}.md"
        self.load = load()
        self.parts: list[str] = []
        self.console = Console(markup=False, highlight=False)  # [ms] is no markup
        if not self.console.is_terminal:
            self.console.width = WIDTH

    def __enter__(self) -> Record:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        said = self.circumstances()
        self.console.print(said)
        if self.path is not None and kind is None:
            self.path.parent.mkdir(exist_ok=True)
            text = "\n\n".join([f"```sh\n{command()}\n```", *self.parts, f"*{said}*"])
            self.path.write_text(text + "\n", encoding="utf-8")

    def show(self, part: Table | str) -> None:
        """Print a table or a sentence, and keep it."""
        self.console.print(part)
        self.parts.append(part if isinstance(part, str) else markdown(part))

    def circumstances(self) -> str:
        """Return date, machine, load and versions in a line."""
        loads = ""
        if self.load is not None:
            loads = f", load {self.load:.1f} before and {load():.1f} at the end"
            loads += ": a busy machine" if max(self.load, load() - 1) > BUSY else ""
        return f"{date.today():%d %B %Y}; {machine()}{loads}; {versions()}"


def load() -> float | None:
    """Return how many processes wanted a processor during the last minute, where the system counts them."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def machine() -> str:
    """Return processor, cores and system."""
    info = Path("/proc/cpuinfo")
    models = [line for line in info.read_text().splitlines() if line.startswith("model name")] if info.exists() else []
    model = models[0].partition(":")[2].strip() if models else platform.processor() or platform.machine()
    return f"{model}, {os.cpu_count()} cores, {platform.system()}"


def versions() -> str:
    """Return the versions of Python, of this package and of those that are measured and installed."""
    found = [f"Python {platform.python_version()}", f"lin_freq_ocp {lfo.__version__}"]
    for package in PACKAGES:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    return ", ".join(found)


def command() -> str:
    """Return the command line of this run."""
    threads = os.environ.get("OMP_NUM_THREADS")
    begin = "" if threads is None else f"OMP_NUM_THREADS={threads} "
    return f"{begin}python scripts/benchmark.py {shlex.join(sys.argv[1:])}"


def markdown(table: Table) -> str:
    """Return a table in Markdown, without its empty columns, after its title."""
    columns = [column for column in table.columns if any(column.cells)]
    rules = ["---:" if column.justify == "right" else "---" for column in columns]
    rows = [[column.header for column in columns], rules, *zip(*(column.cells for column in columns), strict=True)]
    lines = "\n".join("| " + " | ".join(str(cell).replace("|", r"\|") for cell in row) + " |" for row in rows)
    return lines if table.title is None else f"**{table.title}**\n\n{lines}"


def duration(seconds: float | None) -> str:
    """Return seconds with three digits, in ms below one second."""
    if seconds is None:
        return ""
    return f"{seconds:.3g} s" if seconds >= 1 else f"{1e3 * seconds:.3g} ms"
