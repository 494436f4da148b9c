"""Which method is the fastest for which linear problem: the measurements behind the choice of "auto".

    OMP_NUM_THREADS=1 python scripts/benchmark.py choice [--families NAME ...] [--horizons T ...] [--repeats N]
                                                         [--write]

CPU seconds of ``lfo.solve``, judge included, the least of N, runs alternating; "-" where a method does not apply, a
status where its answer is not optimal. The last columns: what "auto" took, and how much longer than the fastest.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from rich.table import Table

import lin_freq_ocp as lfo
from benchmark.record import Record, build_parser
from benchmark.structured_cases import masked, rate_limited, rendezvous, time_varying

METHODS = "spectral", "structured", "convex"
SLOW = 5.0  # seconds beyond which a method is not tried again, nor at a longer horizon


def unfiltered(horizon: int) -> lfo.OptimalControlProblem:
    """Return the time-varying oscillator without its low pass."""
    return replace(time_varying(horizon), control_spectrum=None)


def sparse_thrust(horizon: int) -> lfo.OptimalControlProblem:
    """Return the double integrator with a price on the absolute force."""
    problem = lfo.library.double_integrator(horizon=horizon, sampling_time=8 / horizon, cutoff_hz=None)
    return replace(problem, cost=problem.cost + lfo.costs.L1Cost(u=0.1))


def soft_speed(horizon: int) -> lfo.OptimalControlProblem:
    """Return the pendulum with a soft bound on a state, and its stop band."""
    problem = lfo.library.pendulum(horizon=horizon, sampling_time=2.4 / horizon)
    soft = lfo.StageRows([[0.0, 1.0, 0.0, 0.0]], None, [0.1], penalty=10.0)
    return replace(problem, stage_rows=[*problem.stage_rows, soft])


def resonance(horizon: int) -> lfo.OptimalControlProblem:
    """Return the chain of masses, whose first resonance is removed from a state."""
    return lfo.library.mass_chain(horizon=horizon)


FAMILIES: dict[str, Callable[[int], lfo.OptimalControlProblem]] = {
    "time-varying": time_varying,
    "time-varying, no band": unfiltered,
    "rate-limited": rate_limited,
    "mask": masked,
    "cone-limited": rendezvous,
    "L1 cost": sparse_thrust,
    "soft rows": soft_speed,
    "resonance": resonance,
    "pendulum": lambda horizon: lfo.library.pendulum(horizon=horizon, sampling_time=2.4 / horizon),
}


def seconds(problem: lfo.OptimalControlProblem, method: str) -> tuple[float, lfo.results.Result | None]:
    """Return CPU seconds and the result; None where the method does not apply."""
    start = time.process_time()
    try:
        result = lfo.solve(problem, method, throw=False)
    except lfo.errors.UnsupportedError:
        result = None
    return time.process_time() - start, result


def main(arguments: Sequence[str]) -> None:
    """Measure all families."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--horizons", nargs="+", type=int, default=[30, 100, 300, 1000])
    parser.add_argument("--families", nargs="+", choices=list(FAMILIES), default=list(FAMILIES))
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args(arguments)
    with Record(given.write) as record:
        losses = measured(record, given.families, given.horizons, given.repeats)
        record.show(f"Lost: {np.exp(np.nanmean(np.log(losses))):.3g}x in the mean, {np.nanmax(losses):.3g}x at most.")


def measured(record: Record, families: Sequence[str], horizons: Sequence[int], repeats: int) -> list[float]:
    """Show the table of all families, and return how much longer the chosen methods take than the fastest."""
    table = Table("problem", "T", *METHODS, "auto", "lost", title='CPU milliseconds, and the choice of "auto"')
    losses: list[float] = []
    for name in families:
        family = FAMILIES[name]
        slow: set[str] = set()
        for horizon in horizons:
            try:
                problem = family(horizon)
            except lfo.errors.ProblemError:  # too short for its bands
                continue
            best: dict[str, float] = {}
            shown: dict[str, str] = {}
            for _ in range(repeats):
                for method in METHODS:
                    if method in slow:
                        continue
                    spent, result = seconds(problem, method)
                    if spent > SLOW:
                        slow.add(method)
                    if result is None or result.status != lfo.results.Status.OPTIMAL:
                        shown[method] = "-" if result is None else str(result.status)
                        continue
                    best[method] = min(best.get(method, np.inf), spent)
                    shown[method] = f"{1e3 * best[method]:.3g}"
            _, chosen = seconds(problem, "auto")
            assert chosen is not None  # "auto" takes every problem
            lost = best.get(chosen.method, np.nan) / min(best.values(), default=np.nan)
            losses.append(lost)
            table.add_row(name, str(horizon), *(shown.get(m, "") for m in METHODS), chosen.method, f"{lost:.2g}x")
    record.show(table)
    return losses
