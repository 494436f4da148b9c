"""Time against horizon on logarithmic axes: a panel per family, a line per contender."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np
from benchmark_cases import FAMILIES
from benchmark_contenders import CONTENDERS
from benchmark_measures import Row
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from lin_freq_ocp.pages.figures.plot_data import (
    CLASSICAL,
    COMPONENTS,
    MARKERS,
    ROW_HEIGHT,
    Note,
    new_figure,
    style_axes,
)

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
    for (T, seconds, name, color), shift in zip(ends, spread(points), strict=True):
        ax.annotate(name, (T, seconds), xytext=(8, shift), textcoords="offset points", color=color, va="center")


def spread(heights: np.ndarray) -> np.ndarray:
    """Return shifts after which no two labels are closer than LABEL_STEP."""
    order, shifted = np.argsort(heights), heights.copy()
    for below, above in pairwise(order):
        shifted[above] = max(shifted[above], shifted[below] + LABEL_STEP)
    return shifted - heights
