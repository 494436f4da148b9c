"""What a proof costs: seconds to solve, write and check, bytes, and the width of the interval.

    python scripts/benchmark_proof.py [--problems pendulum:240 pendulum:10000 double_integrator:100000 ...]

Problems are names of the library with a horizon. "build" is the proof without a file, "write" the file, "enclosure"
both with a check in memory, as ``result.write_proof`` has it up to a horizon of 20000; "check" reads the file. Process
times, on one thread.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import lfo_check
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from lin_freq_ocp.proof.proof import proof_of, unchecked_proof

PROBLEMS = ("double_integrator:200", "pendulum:240", "pendulum:2000", "pendulum:10000", "double_integrator:100000")


def timed(call: Callable[[], object]) -> tuple[object, float]:
    """Return what a call returns, and its seconds."""
    start = time.process_time()
    return call(), time.process_time() - start


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each problem."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--problems", nargs="+", default=PROBLEMS, metavar="NAME:HORIZON")
    parser.add_argument("--enclosures", action="store_true", help="check in memory, too")
    given = parser.parse_args(arguments)
    with threadpool_limits(1), tempfile.TemporaryDirectory() as folder:
        lfo.solve(lfo.library.double_integrator()).write_proof(Path(folder, "first"))  # loads everything
        for text in given.problems:
            name, horizon = text.split(":")
            measure(lfo.library.by_name(name)(horizon=int(horizon)), text, Path(folder, "proof"), given.enclosures)


def measure(problem: lfo.OptimalControlProblem, text: str, file: Path, enclosures: bool) -> None:
    """Print the figures of one problem."""
    result, solve = timed(lambda: lfo.solve(problem))
    proof, build = timed(lambda: unchecked_proof(result))
    _, write = timed(lambda: file.write_text("".join(proof.lines())))
    with file.open("rb") as stream:
        (lower, upper), check = timed(lambda: lfo_check.check(stream, lambda line: None))
    width = float((upper - lower) / abs(upper))
    parts = f"solve {solve:.2f} s, build {build:.2f} s, write {write:.2f} s, check {check:.2f} s"
    print(f"{text}: {parts}, {file.stat().st_size / 1e6:.2f} MB, {proof.bits} bits, width {width:.1e}", flush=True)
    if enclosures:
        (_, found), seconds = timed(lambda: proof_of(result))
        print(f"    enclosure {seconds:.2f} s, width {found.width / abs(found.upper):.1e}", flush=True)


if __name__ == "__main__":
    main()
