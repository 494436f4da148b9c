"""Modes in pictures: tints behind the panels, one strip for each trajectory, and the adjoint with its kinks."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from lin_freq_ocp.comparison.compare import Comparison
from lin_freq_ocp.problem.arrays import Array, Indices
from lin_freq_ocp.report.entries import CLASSICAL, CONSTRAINED, OPTIMAL, entries
from lin_freq_ocp.report.modes import NO_MODE, Kink, Span, mode_names, mode_sequence, sequence_of, spans
from lin_freq_ocp.report.numbers import split_unit
from lin_freq_ocp.report.scene import MARGIN, Scene
from lin_freq_ocp.report.style import (
    COMPONENTS,
    FILTERED,
    GRID,
    HATCHES,
    INK,
    LABEL_SIZE,
    MUTED,
    NOTE_SIZE,
    PAPER,
    ROW_HEIGHT,
    TICK_SIZE,
    TINTS,
    WIDTH,
    dress,
    new_figure,
    plain,
    thinned,
)

CHARACTER = 0.52 * NOTE_SIZE / 72
"""Inches: about the width of a character of a note."""

LONGEST_NAME = 32
"""Characters of a mode's name in a picture."""

STRIP_HEIGHT = 0.3
"""Inches: height of a strip, and the room between strips."""

BAR = 0.09
"""Width of the bar of an interval in steps, or less where there are many."""


def shade_modes(ax: Axes, scene: Scene) -> None:
    """Put the tint of the host's mode behind every step of a panel in time."""
    for span in scene.modes:
        if span.mode != NO_MODE:
            start, end = scene.time.factor * span.start, scene.time.factor * span.end
            ax.axvspan(start, end, **_look(span.mode), zorder=0)


def mode_legend(figure: Figure, scene: Scene) -> None:
    """Explain the tints below the panels, where there are any."""
    used = sorted({span.mode for span in scene.modes} - {NO_MODE})
    if not used:
        return
    names = _short_names(mode_names(scene.problem))
    opening = "mode" if len(scene.traces) == 1 else f"mode of the {scene.host.label} trajectory"
    labels = [f"{opening}:", *(names[mode] for mode in used)]
    legend = figure.legend(
        handles=[Patch(alpha=0), *(Patch(**_look(mode)) for mode in used)],
        labels=["mode"] * len(labels),
        loc="outside lower left",
        ncols=_columns(labels),
        frameon=False,
        fontsize=LABEL_SIZE + 0.5,
        labelcolor=INK,
        handlelength=1.8,
        columnspacing=1.6,
    )
    for text, label in zip(legend.get_texts(), labels, strict=True):
        text.set_text(label)  # a label that begins with an underscore would be left out


def legend_height(scene: Scene) -> float:
    """Return the inches that the legend of the tints takes."""
    used = {span.mode for span in scene.modes} - {NO_MODE}
    if not used:
        return 0.0
    names = _short_names(mode_names(scene.problem))
    return 0.24 * ceil((len(used) + 1) / _columns([names[mode] for mode in used])) + 0.08


def strip_rows(comparison: Comparison) -> list[tuple[str, Indices | None]]:
    """Return label and mode sequence of every trajectory of a comparison; None where its states mean nothing."""
    rows = list[tuple[str, Indices | None]]()
    for entry in entries(comparison):
        if entry.trajectory is not None:
            rows.append((entry.label, mode_sequence(entry.problem, entry.trajectory) if entry.replayed else None))
    solved = {CLASSICAL: comparison.classical, CONSTRAINED: comparison.constrained, OPTIMAL: comparison.constrained}
    return [(label, sequence_of(solved[label]) if label in solved else modes) for label, modes in rows]


def strips_figure(scene: Scene, rows: Sequence[tuple[str, Indices | None]]) -> Figure:
    """Return one strip for each trajectory: label and mode sequence, or None where its states mean nothing."""
    figure = new_figure(STRIP_HEIGHT * 1.25 * len(rows) + 0.75)
    ax = figure.add_subplot()
    names, factor, horizon = _short_names(mode_names(scene.problem)), scene.time.factor, scene.problem.horizon
    for row, (_, sequence) in enumerate(rows):
        for span in () if sequence is None else spans(sequence):
            _draw_strip(ax, span, row, factor, horizon, names)
        if sequence is None:
            ax.text(0.5 * factor * horizon, row, "not replayed", **_word(MUTED))
    dress(ax, "Modes", scene.time.label, "")
    ax.grid(False)
    ax.set_xlim(-0.008 * factor * horizon, 1.008 * factor * horizon)
    ax.set_ylim(len(rows) - 0.35, -0.65)
    ax.set_yticks(range(len(rows)), [plain(label) for label, _ in rows], fontsize=LABEL_SIZE, color=INK)
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    return figure


def adjoint_figure(scene: Scene, eta: Array, found: Sequence[Kink]) -> Figure:
    """Return each component of eta_t, (T, n), in time, with what the modes make of it where they meet."""
    names = scene.problem.state_names
    columns = min(len(names), 2)
    rows = ceil(len(names) / columns)
    figure = new_figure(0.85 * ROW_HEIGHT * rows + 0.5 + legend_height(scene))
    for i, name in enumerate(names):
        ax = figure.add_subplot(rows, columns, i + 1)
        shade_modes(ax, scene)
        times = scene.time.factor * np.arange(len(eta))
        marker = {"marker": "o", "markersize": 3.2} if len(eta) <= 60 else {}
        ax.plot(*thinned(times, eta[:, i]), color=COMPONENTS[0], linewidth=1.5, zorder=4, **marker)
        for kink in found:
            _draw_kink(ax, scene, kink, i)
        shown = np.concatenate([eta[:, i], *([one.lower[i], one.upper[i], one.required[i]] for one in found)])
        low, high = float(shown.min()), float(shown.max())
        margin = 1.5 * MARGIN * (high - low or abs(high) or 1.0)
        ax.set_ylim(low - margin, high + margin)
        ax.set_xlim(np.array([-0.015, 1.015]) * scene.time.factor * scene.problem.horizon)
        short, unit = split_unit(name)
        dress(ax, f"Adjoint of {short}", scene.time.label, f"\N{GREEK SMALL LETTER ETA} [cost per {unit or 'unit'}]")
    _adjoint_legend(figure, bool(found))
    mode_legend(figure, scene)
    return figure


def _draw_kink(ax: Axes, scene: Scene, kink: Kink, i: int) -> None:
    """Draw the interval as a bar with caps, and beside it what the adjoint equation requires."""
    factor, horizon = scene.time.factor, scene.problem.horizon
    at, half = factor * kink.time, 0.5 * factor * _bar_width(horizon)
    low, high = float(kink.lower[i]), float(kink.upper[i])
    bar = Rectangle((at - half, low), 2 * half, high - low)
    bar.set(facecolor=FILTERED, alpha=0.28, linewidth=0, zorder=5)
    ax.add_patch(bar)
    ax.hlines([low, high], at - 1.6 * half, at + 1.6 * half, color=FILTERED, linewidth=1.8, zorder=6)
    ax.plot(at, kink.required[i], "D", **_required(), zorder=8)


def _bar_width(horizon: int) -> float:
    return max(BAR, 0.012 * horizon)


def _required() -> dict[str, Any]:
    return {"color": INK, "markersize": 6.5, "markerfacecolor": PAPER, "markeredgewidth": 1.4}


def _adjoint_legend(figure: Figure, with_kinks: bool) -> None:
    eta = "\N{GREEK SMALL LETTER ETA}"
    handles: list[Artist] = [Line2D([], [], color=COMPONENTS[0], linewidth=1.5, marker="o", markersize=3.2, label=eta)]
    if with_kinks:
        handles.append(Patch(facecolor=FILTERED, alpha=0.4, label=f"what D\N{SUBSCRIPT ONE} can be there"))
        handles.append(Line2D([], [], linestyle="none", marker="D", **_required(), label="what the equation requires"))
    figure.legend(
        handles=handles,
        loc="outside upper left",
        ncols=len(handles),
        frameon=False,
        fontsize=LABEL_SIZE + 0.5,
        labelcolor=INK,
        columnspacing=1.6,
    )


def _draw_strip(ax: Axes, span: Span, row: int, factor: float, horizon: int, names: Sequence[str]) -> None:
    """Draw a span as a box, with its mode's name where there is room."""
    outside = span.mode == NO_MODE
    look = {"facecolor": PAPER, "edgecolor": GRID, "linestyle": (0, (3, 2))} if outside else _look(span.mode)
    box = Rectangle((factor * span.start, row - 0.4), factor * (span.end - span.start), 0.8)
    box.set(**look)
    ax.add_patch(box)
    ax.vlines(factor * span.end, row - 0.4, row + 0.4, color=PAPER, linewidth=1.2)
    name = "outside" if outside else names[span.mode]
    if (0.82 * WIDTH * (span.end - span.start) / horizon) > CHARACTER * (len(name) + 1):
        ax.text(0.5 * factor * (span.start + span.end), row, name, **_word(MUTED if outside else INK))


def _word(color: str) -> dict[str, Any]:
    return {"ha": "center", "va": "center_baseline", "fontsize": TICK_SIZE, "color": color}


def _look(mode: int) -> dict[str, Any]:
    """Return facecolor, hatch and edge of a mode."""
    hatch = HATCHES[mode // len(TINTS) % len(HATCHES)]
    return {"facecolor": TINTS[mode % len(TINTS)], "hatch": hatch, "edgecolor": PAPER, "linewidth": 0}


def _short_names(names: Sequence[str]) -> list[str]:
    """Return names as pictures show them, ready to be drawn."""
    end = "\N{HORIZONTAL ELLIPSIS}"
    return [plain(name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 1] + end) for name in names]


def _columns(labels: Sequence[str]) -> int:
    """Return how many entries of a legend fit side by side."""
    return max(1, int((WIDTH - 0.3) / (1.12 * CHARACTER * max(map(len, labels)) + 0.55)))
