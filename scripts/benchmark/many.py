"""One problem again and again: a thousand initial states at once, and a loop of them one after the other.

    OMP_NUM_THREADS=1 python scripts/benchmark.py many [--count 1000] [--steps 200] [--repeats 3] [--write]

CPU and wall time of ``lfo.solve_many`` with everything in it; CPU time of single steps of ``lfo.Solver``, without the
certificate, which is timed again by itself. Medians over steps, the least of the repeats.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence

import numpy as np
from rich.table import Table
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from benchmark.cases import MOVES
from benchmark.record import Record, build_parser

DISTURBED = 0.1  # of the spread of the random states: what a step of the loop is off
METHODS = ("spectral", "structured")
HORIZONS = (60, 240)


def states(problem: lfo.OptimalControlProblem, count: int, scale: float) -> np.ndarray:
    """Return random initial states around the problem's own."""
    moves = np.random.default_rng(0).standard_normal((count, problem.state_dim))
    return problem.initial_state.lower + scale * np.array(MOVES) * moves


def many(count: int, repeats: int) -> str:
    """Return a sentence on the time of many states at once."""
    problem = lfo.library.pendulum()
    given, least = states(problem, count, 1.0), np.full(2, np.inf)
    for _ in range(repeats):
        clocks = np.array([time.process_time(), time.perf_counter()])
        found = lfo.solve_many(problem, given)
        least = np.minimum(least, np.array([time.process_time(), time.perf_counter()]) - clocks)
    ended = ", ".join(f"{number} {status}" for status, number in Counter(found.statuses).items())
    return (
        f"{count} states, T = {problem.horizon}: {least[0]:.2f} s of CPU, {least[1]:.2f} s of wall time; {ended}; "
        f"{'all' if found.proven else 'not all'} proven, largest gap {np.nanmax(found.gaps):.0e}."
    )


def loop(horizon: int, method: str, steps: int, repeats: int) -> list[str]:
    """Return a row of the times of steps from disturbed states, by one method."""
    problem = lfo.library.pendulum(horizon=horizon, sampling_time=2.4 / horizon)
    given, least = states(problem, steps, DISTURBED), np.full((2, steps), np.inf)
    for _ in range(repeats):
        solver, seconds = lfo.Solver(problem, method), list[tuple[float, float]]()
        solver.solve()
        for state in given:
            clocks = [time.process_time()]
            result = solver.solve(initial_state=state)
            clocks.append(time.process_time())
            lfo.certify(result.problem, result.trajectory, result.multipliers)
            clocks.append(time.process_time())
            taken, certify = np.diff(clocks)
            seconds.append((taken - certify, certify))
        least = np.minimum(least, np.array(seconds).T)
    solve, certify = 1e3 * np.median(least, axis=1)
    slowest = 1e3 * least[0].max()
    return [str(horizon), method, f"{solve:.2f}", f"{slowest:.1f}", f"{certify:.2f}"]


def main(arguments: Sequence[str]) -> None:
    """Print all figures."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args(arguments)
    table = Table("T", "method", "a step [ms]", "slowest [ms]", "certificate [ms]", title="a loop of disturbed states")
    with Record(given.write) as record, threadpool_limits(1):
        record.show(many(given.count, given.repeats))
        for method in METHODS:
            steps = given.steps if method == "spectral" else given.steps // 5
            for horizon in HORIZONS:
                table.add_row(*loop(horizon, method, steps, given.repeats))
        record.show(table)
