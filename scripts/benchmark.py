"""Time, accuracy and memory of the Fourier-domain solver beside others, on problems that grow. About 4 minutes.

    python scripts/benchmark.py [--family pendulum] [--sizes 240 960] [--full] [--csv FILE] [--figure FILE] [--write]
    python scripts/benchmark.py --memory --family pendulum --sizes 960
    python scripts/benchmark.py --list

All contenders run in one process with one thread (BLAS and solvers), in turns, and the median counts, in seconds of the
process. Writing the problem down for the solver is timed with the solve, as are multipliers; constructing the
OptimalControlProblem is not. Who is expected to need longer than the limit is skipped, and the table says so. Next to
the times stand the residuals of every answer, relative and computed from the problem's data, and its certificate; what
each figure is, is written in ``benchmark_measures.Row``, and who runs with which settings in ``benchmark_contenders``.
The families "resolve" and "resolve-slow" solve one problem from many new initial states, and show the worst residuals
of all. The last table, the one that --write keeps, has a line for each problem and horizon.
"""

from __future__ import annotations

import argparse
import csv
import gc
import sys
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path

import benchmark_record
import numpy as np
from benchmark_cases import FAMILIES, RESOLVE_SIZES, RESOLVED, small
from benchmark_contenders import CONTENDERS
from benchmark_figure import draw
from benchmark_measures import Row, Runs, measured, timed
from benchmark_memory import in_own_process
from benchmark_resolve import resolve_rows
from benchmark_summary import duration, summary
from rich.table import Table
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo

GROWTH = {"ours": 1.2}
# Exponents by which times are expected to grow with the horizon; a stop band in the time domain is dense rows
CUBIC = 3.0
SAFETY = 1.5  # who may need this many times less than expected is still run
# No contender but ours starts unseen above this horizon: dense rows need memory that grows with its square
LARGEST_DENSE = 3000
REPEAT_SECONDS = 4.0  # A contender whose runs at one horizon took this long together is not repeated any more
EXPONENT_FROM, EXPONENT_TO = 10_000, 1_000_000  # horizons between which the growth of our time is stated
COLUMNS = ("error", "gap", "dynamics", "stop_band", "bounds", "adjoint")


def skip_reason(name: str, horizon: int, earlier: tuple[int, float] | None, limit: float) -> str:
    """Return why a contender is not run, or "".

    Parameters
    ----------
    name : str
    horizon : int
    earlier : (int, float) or None
        The last horizon of the same family that it was run at, and its seconds there.
    limit : float
        Seconds.
    """
    if earlier is None:
        return "skipped: no smaller horizon was run" if name != "ours" and horizon > LARGEST_DENSE else ""
    before, seconds = earlier
    if seconds > limit:
        return f"skipped: > {limit:g} s at T = {before}"
    expected = seconds * (horizon / before) ** GROWTH.get(name, CUBIC)
    return f"skipped: > {limit:g} s expected" if expected > SAFETY * limit else ""


def race(problem: lfo.OptimalControlProblem, names: Sequence[str], repeats: int, limit: float) -> dict[str, Runs]:
    """Run contenders in turns; none is repeated after a failure, or when it has had REPEAT_SECONDS."""
    runs: dict[str, Runs] = {}
    for _ in range(repeats):
        for name in names:
            if name in runs and (runs[name].answer.status != "optimal" or sum(runs[name].seconds) > REPEAT_SECONDS):
                continue
            run = timed(CONTENDERS[name], problem, limit)
            runs[name] = Runs(run.answer, (*runs[name].seconds, *run.seconds)) if name in runs else run
    return runs


def family_rows(name: str, sizes: Sequence[int], repeats: int, limit: float) -> tuple[list[Row], list[str]]:
    """Return the rows of one family at all horizons, and what is said below their table."""
    rows: list[Row] = []
    notes: list[str] = []
    earlier: dict[str, tuple[int, float]] = {}
    for T in sorted(sizes):
        reasons = {one: skip_reason(one, T, earlier.get(one), limit) for one in CONTENDERS}
        print(f"{name}, T = {T}", file=sys.stderr)
        problem = FAMILIES[name].problem(T)
        runs = race(problem, [one for one in CONTENDERS if not reasons[one]], repeats, limit)
        earlier |= {one: (T, float(np.median(some.seconds))) for one, some in runs.items()}
        some, best = measured(name, problem, runs)
        rows += some
        rows += [Row(name, T, one, "skipped", remark=reason) for one, reason in reasons.items() if reason]
        notes.append(f"T = {T}: {best or 'no bound was proven'}")
    return rows, notes


def table_of(title: str, rows: Sequence[Row], notes: Sequence[str]) -> Table:
    """Return the rows of one family, a section per horizon."""
    table = Table(title=title, caption="\n".join(notes), caption_justify="left")
    for heading in ("T", "", "time", "x ours", *(column.replace("_", " ") for column in COLUMNS), "iter.", "runs"):
        table.add_column(heading, justify="left" if heading == "" else "right")
    table.add_column("remark")
    for row, after in zip(rows, [*rows[1:], None], strict=True):
        table.add_row(
            f"{row.horizon:,}".replace(",", " "),
            row.contender,
            duration(row.seconds),
            "" if row.ratio is None else f"{row.ratio:.3g}",
            *("" if (value := getattr(row, column)) is None else f"{value:.0e}" for column in COLUMNS),
            "" if row.iterations is None else str(row.iterations),
            str(row.runs or ""),
            row.remark if row.status in ("optimal", "skipped") else f"{row.status}: {row.remark}",
            style="bold" if row.contender == "ours" else "",
            end_section=after is not None and after.horizon != row.horizon,
        )
    return table


def exponent(rows: Sequence[Row]) -> float | None:
    """Return p of time ~ T^p for ours on the pendulum, between EXPONENT_FROM and EXPONENT_TO, if both were solved."""
    solved = [row for row in rows if (row.family, row.contender, row.status) == ("pendulum", "ours", "optimal")]
    seconds = {row.horizon: row.seconds for row in solved}
    first, last = seconds.get(EXPONENT_FROM), seconds.get(EXPONENT_TO)
    if first is None or last is None:
        return None
    return float(np.log(last / first) / np.log(EXPONENT_TO / EXPONENT_FROM))


def memory_table(names: Sequence[str], sizes: Sequence[int] | None, limit: float) -> Table:
    """Return the peak memory of every contender, each in a process of its own, on the first horizon of each family."""
    table = Table("family", "T", "contender", title="peak resident memory, a process for each [MiB]")
    for heading in ("imports", "peak", "difference"):
        table.add_column(heading, justify="right")
    table.add_column("remark")
    for name in names:
        for T in sizes or FAMILIES[name].sizes[:1]:
            for contender in CONTENDERS:
                if contender != "ours" and T > LARGEST_DENSE:
                    table.add_row(name, str(T), contender, "", "", "", "skipped: too large")
                    continue
                found = in_own_process(contender, name, T, limit)
                imports, peak = found.get("imports"), found.get("peak")
                cells = ["", "", ""] if peak is None else [f"{v:.0f}" for v in (imports, peak, peak - imports)]
                remark = "" if found["status"] == "optimal" else str(found["status"])
                table.add_row(name, str(T), contender, *cells, remark)
    return table


def save_csv(rows: Sequence[Row], path: Path) -> None:
    """Write all rows under the names of their fields; what is absent is empty."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


def parsed() -> argparse.Namespace:
    """Return the options."""
    parser = benchmark_record.parser(__doc__)
    families = [*FAMILIES, *RESOLVED]
    parser.add_argument("--family", action="append", choices=families, help="repeatable; default: all")
    parser.add_argument("--sizes", type=int, nargs="+", metavar="T", help="horizons instead of the family's own")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--limit-s", type=float, default=20.0, metavar="SECONDS")
    parser.add_argument(
        "--resolves", type=int, default=200, metavar="N", help="initial states of the families resolve..."
    )
    parser.add_argument("--full", action="store_true", help="all horizons; long")
    parser.add_argument("--memory", action="store_true", help="peak memory instead of times")
    parser.add_argument("--csv", type=Path, metavar="FILE")
    parser.add_argument("--figure", type=Path, metavar="FILE")
    parser.add_argument("--list", action="store_true", help="print families and horizons, and stop")
    return parser.parse_args()


def main() -> None:
    """Run what the options ask for, and print the tables."""
    options = parsed()
    if options.list:
        for name, family in FAMILIES.items():
            print(f"{name:14} {family.words}; T = {family.sizes}, --full {family.full}")
        for name, solved in RESOLVED.items():
            print(f"{name:14} {solved}, again and again from new initial states; T = {RESOLVE_SIZES}")
        return
    names = options.family or [*FAMILIES, *RESOLVED]
    with benchmark_record.Record(options.write) as record, threadpool_limits(1):
        if options.memory:
            families = [name for name in names if name in FAMILIES]
            record.show(memory_table(families, options.sizes, options.limit_s))
            return
        rows = raced(record, names, options)
        record.show(summary(rows))
        growth = exponent(rows)
        if growth is not None:
            record.show(f"Time of ours from T = {EXPONENT_FROM:.0e} to {EXPONENT_TO:.0e} grows as T^{growth:.2f}.")
    if options.csv:
        save_csv(rows, options.csv)
    if options.figure and not draw(rows, options.figure):
        print("no figure: no family was run at two horizons")


def raced(record: benchmark_record.Record, names: Sequence[str], options: argparse.Namespace) -> list[Row]:
    """Run all contenders on these families, print the table of each, and return the rows of all."""
    rows = list[Row]()
    for contender in CONTENDERS.values():
        timed(contender, small(), options.limit_s)
    gc.freeze()  # what is loaded by now is not looked through again before every run
    for name in names:
        if name in RESOLVED:
            words = f"{FAMILIES[RESOLVED[name]].words}; again and again from new initial states"
            sizes = options.sizes or RESOLVE_SIZES
            found = [resolve_rows(name, T, options.resolves, options.limit_s) for T in sizes]
            some, notes = [row for part, _ in found for row in part], [note for _, note in found]
        else:
            family = FAMILIES[name]
            words, sizes = family.words, options.sizes or (family.full if options.full else family.sizes)
            some, notes = family_rows(name, sizes, options.repeats, options.limit_s)
        rows += some
        record.console.print(table_of(f"{name}: {words}", some, notes))
    return rows


if __name__ == "__main__":
    main()
