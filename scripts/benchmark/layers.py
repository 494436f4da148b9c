"""How much each speed layer of the Fourier-domain method gains: the factor on CPU time without it.

    OMP_NUM_THREADS=1 python scripts/benchmark.py layers [--repeats N] [--cases NAME ...] [--write]

Setup and solve together, but for "re-solve" (ten new initial states of one solver, as the median of their factors).
Runs with and without a layer alternate; each time is the least of N. The answers must have the same status.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import partial

import numpy as np
from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.cases import FAMILIES, moved
from benchmark.record import Record, build_parser
from helpers.random.lti import random_lti
from lin_freq_ocp.methods.spectral import exchange, qp, rows, shortcuts, solver, spaces, structure

Solve = Callable[[], lfo.solvers.SpectralSolution]


def nothing(*_: object) -> None:
    """Replace a function whose answer None means that there is nothing to use."""


LAYERS = {
    "first working set": (solver, "first_working_set", nothing),
    "its held samples": (shortcuts, "HOLD_GROWTH", 0.0),
    "its shorter horizon": (shortcuts, "_shortened_horizon", lambda lti: lti.horizon),
    "model of the whole horizon": (structure.Structure, "whole_horizon", nothing),
    "rows near the working rows": (exchange, "neighbourhood_of", nothing),
    "nearly active samples": (rows, "NEARLY_ACTIVE", 0.0),
    "highest peaks of states only": (rows, "STATE_PEAKS", 10**9),
    "block pivoting": (qp, "block_pivoting", nothing),
    "factor of low rank": (qp, "LOW_RANK_ROWS", 10**9),
    "warm interior point": (qp, "WARM", 1.0),
    "table of kernels": (spaces, "SMALL_TABLE", 0),
}

CASES = {
    "pendulum 240": ("pendulum", 240),
    "pendulum 1e4": ("pendulum", 10_000),
    "pendulum 1e5": ("pendulum", 100_000),
    "slow 240": ("pendulum-slow", 240),
    "slow 1e4": ("pendulum-slow", 10_000),
    "fine 5000": ("fine", 5000),
    "oscillator 1e5": ("oscillator", 100_000),
    "bang-bang 1600": ("bang-bang", 1600),
    "state arcs 800": ("state-arcs", 800),
}


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


def cold(problem: lfo.OptimalControlProblem) -> lfo.solvers.SpectralSolution:
    """Set up and solve."""
    return lfo.SpectralSolver(problem).solve()


def solves(case: str) -> Iterator[Solve]:
    """Yield the solves of a case."""
    if case == "random LTI":
        yield from (partial(cold, random_lti(seed)) for seed in range(12))
    elif case == "re-solve 240":
        problem = FAMILIES["pendulum"].problem(240)
        kept = lfo.SpectralSolver(problem)
        kept.solve()
        kept.solve()
        yield from (partial(kept.solve, other.initial_state.lower) for other in moved(problem, 10))
    else:
        family, horizon = CASES[case]
        yield partial(cold, FAMILIES[family].problem(horizon))


def factor(case: str, layer: str, repeats: int) -> float:
    """Return the median factor on the CPU time of the solves of a case without a layer."""
    return float(np.median([_factor(solve, layer, repeats) for solve in solves(case)]))


def _factor(solve: Solve, layer: str, repeats: int) -> float:
    least = [np.inf, np.inf]
    for _ in range(repeats):
        seconds, status = timed(solve)
        with without(layer):
            off, status_off = timed(solve)
        if status != status_off:
            print(f"without {layer}: {status_off}, not {status}")
        least = [min(least[0], seconds), min(least[1], off)]
    return least[1] / least[0]


def timed(solve: Solve) -> tuple[float, str]:
    """Return CPU time and status."""
    started = time.process_time()
    status = solve().status
    return time.process_time() - started, status


def main(arguments: Sequence[str]) -> None:
    """Print a table of layers against cases."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--repeats", type=int, default=3, help="runs of each, of which the fastest counts")
    parser.add_argument("--cases", nargs="+", default=[*CASES, "re-solve 240", "random LTI"])
    given = parser.parse_args(arguments)
    table = Table("layer", *given.cases)
    with Record(given.write) as record:
        for layer in LAYERS:
            table.add_row(layer, *(f"{factor(case, layer, given.repeats):.2f}" for case in given.cases))
        record.show(table)
