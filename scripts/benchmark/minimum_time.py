"""Minimum time: gradient pulses, each with its least number of samples, the proof, and the time.

    OMP_NUM_THREADS=1 python scripts/benchmark.py minimum_time [--repeats 3] [--write]

CPU and wall time of ``lfo.minimum_time`` with the check of the conditions and the optimum, the least of the repeats.
Fails if the published pulse has not 132 samples, or 131 are not proven infeasible.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial

from rich.table import Table
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from benchmark.record import Record, build_parser

PULSE = lfo.library.mri_gradient
BANDS = ((560, 620), (960, 1310), (1860, 1950))
CASES = {
    "bipolar, first moment 11.74": (PULSE, (120, 140), 132),
    "the same, a wider range": (PULSE, (2, 300), 132),
    "prephaser, zeroth moment 11.74": (partial(PULSE, zeroth_moment=11.74, first_moment=None), (20, 100), None),
    "prephaser, further moments 0": (
        partial(PULSE, zeroth_moment=11.74, first_moment=0.0, second_moment=0.0),
        (100, 200),
        None,
    ),
    "bipolar, second moment 0": (partial(PULSE, second_moment=0.0), (200, 300), None),
    "bipolar, forbidden bands": (partial(PULSE, forbidden_bands_hz=BANDS), (220, 280), None),
}


def timed(
    source: Callable[..., lfo.OptimalControlProblem], horizons: tuple[int, int]
) -> tuple[lfo.results.MinimumTime, float, float]:
    """Return the answer, and its CPU and wall time in seconds."""
    cpu, wall = time.process_time(), time.perf_counter()
    found = lfo.minimum_time(source, horizons=horizons)
    return found, time.process_time() - cpu, time.perf_counter() - wall


def main(arguments: Sequence[str]) -> int:
    """Print a row of each case."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--repeats", type=int, default=3)
    given, failed = parser.parse_args(arguments), False
    table = Table("pulse", "range", "least", "solves", "CPU", "wall")
    with Record(given.write) as record, threadpool_limits(1):
        for name, (source, horizons, published) in CASES.items():
            found, cpu, wall = timed(source, horizons)
            for _ in range(given.repeats - 1):
                _, *again = timed(source, horizons)
                cpu, wall = min(cpu, again[0]), min(wall, again[1])
            low, high = horizons
            times = f"{cpu:.2f} s", f"{wall:.2f} s"
            table.add_row(name, f"{low} .. {high}", str(found.horizon), str(len(found.verdicts)), *times)
            failed |= not found.proven or found.ray is None or published not in (None, found.horizon)
        record.show(table)
    return int(failed)
