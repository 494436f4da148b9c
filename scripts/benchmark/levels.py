"""Controls with levels: cost, samples between levels, bound, gap and seconds, compared with HiGHS on linear costs.

    OMP_NUM_THREADS=1 python scripts/benchmark.py levels [--seconds 20] [--write]

Selective harmonic elimination with duty cycles and, at a tolerance, with whole samples; optimal pulse patterns beside
the published intervals, and the published class, of which the slowest modulation is shown. HiGHS gets the mixed-integer
program by scipy; its harmonics keep the tolerance in both parts, within 1/sqrt(2) of it for k = 3, 5, 7, so that its
point is feasible in ours. With whole samples, our search begins without a start; "first node" is its answer after one
relaxation, from noise-shaped rounding and flips. Seconds are CPU seconds of the process. Fails if a published value is
missed, whole samples have no feasible pattern, or one of the published class is left undecided.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from rich.table import Table
from scipy.optimize import Bounds, LinearConstraint, milp

import lin_freq_ocp as lfo
from benchmark.record import Record, build_parser

RELAXATION = 1.25898269
# Miller, Karamanakos and Geyer, arXiv 2512.08201: modulation, switches, and the interval of the distortion
PATTERNS = ((0.9, 8, 0.042201, 0.042206), (1.0, 8, 0.029132, 0.02916), (0.8, 12, 0.023661, 0.023664))
MODULATIONS, SWITCHES = np.arange(1, 24) / 20, range(8, 36, 4)
LEVELS = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])


def by_highs(samples: int, tolerance: float, whole: bool, seconds: float) -> tuple[float, float, float]:
    """Return the cost, HiGHS' bound and CPU seconds, of weights z (T, levels)."""
    angle = 2 * np.pi * np.arange(samples) / samples
    rows = np.array([wave(k * angle) for k in (1, 3, 5, 7) for wave in (np.sin, np.cos)]) * 2 / samples
    target = np.array([1.5, *[0.0] * 7])
    wide = tolerance * np.array([1.0, 1.0, *[np.sqrt(0.5)] * 6])
    ones = np.kron(np.eye(samples), np.ones(len(LEVELS)))
    started = time.process_time()
    found = milp(
        np.tile(LEVELS**2, samples) / samples,
        integrality=np.full(samples * len(LEVELS), int(whole)),
        bounds=Bounds(0, 1),
        constraints=[
            LinearConstraint(ones, 1, 1),
            LinearConstraint(np.kron(rows, LEVELS), target - wide, target + wide),
        ],
        options={"time_limit": seconds},
    )
    spent = time.process_time() - started
    bound = found.mip_dual_bound if whole else found.fun
    return (np.inf if found.x is None else found.fun), bound, spent


def row(name: str, result: lfo.results.Result | None, cost: float, bound: float, seconds: float) -> list[str]:
    """Return the cells of a row."""
    use = None if result is None else result.level_use
    between = "" if use is None else f"{use.fractional}" + ("" if use.rows is None else f" of {use.rows}")
    gap = (cost - bound) / cost if np.isfinite(cost) else np.inf
    return [name, f"{cost:.9g}", between, f"{bound:.9g}", f"{gap:.1e}", f"{seconds:.2f}"]


def timed(problem: lfo.OptimalControlProblem, **options: object) -> tuple[lfo.results.Result, float]:
    """Return the result of a solve and its CPU seconds."""
    started = time.process_time()
    result = lfo.solve(problem, throw=False, **options)
    return result, time.process_time() - started


@np.errstate(all="ignore")
def main(arguments: Sequence[str]) -> int:
    """Print the table."""
    parser = build_parser(__name__, __doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each search over whole samples")
    parser.add_argument("--tolerance", type=float, default=0.02, help="of harmonics, with whole samples")
    given = parser.parse_args(arguments)
    timed(lfo.library.pulse_pattern(samples=32))  # what is imported once
    timed(lfo.library.pulse_pattern(kind="opp"))
    table = Table("problem", "value", "between levels", "bound", "gap", "CPU s")
    with Record(given.write) as record:
        failed = eliminations(table, given.tolerance, given.seconds)
        failed |= patterns(table)
        failed |= published_class(table, given.seconds)
        record.show(table)
    return int(failed)


def eliminations(table: Table, tolerance: float, limit: float) -> bool:
    """Add the rows of selective harmonic elimination, and return whether the published value is missed."""
    result, seconds = timed(lfo.library.pulse_pattern(samples=128))
    table.add_row(*row("elimination, duty cycles", result, result.cost, result.lower_bound, seconds))
    failed = abs(result.cost - RELAXATION) > 1e-7 or result.level_use.fractional > result.level_use.rows
    cost, bound, seconds = by_highs(128, 0.0, False, limit)
    table.add_row(*row("the same, HiGHS", None, cost, bound, seconds))
    for samples in (128, 200):
        problem = lfo.library.pulse_pattern(samples=samples, tolerance=tolerance)
        cost, bound, seconds = by_highs(samples, tolerance, True, limit)
        table.add_row(*row(f"N = {samples}, whole samples, tolerance {tolerance:g}, HiGHS", None, cost, bound, seconds))
        for name, options in (("first node", {"node_limit": 1}), (f"{limit:g} s", {"time_limit": limit})):
            result, seconds = timed(problem, **options)
            cost = np.inf if result.cost is None else result.cost
            failed |= result.certificate is None or not result.certificate.feasible
            table.add_row(*row(f"the same, ours, {name}", result, cost, result.lower_bound or -np.inf, seconds))
    return failed


def patterns(table: Table) -> bool:
    """Add the rows of optimal pulse patterns, and return whether a published interval is missed."""
    failed = False
    for modulation, switches, low, high in PATTERNS:
        result, seconds = timed(lfo.library.pulse_pattern("opp", modulation=modulation, switches=switches))
        cost, bound = np.sqrt(result.cost), np.sqrt(result.lower_bound)
        name = f"distortion, M = {modulation}, k = {switches}, published {low} .. {high}"
        table.add_row(*row(name, None, cost, bound, seconds))
        failed |= not low <= cost <= high or not low <= bound
    return failed


def published_class(table: Table, limit: float) -> bool:
    """Add for each number of switches the modulation that takes longest, and return whether one is left undecided."""
    failed = False
    for switches in SWITCHES:
        found = []
        for modulation in MODULATIONS:
            dwell = 0.01 * np.pi
            problem = lfo.library.pulse_pattern(
                "opp", modulation=modulation, switches=switches, least_dwell=dwell, unipolar=True, exactly=True
            )
            result, seconds = timed(problem, time_limit=limit)
            failed |= result.status not in ("optimal", "infeasible")
            found.append((seconds, modulation, result))
        ends = [result.status for _, _, result in found]
        name = (
            f"k = {switches}, published class: {ends.count('optimal')} optimal, {ends.count('infeasible')} infeasible"
        )
        seconds, modulation, result = max(one for one in found if one[2].cost is not None)
        cost, bound = np.sqrt(result.cost), np.sqrt(result.lower_bound)
        table.add_row(*row(f"{name}; slowest M = {modulation:g}", None, cost, bound, seconds))
    return failed
