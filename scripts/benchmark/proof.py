"""The price of a proof: seconds to solve, write and check, bytes, and the width of the interval.

    OMP_NUM_THREADS=1 python scripts/benchmark.py proof [--problems NAME:HORIZON ...] [--write]

"Build" is the proof without its text, "write" the file; "enclosure" is a proof that is checked in memory, as
``result.write_proof`` has it up to a horizon of 20000, and always for a search over modes, whose "build" it is. "Check"
reads the file. CPU times.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from rich.table import Table
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from benchmark.record import Record, build_parser
from lin_freq_ocp.proof import lfo_check
from lin_freq_ocp.proof.enclosure import LONGEST_CHECK
from lin_freq_ocp.proof.proof import proof_of, unchecked_proof

PROBLEMS = (
    "double_integrator:200",
    "pendulum:240",
    "pendulum:2000",
    "pendulum:10000",
    "switched_rotation:20",
    "double_integrator:100000",
)
HEADS = ("problem", "solve", "build", "write", "check", "MB", "bits", "width", "enclosure", "its width")
LEAST_WIDTH = 1e-16  # what is narrower is shown so

Found = TypeVar("Found")


def timed(call: Callable[[], Found]) -> tuple[Found, float]:
    """Return the value of a call, and its seconds."""
    start = time.process_time()
    return call(), time.process_time() - start


def measured(problem: lfo.OptimalControlProblem, file: Path) -> list[str]:
    """Return the figures of one problem."""
    result, solve = timed(lambda: lfo.solve(problem))
    modes = problem.mode_names
    proof, build = timed(lambda: proof_of(result)[0] if modes else unchecked_proof(result))
    _, write = timed(lambda: file.write_text("".join(proof.lines())))
    with file.open("rb") as stream:
        (lower, upper), check = timed(lambda: lfo_check.check(stream, lambda line: None))
    size, width = f"{file.stat().st_size / 1e6:.2f}", max(float((upper - lower) / abs(upper)), LEAST_WIDTH)
    figures = [f"{solve:.2f}", f"{build:.2f}", f"{write:.2f}", f"{check:.2f}", size, str(proof.bits), f"{width:.0e}"]
    if problem.horizon > LONGEST_CHECK:
        return [*figures, "", ""]
    (_, found), seconds = timed(lambda: proof_of(result))
    return [*figures, f"{seconds:.2f}", f"{max(found.width / abs(found.upper), LEAST_WIDTH):.0e}"]


def main(arguments: Sequence[str]) -> None:
    """Print a row for each problem."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--problems", nargs="+", default=PROBLEMS, metavar="NAME:HORIZON")
    given, table = parser.parse_args(arguments), Table(*HEADS, title="seconds of CPU, and widths relative to the cost")
    limits = threadpool_limits(1)
    with Record(given.write) as record, limits, tempfile.TemporaryDirectory() as folder:
        lfo.solve(lfo.library.double_integrator()).write_proof(Path(folder, "first"))  # loads what is loaded once
        for text in given.problems:
            name, horizon = text.split(":")
            table.add_row(text, *measured(lfo.library.by_name(name)(horizon=int(horizon)), Path(folder, "proof")))
        record.show(table)
