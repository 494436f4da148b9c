"""The figure of a sweep: what a parameter costs, and where there is no solution at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lin_freq_ocp.comparison.sweep.point import Row
from lin_freq_ocp.comparison.sweep.sweep import SweepOutcome
from lin_freq_ocp.errors import ProblemError
from lin_freq_ocp.phrases import number
from lin_freq_ocp.report.figures.style import (
    COMPONENTS,
    INK,
    LABEL_SIZE,
    MARKERS,
    MUTED,
    PAPER,
    ROW_HEIGHT,
    Note,
    new_figure,
    plain,
    style_axes,
)

HEIGHT = 1.4 * ROW_HEIGHT

WIDE = 30.0
"""An axis whose values, all above zero, have a larger ratio than this is logarithmic."""

MOST_NAMED = 12
"""Of more lines only the first and the last stand in the legend."""

PITCH, STRIP = 0.04, 0.25
"""Fractions of the height: from one line's points without cost to those of the next, and for all of them at most."""

UNITS = {"cutoff": "rad/sample", "cutoff_hz": "Hz", "sampling_time": "s", "horizon": "steps"}
"""Units of parameters whose names are the package's own."""

ABOVE = {"infeasible": ("x", "infeasible (proven)"), "other": ("$?$", "no point that satisfies all constraints")}
BELOW = {"unbounded": ("v", "no lower bound (proven)")}
"""Marker and words for points that have no cost: above all costs where there is no solution, below where there is no
cheapest."""


@dataclass(frozen=True)
class Line:
    """The points that differ in the first parameter only.

    Attributes
    ----------
    label : str
        The values of the other parameters.
    reference : float or None
        The cost where the parameter is None, if that is proven.
    rows : tuple of Row
        Those where it is a number, in ascending order.
    """

    label: str
    reference: float | None
    rows: tuple[Row, ...]


def sweep_figure(sweep: SweepOutcome) -> Figure:
    """Return the cost against the first parameter whose values are numbers, one line for each choice of the others.

    Where None is among its values and every line with a cost has one there, too, costs are divided by that one: what
    the constraint costs. Hollow points are not proven. Points without a solution are marks above all costs, and those
    without a lower bound below: no cost is drawn for either.
    """
    name = _numeric(sweep)
    lines = _lines(sweep, name)
    priced = [line for line in lines if any(row["cost"] is not None for row in line.rows)]
    relative = bool(priced) and all(line.reference is not None and line.reference > 0 for line in priced)
    figure = new_figure(HEIGHT)
    ax = figure.add_subplot()
    for i, line in enumerate(lines):
        _draw(ax, line, i, name, relative, shown=len(lines) <= MOST_NAMED or i in (0, len(lines) - 1))
    values = [row["parameters"][name] for line in lines for row in line.rows]
    if _wide(values):
        ax.set_xscale("log")
    costs = [cost for line in lines for row in line.rows if (cost := _cost(row, line, relative)) is not None]
    if _wide(costs):
        ax.set_yscale("log")
    if relative:
        ax.axhline(1.0, color=MUTED, linewidth=0.9, linestyle=(0, (1.2, 1.2)), zorder=1)
    for marks, above in ((ABOVE, True), (BELOW, False)):
        _draw_marks(ax, lines, name, marks, above)
    unit = UNITS.get(name)
    words = "cost, relative to that without the constraint" if relative else "cost"
    x_label = f"{name.removesuffix('_hz').replace('_', ' ')}" + (f" [{unit}]" if unit else "")
    doubtful = any(row["cost"] is not None and not row["proven"] for row in sweep.rows)
    title = "the price of bandwidth" if name.startswith("cutoff") else f"cost against {name.replace('_', ' ')}"
    style_axes(ax, f"{sweep.problem}: {title}", x_label, words, [Note("Hollow: not proven.")] if doubtful else [])
    if ax.get_legend_handles_labels()[1]:
        figure.legend(fontsize=LABEL_SIZE, labelcolor=INK, frameon=False, loc="outside right upper")
    return figure


def _numeric(sweep: SweepOutcome) -> str:
    for name, values in sweep.grid.items():
        numbers = [value for value in values if value is not None]
        if numbers and all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in numbers):
            return name
    raise ProblemError("grid", f"no parameter with numbers in {', '.join(sweep.names)}", "one to draw costs against")


def _lines(sweep: SweepOutcome, name: str) -> list[Line]:
    groups = dict[str, list[Row]]()
    for row in sweep.rows:
        others = {other: value for other, value in row["parameters"].items() if other != name}
        groups.setdefault(", ".join(f"{other} = {_word(value)}" for other, value in others.items()), []).append(row)
    lines = list[Line]()
    for label, rows in groups.items():
        free = [row["cost"] for row in rows if row["parameters"][name] is None and row["proven"]]
        rows = [row for row in rows if row["parameters"][name] is not None]
        rows.sort(key=lambda row: row["parameters"][name])
        lines.append(Line(label, free[0] if free else None, tuple(rows)))
    return lines


def _draw(ax: Axes, line: Line, i: int, name: str, relative: bool, shown: bool) -> None:
    color, marker = COMPONENTS[i % len(COMPONENTS)], MARKERS[i % len(MARKERS)]
    found = [(row["parameters"][name], _cost(row, line, relative), row) for row in line.rows]
    ax.plot(
        [x for x, _, _ in found],
        [float("nan") if cost is None else cost for _, cost, _ in found],
        color=color,
        linewidth=1.5,
        label=plain(line.label) if shown and line.label else None,
        marker=marker,
        markersize=5,
    )
    doubtful = [(x, cost) for x, cost, row in found if cost is not None and not row["proven"]]
    if doubtful:
        x, cost = zip(*doubtful, strict=True)
        ax.plot(x, cost, linestyle="none", marker=marker, markersize=5, color=color, markerfacecolor=PAPER, zorder=4)


def _draw_marks(ax: Axes, lines: Sequence[Line], name: str, kinds: Mapping[str, tuple[str, str]], above: bool) -> None:
    """Mark points without cost in a strip above, or below, all costs, a row for each line that has some."""
    marked = [i for i, line in enumerate(lines) if any(_kind(row) in kinds for row in line.rows)]
    if not marked:
        return
    pitch = min(PITCH, STRIP / len(marked))
    strip = pitch * (len(marked) + 1)
    _make_room(ax, strip, above)
    edge = 1 - strip if above else strip
    ax.axhline(edge, color=MUTED, linewidth=0.7, zorder=1).set_transform(ax.transAxes)
    words, at, side = ("no solution", 1.0, "top") if above else ("no cheapest", 0.0, "bottom")
    ax.text(0.995, at, words, transform=ax.transAxes, ha="right", va=side, color=MUTED, fontsize=LABEL_SIZE)
    for kind, (mark, words) in kinds.items():
        style: dict[str, Any] = {"linestyle": "none", "marker": mark, "markersize": 6}
        for place, i in enumerate(marked, 1):
            x = [row["parameters"][name] for row in lines[i].rows if _kind(row) == kind]
            height = edge + pitch * place if above else edge - pitch * place
            color = COMPONENTS[i % len(COMPONENTS)]
            ax.plot(x, [height] * len(x), color=color, transform=ax.get_xaxis_transform(), **style)
        if any(_kind(row) == kind for line in lines for row in line.rows):
            ax.plot([], [], color=MUTED, label=words, **style)


def _make_room(ax: Axes, strip: float, above: bool) -> None:
    """Leave a fraction of the height free of costs."""
    axis = ax.yaxis.get_transform()
    low, high = axis.transform(ax.get_ylim())
    room = (high - low) * strip / (1 - strip)
    ax.set_ylim(*map(float, axis.inverted().transform([low, high + room] if above else [low - room, high])))


def _kind(row: Row) -> str:
    """Return the kind of a point without cost; nothing for one that has a cost."""
    if row["cost"] is not None:
        return ""
    return row["status"] if row["proven"] and row["status"] in (*ABOVE, *BELOW) else "other"


def _cost(row: Row, line: Line, relative: bool) -> float | None:
    cost = row["cost"]
    return cost if cost is None or not relative else cost / (line.reference or 1.0)


def _wide(values: Sequence[float]) -> bool:
    return len(values) > 0 and min(values) > 0 and max(values) > WIDE * min(values)


def _word(value: Any) -> str:
    return "none" if value is None else number(value) if isinstance(value, float) else str(value)
