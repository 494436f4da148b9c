"""Time, accuracy and memory of the Fourier-domain solver and of others, on growing problems. About 4 minutes.

    python scripts/benchmark.py solvers [--family pendulum] [--sizes 240 960] [--full] [--csv FILE]
                                        [--figure FILE] [--write]
    python scripts/benchmark.py solvers --memory --family pendulum --sizes 960
    python scripts/benchmark.py solvers --list

All contenders run in one process with one thread (BLAS and solvers), in turns, and the median counts, in seconds of the
process. Writing the problem down for the solver is timed with the solve, as are multipliers; constructing the
OptimalControlProblem is not. A contender that is expected to need longer than the limit is skipped, and the table says
so. Beside the times are the residuals of every answer, relative and computed from the problem's data, and its
certificate: ``measures.Row`` defines each figure, and ``contenders`` the settings of each solver.

The families "resolve" and "resolve-slow" solve one problem from many new initial states, and show the worst residuals
of all. The last table has a line for each problem and horizon; it is the one that --write saves.
"""

from __future__ import annotations

import argparse
import csv
import gc
import sys
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.table import Table
from threadpoolctl import threadpool_limits

import lin_freq_ocp as lfo
from benchmark.cases import FAMILIES, RESOLVE_SIZES, RESOLVED, moved, small
from benchmark.contenders import CONTENDERS, RESOLVERS, Answer
from benchmark.measures import Row, Runs, measured, timed
from benchmark.memory import in_own_process
from benchmark.record import Record, build_parser, duration
from lin_freq_ocp.pages.figures.look import CLASSICAL, COMPONENTS, MARKERS, ROW_HEIGHT, Note, new_figure, style_axes

# Exponents by which times are expected to grow with the horizon; a stop band in the time domain is dense rows
GROWTH = {"ours": 1.2}
CUBIC = 3.0
SAFETY = 1.5  # a contender that is expected to exceed the limit by less than this factor is still run
# No contender but ours starts unseen above this horizon: dense rows need memory that grows with its square
LARGEST_DENSE = 3000
REPEAT_SECONDS = 4.0  # a contender whose runs at one horizon took this long together is not repeated any more
EXPONENT_FROM, EXPONENT_TO = 10_000, 1_000_000  # horizons between which the growth of our time is stated
COLUMNS = ("error", "gap", "dynamics", "stop_band", "bounds", "adjoint")


def main(arguments: Sequence[str]) -> None:
    """Run the families of the options, and print their tables."""
    options = read_options(arguments)
    if options.list:
        for name, family in FAMILIES.items():
            print(f"{name:14} {family.words}; T = {family.sizes}, --full {family.full}")
        for name, solved in RESOLVED.items():
            print(f"{name:14} {solved}, again and again from new initial states; T = {RESOLVE_SIZES}")
        return
    names = options.family or [*FAMILIES, *RESOLVED]
    with Record(options.write) as record, threadpool_limits(1):
        if options.memory:
            families = [name for name in names if name in FAMILIES]
            record.show(memory_table(families, options.sizes, options.limit_s))
            return
        rows = race_families(record, names, options)
        record.show(summary(rows))
        growth = exponent(rows)
        if growth is not None:
            record.show(f"Time of ours from T = {EXPONENT_FROM:.0e} to {EXPONENT_TO:.0e} grows as T^{growth:.2f}.")
    if options.csv:
        save_csv(rows, options.csv)
    if options.figure and not draw(rows, options.figure):
        print("no figure: no family was run at two horizons")


def race_families(record: Record, names: Sequence[str], options: argparse.Namespace) -> list[Row]:
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


def read_options(arguments: Sequence[str]) -> argparse.Namespace:
    """Return the options."""
    parser = build_parser(__name__, __doc__)
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
    return parser.parse_args(arguments)


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
    """Return the rows of one family at all horizons, and the notes below their table."""
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


NONZERO = 1e-9  # A multiplier above this fraction of the largest belongs to an active bound
WORST = ("error", "gap", "dynamics", "stop_band", "bounds", "adjoint", "iterations")


def resolve_rows(family: str, horizon: int, count: int, limit: float) -> tuple[list[Row], str]:
    """Return a row per contender over ``count`` initial states, and the notes below the table.

    Setting up for the first problem, and solving it once, is not timed. Times are medians over the initial states that
    the contender found a trajectory for; every other figure is the worst of them.
    """
    print(f"{family}, T = {horizon}, {count} initial states", file=sys.stderr)
    problem = FAMILIES[RESOLVED[family]].problem(horizon)
    contenders = {name: prepare(problem) for name, prepare in RESOLVERS.items()}
    rows: dict[str, list[Row]] = {name: [] for name in RESOLVERS}
    gaps, active = list[float](), list[np.ndarray]()
    for one in moved(problem, count):
        runs = {name: timed(contender, one, limit) for name, contender in contenders.items()}
        some, best = measured(family, one, runs)
        for row in some:
            rows[row.contender].append(row)
        if best is not None:
            gaps.append(best.gap)
        if runs["ours"].answer.status == "optimal":
            active.append(active_set(runs["ours"].answer))
    merged = [merged_row(some) for some in rows.values()]
    ours = next(row.seconds for row in merged if row.contender == "ours")
    changed = [not np.array_equal(*pair) for pair in pairwise(active)]
    note = f"T = {horizon}: {count} initial states"
    if changed:
        note += f", the active set is another than the one before in {np.mean(changed):.0%}"
    if gaps:
        note += f"; optimal costs proven to {max(gaps):.0e} or better"
    if ours is not None:
        merged = [row if row.seconds is None else replace(row, ratio=row.seconds / ours) for row in merged]
    return merged, note


def merged_row(rows: Sequence[Row]) -> Row:
    """Return one row for the same contender's rows of many initial states."""
    solved = [row for row in rows if row.status == "optimal"]
    first, others = rows[0], [row for row in rows if row.status != "optimal"]
    endings = sorted({row.status for row in others})
    remark = "; ".join(f"{sum(row.status == ending for row in others)} {ending}" for ending in endings)
    if not solved:
        return Row(first.family, first.horizon, first.contender, "failed", remark=remark)
    times = np.array([row.seconds for row in solved])
    columns = {name: [value for row in solved if (value := getattr(row, name)) is not None] for name in WORST}
    worst = {name: max(values, key=abs, default=None) for name, values in columns.items()}
    return Row(
        first.family,
        first.horizon,
        first.contender,
        "optimal",
        runs=len(solved),
        seconds=float(np.median(times)),
        fastest=float(times.min()),
        slowest=float(times.max()),
        remark=remark,
        **worst,
    )


def active_set(answer: Answer) -> np.ndarray:
    """Return where the multipliers of states (ends apart) and controls are not zero, flat."""
    parts = [np.abs(answer.multipliers.mu[1:-1]), np.abs(answer.multipliers.nu)]
    return np.concatenate([(part > NONZERO * part.max()).ravel() for part in parts])


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


OTHERS = [name for name in CONTENDERS if name != "ours"]


def summary(rows: Sequence[Row]) -> Table:
    """Return the table; in brackets is who ended without the answer, and a dash is who was not run."""
    table = Table("problem", title="median CPU time of ours, and how many times longer the others take")
    for heading in ("T", "ours", *OTHERS, "gap, ours", "bounds, ours"):
        table.add_column(heading, justify="right")
    last = ""
    for (family, horizon), some in groupby(rows, lambda row: (row.family, row.horizon)):
        found = {row.contender: row for row in some}
        ours = found["ours"]
        proofs = ("" if value is None else f"{value:.0e}" for value in (ours.gap, ours.bounds))
        cells = (ratio(found.get(name)) for name in OTHERS)
        words, last = ("" if family == last else description(family)), family
        table.add_row(words, f"{horizon}", duration(ours.seconds), *cells, *proofs)
    return table


def description(family: str) -> str:
    """Return the description of a family."""
    solved = RESOLVED.get(family, family)
    return FAMILIES[solved].words + ("" if solved == family else "; again and again from new initial states")


def ratio(row: Row | None) -> str:
    """Return how many times longer than ours, in brackets where there is no answer."""
    if row is None or row.ratio is None:
        return "-"
    said = f"{row.ratio:.0f} x" if row.ratio >= 10 else f"{row.ratio:.1f} x"
    return said if row.status == "optimal" else f"({said})"


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
    """Write all rows under the names of their fields; absent values are empty."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


COLORS = dict(zip(CONTENDERS, (COMPONENTS[0], COMPONENTS[1], CLASSICAL, COMPONENTS[2], COMPONENTS[3]), strict=True))
LABEL_STEP = 11.0  # points between the labels of two lines that end close together
WIDE = 100  # from this ratio of the largest to the smallest horizon on, powers of ten are enough to read the axis


def draw(rows: Sequence[Row], path: Path) -> bool:
    """Write the picture of all families with several horizons and contenders; return whether there was one."""
    timed = [row for row in rows if row.status == "optimal" and row.family in FAMILIES]
    families = {name: list(some) for name, some in groupby(timed, lambda row: row.family)}
    families = {name: some for name, some in families.items() if several(some)}
    if not families:
        return False
    height = ROW_HEIGHT * 1.3
    figure = new_figure(height * ((len(families) + 1) // 2))
    for i, (name, some) in enumerate(families.items()):
        ax = figure.add_subplot((len(families) + 1) // 2, min(2, len(families)), i + 1, xscale="log", yscale="log")
        style_axes(ax, name, "horizon T", "CPU seconds", [Note(FAMILIES[name].words)])
        panel(figure, ax, some)
    figure.savefig(path, dpi=150)
    return True


def several(rows: Sequence[Row]) -> bool:
    """Whether there are several horizons, and several contenders."""
    return min(len({row.horizon for row in rows}), len({row.contender for row in rows})) > 1


def panel(figure: Figure, ax: Axes, rows: Sequence[Row]) -> None:
    """Draw a line per contender, with its name at its end."""
    ends = []
    for marker, (name, color) in zip(MARKERS, COLORS.items(), strict=False):
        line = [(row.horizon, row.seconds) for row in rows if row.contender == name]
        if line:
            ax.plot(*zip(*line, strict=True), color=color, marker=marker, markersize=4.5, linewidth=1.6, zorder=3)
            ends.append((*line[-1], name, color))
    ax.margins(x=0.22, y=0.1)  # room for the names
    horizons = sorted({row.horizon for row in rows})
    if horizons[-1] < WIDE * horizons[0]:
        ax.set_xticks(horizons, [str(T) for T in horizons])
        ax.set_xticks([], minor=True)
    figure.draw_without_rendering()
    points = ax.transData.transform([end[:2] for end in ends])[:, 1] * 72 / figure.dpi
    for (T, seconds, name, color), shift in zip(ends, label_shifts(points), strict=True):
        ax.annotate(name, (T, seconds), xytext=(8, shift), textcoords="offset points", color=color, va="center")


def label_shifts(heights: np.ndarray) -> np.ndarray:
    """Return shifts after which no two labels are closer than LABEL_STEP."""
    order, shifted = np.argsort(heights), heights.copy()
    for below, above in pairwise(order):
        shifted[above] = max(shifted[above], shifted[below] + LABEL_STEP)
    return shifted - heights
