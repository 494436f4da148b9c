"""The look of all figures: colours, lines and sizes, titles with notes, legends, and rows of panels.

Colours are those of Okabe and Ito; each kind of trajectory has its own line and marker. Figures need no display.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from math import ceil
from textwrap import wrap
from typing import Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, MaxNLocator
from matplotlib.typing import LineStyleType
from numpy.typing import NDArray

from lin_freq_ocp.base.errors import warn_user

Numbers = NDArray[np.floating]

INK, MUTED, GRID, PAPER, BAND, BOUND = "#1f2328", "#59636e", "#d6dbe1", "#ffffff", "#f4e8c9", "#8c959f"
REFERENCE = "#8250df"
# Classical is not quite black: SVG files omit the default colour, which the page could then not replace.
CLASSICAL, FILTERED, CONSTRAINED = "#010101", "#d55e00", "#0072b2"

# Background of the panels by mode: light enough for the lines; neighbours differ in lightness, or as blue from yellow,
# which all readers see. Each hatch serves as many modes as there are tints.
TINTS = ("#eceff3", "#cfdcf2", "#e6bfd6", "#cdebd6", "#d8cba0", "#b4b8c4")
HATCHES = ("", "////", "....", "xxxx")

# Colours that the page replaces by its variables, so that figures follow its light and dark scheme.
THEMED = {INK: "ink", MUTED: "muted", GRID: "grid", PAPER: "paper", BAND: "band", BOUND: "bound"}
THEMED |= {REFERENCE: "reference", CLASSICAL: "classical", FILTERED: "filtered", CONSTRAINED: "constrained"}
THEMED_TINTS = {tint: f"mode-{i}" for i, tint in enumerate(TINTS)}  # only on pages of problems with modes

# Components of one signal, soft bounds, and references in the cost.
COMPONENTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
MARKERS = ("o", "s", "^", "D", "v", "P")
SOFT: LineStyleType = (0, (4, 2.5))
REFERENCE_LINE: LineStyleType = (0, (6, 1.5, 1.2, 1.5))
LEVEL_LINE: LineStyleType = (0, (1, 2))

WITHOUT_WINDOWS = {"agg", "cairo", "pdf", "pgf", "ps", "svg", "template"}  # backends that only write files
NOTEBOOK_DPI = 80
WIDTH, ROW_HEIGHT = 11.0, 3.5  # inches: width of a figure, height of a row of panels
MOST_DRAWN = 1000  # for a longer signal, the smallest and largest value of every group of neighbours are drawn
TITLE_SIZE, NOTE_SIZE, LABEL_SIZE, TICK_SIZE = 11, 9, 9.5, 9
LEGEND_CHARACTERS, HANDLE_CHARACTERS = 130, 8  # width of a legend above the panels, and of a line or marker in it
NOTE_CHARACTERS = 70  # width of a note under the title of a panel in half of a figure
AXIS_MARGIN = 0.06  # empty fraction at either side of an axis


@dataclass(frozen=True)
class Style:
    """Colour, line and marker of a kind of trajectory."""

    color: str
    line: LineStyleType
    marker: str
    width: float
    order: int

    def of_line(self, part: float = 1.0) -> dict[str, object]:
        """Return the properties of its line for ``draw_line``, with a part of its width."""
        return {"color": self.color, "linestyle": self.line, "linewidth": part * self.width, "zorder": self.order}


STYLES = {
    "classical": Style(CLASSICAL, (0, (1.2, 1.2)), "^", 1.2, 3),
    "filtered": Style(FILTERED, (0, (5, 1.8)), "s", 1.4, 4),
    "constrained": Style(CONSTRAINED, "solid", "o", 1.8, 5),
}


@dataclass(frozen=True)
class Note:
    """A line under the title of a panel."""

    text: str
    color: str = MUTED


def plain(text: str) -> str:
    """Return text with its dollar signs escaped, so that Matplotlib sees no formula."""
    return text.replace("$", r"\$")


def thin_out(x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
    """Return the points of y over x to draw: for long signals, the extremes of every group of neighbours."""
    if len(y) <= MOST_DRAWN:
        return x, y
    starts = np.linspace(0, len(y), MOST_DRAWN // 2, endpoint=False, dtype=int)
    groups = np.split(y, starts[1:])
    extremes = [(at + group.argmin(), at + group.argmax()) for at, group in zip(starts, groups, strict=True)]
    drawn = np.unique([0, len(y) - 1, *np.ravel(extremes)])
    return x[drawn], y[drawn]


def draw_line(ax: Axes, x: Numbers, y: Numbers, **properties: object) -> None:
    """Draw y over x, thinned out if it is long, as a line with these properties."""
    (line,) = ax.plot(*thin_out(x, y))
    line.set(**properties)


def legend_line(label: str, **properties: object) -> Line2D:
    """Return a line of a legend with its label."""
    line = Line2D([], [], linewidth=1.2, label=label)
    line.set(**properties)
    return line


class ShownFigure(Figure):
    """A figure that notebooks show and that opens a window on request; only then does pyplot manage it."""

    def _repr_png_(self) -> bytes:
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=NOTEBOOK_DPI)
        return stream.getvalue()

    def show(self, warn: bool = True) -> None:
        """Open a window with the figure, and wait until it is closed, as ``matplotlib.pyplot.show`` does.

        Without a display, it only warns: use ``savefig``.
        """
        from matplotlib import pyplot

        if pyplot.get_backend().lower() in WITHOUT_WINDOWS:
            if warn:
                warn_user(f"{pyplot.get_backend()} shows no windows: use savefig(path).", UserWarning)
            return
        if self.canvas.manager is None:
            pyplot.figure(FigureClass=cast(Any, lambda *_, **__: self))
        pyplot.show()


def new_figure(height: float) -> Figure:
    """Return an empty figure whose layout makes room for its labels."""
    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1, hspace=0.04, wspace=0.03)
    return ShownFigure(figsize=(WIDTH, height), layout=layout, facecolor=PAPER)


def panel_grid(count: int, height: float, extra: float = 0.0, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels, in rows of this height, with ``extra`` inches for legends."""
    columns = min(count, columns)
    rows = ceil(count / columns)
    figure = new_figure(height * rows + extra)
    return figure, [figure.add_subplot(rows, columns, i + 1) for i in range(count)]


def legend_rows(handles: Sequence[Artist]) -> int:
    """Return the number of rows of a legend."""
    length = sum(len(str(handle.get_label())) + HANDLE_CHARACTERS for handle in handles)
    return ceil(length / LEGEND_CHARACTERS)


def legend_above(figure: Figure, handles: Sequence[Artist], handlelength: float | None = None) -> None:
    """Draw a legend above the panels, in as many rows as it needs."""
    figure.legend(
        handles=list(handles),
        loc="outside upper left",
        ncols=ceil(len(handles) / legend_rows(handles)),
        frameon=False,
        fontsize=LABEL_SIZE + 0.5,
        labelcolor=INK,
        handlelength=handlelength,
        columnspacing=1.6,
    )


def style_axes(ax: Axes, title: str, x_label: str, y_label: str, notes: Sequence[Note] = ()) -> None:
    """Give a panel its title, notes, labels and grid."""
    lines = [(line, note.color) for note in notes for line in wrap(note.text, NOTE_CHARACTERS)]
    pitch = NOTE_SIZE * 1.35
    ax.set_title(
        plain(title),
        loc="left",
        fontsize=TITLE_SIZE,
        fontweight="bold",
        color=INK,
        y=1.0,  # not computed again at every draw
        pad=6 + pitch * len(lines) + (3 if lines else 0),
    )
    for i, (line, color) in enumerate(lines):
        text = ax.annotate(
            plain(line),
            (0, 1),
            xytext=(0, 6 + pitch * (len(lines) - 1 - i)),
            xycoords="axes fraction",
            textcoords="offset points",
            fontsize=NOTE_SIZE,
            color=color,
            va="bottom",
            annotation_clip=False,
        )
        text.set_in_layout(False)  # the title makes room for it
    ax.set_xlabel(plain(x_label), fontsize=LABEL_SIZE, color=INK)
    ax.set_ylabel(plain(y_label), fontsize=LABEL_SIZE, color=INK)
    ax.set_facecolor(PAPER)
    ax.grid(True, color=GRID, linewidth=0.6)
    ax.set_axisbelow(True)
    for axis in (ax.xaxis, ax.yaxis):
        if axis.get_scale() == "linear":  # ticks without an offset text, which would cover the title
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.10g}".replace("-", "\N{MINUS SIGN}")))
    if ax.get_xscale() == "linear":
        ax.xaxis.set_major_locator(MaxNLocator(7, steps=[1, 2, 2.5, 5, 10]))
    ax.tick_params(which="both", labelsize=TICK_SIZE, colors=INK, width=0.7)
    ax.tick_params(length=3)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(MUTED)
        ax.spines[side].set_linewidth(0.8)
