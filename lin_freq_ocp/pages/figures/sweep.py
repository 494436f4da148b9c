"""The figure of a sweep: cost over a parameter, with marks for points without a solution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lin_freq_ocp.base.errors import ProblemError
from lin_freq_ocp.base.phrases import settings
from lin_freq_ocp.batch.sweep import Row, SweepOutcome
from lin_freq_ocp.pages.figures import look

HEIGHT = 1.4 * look.ROW_HEIGHT
WIDE = 30.0  # an axis of positive values with a larger ratio than this is logarithmic
MOST_NAMED = 12  # the legend names the first and the last of more lines
PITCH, STRIP = 0.04, 0.25  # fractions of the height: from row to row of marks, and for all rows of marks at most

# Units of parameters whose names are the package's own.
UNITS = {"cutoff": "rad/sample", "cutoff_hz": "Hz", "sampling_time": "s", "horizon": "steps"}

# Marker and label of points without a cost: above all costs if infeasible, below if there is no lower bound.
MARKS_ABOVE = {"infeasible": ("x", "infeasible (proven)"), "other": ("$?$", "no point that satisfies all constraints")}
BELOW = {"unbounded": ("v", "no lower bound (proven)")}


@dataclass(frozen=True)
class CostLine:
    """Points that differ in the first parameter only."""

    label: str  # the values of the other parameters
    reference: float | None  # the proven cost where the first parameter is None
    points: list[tuple[float, Row]]  # with a number as first parameter, in ascending order

    def costs(self, relative: bool) -> list[float]:
        """Return the cost of each point, on request relative to the reference; NaN without a cost."""
        scale = (self.reference or 1.0) if relative else 1.0
        return [float("nan") if row["cost"] is None else row["cost"] / scale for _, row in self.points]


def sweep_figure(sweep: SweepOutcome) -> Figure:
    """Return the cost over the first parameter whose values are numbers, one line for each choice of the others.

    If None is among its values and every line has a cost there, costs are divided by that cost and show the price of
    the constraint. Hollow points are not proven. Points without a solution are marks above all costs, points without a
    lower bound are marks below them.
    """
    name = next((name for name, values in sweep.grid.items() if _are_numbers(values)), None)
    if name is None:
        got = f"no parameter with numbers in {', '.join(sweep.names)}"
        raise ProblemError("grid", got, "one to draw costs against")
    lines = _lines_along(sweep, name)
    priced = [line for line in lines if any(row["cost"] is not None for _, row in line.points)]
    relative = bool(priced) and all(line.reference is not None and line.reference > 0 for line in priced)
    figure = look.new_figure(HEIGHT)
    ax = figure.add_subplot()
    for i, line in enumerate(lines):
        x, costs = np.array([at for at, _ in line.points]), np.array(line.costs(relative))
        named = line.label and (len(lines) <= MOST_NAMED or i in (0, len(lines) - 1))
        label = look.plain(line.label) if named else None
        color, marker = look.COMPONENTS[i % len(look.COMPONENTS)], look.MARKERS[i % len(look.MARKERS)]
        ax.plot(x, costs, color=color, linewidth=1.5, label=label, marker=marker, markersize=5)
        unproven = np.array([not row["proven"] for _, row in line.points], dtype=bool) & np.isfinite(costs)
        if unproven.any():
            (points,) = ax.plot(x[unproven], costs[unproven], linestyle="none", marker=marker, markersize=5, zorder=4)
            points.set(color=color, markerfacecolor=look.PAPER)
    if _span_decades([x for line in lines for x, _ in line.points]):
        ax.set_xscale("log")
    if _span_decades([cost for line in lines for cost in line.costs(relative) if cost == cost]):
        ax.set_yscale("log")
    if relative:
        ax.axhline(1.0, color=look.MUTED, linewidth=0.9, linestyle=(0, (1.2, 1.2)), zorder=1)
    for kinds, above in ((MARKS_ABOVE, True), (BELOW, False)):
        _draw_marks(ax, lines, kinds, above)
    unit = UNITS.get(name)
    y_label = "cost, relative to that without the constraint" if relative else "cost"
    x_label = f"{name.removesuffix('_hz').replace('_', ' ')}" + (f" [{unit}]" if unit else "")
    hollow = any(row["cost"] is not None and not row["proven"] for row in sweep.rows)
    title = "the price of bandwidth" if name.startswith("cutoff") else f"cost against {name.replace('_', ' ')}"
    look.style_axes(
        ax, f"{sweep.problem}: {title}", x_label, y_label, [look.Note("Hollow: not proven.")] if hollow else []
    )
    if ax.get_legend_handles_labels()[1]:
        figure.legend(fontsize=look.LABEL_SIZE, labelcolor=look.INK, frameon=False, loc="outside right upper")
    return figure


def _are_numbers(values: Sequence[object]) -> bool:
    numbers = [value for value in values if value is not None]
    return bool(numbers) and all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in numbers)


def _lines_along(sweep: SweepOutcome, name: str) -> list[CostLine]:
    references, groups = dict[str, float | None](), dict[str, list[tuple[float, Row]]]()
    for row in sweep.rows:
        label = settings({key: value for key, value in row["parameters"].items() if key != name})
        points, value = groups.setdefault(label, []), row["parameters"][name]
        if isinstance(value, (int, float)):
            points.append((value, row))
        elif row["proven"]:
            references.setdefault(label, row["cost"])
    return [
        CostLine(label, references.get(label), sorted(points, key=itemgetter(0))) for label, points in groups.items()
    ]


def _draw_marks(ax: Axes, lines: Sequence[CostLine], kinds: Mapping[str, tuple[str, str]], above: bool) -> None:
    """Mark points without cost in a strip above or below all costs, in one row for each line that has some."""
    marked = [i for i, line in enumerate(lines) if any(_kind(row) in kinds for _, row in line.points)]
    if not marked:
        return
    pitch = min(PITCH, STRIP / len(marked))
    strip = pitch * (len(marked) + 1)
    axis = ax.yaxis.get_transform()
    low, high = axis.transform(ax.get_ylim())
    room = (high - low) * strip / (1 - strip)  # keeps that fraction of the height free of costs
    ax.set_ylim(*map(float, axis.inverted().transform([low, high + room] if above else [low - room, high])))
    edge = 1 - strip if above else strip
    ax.axhline(edge, color=look.MUTED, linewidth=0.7, zorder=1).set_transform(ax.transAxes)
    text, at, side = ("no solution", 1.0, "top") if above else ("no cheapest", 0.0, "bottom")
    ax.text(0.995, at, text, transform=ax.transAxes, ha="right", va=side, color=look.MUTED, fontsize=look.LABEL_SIZE)
    for kind, (marker, label) in kinds.items():
        drawn = False
        mark: dict[str, object] = {"linestyle": "none", "marker": marker, "markersize": 6}
        for row_number, i in enumerate(marked, 1):
            x = [x for x, row in lines[i].points if _kind(row) == kind]
            height = edge + pitch * row_number if above else edge - pitch * row_number
            (marks,) = ax.plot(x, [height] * len(x), transform=ax.get_xaxis_transform())
            marks.set(color=look.COMPONENTS[i % len(look.COMPONENTS)], **mark)
            drawn = drawn or bool(x)
        if drawn:
            ax.plot([], [])[0].set(color=look.MUTED, label=label, **mark)


def _kind(row: Row) -> str:
    """Return the kind of a point without cost; an empty text for a point with one."""
    if row["cost"] is not None:
        return ""
    return row["status"] if row["proven"] and row["status"] in (*MARKS_ABOVE, *BELOW) else "other"


def _span_decades(values: Sequence[float]) -> bool:
    """Whether positive values are so far apart that their axis is logarithmic."""
    return len(values) > 0 and min(values) > 0 and max(values) > WIDE * min(values)
