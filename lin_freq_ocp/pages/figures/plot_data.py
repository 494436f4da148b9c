"""What the panels of all figures share: style, and the problem with its trajectories, units and ranges of axes.

Colours are those of Okabe and Ito; each kind of trajectory has its own line and marker. Figures need no display.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from itertools import pairwise
from math import ceil
from textwrap import wrap
from typing import Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, MaxNLocator
from matplotlib.typing import LineStyleType
from numpy.typing import NDArray

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.phrases import listed
from lin_freq_ocp.comparison.trajectories import MeasuredTrajectory, Signal, controls_of, outputs_of, states_of
from lin_freq_ocp.pages.units import Scale, frequency_scale, quantity, rough, time_scale
from lin_freq_ocp.problem.ocp import OptimalControlProblem
from lin_freq_ocp.problem.trajectory import Trajectory

Numbers = NDArray[np.floating]

INK, MUTED, GRID, PAPER, BAND, BOUND = "#1f2328", "#59636e", "#d6dbe1", "#ffffff", "#f4e8c9", "#8c959f"
REFERENCE = "#8250df"
# Classical is not quite black: SVG files leave out the default, and the page could then not replace it.
CLASSICAL, FILTERED, CONSTRAINED = "#010101", "#d55e00", "#0072b2"

# Behind the panels, by the number of the mode: light enough for the lines; neighbours differ in lightness or in blue
# against yellow, which all readers see. Each hatch serves as many modes as there are tints.
TINTS = ("#eceff3", "#cfdcf2", "#e6bfd6", "#cdebd6", "#d8cba0", "#b4b8c4")
HATCHES = ("", "////", "....", "xxxx")

# Colours that the page replaces by its own variables, so that figures follow its light and dark scheme.
THEMED = {INK: "ink", MUTED: "muted", GRID: "grid", PAPER: "paper", BAND: "band", BOUND: "bound"}
THEMED |= {REFERENCE: "reference", CLASSICAL: "classical", FILTERED: "filtered", CONSTRAINED: "constrained"}
THEMED_TINTS = {tint: f"mode-{i}" for i, tint in enumerate(TINTS)}  # only on pages of problems with modes

# Of the components of one signal, of soft bounds, and of references in the cost.
COMPONENTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
MARKERS = ("o", "s", "^", "D", "v", "P")
SOFT: LineStyleType = (0, (4, 2.5))
REFERENCE_LINE: LineStyleType = (0, (6, 1.5, 1.2, 1.5))

WITHOUT_WINDOWS = {"agg", "cairo", "pdf", "pgf", "ps", "svg", "template"}  # backends that only write files
NOTEBOOK_DPI = 80
WIDTH, ROW_HEIGHT = 11.0, 3.5  # inches: width of a figure, height of a row of panels
MOST_DRAWN = 1000  # of a longer signal, the smallest and largest value of every group of neighbours is drawn
TITLE_SIZE, NOTE_SIZE, LABEL_SIZE, TICK_SIZE = 11, 9, 9.5, 9
LEGEND_CHARACTERS, HANDLE_CHARACTERS = 130, 8  # width of a legend above the panels, and of a line or marker in it
NOTE_CHARACTERS = 70  # width of a note under the title of a panel in half of a figure

OVERLAY_REACH = 0.6  # an overlay may widen an axis by this fraction of what the others span; beyond, it is cut off
BOUND_REACH = 0.6  # likewise for a bound far from all trajectories
AXIS_MARGIN = 0.06  # empty fraction at either side of an axis


@dataclass(frozen=True)
class Style:
    """Colour, line and marker of a kind of trajectory."""

    color: str
    line: LineStyleType
    marker: str
    width: float
    order: int


STYLES = {
    "classical": Style(CLASSICAL, (0, (1.2, 1.2)), "^", 1.2, 3),
    "filtered": Style(FILTERED, (0, (5, 1.8)), "s", 1.4, 4),
    "constrained": Style(CONSTRAINED, "solid", "o", 1.8, 5),
}


@dataclass(frozen=True, eq=False)
class Trace:
    """One trajectory as a figure shows it."""

    label: str
    measured: MeasuredTrajectory
    style: Style
    detail: str = ""  # beside the label in the legend
    overlay: bool = False  # whether the axes may cut it off, so that a filtered trajectory leaves room for the others

    @property
    def trajectory(self) -> Trajectory:
        """Return the trajectory."""
        return self.measured.trajectory

    def of(self, signal: Signal) -> Array:
        """Return the values of a signal over time."""
        return signal.of(self.trajectory)


@dataclass(frozen=True)
class Note:
    """A line under the title of a panel."""

    text: str
    color: str = MUTED


def plain(text: str) -> str:
    """Return text with its dollar signs escaped: it is no formula."""
    return text.replace("$", r"\$")


def thin_out(x: Numbers, y: Numbers) -> tuple[Numbers, Numbers]:
    """Return what is drawn of y over x: for long signals, the extremes of every group of neighbours."""
    if len(y) <= MOST_DRAWN:
        return x, y
    starts = np.linspace(0, len(y), MOST_DRAWN // 2, endpoint=False, dtype=int)
    groups = np.split(y, starts[1:])
    extremes = [(at + group.argmin(), at + group.argmax()) for at, group in zip(starts, groups, strict=True)]
    kept = np.unique([0, len(y) - 1, *np.ravel(extremes)])
    return x[kept], y[kept]


class ShownFigure(Figure):
    """A figure that notebooks show, and that opens a window on request; pyplot manages it only then."""

    def _repr_png_(self) -> bytes:
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=NOTEBOOK_DPI)
        return stream.getvalue()

    def show(self, warn: bool = True) -> None:
        """Open a window with the figure, and wait until it is closed, as ``matplotlib.pyplot.show`` does.

        Where there is no display, a warning says so, and nothing is shown: use ``savefig``.
        """
        from matplotlib import pyplot

        if pyplot.get_backend().lower() in WITHOUT_WINDOWS:
            if warn:
                warnings.warn(f"{pyplot.get_backend()} shows no windows: use savefig(path).", stacklevel=2)
            return
        if self.canvas.manager is None:
            pyplot.figure(FigureClass=cast(Any, lambda *_, **__: self))
        pyplot.show()


def new_figure(height: float) -> Figure:
    """Return an empty figure that makes room for its labels itself."""
    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.1, hspace=0.04, wspace=0.03)
    return ShownFigure(figsize=(WIDTH, height), layout=layout, facecolor=PAPER)


def legend_rows(handles: Sequence[Artist]) -> int:
    """Return how many rows the explanation of lines and markers takes."""
    length = sum(len(str(one.get_label())) + HANDLE_CHARACTERS for one in handles)
    return ceil(length / LEGEND_CHARACTERS)


def legend_above(figure: Figure, handles: Sequence[Artist], handlelength: float | None = None) -> None:
    """Explain lines and markers above the panels, in one row, or more where they are many."""
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
        y=1.0,  # not looked for anew at every draw
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
        if axis.get_scale() == "linear":  # whole numbers on the ticks: an offset apart would lie on the title
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.10g}".replace("-", "\N{MINUS SIGN}")))
    if ax.get_xscale() == "linear":
        ax.xaxis.set_major_locator(MaxNLocator(7, steps=[1, 2, 2.5, 5, 10]))
    ax.tick_params(labelsize=TICK_SIZE, colors=INK, length=3, width=0.7)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(MUTED)
        ax.spines[side].set_linewidth(0.8)


@dataclass(frozen=True)
class Span:
    """A mode that holds over the steps start .. end - 1, from time ``start`` to time ``end``."""

    start: int
    end: int
    mode: int


def spans(sequence: Indices) -> tuple[Span, ...]:
    """Return the runs of equal modes of a sequence."""
    edges = [0, *(int(t) + 1 for t in np.flatnonzero(np.diff(sequence))), len(sequence)]
    return tuple(Span(start, end, int(sequence[start])) for start, end in pairwise(edges))


@dataclass(frozen=True)
class View:
    """The range of an axis, and whether an overlay leaves it."""

    low: float
    high: float
    outside: bool


@dataclass(frozen=True, eq=False)
class PlotData:
    """A problem and the trajectories to show, at least one of them not an overlay."""

    problem: OptimalControlProblem
    traces: tuple[Trace, ...]

    @cached_property
    def time(self) -> Scale:
        """Return the scale of the time axes."""
        return time_scale(self.problem)

    @cached_property
    def frequency(self) -> Scale:
        """Return the scale of the frequency axes."""
        return frequency_scale(self.problem)

    @property
    def main(self) -> Trace:
        """Return the trajectory that the figure is about: the last that is not an overlay."""
        return [trace for trace in self.traces if not trace.overlay][-1]

    @cached_property
    def modes(self) -> tuple[Span, ...]:
        """Return the modes of the main trajectory; nothing with fewer than two modes."""
        return () if self.main.measured.modes is None else spans(self.main.measured.modes)

    @cached_property
    def controls(self) -> list[Signal]:
        """Return all controls."""
        return controls_of(self.problem)

    @cached_property
    def states(self) -> list[Signal]:
        """Return all states."""
        return states_of(self.problem)

    @cached_property
    def outputs(self) -> list[Signal]:
        """Return the outputs whose spectrum is constrained."""
        return outputs_of(self.problem)

    def showing(self, signal: Signal) -> tuple[Trace, ...]:
        """Return the traces that have meaningful values of this signal."""
        return tuple(trace for trace in self.traces if trace.measured.meaningful or not signal.is_state)

    def view(self, signal: Signal) -> View:
        """Return the range of a signal's axis."""
        shown = self.showing(signal)
        return view(
            [trace.of(signal) for trace in shown if not trace.overlay],
            [trace.of(signal) for trace in shown if trace.overlay],
            np.concatenate([*signal.bounds, *(line.values for line in signal.row_bounds)]),
            [line.values[np.isfinite(line.values)] for line in signal.references],
        )

    def notes(self, signals: Sequence[Signal]) -> list[Note]:
        """Return which trajectories are missing from a panel of these states, and which leave it."""
        outside = any(self.view(signal).outside for signal in signals)
        notes = list[Note]()
        for trace in self.traces:
            measured, text = trace.measured, ""
            if measured.stopped:
                text = f"not replayed; its {measured.why_stopped}"
            elif not measured.meaningful:
                text = f"not replayed; rounding errors would grow {rough(measured.measures.amplification)}-fold"
            elif trace.overlay and outside:
                text = f"leaves the picture; {_end_text(trace, signals)}"
            if text:
                notes.append(Note(f"{trace.label}: {text}", trace.style.color))
        return notes


def _end_text(trace: Trace, signals: Sequence[Signal]) -> str:
    """Return how far from the terminal set a trajectory ends, or how far it goes where the end is free."""
    end = trace.measured.end
    bounded = [] if end is None else [one for one in signals if end.bounded[one.index]]
    if end is not None and bounded:
        return f"ends {listed([quantity(float(end.values[one.index]), one.name) for one in bounded])} away"
    return f"goes as far as {listed([quantity(trace.measured.largest(one), one.name) for one in signals])}"


def view(mains: Sequence[Array], overlays: Sequence[Array], bounds: Array, references: Sequence[Array] = ()) -> View:
    """Return a range that shows all mains and references, and overlays and bounds as far as they are near."""
    mains = [*mains, *references]
    low, high = min(float(main.min()) for main in mains), max(float(main.max()) for main in mains)
    span = high - low or max(abs(high), 1.0)
    reach = BOUND_REACH * span
    near = [float(b) for b in np.unique(bounds[np.isfinite(bounds)]) if low - reach <= b <= high + reach]
    low, high = min([low, *near]), max([high, *near])
    slack, outside = OVERLAY_REACH * span, False
    for overlay in overlays:
        if overlay.min() < low - slack or overlay.max() > high + slack:
            outside = True
        else:
            low, high = min(low, float(overlay.min())), max(high, float(overlay.max()))
    margin = AXIS_MARGIN * (high - low or span)
    return View(low - margin, high + margin, outside)
