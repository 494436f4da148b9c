"""The figure of a sweep: what a parameter costs, and where there is no solution at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import number
from lin_freq_ocp.batch.sweep import Row, SweepOutcome
from lin_freq_ocp.pages.figures import look

HEIGHT = 1.4 * look.ROW_HEIGHT
WIDE = 30.0  # an axis whose values, all above zero, have a larger ratio than this is logarithmic
MOST_NAMED = 12  # of more lines only the first and the last stand in the legend
PITCH, STRIP = 0.04, 0.25  # fractions of the height: from row to row of marks, and for all rows of marks at most

# Units of parameters whose names are the package's own.
UNITS = {"cutoff": "rad/sample", "cutoff_hz": "Hz", "sampling_time": "s", "horizon": "steps"}

# Marker and label of points that have no cost: above all costs without a solution, below without a lower bound.
MARKS_ABOVE = {"infeasible": ("x", "infeasible (proven)"), "other": ("$?$", "no point that satisfies all constraints")}
BELOW = {"unbounded": ("v", "no lower bound (proven)")}


@dataclass(frozen=True)
class Line:
    """The points that differ in the first parameter only."""

    label: str  # the values of the other parameters
    reference: float | None  # the proven cost where the first parameter is None
    points: tuple[tuple[float, Row], ...]  # where it is a number, in ascending order


def sweep_figure(sweep: SweepOutcome) -> Figure:
    """Return the cost against the first parameter whose values are numbers, one line for each choice of the others.

    Where None is among its values and every line with a cost has a cost there, too, costs are divided by that cost:
    the price of the constraint. Hollow points are not proven. Points without a solution are marks above all costs, and
    those without a lower bound below: no cost is drawn for either.
    """
    name = _numeric(sweep)
    lines = _lines(sweep, name)
    priced = [line for line in lines if any(row["cost"] is not None for _, row in line.points)]
    relative = bool(priced) and all(line.reference is not None and line.reference > 0 for line in priced)
    figure = look.new_figure(HEIGHT)
    ax = figure.add_subplot()
    for i, line in enumerate(lines):
        _draw(ax, line, i, relative, named=len(lines) <= MOST_NAMED or i in (0, len(lines) - 1))
    if _wide([x for line in lines for x, _ in line.points]):
        ax.set_xscale("log")
    if _wide([cost for line in lines for _, row in line.points if (cost := _cost(row, line, relative)) is not None]):
        ax.set_yscale("log")
    if relative:
        ax.axhline(1.0, color=look.MUTED, linewidth=0.9, linestyle=(0, (1.2, 1.2)), zorder=1)
    for kinds, above in ((MARKS_ABOVE, True), (BELOW, False)):
        _draw_marks(ax, lines, kinds, above)
    unit = UNITS.get(name)
    y_label = "cost, relative to that without the constraint" if relative else "cost"
    x_label = f"{name.removesuffix('_hz').replace('_', ' ')}" + (f" [{unit}]" if unit else "")
    unproven = any(row["cost"] is not None and not row["proven"] for row in sweep.rows)
    title = "the price of bandwidth" if name.startswith("cutoff") else f"cost against {name.replace('_', ' ')}"
    look.style_axes(
        ax, f"{sweep.problem}: {title}", x_label, y_label, [look.Note("Hollow: not proven.")] if unproven else []
    )
    if ax.get_legend_handles_labels()[1]:
        figure.legend(fontsize=look.LABEL_SIZE, labelcolor=look.INK, frameon=False, loc="outside right upper")
    return figure


def _numeric(sweep: SweepOutcome) -> str:
    for name, values in sweep.grid.items():
        numbers = [value for value in values if value is not None]
        if numbers and all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in numbers):
            return name
    raise ProblemError("grid", f"no parameter with numbers in {', '.join(sweep.names)}", "one to draw costs against")


def _lines(sweep: SweepOutcome, name: str) -> list[Line]:
    references, groups = dict[str, float | None](), dict[str, list[tuple[float, Row]]]()
    for row in sweep.rows:
        label = ", ".join(f"{other} = {_text(value)}" for other, value in row["parameters"].items() if other != name)
        points, value = groups.setdefault(label, []), row["parameters"][name]
        if isinstance(value, (int, float)):
            points.append((value, row))
        elif row["proven"]:
            references.setdefault(label, row["cost"])
    return [
        Line(label, references.get(label), tuple(sorted(points, key=itemgetter(0)))) for label, points in groups.items()
    ]


def _draw(ax: Axes, line: Line, i: int, relative: bool, named: bool) -> None:
    color, marker = look.COMPONENTS[i % len(look.COMPONENTS)], look.MARKERS[i % len(look.MARKERS)]
    costs = [_cost(row, line, relative) for _, row in line.points]
    ax.plot(
        [x for x, _ in line.points],
        [float("nan") if cost is None else cost for cost in costs],
        color=color,
        linewidth=1.5,
        label=look.plain(line.label) if named and line.label else None,
        marker=marker,
        markersize=5,
    )
    unproven = [
        (x, cost) for (x, row), cost in zip(line.points, costs, strict=True) if cost is not None and not row["proven"]
    ]
    if unproven:
        x, cost = zip(*unproven, strict=True)
        ax.plot(
            x, cost, linestyle="none", marker=marker, markersize=5, color=color, markerfacecolor=look.PAPER, zorder=4
        )


def _draw_marks(ax: Axes, lines: Sequence[Line], kinds: Mapping[str, tuple[str, str]], above: bool) -> None:
    """Mark points without cost in a strip above, or below, all costs, a row for each line that has some."""
    marked = [i for i, line in enumerate(lines) if any(_kind(row) in kinds for _, row in line.points)]
    if not marked:
        return
    pitch = min(PITCH, STRIP / len(marked))
    strip = pitch * (len(marked) + 1)
    axis = ax.yaxis.get_transform()
    low, high = axis.transform(ax.get_ylim())
    room = (high - low) * strip / (1 - strip)  # for a fraction of the height that is free of costs
    ax.set_ylim(*map(float, axis.inverted().transform([low, high + room] if above else [low - room, high])))
    edge = 1 - strip if above else strip
    ax.axhline(edge, color=look.MUTED, linewidth=0.7, zorder=1).set_transform(ax.transAxes)
    text, at, side = ("no solution", 1.0, "top") if above else ("no cheapest", 0.0, "bottom")
    ax.text(0.995, at, text, transform=ax.transAxes, ha="right", va=side, color=look.MUTED, fontsize=look.LABEL_SIZE)
    for kind, (marker, label) in kinds.items():
        found = False
        for row_number, i in enumerate(marked, 1):
            x = [x for x, row in lines[i].points if _kind(row) == kind]
            height = edge + pitch * row_number if above else edge - pitch * row_number
            color, transform = look.COMPONENTS[i % len(look.COMPONENTS)], ax.get_xaxis_transform()
            ax.plot(
                x, [height] * len(x), linestyle="none", marker=marker, color=color, markersize=6, transform=transform
            )
            found = found or bool(x)
        if found:
            ax.plot([], [], linestyle="none", marker=marker, color=look.MUTED, markersize=6, label=label)


def _kind(row: Row) -> str:
    """Return the kind of a point without cost; nothing for a point that has a cost."""
    if row["cost"] is not None:
        return ""
    return row["status"] if row["proven"] and row["status"] in (*MARKS_ABOVE, *BELOW) else "other"


def _cost(row: Row, line: Line, relative: bool) -> float | None:
    cost = row["cost"]
    return cost if cost is None or not relative else cost / (line.reference or 1.0)


def _wide(values: Sequence[float]) -> bool:
    return len(values) > 0 and min(values) > 0 and max(values) > WIDE * min(values)


def _text(value: object) -> str:
    return "none" if value is None else number(value) if isinstance(value, float) else str(value)
