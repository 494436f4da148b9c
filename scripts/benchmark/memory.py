"""Peak resident memory of one contender on one problem, in a process of its own.

    python scripts/benchmark.py memory CONTENDER FAMILY HORIZON LIMIT

Prints one JSON object: MiB after the imports (with a small problem solved, so that everything is loaded), MiB at the
peak, and the status. ``benchmark.py solvers --memory`` starts it for every contender.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from threadpoolctl import threadpool_limits

from benchmark.cases import FAMILIES, small
from benchmark.contenders import CONTENDERS

ENTRY = Path(__file__).parents[1] / "benchmark.py"
START_SECONDS = 30.0  # time for imports and the first small problem, beyond the limit of the solver


def peak() -> float:
    """Return the peak resident memory of this process in MiB.

    ``ru_maxrss`` of a process includes, on Linux, that of its parent before it became a program of its own; VmHWM does
    not.
    """
    status = Path("/proc/self/status")
    if status.exists():
        return next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith("VmHWM")) / 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 1024)


def in_own_process(contender: str, family: str, horizon: int, limit: float) -> dict[str, str | float]:
    """Run ``main`` for one contender; return its JSON object, or only a status if it came to no end."""
    command = [sys.executable, str(ENTRY), "memory", contender, family, str(horizon), str(limit)]
    try:
        child = subprocess.run(command, capture_output=True, text=True, timeout=limit + START_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return {"status": f"does not finish in {limit:g} s"}
    return json.loads(child.stdout) if child.returncode == 0 else {"status": f"ended with {child.returncode}"}


def main(arguments: Sequence[str]) -> None:
    """Solve a small problem, then the one asked for, and print the memory after each."""
    parser = argparse.ArgumentParser(
        prog="benchmark.py memory", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("contender", choices=CONTENDERS)
    parser.add_argument("family", choices=FAMILIES)
    parser.add_argument("horizon", type=int)
    parser.add_argument("limit", type=float, help="seconds")
    options = parser.parse_args(arguments)
    solve = CONTENDERS[options.contender]
    with threadpool_limits(1):
        solve(small(), options.limit)
        problem, imports = FAMILIES[options.family].problem(options.horizon), peak()
        answer = solve(problem, options.limit)
    print(json.dumps({"status": answer.status, "imports": imports, "peak": peak()}))
