"""Masks at every frequency on the pendulum: rounds, and time against one solve with the bins of the DFT only.

    OMP_NUM_THREADS=1 python scripts/benchmark.py frequencies [--horizons 240 2400 24000] [--repeats 3] [--limit-s 600]
                                                              [--write]

The first two rows have costs that others have published to ten digits. CPU times are the least of the repeats, both
solves in one run by the structured method; the last columns are what the judge proves. The rows with a price are the
same with a soft mask, at half of what the multipliers of the hard mask add up to.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from rich.table import Table
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from benchmark.record import Record, build_parser
from lin_freq_ocp.solving.method import Request
from lin_freq_ocp.solving.outcome import Outcome

KNOWN = {(0.2, 80, 240, 0.01): 3670.032556, (0.5, 90, 240, 0.1): 339.591322}  # level [N], bin of 240, T, step [s]


@dataclass(frozen=True)
class Rounds(lfo.solvers.Structured):
    """The structured method, which notes every solve."""

    solved: list[str] = field(default_factory=list[str])

    def solve(self, problem: lfo.OptimalControlProblem, request: Request) -> Outcome:
        """Solve, and note it."""
        outcome = super().solve(problem, request)
        self.solved.append(outcome.status)
        return outcome


def problem_of(
    level: float, cutoff: int, horizon: int, step: float, every: bool, price: float | None = None
) -> lfo.OptimalControlProblem:
    """Return the pendulum with a mask at every frequency, or at the bins; with a price, it is soft."""
    band = lfo.low_pass(2 * np.pi * cutoff / 240)
    mask = lfo.MagnitudeBound(level, band=band, every_frequency=every, penalty=price)
    return replace(lfo.library.pendulum(horizon=horizon, sampling_time=step), control_spectrum=mask)


def least(repeats: int, problem: lfo.OptimalControlProblem, limit: float) -> tuple[float, Outcome, int]:
    """Return the least CPU time, the answer and the number of rounds."""
    times = list[float]()
    for _ in range(repeats):
        method, clock = Rounds(), time.process_time()
        result = lfo.solve(problem, method, time_limit=limit, throw=False)
        times.append(time.process_time() - clock)
    return min(times), result, len(method.solved)


def add_soft(table: Table, name: str, price: float, bins: float, found: tuple[float, Outcome, int]) -> None:
    """Add the row of a soft mask."""
    taken, result, rounds = found
    if result.certificate is None or result.multipliers is None:
        table.add_row(f"{name}, soft", "", str(result.status))
        return
    (peak,) = (one.peak for one in result.certificate.conditions if one.peak is not None)
    atoms = sum(map(len, result.multipliers.frequencies.values()))
    cells = "", f"{taken:.3g} s ({taken / bins:.1f} x)", str(rounds), str(atoms)
    table.add_row(
        f"  with a price of {price:.4g}", *cells, f"{peak.ratio - 1:.1e}", f"{result.gap:.1e}", f"{result.cost:.9g}"
    )


def main(arguments: Sequence[str]) -> None:
    """Print the table."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--horizons", type=int, nargs="*", default=[240, 2400, 24_000])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--limit-s", type=float, default=600.0)
    given = parser.parse_args(arguments)
    table = Table("level, from, T, step", title="the pendulum with a mask at every frequency")
    for column in ("bins only", "every frequency", "rounds", "atoms", "|V|/l - 1", "gap", "cost", "off the known"):
        table.add_column(column, justify="right")
    cases = dict.fromkeys([*KNOWN, *((0.2, 80, T, 0.01) for T in given.horizons)])
    with Record(given.write) as record, threadpool_limits(1):
        for case in cases:
            name = "{} N, {}/240, {}, {} s".format(*case)
            try:
                bins, _, _ = least(given.repeats, problem_of(*case, every=False), given.limit_s)
                taken, result, rounds = least(given.repeats, problem_of(*case, every=True), given.limit_s)
            except lfo.errors.UnsupportedError as error:
                table.add_row(name, "refused", str(error)[:60])
                continue
            if result.certificate is None or result.multipliers is None:
                table.add_row(name, f"{bins:.3g} s", str(result.status))
                continue
            (peak,) = (one.peak for one in result.certificate.conditions if one.peak is not None)
            atoms = sum(map(len, result.multipliers.frequencies.values()))
            off = "" if case not in KNOWN else f"{result.cost / KNOWN[case] - 1:.1e}"
            cells = f"{bins:.3g} s", f"{taken:.3g} s ({taken / bins:.1f} x)", str(rounds), str(atoms)
            table.add_row(name, *cells, f"{peak.ratio - 1:.1e}", f"{result.gap:.1e}", f"{result.cost:.9g}", off)
            if case in KNOWN:
                weights = np.concatenate([result.multipliers.stage[one] for one in result.multipliers.frequencies])
                price = 0.5 * case[0] * float(np.linalg.norm(weights, axis=1).sum())
                add_soft(table, name, price, bins, least(given.repeats, problem_of(*case, True, price), given.limit_s))
        record.show(table)
