"""Pictures of modes: tinted panels, one strip for each trajectory, and the adjoint with its kinks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FuncFormatter

from lin_freq_ocp.base.arrays import Array, Indices
from lin_freq_ocp.base.phrases import LARGE, SMALL, number, split_unit
from lin_freq_ocp.certificate.hybrid.smooth import Kink
from lin_freq_ocp.certificate.verdict import Certificate
from lin_freq_ocp.comparison.compare import ComparisonOutcome
from lin_freq_ocp.comparison.trajectories import NO_MODE
from lin_freq_ocp.pages.figures import look
from lin_freq_ocp.pages.figures.plot_data import PlotData, Span, spans
from lin_freq_ocp.pages.report.proof import ETA

CHARACTER = 0.52 * look.NOTE_SIZE / 72  # inches: about the width of a character of a note
# Inches: the largest width of a legend, and about that of one of its characters.
LEGEND_WIDTH, LEGEND_CHARACTER = look.WIDTH - 0.3, 1.12 * CHARACTER
LONGEST_NAME = 32  # characters of a mode's name in a picture
STRIP_HEIGHT = 0.3  # inches
BAR = 0.02  # width of the bar of an interval, relative to the time axis
# The marker of the value that the adjoint equation requires.
REQUIRED: dict[str, object] = {
    "color": look.INK,
    "markersize": 6.5,
    "markerfacecolor": look.PAPER,
    "markeredgewidth": 1.4,
}
MARKED = 60  # up to so many values, each has a marker


def shade_modes(ax: Axes, data: PlotData) -> None:
    """Tint every step of a panel over time by the main trajectory's mode."""
    for span in data.modes:
        if span.mode != NO_MODE:
            start, end = data.time.factor * span.start, data.time.factor * span.end
            _paint(ax.axvspan(start, end, zorder=0), span.mode)


@dataclass(frozen=True)
class ModeLegend:
    """The tints of modes with their names, and the trajectory that they belong to; empty without modes."""

    modes: tuple[int, ...]
    names: tuple[str, ...]
    whose: str

    def _layout(self) -> tuple[int, bool]:
        """Return the number of columns, and whether all names and ``whose`` fit in one row."""
        width = LEGEND_CHARACTER * max(map(len, self.names)) + 0.55
        if len(self.modes) * width + len(self.whose) * LEGEND_CHARACTER <= LEGEND_WIDTH:
            return len(self.modes), True
        return max(1, int(LEGEND_WIDTH / width)), False

    @property
    def height(self) -> float:
        """Return its height in inches."""
        if not self.modes:
            return 0.0
        columns, in_one_row = self._layout()
        return 0.24 * (1 if in_one_row else 1 + ceil(len(self.modes) / columns)) + 0.08

    def draw(self, figure: Figure) -> None:
        """Draw it below the panels."""
        if not self.modes:
            return
        columns, in_one_row = self._layout()
        legend = figure.legend(
            handles=[_paint(Patch(), mode) for mode in self.modes],
            labels=["mode"] * len(self.modes),
            title=None if in_one_row else look.plain(self.whose),
            title_fontsize=look.LABEL_SIZE + 0.5,
            alignment="left",
            loc="outside lower left",
            ncols=columns,
            frameon=False,
            fontsize=look.LABEL_SIZE + 0.5,
            labelcolor=look.INK,
            handlelength=1.8,
            columnspacing=1.6,
        )
        legend.get_title().set_color(look.INK)
        labels = list(self.names)
        labels[-1] += f"   ({self.whose})" if in_one_row else ""
        for text, label in zip(legend.get_texts(), labels, strict=True):
            text.set_text(label)  # a label that begins with an underscore would be left out


def mode_legend(data: PlotData) -> ModeLegend:
    """Return the legend of the tints of the panels."""
    whose = "mode" if len(data.traces) == 1 else f"mode of the {data.main.label} trajectory"
    return _legend_of(data, {span.mode for span in data.modes}, whose)


def _legend_of(data: PlotData, modes: set[int], whose: str) -> ModeLegend:
    used, names = sorted(modes - {NO_MODE}), _short_names(data.problem.mode_names)
    return ModeLegend(tuple(used), tuple(names[mode] for mode in used), whose)


def strip_rows(comparison: ComparisonOutcome) -> list[tuple[str, Indices | None]]:
    """Return label and mode sequence of every trajectory of a comparison; None without a simulation."""
    return [(trajectory.label, trajectory.modes) for trajectory in comparison.trajectories]


def strips_figure(data: PlotData, rows: Sequence[tuple[str, Indices | None]]) -> Figure:
    """Return one strip for each trajectory: label and mode sequence, None if its states mean nothing."""
    names, factor, horizon = _short_names(data.problem.mode_names), data.time.factor, data.problem.horizon
    drawn = [(row, span) for row, (_, modes) in enumerate(rows) if modes is not None for span in spans(modes)]
    unnamed = any(span.mode != NO_MODE and not _has_room(span, names[span.mode], horizon) for _, span in drawn)
    legend = _legend_of(data, {span.mode for _, span in drawn} if unnamed else set(), "mode")
    figure = look.new_figure(STRIP_HEIGHT * 1.25 * len(rows) + 0.75 + legend.height)
    ax = figure.add_subplot()
    for row, span in drawn:  # a box, with the name of its mode if there is room
        outside = span.mode == NO_MODE
        box = Rectangle((factor * span.start, row - 0.4), factor * (span.end - span.start), 0.8)
        if outside:
            box.set(facecolor=look.PAPER, edgecolor=look.GRID, linestyle=(0, (3, 2)))
        else:
            _paint(box, span.mode)
        ax.add_patch(box)
        ax.vlines(factor * span.end, row - 0.4, row + 0.4, color=look.PAPER, linewidth=1.2)
        name = "outside" if outside else names[span.mode]
        if _has_room(span, name, horizon):
            _write(ax, 0.5 * factor * (span.start + span.end), row, name, look.MUTED if outside else look.INK)
    for row, (_, modes) in enumerate(rows):
        if modes is None:
            _write(ax, 0.5 * factor * horizon, row, "not simulated", look.MUTED)
    look.style_axes(ax, "Modes", data.time.label, "")
    ax.grid(False)
    ax.set_xlim(-0.008 * factor * horizon, 1.008 * factor * horizon)
    ax.set_ylim(len(rows) - 0.35, -0.65)
    ax.set_yticks(range(len(rows)), [look.plain(label) for label, _ in rows], fontsize=look.LABEL_SIZE, color=look.INK)
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    legend.draw(figure)
    return figure


def adjoint_figure(data: PlotData, eta: Array, kinks: Sequence[Kink], least: float) -> Figure:
    """Return each component of eta_t, (T, n), over time, with its possible derivatives at kinks.

    Values smaller than ``least`` are zero within the tolerance of the adjoint equation.
    """
    names, height = data.problem.state_names, 0.5 + mode_legend(data).height
    figure, panels = look.panel_grid(len(names), 0.85 * look.ROW_HEIGHT, height, columns=2)
    line: dict[str, object] = {"color": look.COMPONENTS[0], "linewidth": 1.5, "markersize": 3.2}
    for i, (ax, name) in enumerate(zip(panels, names, strict=True)):
        shade_modes(ax, data)
        times = data.time.factor * np.arange(len(eta))
        look.draw_line(ax, times, eta[:, i], marker="o" if len(eta) <= MARKED else "", zorder=4, **line)
        end = data.time.factor * data.problem.horizon
        for kink in kinks:  # the interval as a bar with caps, and the value that the adjoint equation requires
            at, half = data.time.factor * kink.time, 0.5 * BAR * end
            low, high = float(kink.lower[i]), float(kink.upper[i])
            bar = Rectangle((at - half, low), 2 * half, high - low)
            bar.set(facecolor=look.FILTERED, alpha=0.28, linewidth=0, zorder=5)
            ax.add_patch(bar)
            ax.hlines([low, high], at - 1.5 * half, at + 1.5 * half, color=look.FILTERED, linewidth=1.8, zorder=6)
            (point,) = ax.plot(at, kink.required[i], "D", zorder=8)
            point.set(**REQUIRED)
        ax.set_xlim(-BAR * end, (1 + BAR) * end)
        shown, notes = np.concatenate([eta[:, i], *(kink.of(i) for kink in kinks)]), list[look.Note]()
        low, high = float(shown.min()), float(shown.max())
        if max(-low, high) <= least:  # zero up to rounding, which would fill the axis
            ax.set_ylim(-1, 1)
            notes = [look.Note("zero, within the tolerance of the adjoint equation")]
        else:
            margin = 1.5 * look.AXIS_MARGIN * (high - low if high - low > least else max(-low, high))
            ax.set_ylim(low - margin, high + margin)
            if not SMALL <= max(-low, high) < LARGE:  # a common power of ten would cover the title
                ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: number(value, 3)))
        short, unit = split_unit(name)
        look.style_axes(ax, f"Adjoint of {short}", data.time.label, f"{ETA} [cost per {unit or 'unit'}]", notes)
    handles: list[Artist] = [look.legend_line(f"adjoint {ETA}", marker="o", **line)]
    if kinks:
        text = f"$D_x$ <{ETA}, f> over all derivatives at a kink"
        handles.append(Patch(facecolor=look.FILTERED, alpha=0.28, label=text))
        text = "its value that the adjoint equation requires"
        handles.append(look.legend_line(text, linestyle="none", marker="D", **REQUIRED))
    look.legend_above(figure, handles)
    mode_legend(data).draw(figure)
    return figure


def smallest_adjoint(certificate: Certificate) -> float:
    """Return the size below which the judge cannot tell eta from zero."""
    adjoint = [condition for condition in certificate.conditions if condition.name == "adjoint equation"]
    return max((condition.scale * condition.tolerance for condition in adjoint), default=0.0)


def _has_room(span: Span, name: str, horizon: int) -> bool:
    return 0.82 * look.WIDTH * (span.end - span.start) / horizon > CHARACTER * (len(name) + 1)


def _write(ax: Axes, x: float, row: int, text: str, color: str) -> None:
    ax.text(x, row, text, ha="center", va="center_baseline", fontsize=look.TICK_SIZE, color=color)


def _paint(patch: Patch, mode: int) -> Patch:
    """Give a patch the colour and hatch of a mode."""
    hatch = look.HATCHES[mode // len(look.TINTS) % len(look.HATCHES)]
    patch.set(facecolor=look.TINTS[mode % len(look.TINTS)], hatch=hatch, edgecolor=look.PAPER, linewidth=0)
    return patch


def _short_names(names: Sequence[str]) -> list[str]:
    """Return names cut to the length that pictures show, with escaped dollar signs."""
    end = "\N{HORIZONTAL ELLIPSIS}"
    return [look.plain(name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + end) for name in names]
