"""Time, accuracy and memory of this package, compared with other solvers. One file each in benchmark/.

    python scripts/benchmark.py NAME [options]
    python scripts/benchmark.py NAME --help

--write puts the tables of a run into docs/benchmarks/NAME.md, with machine, load, versions, date and command.
"""

from __future__ import annotations

import ast
import sys
from importlib import import_module
from pathlib import Path

SCRIPTS = Path(__file__).parent
sys.path.append(str(SCRIPTS.parent / "tests"))  # some measure on random problems of the tests

BENCHMARKS = (
    *("solvers", "memory", "structured", "layers", "choice"),
    *("frequencies", "wave_energy", "shapers", "minimum_time"),
    *("many", "derivatives", "loop", "embedded", "closed_loop", "explore", "proof", "threads", "robust"),
    *("levels", "modes", "nonlinear", "formula_costs", "commits"),
)


def summary(name: str) -> str:
    """Return the first line of a benchmark's docstring, without its imports."""
    document = ast.get_docstring(ast.parse((SCRIPTS / "benchmark" / f"{name}.py").read_text(encoding="utf-8")))
    return (document or "").splitlines()[0]


def main() -> int:
    """Run a benchmark, or list all of them."""
    name, *arguments = sys.argv[1:] or ["--help"]
    if name in BENCHMARKS:
        return import_module(f"benchmark.{name}").main(arguments) or 0
    print(__doc__, *(f"{other:14} {summary(other)}" for other in BENCHMARKS), sep="\n")
    return 0 if name in ("-h", "--help") else 2


if __name__ == "__main__":
    sys.exit(main())
