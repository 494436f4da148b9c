"""How much each speed layer of the structured method gains: the factor on CPU time without it.

    OMP_NUM_THREADS=1 python scripts/benchmark.py structured --layers [--repeats N]

A run of ``lfo.solve`` alternates with one without the layer; the least of N counts. Where the answer has another
status without a layer, that is said instead.
"""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager

import numpy as np
from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.structured_cases import CASES
from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.methods.structured import choice, embedding, solver
from lin_freq_ocp.methods.structured.kkt import dense, range_space, recursions


def both_sweeps(regulator: dense.Regulator, channels: Indices, R: Array, E: Array) -> Array:
    """Return the products of gradients and their whole responses."""
    Y, X = regulator.responses(channels, R, E)
    return -(np.tensordot(R, Y, ((0, 1), (0, 1))) + E.T @ X)


LAYERS = {
    "compiled loops": (solver, "loops", lambda compiled: recursions.loops(False)),
    "correctors": (embedding, "CORRECTORS", 0),
    "longer last steps": (embedding, "MOST_FRACTION", embedding.FRACTION),
    "refinement where steps fall short": (embedding, "EXPECTED", -np.inf),
    "sweeps one way": (dense.Regulator, "gram", both_sweeps),
    "blocks of stages": (dense, "NARROW", 10**9),
    "low rank of fine masks": (range_space, "WORTH", 0.0),
    "the smaller space": (choice.Sizes, "seconds", lambda sizes: {"range space": 0.0}),
    "conjugate gradients": (choice, "ITERATIONS", np.inf),
}

RUNS = {"time-varying": (1000, 4000), "rate-limited": (1000,), "mask": (240, 1000), "cone-limited": (5000,)}


@contextmanager
def without(layer: str) -> Generator[None]:
    """Switch a layer off."""
    holder, name, value = LAYERS[layer]
    before = getattr(holder, name)
    setattr(holder, name, value)
    try:
        yield
    finally:
        setattr(holder, name, before)


def timed(problem: lfo.OptimalControlProblem) -> tuple[float, str]:
    """Return CPU time and status of a solve."""
    started = time.process_time()
    status = str(lfo.solve(problem, "structured", throw=False).status)
    return time.process_time() - started, status


def factor(problem: lfo.OptimalControlProblem, layer: str, repeats: int) -> str:
    """Return the factor on the CPU time without a layer, or the status if it is another."""
    least = [np.inf, np.inf]
    for _ in range(repeats):
        seconds, status = timed(problem)
        with without(layer):
            off, status_off = timed(problem)
        if status != status_off:
            return status_off
        least = [min(least[0], seconds), min(least[1], off)]
    return f"{least[1] / least[0]:.2f}"


def table_of(repeats: int) -> Table:
    """Return a table of layers against cases."""
    problems = {f"{name} {T}": CASES[name].problem(T) for name, horizons in RUNS.items() for T in horizons}
    table = Table("without", *problems)
    for layer in LAYERS:
        table.add_row(layer, *(factor(problem, layer, repeats) for problem in problems.values()))
    return table
