"""Peak resident memory of one contender on one problem, in a process of its own.

    python scripts/benchmark_memory.py CONTENDER FAMILY HORIZON LIMIT

Prints one JSON object: MiB after the imports (with a small problem solved, so that everything is loaded), MiB at the
peak, and the status. ``benchmark.py --memory`` starts it.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
from pathlib import Path

from benchmark_cases import FAMILIES, small
from benchmark_contenders import CONTENDERS
from threadpoolctl import threadpool_limits

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
    """Run this file for one contender; its JSON object, or only a status if it came to no end."""
    command = [sys.executable, __file__, contender, family, str(horizon), str(limit)]
    try:
        child = subprocess.run(command, capture_output=True, text=True, timeout=limit + START_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return {"status": f"does not finish in {limit:g} s"}
    return json.loads(child.stdout) if child.returncode == 0 else {"status": f"ended with {child.returncode}"}


def main(contender: str, family: str, horizon: str, limit: str) -> None:
    """Solve a small problem, then the one asked for, and print the memory after each."""
    with threadpool_limits(1):
        CONTENDERS[contender](small(), float(limit))
        problem, imports = FAMILIES[family].problem(int(horizon)), peak()
        answer = CONTENDERS[contender](problem, float(limit))
    print(json.dumps({"status": answer.status, "imports": imports, "peak": peak()}))


if __name__ == "__main__":
    main(*sys.argv[1:])
